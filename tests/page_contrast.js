// Contrast of text, labels and lines to the background of the page, as in WCAG 2.
(() => {
  const light = (colour) => {
    const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = colour.match(/[\d.]+/g).slice(0, 3).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = light(getComputedStyle(document.body).backgroundColor);
  const ratio = (colour) => (Math.max(light(colour), ground) + 0.05) / (Math.min(light(colour), ground) + 0.05);
  const least = (selector, property) =>
    Math.min(...[...document.querySelectorAll(selector)].map((one) => ratio(getComputedStyle(one)[property])));
  return { ground, text: least("p, td, figcaption, h3, .key", "color"), labels: least(".sheet .tick, .sheet .title", "fill"),
    lines: least(".sheet .line.mark", "stroke") };
})()
