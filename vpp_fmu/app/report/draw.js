// Draws the figures of a report, from the data of vpp_fmu/app/report/canvas.py, as SVG in the page's colours and at its width.
// Point at a line to read it, drag to zoom, double-click to go back, click on a name of the legend to hide it.
"use strict";
const figures = [];
const arrays = []; // of all figures; a page has each array once

function draw(name, spec) {
  const host = document.getElementById(name);
  arrays.push(...spec.arrays.map(floats));
  for (const mark of spec.marks)
    for (const key of ["x", "y", "error"]) {
      if (Number.isInteger(mark[key])) mark[key] = arrays[mark[key]];
    }
  const figure = { host, spec, hidden: new Set(), zoom: {}, width: 0 };
  figures.push(figure);
  const keys = make("div", "keys", host);
  for (const entry of [...spec.marks, ...spec.shapes]) if (entry.shown) legendEntry(figure, keys, entry);
  figure.place = make("div", "sheet", host);
  figure.note = make("div", "tip", host);
  new ResizeObserver(() => paint(figure)).observe(host);
  paint(figure);
}
addEventListener("beforeprint", () => figures.forEach((figure) => paint(figure, 680))); // A4 less its margins, in CSS pixels
addEventListener("afterprint", () => figures.forEach((figure) => paint(figure)));

// ---------------------------------------------------------------------------------------------------------------- elements

const FONT = { tick: 12, title: 13 };
const pen = document.createElement("canvas").getContext("2d");

function make(tag, kind, parent, text) {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  if (text !== undefined) made.textContent = text;
  parent?.append(made);
  return made;
}

function svg(tag, attributes, parent, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  parent?.append(made);
  return made;
}

function floats(text) {
  if (typeof text !== "string") return text;
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

function wide(text, size) {
  pen.font = `${size}px ${getComputedStyle(document.body).fontFamily}`;
  return pen.measureText(text).width;
}

function folded(text, room, size) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = lines[lines.length - 1] ? `${lines[lines.length - 1]} ${word}` : word;
    if (wide(longer, size) <= room || !lines[lines.length - 1]) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}

// ----------------------------------------------------------------------------------------------------------------- numbers

function digits(value, format) {
  const [, sign, places, trim, kind] = /^(\+?)(?:\.(\d+))?(~?)([a-z]?)$/.exec(format);
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const most = places === undefined ? 6 : +places;
  let text;
  if (kind === "f") text = size.toFixed(most);
  else if (kind === "e") text = size.toExponential(most);
  else if (kind === "r") text = size === 0 ? "0" : plain(Number(size.toPrecision(most)), most);
  else text = size.toPrecision(most || 1);
  if ((trim || kind === "g") && text.includes(".")) text = text.replace(/\.?0+(?=e|$)/, "");
  text = text.replace(/e([+-])(\d+)$/, (_, plus, power) => `·10${raised(plus === "-" ? -power : +power)}`);
  return (value < 0 && /[1-9]/.test(text) ? "−" : sign) + text;
}

function plain(size, most) {
  return size >= 10 ** most ? String(size) : size.toFixed(Math.min(20, Math.max(0, most - 1 - Math.floor(Math.log10(size)))));
}

function raised(power) {
  return String(power).replace(/./g, (letter) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(letter)]);
}

// -------------------------------------------------------------------------------------------------------------------- axes

class Axis {
  constructor(given, range) {
    Object.assign(this, { format: ".5~g" }, given);
    [this.low, this.high] = range;
  }

  value(entry) {
    return this.kind === "category" ? this.names.indexOf(entry) : this.kind === "log" ? Math.log10(entry) : entry;
  }

  over(from, to) {
    [this.from, this.to] = this.reversed ? [to, from] : [from, to];
    return this;
  }

  at(entry) {
    return this.from + ((this.value(entry) - this.low) / (this.high - this.low)) * (this.to - this.from);
  }

  inverse(place) {
    const value = this.low + ((place - this.from) / (this.to - this.from)) * (this.high - this.low);
    return this.kind === "log" ? 10 ** value : value;
  }

  // [value, label] of each tick, as many as fit if a label takes `apart(label)` pixels
  ticks(pixels, apart) {
    const fits = (found) =>
      found.every(([value, text], k) => {
        if (!k) return true;
        const room = Math.abs(this.value(value) - this.value(found[k - 1][0])) / (this.high - this.low);
        return room * pixels >= (apart(text) + apart(found[k - 1][1])) / 2;
      });
    const choices = [...this.choices()];
    return choices.find(fits) ?? choices[choices.length - 1] ?? [];
  }

  *choices() {
    const inside = (value) => this.value(value) >= this.low - 1e-9 && this.value(value) <= this.high + 1e-9;
    if (this.kind === "category") {
      for (const every of [1, 2, 5, 10, 20, 50, 100]) yield this.names.map((n) => [n, n]).filter((_, k) => k % every === 0);
    } else if (this.kind === "log") {
      for (const [leading, every] of [[[1, 2, 3, 4, 5, 6, 7, 8, 9], 1], [[1, 2, 5], 1], [[1], 1], [[1], 2], [[1], 4]]) {
        const found = [];
        for (let power = Math.floor(this.low); power <= this.high; power += 1)
          if (power % every === 0) for (const digit of leading) found.push(digit * 10 ** power);
        const seen = found.filter(inside);
        if (seen.length > 1 && seen.length < 14) yield seen.map((value) => [value, logarithmic(value)]);
      }
      yield* this.even(10 ** this.low, 10 ** this.high); // less than a decade
    } else yield* this.even(this.low, this.high);
  }

  // steps of 1, 2 or 5 times a power of ten, the finest first
  *even(low, high) {
    const finest = this.step ?? 10 ** Math.floor(Math.log10((high - low) / 12));
    for (let decade = 1; decade <= 1e4; decade *= 10)
      for (const digit of [1, 2, 5]) {
        const step = finest * decade * digit;
        const first = Math.ceil(low / step - 1e-9);
        const count = Math.floor(high / step + 1e-9) - first + 1;
        if (count > 13) continue;
        if (count < 2) return;
        const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
        yield Array.from({ length: count }, (_, k) => (first + k) * step).map((value) => [value, digits(value, `.${decimals}f`)]);
      }
  }
}

function logarithmic(value) {
  const power = Math.floor(Math.log10(value) + 1e-9);
  const leading = Math.round(value / 10 ** power);
  if (power >= -3 && power < 5) return digits(value, ".1~r");
  return (leading === 1 ? "" : `${leading}·`) + `10${raised(power)}`;
}

function axisOf(figure, name) {
  const given = figure.spec.axes[name];
  if (figure.zoom[name]) return new Axis(given, figure.zoom[name]);
  if (given.range) return new Axis(given, given.range);
  if (given.kind === "category") return new Axis(given, [-0.5, given.names.length - 0.5]);
  const side = name[0];
  let [low, high, round] = [Infinity, -Infinity, false];
  const hold = (value) => {
    const seen = given.kind === "log" ? Math.log10(value) : value;
    if (!Number.isFinite(seen)) return;
    low = Math.min(low, seen);
    high = Math.max(high, seen);
  };
  const window = side === "y" && figure.zoom.x;
  for (const mark of figure.spec.marks) {
    if ((side === "y" && mark.axis !== name) || figure.hidden.has(mark.key)) continue;
    for (let k = 0; k < mark[side].length; k += 1) {
      if (window && !(mark.x[k] >= window[0] && mark.x[k] <= window[1])) continue;
      hold(mark[side][k]);
      if (mark.across === side) {
        hold(mark[side][k] + (mark.error[k] || 0));
        hold(mark[side][k] - (mark.error[k] || 0));
      }
    }
    if (mark.size) round = true;
  }
  for (const shape of figure.spec.shapes) if (shape.axis === name) shape.ends.forEach(hold);
  if (!(low <= high)) [low, high] = [0, 1];
  if (low === high) [low, high] = [low - (Math.abs(low) * 0.1 || 0.5), high + (Math.abs(high) * 0.1 || 0.5)];
  const air = (high - low) * (side === "y" ? 0.06 : round ? 0.025 : 0);
  return new Axis(given, [low - air, high + air]);
}

// ------------------------------------------------------------------------------------------------------------------ layout

const BELOW = 26; // pixels that the labels of an x axis take

function paint(figure, forced) {
  const { spec, host, place } = figure;
  const full = forced ?? host.clientWidth;
  if (!full || (full === figure.width && !figure.stale)) return;
  Object.assign(figure, { width: full, stale: false });
  figure.note.hidden = true;
  const axes = {};
  for (const name of Object.keys(spec.axes)) axes[name] = axisOf(figure, name);
  const placed = spec.panels.map((panel) => ({ ...panel }));
  // The y labels are on the left; those of categories are above their rows if they would take too much of the width.
  let [room, titled] = [0, 0];
  const labels = {};
  for (const panel of placed) {
    const axis = axes[panel.y];
    labels[panel.y] = axis.ticks(panel.tall, () => (axis.kind === "category" ? 0 : 24));
    const widest = Math.max(0, ...labels[panel.y].flatMap(([, text]) => text.split("\n")).map((line) => wide(line, FONT.tick)));
    panel.above = axis.kind === "category" && widest > 0.34 * full;
    if (!panel.above) room = Math.max(room, widest + 9);
    const lines = folded(axis.title, panel.tall, FONT.title).length;
    titled = Math.max(titled, 17 * lines + 4);
  }
  let left = room + titled;
  const { kind, names } = axes.x;
  if (kind === "category") {
    // Labels that do not fit side by side are turned, and extend to the left.
    const step = (full - left - 12) / names.length;
    const reach = names.map((name, k) => 0.77 * wide(name, FONT.tick) - (k + 0.5) * step);
    if (names.some((name) => wide(name, FONT.tick) + 14 > step)) left = Math.max(left, ...reach.map((each) => each + 8));
  }
  const right = full - 12;
  let bottom = 0;
  for (const panel of placed) {
    Object.assign(panel, { x0: left, x1: right, y1: panel.y0 + panel.tall });
    bottom = Math.max(bottom, panel.y1);
  }
  const root = svg("svg", { width: full, height: 10, role: "img", "aria-label": host.dataset.title });
  place.replaceChildren(root);
  const clips = svg("defs", {}, root);
  placed.forEach((panel, k) => {
    const [x, y] = [axes.x.over(panel.x0, panel.x1), axes[panel.y].over(panel.y1, panel.y0)];
    panel.axes = { x, y };
    const clip = svg("clipPath", { id: `${host.id}-${k}` }, clips);
    svg("rect", { x: panel.x0, y: panel.y0 - 1, width: panel.x1 - panel.x0, height: panel.tall + 2 }, clip);
    bottom = Math.max(bottom, frame(root, panel, k === placed.length - 1, labels[panel.y], full));
    const inner = svg("g", { "clip-path": `url(#${host.id}-${k})` }, root);
    const own = spec.marks.filter((mark) => mark.axis === panel.y && !figure.hidden.has(mark.key));
    const shapes = spec.shapes.filter((shape) => ["x", panel.y].includes(shape.axis) && !figure.hidden.has(shape.key));
    for (const shape of shapes) if (shape.fill) shaded(inner, shape, panel);
    own.forEach((mark) => line(inner, mark, panel, own));
    for (const shape of shapes) for (const end of shape.ends) level(inner, shape, panel, end);
  });
  // The titles of the axes: of y in the margin, of x below the labels.
  for (const panel of placed) {
    const lines = folded(panel.axes.y.title, panel.tall, FONT.title);
    const [x, y] = [13, (panel.y0 + panel.y1) / 2];
    const text = svg("text", { transform: `translate(${x} ${y}) rotate(-90)`, "text-anchor": "middle", class: "title" }, root);
    lines.forEach((line, k) => svg("tspan", { x: 0, y: 17 * k }, text, line));
  }
  folded(axes.x.title, full - 16, FONT.title).forEach((line) => {
    bottom += 18;
    const middle = wide(line, FONT.title) < right - left ? (left + right) / 2 : full / 2;
    svg("text", { x: middle, y: bottom, "text-anchor": "middle", class: "title" }, root, line);
  });
  root.setAttribute("height", bottom + 8);
  attend(figure, root, placed);
}

// Grid, axes and labels of a panel; returns how far down the labels reach.
function frame(root, panel, labelled, rows, edge) {
  const { x, y } = panel.axes;
  const { x0, x1, y0, y1 } = panel;
  const back = svg("g", { class: "frame" }, root);
  svg("rect", { x: x0, y: y0, width: x1 - x0, height: y1 - y0, class: "ground" }, back);
  let turned = false;
  let found = x.ticks(x1 - x0, (text) => wide(text, FONT.tick) + 14);
  if (x.kind === "category" && found.length < x.names.length) {
    turned = true;
    found = x.ticks(x1 - x0, () => 20);
  }
  const across = x.kind === "category";
  for (const [value] of found) if (!across) vertical(back, x.at(value), panel, "grid");
  for (const [value] of rows) if (y.kind !== "category") horizontal(back, y.at(value), panel, "grid");
  if (y.kind === "linear" && y.low < 0 && y.high > 0) horizontal(back, y.at(0), panel, "zero");
  vertical(back, x0, panel, "axis");
  horizontal(back, y1, panel, "axis");
  for (const [value, text] of rows) {
    const lines = text.split("\n");
    const height = y.at(value);
    if (panel.above) {
      const half = Math.abs(y.to - y.from) / y.names.length / 2;
      while (lines.length > 1 && x0 + 6 + wide(lines.join(" · "), FONT.tick) > edge) lines.pop(); // the table has it
      svg("text", { x: x0 + 4, y: height - half + 12, class: "tick row" }, root, lines.join(" · "));
      continue;
    }
    const at = { x: x0 - 7, "text-anchor": "end", class: "tick" };
    lines.forEach((line, k) => svg("text", { ...at, y: height + 4 + 14 * (k - (lines.length - 1) / 2) }, root, line));
    if (y.kind !== "category") svg("path", { d: `M${x0 - 4} ${height}h4`, class: "axis" }, back);
  }
  if (!labelled) return y1;
  let reach = 0;
  for (const [value, text] of found) {
    const place = x.at(value);
    if (!across) svg("path", { d: `M${place} ${y1}v4`, class: "axis" }, back);
    if (turned) {
      const angle = { transform: `translate(${place + 4} ${y1 + 12}) rotate(-40)`, "text-anchor": "end", class: "tick turned" };
      svg("text", angle, root, text);
      reach = Math.max(reach, 14 + 0.65 * wide(text, FONT.tick));
    } else svg("text", { x: Math.min(place, edge - wide(text, FONT.tick) / 2 - 1), y: y1 + 18, "text-anchor": "middle", class: "tick" }, root, text);
  }
  return y1 + Math.max(BELOW, reach);
}

function vertical(parent, x, panel, kind) {
  svg("path", { d: `M${x} ${panel.y0}V${panel.y1}`, class: kind }, parent);
}

function horizontal(parent, y, panel, kind) {
  svg("path", { d: `M${panel.x0} ${y}H${panel.x1}`, class: kind }, parent);
}

// ------------------------------------------------------------------------------------------------------------------- marks

const DASHES = { dot: "2 3", dash: "7 4", dashdot: "8 3 2 3" };

function line(parent, mark, panel, own) {
  const points = placedAt(mark, panel);
  if (mark.fill) area(parent, mark, points, placedAt(own[own.indexOf(mark) - 1], panel).reverse());
  if (mark.wide) {
    const style = `stroke:${mark.colour};stroke-width:${mark.wide}`;
    svg("path", { d: path(points, mark.held), class: "mark line", "stroke-dasharray": DASHES[mark.dash], style }, parent);
  }
  if (mark.across) whiskers(parent, mark, panel);
  if (mark.size) for (const [x, y] of points) symbol(parent, mark, x, y);
}

function placedAt(mark, panel) {
  const { x, y } = panel.axes;
  const rows = y.kind === "category" && panel.above ? 7 : 0;
  return Array.from(mark.x, (value, k) => [x.at(value), y.at(mark.y[k]) + rows]);
}

function path(points, held) {
  let [text, down] = ["", false];
  for (const [x, y] of points) {
    if (!Number.isFinite(x) || !Number.isFinite(y)) down = false;
    else {
      text += down ? (held ? `H${x.toFixed(1)}V${y.toFixed(1)}` : `L${x.toFixed(1)} ${y.toFixed(1)}`) : `M${x.toFixed(1)} ${y.toFixed(1)}`;
      down = true;
    }
  }
  return text;
}

function area(parent, mark, points, back) {
  svg("path", { d: `${path([...points, ...back].filter((p) => p.every(Number.isFinite)))}Z`, class: "mark", style: `fill:${mark.fill}` }, parent);
}

function whiskers(parent, mark, panel) {
  const flat = mark.across === "x";
  const axis = panel.axes[mark.across];
  placedAt(mark, panel).forEach(([x, y], k) => {
    const [low, high] = [mark[mark.across][k] - mark.error[k], mark[mark.across][k] + mark.error[k]].map((end) => axis.at(end));
    if (![x, y, low, high].every(Number.isFinite)) return;
    const d = flat ? `M${low} ${y}H${high}M${low} ${y - 4}v8M${high} ${y - 4}v8` : `M${x} ${low}V${high}M${x - 4} ${low}h8M${x - 4} ${high}h8`;
    svg("path", { d, class: "mark line", style: `stroke:${mark.colour};stroke-width:1.6` }, parent);
  });
}

function symbol(parent, mark, x, y) {
  if (!Number.isFinite(x) || !Number.isFinite(y)) return;
  const half = mark.size / 2;
  if (mark.bar) svg("path", { d: `M${x} ${y - half}v${mark.size}`, class: "mark line", style: `stroke:${mark.colour};stroke-width:3` }, parent);
  else svg("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: half, class: "mark", style: `fill:${mark.colour}` }, parent);
}

// A line across the panel: a shape of its own, or the edge of a band.
function level(parent, shape, panel, end) {
  const at = panel.axes[shape.axis[0]].at(end);
  const d = shape.axis === "x" ? `M${at} ${panel.y0}V${panel.y1}` : `M${panel.x0} ${at}H${panel.x1}`;
  const style = `stroke:${shape.colour};stroke-width:${shape.wide}`;
  svg("path", { d, class: "line", "stroke-dasharray": DASHES[shape.dash], style }, parent);
}

function shaded(parent, shape, panel) {
  const [high, low] = shape.ends.map((end) => panel.axes.y.at(end)).sort((a, b) => a - b);
  svg("rect", { x: panel.x0, y: high, width: panel.x1 - panel.x0, height: low - high, style: `fill:${shape.fill}` }, parent);
}

// ------------------------------------------------------------------------------------------------------------------ legend

function legendEntry(figure, keys, entry) {
  const button = make("button", "key", keys);
  button.type = "button";
  const swatch = svg("svg", { width: 26, height: 12, "aria-hidden": "true" }, button);
  if (entry.fill) svg("rect", { x: 2, y: 1, width: 22, height: 10, style: `fill:${entry.fill}` }, swatch);
  else if (entry.wide) {
    const style = `stroke:${entry.colour};stroke-width:${Math.max(entry.wide, 1.5)}`;
    svg("path", { d: "M1 6H25", class: "line", "stroke-dasharray": DASHES[entry.dash], style }, swatch);
  }
  if (entry.size) symbol(swatch, { ...entry, size: Math.min(entry.size, 9) }, 13, 6);
  make("span", "", button, entry.name);
  button.addEventListener("click", () => {
    if (!figure.hidden.delete(entry.key)) figure.hidden.add(entry.key);
    button.classList.toggle("off", figure.hidden.has(entry.key));
    figure.stale = true;
    paint(figure);
  });
}

// ------------------------------------------------------------------------------------------------------- pointing, zooming

function attend(figure, root, placed) {
  const panelAt = (x, y) => placed.find((panel) => x >= panel.x0 - 3 && x <= panel.x1 + 3 && y >= panel.y0 - 11 && y <= panel.y1 + 3);
  const where = (event) => {
    const box = root.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const guide = svg("path", { class: "guide" }, root);
  const frame = svg("rect", { class: "drag", visibility: "hidden" }, root);
  let begun = null;
  const point = (event) => {
    const [x, y] = where(event);
    const panel = panelAt(x, y);
    guide.setAttribute("d", "");
    figure.note.hidden = true;
    if (begun) {
      const flat = figure.spec.unified;
      const from = [Math.min(x, begun.x), flat ? begun.panel.y0 : Math.min(y, begun.y)];
      const size = [Math.abs(x - begun.x), flat ? begun.panel.tall : Math.abs(y - begun.y)];
      const box = { x: from[0], y: from[1], width: size[0], height: size[1], visibility: "visible" };
      for (const [key, value] of Object.entries(box)) frame.setAttribute(key, value);
    } else if (panel) tell(figure, placed, panel, x, y, guide);
  };
  root.addEventListener("pointermove", point);
  root.addEventListener("pointerdown", (event) => {
    const [x, y] = where(event);
    const panel = panelAt(x, y);
    if (event.pointerType !== "mouse") point(event); // a finger scrolls the page; a tap shows the values
    else if (panel && event.button === 0) {
      begun = { x, y, panel };
      root.setPointerCapture(event.pointerId);
    }
  });
  root.addEventListener("pointerup", (event) => {
    if (!begun) return;
    const [x, y] = where(event);
    const { panel } = begun;
    const zoom = (name, axis, from, to) => {
      if (Math.abs(to - from) < 8 || axis.kind === "category") return;
      const ends = [from, to].map((place) => axis.value(axis.inverse(place)));
      figure.zoom[name] = [Math.max(axis.low, Math.min(...ends)), Math.min(axis.high, Math.max(...ends))];
      figure.stale = true;
    };
    zoom("x", panel.axes.x, begun.x, x);
    if (!figure.spec.unified) zoom(panel.y, panel.axes.y, begun.y, y);
    begun = null;
    frame.setAttribute("visibility", "hidden");
    paint(figure);
  });
  root.addEventListener("dblclick", () => {
    figure.zoom = {};
    figure.stale = true;
    paint(figure);
  });
  root.addEventListener("pointerleave", () => {
    guide.setAttribute("d", "");
    figure.note.hidden = true;
  });
}

// Values at the pointer: of lines over one axis all values there, else the nearest point.
function tell(figure, placed, panel, x, y, guide) {
  const { spec } = figure;
  const lines = [];
  if (spec.unified) {
    let at = null;
    for (const each of placed)
      for (const mark of seen(figure, each)) {
        const k = nearest(mark, each, x);
        if (k < 0) continue;
        if (at === null) {
          at = mark.x[k];
          lines.push([`${panel.axes.x.kind === "category" ? at : digits(at, panel.axes.x.format)}${unit(panel.axes.x)}`]);
        }
        lines.push([`${mark.name}: ${digits(mark.y[k], each.axes.y.format)}${unit(each.axes.y)}`, mark.colour]);
      }
    if (lines.length) guide.setAttribute("d", `M${x} ${placed[0].y0}V${placed[placed.length - 1].y1}`);
  } else {
    let [best, found] = [30, null];
    for (const mark of seen(figure, panel))
      placedAt(mark, panel).forEach(([px, py], k) => {
        const far = Math.hypot(px - x, py - y);
        if (far < best) [best, found] = [far, [mark, k]];
      });
    if (!found) return;
    const [mark, k] = found;
    if (mark.name) lines.push([mark.name, mark.colour]);
    const named = (axis, value) => (axis.kind === "category" ? value : digits(value, axis.format) + unit(axis));
    `${named(panel.axes.y, mark.y[k])} at ${named(panel.axes.x, mark.x[k])}`.split("\n").forEach((line) => lines.push([line]));
  }
  if (!lines.length) return;
  figure.note.replaceChildren();
  for (const [text, colour] of lines.slice(0, 16)) {
    const row = make("div", "", figure.note);
    if (colour) make("i", "", row).style.background = colour;
    row.append(text);
  }
  figure.note.hidden = false;
  const offset = figure.place.offsetTop;
  const scrolled = x - figure.place.scrollLeft;
  const beside = scrolled + 14 + figure.note.offsetWidth < figure.width ? scrolled + 14 : scrolled - 14 - figure.note.offsetWidth;
  figure.note.style.left = `${Math.max(0, beside)}px`;
  figure.note.style.top = `${offset + y + 14}px`;
}

function seen(figure, panel) {
  return figure.spec.marks.filter((mark) => mark.axis === panel.y && !mark.mute && !figure.hidden.has(mark.key));
}

function nearest(mark, panel, x) {
  const axis = panel.axes.x;
  let [best, found] = [Infinity, -1];
  for (let k = 0; k < mark.x.length; k += 1) {
    const far = Math.abs(axis.at(mark.x[k]) - x);
    if (far < best && Number.isFinite(mark.y[k])) [best, found] = [far, k];
  }
  return found;
}

function unit(axis) {
  const found = /\[([^\]]+)\]$/.exec(axis.title);
  return found && found[1] !== "-" ? ` ${found[1]}` : "";
}
