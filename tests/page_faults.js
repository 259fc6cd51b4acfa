// Faults in the layout of a page, one a line.
(() => {
  const slack = 2; // pixels: the box of a text is higher than its letters
  const faults = [];
  const told = (element) => `${element.closest(".plot")?.id ?? element.tagName} "${element.textContent.slice(0, 40)}"`;
  const room = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > room) faults.push(`the page is ${document.documentElement.scrollWidth} wide`);
  for (const element of document.querySelectorAll("main *")) {
    if (element.closest(".table, .sheet, .tip, pre")) continue;
    if (element.getBoundingClientRect().right > room + 1) faults.push(`beyond the page: ${told(element)}`);
  }
  // Turned labels stand side by side in their own direction: there they are compared.
  const box = (text) => {
    const turn = /translate\(([-.\d]+) ([-.\d]+)\) rotate\(-40\)/.exec(text.getAttribute("transform") ?? "");
    if (!turn) return { turned: false, ...text.getBoundingClientRect().toJSON() };
    const [x, y, c, s] = [+turn[1], +turn[2], Math.cos((40 * Math.PI) / 180), Math.sin((40 * Math.PI) / 180)];
    const [own, left, top] = [text.getBBox(), x * c - y * s, x * s + y * c];
    return { turned: true, left: left + own.x, right: left + own.x + own.width, top: top + own.y,
      bottom: top + own.y + own.height };
  };
  const share = (a, b) =>
    Math.min(Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top));
  for (const plot of document.querySelectorAll(".plot")) {
    const sheet = plot.querySelector(".sheet svg");
    if (!sheet) { faults.push(`not drawn: ${plot.id}`); continue; }
    for (const panel of sheet.querySelectorAll("g[clip-path]")) {
      const marks = [...panel.querySelectorAll(".mark")].map((mark) => mark.getBBox());
      if (!marks.some((one) => one.width > 1 || one.height > 1)) faults.push(`empty panel: ${plot.id}`);
    }
    const texts = [...sheet.querySelectorAll("text")].filter((text) => text.textContent);
    const [frame, boxes] = [sheet.getBoundingClientRect(), texts.map(box)];
    texts.forEach((text, k) => {
      const own = text.getBoundingClientRect();
      if (own.left < frame.left - 1 || own.right > frame.right + 1 || own.bottom > frame.bottom + 1 || own.top < frame.top - 1)
        faults.push(`cut off: ${told(text)} of ${plot.id}`);
      for (let j = 0; j < k; j += 1)
        if (boxes[j].turned === boxes[k].turned && share(boxes[j], boxes[k]) > slack)
          faults.push(`overlap in ${plot.id}: "${texts[j].textContent}" and "${text.textContent}"`);
    });
    const keys = plot.querySelector(".keys").getBoundingClientRect();
    if (keys.bottom > frame.top + 1) faults.push(`the legend covers ${plot.id}`);
  }
  return [...new Set(faults)];
})()
