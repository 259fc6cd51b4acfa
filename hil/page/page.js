// Draws the server's stream, and sends STOP. Only its one POST reaches the rig.
"use strict";
const at = (id) => document.getElementById(id);
const SHOWN = 60; // s of the curves
const SUPPLY = [["voltage", 1, "V"], ["current", 1, "A"], ["temperature", 0, "°C"], ["torque", 3, "N·m"]];
const LIMITS = [ // name, unit, the supply's sensors that it needs, keys in hil.json
  ["speed command", "rpm", [], "omega_min", "omega_max"], ["pitch command", "deg", [], "beta_min", "beta_max"],
  ["over-speed", "rpm", [], "omega_trip"], ["over-thrust", "N", [], "thrust_trip"], ["run time", "s", [], "run_time"],
  ["lowest voltage", "V", ["voltage"], "voltage_min"], ["highest voltage", "V", ["voltage"], "voltage_max"],
  ["current", "A", ["current"], "current_max"], ["power", "W", ["voltage", "current"], "power_max"],
  ["temperature", "°C", ["temperature"], "temperature_max"],
];
const dark = matchMedia("(prefers-color-scheme: dark)");
let told = {}, part = {}, number = -1, columns = [], curves = {time: []}, now = {}, map = [], heard = performance.now(), ended = "", failed = "", drawn = 0, news = false;

function text(value, digits, unit) {
  return value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`.trim();
}

function element(tag, content, className) {
  const made = document.createElement(tag);
  made.textContent = content;
  if (className) made.className = className;
  return made;
}

function row(cells, className, numbers = [0]) {
  const made = document.createElement("tr");
  if (className) made.className = className;
  cells.forEach((cell, k) => made.append(element("td", cell, numbers.includes(k) ? "number" : "")));
  return made;
}

// --- STOP acts on the press and not on the release; from the keyboard on the click, whose detail is then 0.

async function stop() {
  at("stop").classList.add("pressed");
  try {
    const answer = await fetch("stop", {method: "POST", keepalive: true});
    if (answer.status === 409) return;
    if (!answer.ok) throw new Error(`refused (${answer.status})`);
    at("stop").querySelector("b").textContent = "STOP AT ONCE";
    at("stop-does").textContent = "asked to ramp down; again: idle at once";
  } catch (error) {
    failed = `STOP did not reach the rig (${error.message}): Ctrl-C in the terminal, or the emergency stop`;
    banner();
  } finally {
    at("stop").classList.remove("pressed");
  }
}
at("stop").addEventListener("pointerdown", (event) => { if (event.button === 0) stop(); });
at("stop").addEventListener("click", (event) => { if (event.detail === 0) stop(); });

// --- Messages

const stream = new EventSource("stream");
stream.onmessage = (event) => {
  const message = JSON.parse(event.data);
  heard = performance.now();
  if (message.number !== number) begin(message);
  for (const point of message.curves) point.forEach((value, k) => curves[columns[k]].push(value));
  const old = curves.time.findIndex((t) => t > curves.time[curves.time.length - 1] - SHOWN - 5);
  if (old > 0) for (const name of columns) curves[name].splice(0, old);
  now = message.now;
  news ||= message.curves.length > 0;
  for (const one of message.events) {
    const alarm = /alarm/.test(one.why) || one.state === "fault" || /^page:/.test(one.why);
    at("events").prepend(row([text(one.time, 2, ""), one.state, one.why], alarm ? "alarm" : ""));
  }
  map.push(...message.map);
  if (message.map.length) drawMap();
  at("counters").replaceChildren(...healed(message.counters));
  if (message.ended) { ended = message.ended; stream.close(); }
  values();
  twinSays();
  banner();
};

function begin(message) {
  ({number, told, part, columns} = message);
  curves = Object.fromEntries(columns.map((name) => [name, []]));
  map = [];
  at("events").replaceChildren();
  const who = [told.operator, told.host].filter(Boolean).join(" on ");
  const over = told.profile ? `, ${told.profile.file}` : "";
  const hidden = (told.hidden || []).length ? ` with ${told.hidden.join(", ")} hidden in it` : "";
  at("what").textContent = `The ${told.rig} rig${hidden}${over}; ${who}; begun ${told.begun}; calibration ${(told.calibration.sha256 || "").slice(0, 12)}.`;
  at("limits").replaceChildren(...limits());
  at("parts").hidden = !part.parts;
  const current = (part.parts || []).indexOf(part.part);
  at("parts").replaceChildren(...(part.parts || []).map((name, k) =>
    element("li", `${k < current ? "✓ " : ""}${name.replaceAll("_", " ")}`, k === current ? "now" : "")));
  at("twin").hidden = !told.twin;
  at("map-figure").hidden = !part.grid;
  if (part.grid) drawMap();
}

function limits() {
  const known = told.limits || {}, read = told.supply || [];
  const shown = LIMITS.filter(([,, sensors, low]) => low in known && sensors.every((name) => read.includes(name)));
  return shown.map(([name, unit,, ...keys]) => row([name, `${keys.map((key) => known[key]).join(" to ")} ${unit}`], "", []));
}

function healed(counters) {
  const rows = Object.entries(counters).flatMap(([device, counts]) =>
    Object.entries(counts).map(([what, count]) => row([count, `${device}: ${what}`])));
  return rows.length ? rows : [row(["nothing went wrong"], "", [])];
}

// --- Header, tiles and progress

function values() {
  const state = ended ? "ended" : now.state || "waiting";
  at("state").textContent = now.alarm && !ended ? `${state} · alarm` : state;
  at("clock").textContent = now.time === undefined ? "" : `${now.time.toFixed(1)} s`;
  document.title = `${state} – rig`;
  at("stop").disabled = Boolean(ended);
  if (ended) [at("stop").querySelector("b").textContent, at("stop-does").textContent] = ["STOP", "nothing turns"];
  const tiles = [
    ["thrust", text(now.thrust, 2, "N"), `set-point ${text(now.thrust_set, 2, "N")}`],
    ["speed", text(now.omega, 0, "rpm"), `command ${text(now.omega_ref, 0, "rpm")}`],
    ["pitch command", text(now.beta_ref, 1, "deg"), `wanted ${text(now.beta_wanted, 1, "deg")}`],
    ["throttle", text(now.throttle === undefined ? null : 100 * now.throttle, 0, "%"), `tick ${text(now.late === undefined ? null : 1e3 * now.late, 2, "ms")} late`],
  ];
  const supply = SUPPLY.filter(([name]) => (told.supply || []).includes(name)).map(([name, digits, unit]) => text(now[name], digits, unit));
  if (supply.length) tiles.push(["supply", supply[0], supply.slice(1).join(", ")]);
  const twin = now.twin || {};
  if (told.twin) tiles.push(["off its twin", text(now.residual, 2, "N"), twin.alarm ? `ALARM: most like ${cause(twin)}` : `band ± ${text(now["twin.band"], 2, "N")}`, twin.alarm]);
  at("tiles").replaceChildren(...tiles.map(([label, value, small, alarm]) => {
    const tile = element("div", "", alarm ? "tile alarm" : "tile");
    tile.append(element("div", label, "label"), element("div", value, "value"), element("div", small, "small"));
    return tile;
  }));
  const done = now.done;
  at("progress").hidden = done === null || done === undefined;
  if (done !== null && done !== undefined) {
    at("bar").style.width = `${100 * done}%`;
    const count = part.grid ? `, ${map.length} of ${part.grid.speeds.length * part.grid.pitches.length} points` : "";
    at("done").textContent = `${(part.part || "").replaceAll("_", " ")} ${Math.floor(100 * done)} %${count}`;
  }
}

// --- The twin: its last values stay after the loop was closed

function cause(twin) {
  return ["no parameter", ...Object.keys(told.twin.adapted)][twin.direction];
}

function digits(uncertainty) { // decimals of two digits of a standard deviation
  return uncertainty > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(uncertainty)), 0), 9) : 4;
}

function twinSays() {
  if (!told.twin) return;
  const {adapted, certain} = told.twin, twin = now.twin || {}, known = twin.band !== undefined;
  const followed = twin.changes ? ` Changes followed: ${twin.changes}, the last most like ${cause(twin)}.` : " No change followed yet.";
  const like = twin.direction ? `Most like a change of ${cause(twin)} (${adapted[cause(twin)]?.description})` : "It is like no change of one parameter";
  at("twin-says").className = twin.alarm ? "alarm" : "";
  const learns = twin.learning ? "It follows the rig, to see whether its parameters explain it." : "No parameter explains it: it has stopped learning, for vpp diagnose to look at.";
  at("twin-says").textContent = !known ? "It begins when the loop is closed." : twin.alarm
    ? `ALARM: the rig does not do what the adapted model says. ${like}. ${learns}` : `No alarm.${followed}`;
  at("adapted").replaceChildren(...Object.entries(adapted).map(([name, one]) => {
    const [value, std] = [twin[`adapted.${name}`], twin[`std.${name}`]], places = digits(std ?? one.change);
    const moved = known && Math.abs(value - one.start) > certain * std;
    const made = row([name, one.unit, text(one.start, places, ""), `${moved ? (value > one.start ? "↑ " : "↓ ") : ""}${text(value, places, "")}`, text(std, places, "")],
      moved ? "moved" : "", [2, 3, 4]);
    made.children[0].append(element("span", one.description));
    made.children[3].classList.add("now");
    return made;
  }));
}

function banner() {
  const silent = (performance.now() - heard) / 1000;
  let said = failed, note = false;
  if (!said && ended) [said, note] = [`It is over: ${ended}`, true];
  if (!said && silent > 1.0) said = `Nothing heard for ${silent.toFixed(0)} s: STOP may not reach the rig. Ctrl-C in the terminal, or the emergency stop`;
  if (!said && now.age > 0.5 && now.state !== "safe") said = `The loop has not ticked for ${now.age.toFixed(1)} s`;
  at("banner").hidden = !said;
  at("banner").className = note ? "note" : "";
  at("banner").textContent = said;
}
setInterval(banner, 500);

// --- The curves

function colours() {
  return dark.matches
    ? {ink: "#e4e9ee", grid: "#2a333b", axis: "#6b7885", measured: "#d7dde3", set: "#f0a94e", twin: "#56b4e9", band: "rgba(86,180,233,0.18)", back: "#14191e"}
    : {ink: "#1f2933", grid: "#e8ecef", axis: "#9aa5b1", measured: "#4d4d4d", set: "#e08214", twin: "#0072b2", band: "rgba(0,114,178,0.14)", back: "#ffffff"};
}

function axis(own, c) {
  return {gridcolor: c.grid, linecolor: c.axis, showline: true, zeroline: false, exponentformat: "none", automargin: true, fixedrange: true, ...own};
}

function layout(own, c) {
  return {
    paper_bgcolor: c.back, plot_bgcolor: c.back, font: {color: c.ink, size: 13, family: "system-ui, sans-serif"}, separators: ".",
    margin: {l: 62, r: 14, t: 34, b: 44}, legend: {orientation: "h", x: 0, y: 1.0, yanchor: "bottom"}, ...own,
  };
}
const settings = {responsive: true, displayModeBar: false};

function line(x, y, name, color, axes, more) {
  return {x, y, name, type: "scatter", mode: "lines", line: {color, width: 1.8}, yaxis: axes, hoverinfo: "name+y", ...more};
}

function draw() {
  if (document.hidden || !news) return;
  news = false;
  const c = colours(), {time: x, thrust, residual} = curves, last = x[x.length - 1];
  const twin = residual.map((off, k) => (off === null ? null : thrust[k] - off));
  const dashed = (color) => ({line: {color, width: 1.6, dash: "dash", shape: "hv"}});
  const traces = [];
  if (told.twin) {
    const edge = (side) => twin.map((value, k) => (value === null ? null : value + side * curves["twin.band"][k]));
    const unseen = {line: {width: 0}, hoverinfo: "skip"};
    traces.push(line(x, edge(-1), "", c.band, "y", {...unseen, showlegend: false}));
    traces.push(line(x, edge(1), "twin's band", c.band, "y", {...unseen, fill: "tonexty", fillcolor: c.band}));
    traces.push(line(x, twin, "twin", c.twin, "y", {line: {color: c.twin, width: 1.4}}));
  }
  traces.push(line(x, thrust, "measured", c.measured, "y"), line(x, curves.thrust_set, "set-point, command", c.set, "y", dashed(c.set)));
  traces.push(line(x, curves.omega, "speed", c.measured, "y2", {showlegend: false}), line(x, curves.omega_ref, "command", c.set, "y2", {...dashed(c.set), showlegend: false}));
  traces.push(line(x, curves.beta_wanted, "wanted by the controller", c.axis, "y3", {line: {color: c.axis, width: 1.2, dash: "dot", shape: "hv"}}));
  traces.push(line(x, curves.beta_ref, "command", c.set, "y3", {showlegend: false, line: {color: c.set, width: 1.8, shape: "hv"}}));
  drawn += 1;
  Plotly.react("curves", traces, layout({
    datarevision: drawn,
    xaxis: axis({title: {text: "time [s]"}, range: [Math.max(last - SHOWN, x[0]), Math.max(last, x[0] + 10)], anchor: "y3"}, c),
    yaxis: axis({title: {text: "thrust [N]"}, domain: [0.56, 1.0]}, c),
    yaxis2: axis({title: {text: "speed [rpm]"}, domain: [0.28, 0.52]}, c),
    yaxis3: axis({title: {text: "pitch [deg]"}, domain: [0.0, 0.24]}, c),
  }, c), settings);
}
setInterval(draw, 250);

function drawAnew() { news = curves.time.length > 0; draw(); drawMap(); }
dark.addEventListener("change", drawAnew);
document.addEventListener("visibilitychange", drawAnew);
new ResizeObserver(() => {
  for (const name of ["curves", "map"]) if (at(name).layout && at(name).clientWidth) Plotly.Plots.resize(name);
}).observe(at("curves"));

function drawMap() {
  if (!part.grid) return;
  const c = colours(), {speeds, pitches} = part.grid;
  const planned = speeds.flatMap((w) => pitches.map((b) => [w, b]));
  const column = (points, k) => points.map((point) => point[k]);
  const shared = {type: "scatter", mode: "markers"};
  Plotly.react("map", [
    {...shared, x: column(planned, 0), y: column(planned, 1), hoverinfo: "skip", showlegend: false,
      marker: {symbol: "square-open", size: 15, color: c.axis, line: {width: 1}}},
    {...shared, x: column(map, 0), y: column(map, 1), text: column(map, 3).map((t) => `${t.toFixed(2)} N`), hoverinfo: "text+x+y", showlegend: false,
      marker: {symbol: "square", size: 15, color: column(map, 3), colorscale: "Viridis", showscale: true, colorbar: {title: {text: "thrust [N]"}, thickness: 14, exponentformat: "none"}}},
  ], layout({
    xaxis: axis({title: {text: "speed [rpm]"}}, c), yaxis: axis({title: {text: "pitch [deg]"}}, c), margin: {l: 62, r: 14, t: 14, b: 44},
  }, c), settings);
}
