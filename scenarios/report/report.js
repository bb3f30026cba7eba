"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const RAD = Math.PI / 180;

/* Names are the user's: they enter the page as text nodes and attributes, never as markup. */
function node(tag, attributes = {}, ...children) {
  const made = SVG.has(tag) ? document.createElementNS(document.querySelector("svg").namespaceURI, tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
const SVG = new Set(["svg", "g", "line", "text", "title", "circle", "polygon"]);
const dotOf = (name) => { const dot = node("i", { class: "dot" }); dot.style.setProperty("--colour", colour[name]); return dot; };

/* One colour per estimator, the same in every chart; after Paul Tol's and Okabe & Ito's colour-blind safe sets. */
const PALETTE = ["#8a8f98", "#0072b2", "#56b4e9", "#e69f00", "#009e73", "#7b5cd6", "#b294e8", "#cc79a7", "#a6761d", "#c9a27a", "#12aebd", "#7f9f2f", "#ff8a75", "#d62728"];
const DASHES = [[], [7, 3], [2, 2]]; // the palette a second and a third time over
const colour = Object.fromEntries(data.estimators.map((name, i) => [name, PALETTE[i % PALETTE.length]]));
const dash = Object.fromEntries(data.estimators.map((name, i) => [name, DASHES[Math.floor(i / PALETTE.length) % DASHES.length]]));
for (const dot of all(".dot")) dot.style.setProperty("--colour", colour[dot.dataset.estimator] ?? "#888");

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const cell = (scenario, estimator) => data.cells[scenario + "|" + estimator];
const state = { scenario: data.scenarios[0], shown: new Set(), from: 0, to: Infinity, time: 0 };

/* ---- theme ---- */
$("theme").onclick = () => {
  const dark = document.documentElement.dataset.theme
    ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  redraw();
};

/* ---- tables ---- */
for (const table of all("table.sortable")) {
  all("th", table).forEach((th, column) => {
    th.querySelector("button").onclick = () => sortBy(table, th, column);
  });
}
function sortBy(table, th, column) {
  const up = !th.classList.contains("up");
  for (const other of all("th", table)) { other.classList.remove("up", "down"); other.removeAttribute("aria-sort"); }
  th.classList.add(up ? "up" : "down");
  th.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = (row) => {
    const td = row.cells[column];
    if (!td) return null;
    if (td.dataset.value === undefined) return td.classList.contains("failed") ? null : td.textContent.trim();
    return td.dataset.value === "" ? null : Number(td.dataset.value);
  };
  const compare = (a, b) => {
    const [x, y] = [key(a), key(b)];
    if (x === null || y === null) return (x === null) - (y === null); // what has no value stays last
    return (up ? 1 : -1) * (typeof x === "number" ? x - y : x.localeCompare(y));
  };
  const body = table.tBodies[0];
  body.append(...[...body.rows].sort(compare));
}

function closedLoop() {
  for (const select of [...all("select.scenario"), ...["spread-scenario", "table-scenario", "pairs-scenario"].map($)])
    for (const name of data.scenarios) select?.add(new Option(name, name));
  const focus = data.estimators.filter((name) => data.shown.includes(name));
  for (const name of focus) state.shown.add(name);
  for (const [key, q] of Object.entries(QUANTITIES)) $("quantity").add(new Option(q.label, key));
  for (const name of data.estimators) {
    const chip = document.createElement("button");
    chip.type = "button";
    chip.append(dotOf(name), name);
    chip.style.setProperty("--colour", colour[name]);
    chip.onclick = () => { state.shown.has(name) ? state.shown.delete(name) : state.shown.add(name); redraw(); };
    chip.dataset.estimator = name;
    $("chips").append(chip);
  }
  $("map-metric").onchange = drawMap;
  $("quantity").onchange = redraw;
  $("spread-scenario").onchange = drawViolins;
  $("table-scenario").onchange = (event) => {
    for (const row of $("results").tBodies[0].rows) row.hidden = event.target.value && row.dataset.scenario !== event.target.value;
  };
  if ($("pairs")) {
    for (const name of data.estimators) $("pairs-base").add(new Option(name, name, false, name === data.best));
    for (const id of ["pairs-base", "pairs-scenario", "pairs-metric"]) $(id).onchange = drawForest;
    drawForest();
  }
  for (const select of all("select.scenario")) select.onchange = () => choose(select.value);
  for (const td of all(".heat td")) {
    td.onclick = () => { state.shown.add(td.dataset.estimator); choose(td.dataset.scenario); $("series").scrollIntoView(); };
    td.onkeydown = (event) => { if (event.key === "Enter") td.onclick(); };
  }
  zoomable($("plot"));
  turnable($("stage"));
  player();
  for (const change of ["resize", "beforeprint", "afterprint"]) addEventListener(change, redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  choose(state.scenario);
  drawMap();
  drawViolins();
}
function choose(scenario) {
  state.scenario = scenario;
  [state.from, state.to, state.time] = [0, Infinity, 0];
  for (const select of all("select.scenario")) select.value = scenario;
  redraw();
}
function redraw() {
  if (!data.scenarios.length) return;
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", state.shown.has(chip.dataset.estimator));
  for (const td of all(".heat td")) td.classList.toggle("chosen", td.dataset.scenario === state.scenario && state.shown.has(td.dataset.estimator));
  drawPlot();
  drawStage();
  drawViolins();
  if ($("pairs")) drawForest();
}

/* ---- heat map ---- */
function drawMap() {
  const metric = data.metrics.find((m) => m.key === $("map-metric").value);
  const cells = all(".heat td").map((td) => [td, cell(td.dataset.scenario, td.dataset.estimator)]);
  const positive = cells.map(([, c]) => c?.values[metric.key]).filter((v) => v > 0);
  const [low, high] = [Math.log(Math.min(...positive)), Math.log(Math.max(...positive))];
  for (const [td, c] of cells) {
    const value = c?.values[metric.key];
    const known = value !== null && value !== undefined;
    td.querySelector("b").textContent = known ? value.toFixed(metric.digits) : "";
    td.classList.toggle("none", !known);
    td.classList.toggle("crashed", c?.values.crash_rate > 0);
    const t = metric.key.endsWith("rate") ? value : value > 0 && high > low ? (Math.log(value) - low) / (high - low) : 0;
    td.style.setProperty("--t", known ? t.toFixed(3) : 0);
  }
}

/* ---- the series, stored as scaled 16-bit integers ---- */
function series(scenario, estimator) {
  const c = cell(scenario, estimator);
  if (!c?.series) return null;
  if (c.decoded) return c.decoded;
  const decoded = { dt: c.series.dt };
  for (const [name, { scale, data }] of Object.entries(c.series.channels)) {
    const bytes = Uint8Array.from(atob(data), (character) => character.charCodeAt(0));
    decoded[name] = Float32Array.from(new Int16Array(bytes.buffer), (q) => q * scale);
  }
  return (c.decoded = decoded);
}
const zip = (s, f) => Float32Array.from(s.roll, (_, k) => f(k));
const down = (roll, pitch) => [-Math.sin(pitch), Math.sin(roll) * Math.cos(pitch), Math.cos(roll) * Math.cos(pitch)];
function inclination(s) {
  return zip(s, (k) => {
    const [a, b] = [down(s.roll[k] * RAD, s.pitch[k] * RAD), down(s.roll_est[k] * RAD, s.pitch_est[k] * RAD)];
    const cross = Math.hypot(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
    return Math.atan2(cross, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / RAD;
  });
}
const QUANTITIES = {
  inclination: { label: "Inclination error [deg]", main: inclination },
  roll: { label: "Roll, estimated and true [deg]", main: (s) => s.roll_est, truth: (s) => s.roll },
  pitch: { label: "Pitch, estimated and true [deg]", main: (s) => s.pitch_est, truth: (s) => s.pitch },
  roll_error: { label: "Roll error [deg]", main: (s) => zip(s, (k) => s.roll_est[k] - s.roll[k]) },
  pitch_error: { label: "Pitch error [deg]", main: (s) => zip(s, (k) => s.pitch_est[k] - s.pitch[k]) },
  away: { label: "Distance from the set point [m]", main: (s) => zip(s, (k) => Math.hypot(s.x[k] - s.x_ref[k], s.y[k] - s.y_ref[k], s.z[k] - s.z_ref[k])) },
  x: { label: "x and set point [m]", main: (s) => s.x, truth: (s) => s.x_ref },
  y: { label: "y and set point [m]", main: (s) => s.y, truth: (s) => s.y_ref },
  z: { label: "Height and set point [m]", main: (s) => s.z, truth: (s) => s.z_ref },
};
const flights = () => data.estimators.filter((e) => state.shown.has(e)).map((e) => [e, series(state.scenario, e)]).filter(([, s]) => s);

/* ---- time plot ---- */
const BOX = { left: 52, right: 14, top: 12, bottom: 30 };
let frame = null;
function prepare(canvas) {
  const [width, height, ratio] = [canvas.clientWidth, Number(canvas.dataset.height), devicePixelRatio || 1];
  canvas.style.height = height + "px";
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  return [pen, width, height];
}
function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const out = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) out.push(Math.abs(v) < step * 1e-6 ? 0 : v);
  return [out, Math.max(0, -Math.floor(Math.log10(step)))];
}
function drawPlot() {
  const [pen, width, height] = prepare($("plot"));
  const quantity = QUANTITIES[$("quantity").value];
  const lines = flights().map(([name, s]) => ({ name, dt: s.dt, main: quantity.main(s), truth: quantity.truth?.(s) }));
  const end = Math.max(1, ...lines.map((l) => (l.main.length - 1) * l.dt));
  const [t0, t1] = [Math.max(0, state.from), Math.min(end, state.to)];
  let [low, high] = [Infinity, -Infinity];
  for (const line of lines) for (const values of [line.main, line.truth ?? []])
    for (let k = Math.max(0, Math.floor(t0 / line.dt)); k < values.length && k * line.dt <= t1; k++) {
      if (values[k] < low) low = values[k];
      if (values[k] > high) high = values[k];
    }
  if (!(high > low)) [low, high] = [Math.min(0, low === Infinity ? 0 : low - 1), high === -Infinity ? 1 : high + 1];
  const pad = 0.06 * (high - low);
  high += pad; low = quantity === QUANTITIES.inclination || quantity === QUANTITIES.away ? 0 : low - pad;
  const X = (t) => BOX.left + ((t - t0) / (t1 - t0)) * (width - BOX.left - BOX.right);
  const Y = (v) => height - BOX.bottom - ((v - low) / (high - low)) * (height - BOX.top - BOX.bottom);
  pen.strokeStyle = css("--line"); pen.fillStyle = css("--soft"); pen.lineWidth = 1;
  const [ys, yd] = ticks(low, high, 6), [xs, xd] = ticks(t0, t1, Math.max(3, width / 110));
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const v of ys) { rule(pen, BOX.left, Y(v), width - BOX.right, Y(v)); pen.fillText(v.toFixed(yd), BOX.left - 7, Y(v)); }
  pen.textAlign = "center"; pen.textBaseline = "top";
  for (const v of xs) pen.fillText(v.toFixed(xd) + " s", X(v), height - BOX.bottom + 8);
  pen.save(); pen.beginPath(); pen.rect(BOX.left, 0, width - BOX.left - BOX.right, height - BOX.bottom); pen.clip();
  for (const line of lines) {
    if (line.truth) { pen.globalAlpha = 0.45; trace(pen, line.truth, line.dt, X, Y, t0, t1, colour[line.name], 3.5, []); pen.globalAlpha = 1; }
    trace(pen, line.main, line.dt, X, Y, t0, t1, colour[line.name], 1.5, dash[line.name]);
    const last = (line.main.length - 1) * line.dt;
    if (last < end - 0.5) { pen.fillStyle = colour[line.name]; pen.textAlign = "center"; pen.textBaseline = "middle"; pen.font = "bold 16px system-ui"; pen.fillText("✕", X(last), Y(line.main.at(-1))); }
  }
  pen.restore();
  frame = { lines, t0, t1, end, width, X, Y };
  $("plot-note").textContent = lines.length
    ? `One flight of each estimator, all with the same seed (${data.series_seed}), hence the same wind and the same sensor noise. ✕: crashed.` + (quantity.truth ? " Thin: estimate or position; broad and pale: truth or set point." : "")
    : "No flight is stored for this choice.";
}
function rule(pen, x0, y0, x1, y1) { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); }
function trace(pen, values, dt, X, Y, t0, t1, stroke, thick, pattern) {
  pen.beginPath(); pen.strokeStyle = stroke; pen.lineWidth = thick; pen.lineJoin = "round"; pen.setLineDash(pattern);
  const first = Math.max(0, Math.floor(t0 / dt) - 1), last = Math.min(values.length - 1, Math.ceil(t1 / dt) + 1);
  for (let k = first; k <= last; k++) k === first ? pen.moveTo(X(k * dt), Y(values[k])) : pen.lineTo(X(k * dt), Y(values[k]));
  pen.stroke(); pen.setLineDash([]);
}
function zoomable(canvas) {
  let start = null;
  const time = (x) => frame.t0 + ((x - BOX.left) / (frame.width - BOX.left - BOX.right)) * (frame.t1 - frame.t0);
  canvas.onpointerdown = (event) => { start = event.offsetX; canvas.setPointerCapture(event.pointerId); };
  canvas.onpointermove = (event) => {
    if (!frame?.lines.length) return;
    drawPlot();
    const pen = canvas.getContext("2d"), x = event.offsetX, height = Number(canvas.dataset.height);
    pen.strokeStyle = css("--soft"); pen.lineWidth = 1; rule(pen, x, BOX.top, x, height - BOX.bottom);
    if (start !== null) { pen.fillStyle = css("--accent"); pen.globalAlpha = 0.15; pen.fillRect(Math.min(start, x), BOX.top, Math.abs(x - start), height - BOX.top - BOX.bottom); pen.globalAlpha = 1; }
    const t = time(x), rows = frame.lines.map((l) => [l.name, l.main[Math.round(t / l.dt)]]).filter(([, v]) => v !== undefined);
    const box = $("readout");
    box.hidden = t < frame.t0 || t > frame.t1;
    box.replaceChildren(
      node("b", {}, `${t.toFixed(2)} s`),
      ...rows.map(([n, v]) => node("div", {}, node("span", {}, dotOf(n), n), node("span", {}, v.toFixed(2)))),
    );
    box.style.left = (x > frame.width / 2 ? x - box.offsetWidth - 12 : x + 12) + "px"; box.style.top = "14px";
  };
  canvas.onpointerup = (event) => {
    if (start !== null && Math.abs(event.offsetX - start) > 6) {
      [state.from, state.to] = [time(start), time(event.offsetX)].sort((a, b) => a - b);
    }
    start = null; drawPlot();
  };
  canvas.onpointerleave = () => { $("readout").hidden = true; if (start === null) drawPlot(); };
  canvas.ondblclick = () => { [state.from, state.to] = [0, Infinity]; drawPlot(); };
  canvas.onkeydown = (event) => { if (event.key === "Escape") canvas.ondblclick(); };
}

/* ---- violins ---- */
function drawViolins() {
  const scenario = $("spread-scenario").value, { low, high, bins } = data.edges;
  const rows = data.estimators.filter((e) => e !== "truth").map((e) => {
    const total = new Float64Array(bins);
    for (const s of scenario ? [scenario] : data.scenarios) cell(s, e)?.histogram?.forEach((count, i) => { total[i] += count; });
    return [e, total, total.reduce((a, b) => a + b, 0)];
  }).filter(([, , n]) => n > 0);
  const [left, width, tall] = [165, 900, 46], bottom = 26, height = rows.length * tall + bottom;
  const X = (decade) => left + ((decade - low) / (high - low)) * (width - left - 20);
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Distribution of errors by estimator" });
  for (const v of [0.01, 0.1, 1, 10, 100]) svg.append(...mark(X(Math.log10(v)), height, bottom, `${v}°`));
  rows.forEach(([name, counts, n], i) => {
    const smooth = blur(counts), peak = Math.max(...smooth), middle = (i + 0.5) * tall, step = (high - low) / bins;
    const edge = (sign) => [...smooth].map((c, k) => `${X(low + (k + 0.5) * step).toFixed(1)},${(middle + sign * (c / peak) * tall * 0.42).toFixed(1)}`);
    const at = (p) => { let sum = 0; for (let k = 0; k < bins; k++) { if (sum + counts[k] >= p * n) return X(low + (k + (p * n - sum) / counts[k]) * step); sum += counts[k]; } return X(high); };
    const median = at(0.5);
    svg.append(node("g", {}, ...label(name, left - 12, middle + 4),
      node("polygon", { points: [...edge(-1), ...edge(1).reverse()].join(" "), fill: colour[name], "fill-opacity": 0.35, stroke: colour[name] }),
      node("line", { x1: at(0.25), x2: at(0.75), y1: middle, y2: middle, stroke: colour[name], "stroke-width": 5, "stroke-linecap": "round" }),
      node("line", { x1: median, x2: median, y1: middle - 11, y2: middle + 11, stroke: css("--ink"), "stroke-width": 2 })));
  });
  $("violins").replaceChildren(svg);
}
function mark(x, height, bottom, text) {
  return [node("line", { class: "grid", x1: x, x2: x, y1: 0, y2: height - bottom }),
    node("text", { class: "axis", x, y: height - 8, "text-anchor": "middle" }, text)];
}
function label(name, x, y) {
  return [node("title", {}, name), node("text", { x, y, "text-anchor": "end" }, name)];
}

/* ---- paired differences ---- */
function drawForest() {
  const base = $("pairs-base").value, unit = $("pairs-metric").selectedOptions[0].dataset.unit;
  const rows = (data.pairs[$("pairs-metric").value + "|" + $("pairs-scenario").value] ?? []).flatMap(([a, b, mean, low, high, n, only, other]) =>
    a === base ? [[b, mean === null ? null : -mean, high === null ? null : -high, low === null ? null : -low, n, other, only]]
      : b === base ? [[a, mean, low, high, n, only, other]] : []).sort((x, y) => (x[1] ?? Infinity) - (y[1] ?? Infinity));
  const ends = rows.flatMap(([, mean, low, high]) => mean === null ? [] : [low ?? mean, high ?? mean]);
  let [from, to] = [Math.min(0, ...ends), Math.max(0, ...ends)];
  const pad = 0.05 * (to - from || 1); from -= pad; to += pad;
  const [left, right, width, tall] = [165, 235, 900, 26], bottom = 26, height = rows.length * tall + bottom;
  const X = (v) => left + ((v - from) / (to - from)) * (width - left - right);
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Paired differences from ${base}` });
  const [marks, digits] = ticks(from, to, 6);
  for (const v of marks) svg.append(...mark(X(v), height, bottom, `${v > 0 ? "+" : ""}${v.toFixed(digits)} ${unit}`));
  svg.append(node("line", { x1: X(0), x2: X(0), y1: 0, y2: height - bottom, stroke: css("--ink"), "stroke-width": 1.5 }));
  rows.forEach(([name, mean, low, high, n, only, other], i) => {
    const y = (i + 0.5) * tall;
    const row = node("g", {}, ...label(name, left - 12, y + 4));
    if (mean !== null) {
      if (low !== null) row.append(node("line", { x1: X(low), x2: X(high), y1: y, y2: y, stroke: colour[name], "stroke-width": 3, "stroke-linecap": "round" }));
      row.append(node("circle", { cx: X(mean), cy: y, r: 5, fill: colour[name] }));
    }
    const text = mean === null ? "no flight that both flew" : `${mean > 0 ? "+" : ""}${mean.toFixed(2)}` + (low === null ? "" : ` (${low.toFixed(2)} to ${high.toFixed(2)})`);
    const crashes = only || other ? `, ✕ ${only} : ${other}` : "";
    row.append(node("text", { class: "value", x: width - right + 14, y: y + 4 }, text + crashes));
    svg.append(row);
  });
  $("forest").replaceChildren(svg);
}
function blur(counts) {
  const kernel = [1, 4, 7, 4, 1];
  return Float64Array.from(counts, (_, i) => kernel.reduce((sum, w, j) => sum + w * (counts[i + j - 2] ?? 0), 0) / 17);
}

/* ---- replay in three dimensions, drawn with nothing but lines ---- */
const camera = { azimuth: -0.9, elevation: 0.42, zoom: 1 };
function drawStage() {
  const [pen, width, height] = prepare($("stage"));
  const crew = flights();
  if (!crew.length) return;
  const long = crew.reduce((a, b) => (b[1].x.length > a[1].x.length ? b : a))[1];
  const k = Math.min(long.x.length - 1, Math.round(state.time / long.dt));
  const centre = span(long), size = (Math.min(width, height) * 0.72 * camera.zoom) / centre.extent;
  const [ca, sa, ce, se] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth), Math.cos(camera.elevation), Math.sin(camera.elevation)];
  const project = (x, y, z) => {
    [x, y, z] = [x - centre.x, y - centre.y, z - centre.z];
    const [u, v] = [ca * x - sa * y, sa * x + ca * y];
    const depth = 1 / (1 + (0.22 * (ce * v - se * z)) / centre.extent);
    return [width / 2 + size * u * depth, height / 2 - size * (se * v + ce * z) * depth];
  };
  const path = (points, stroke, thick, alpha = 1) => {
    pen.beginPath(); pen.strokeStyle = stroke; pen.lineWidth = thick; pen.globalAlpha = alpha; pen.lineCap = "round";
    points.forEach((p, i) => { const [u, v] = project(...p); i ? pen.lineTo(u, v) : pen.moveTo(u, v); });
    pen.stroke(); pen.globalAlpha = 1;
  };
  const half = centre.extent * 0.75, step = half > 6 ? 2 : half > 2.5 ? 1 : 0.5;
  const x0 = Math.round(centre.x / step) * step, y0 = Math.round(centre.y / step) * step, n = Math.ceil(half / step);
  for (let i = -n; i <= n; i++) {
    path([[x0 + i * step, y0 - n * step, centre.floor], [x0 + i * step, y0 + n * step, centre.floor]], css("--line"), 1);
    path([[x0 - n * step, y0 + i * step, centre.floor], [x0 + n * step, y0 + i * step, centre.floor]], css("--line"), 1);
  }
  const [rx, ry, rz] = [long.x_ref[k], long.y_ref[k], long.z_ref[k]], mark = centre.extent * 0.03;
  for (const [dx, dy, dz] of [[mark, 0, 0], [0, mark, 0], [0, 0, mark]]) path([[rx - dx, ry - dy, rz - dz], [rx + dx, ry + dy, rz + dz]], css("--ink"), 2);
  const big = Math.max(1, (centre.extent * 0.075) / 0.17); // drawn larger than life in a wide scene
  for (const [name, s] of crew) {
    const j = Math.min(k, s.x.length - 1), crashed = k > s.x.length - 1;
    const trail = [];
    for (let i = Math.max(0, j - Math.round(3 / s.dt)); i <= j; i++) trail.push([s.x[i], s.y[i], s.z[i]]);
    path(trail, colour[name], 1.5, 0.55);
    const here = [s.x[j], s.y[j], s.z[j]], rotate = rotation(s.roll[j] * RAD, s.pitch[j] * RAD, s.yaw[j] * RAD);
    const place = (x, y, z) => { const r = rotate(x * big, y * big, z * big); return [here[0] + r[0], here[1] + r[1], here[2] + r[2]]; };
    path([[here[0], here[1], centre.floor], here], css("--soft"), 1, 0.35);
    data.hubs.forEach(([x, y, z]) => {
      path([place(0, 0, 0), place(x, y, z)], x > 0.5 * Math.hypot(x, y) ? css("--accent") : colour[name], 3.5, crashed ? 0.35 : 1);
      const ring = [];
      for (let a = 0; a <= 16; a++) ring.push(place(x + data.prop_radius * Math.cos(a * Math.PI / 8), y + data.prop_radius * Math.sin(a * Math.PI / 8), z));
      path(ring, colour[name], 1.5, crashed ? 0.35 : 1);
    });
  }
  pen.textAlign = "left"; pen.textBaseline = "middle";
  crew.forEach(([name, s], i) => {
    pen.fillStyle = colour[name]; pen.fillRect(10, 13 + 18 * i, 10, 10);
    pen.fillStyle = css("--ink"); pen.fillText(name + (k > s.x.length - 1 ? "  ✕ crashed" : ""), 27, 18.5 + 18 * i);
  });
  pen.fillStyle = css("--soft"); pen.textAlign = "right";
  pen.fillText(`squares of ${step} m` + (centre.floor > 0 ? `, ${centre.floor.toFixed(1)} m above ground` : " on the ground"), width - 8, height - 10);
  $("clock").max = (long.x.length - 1) * long.dt;
  $("clock").value = state.time;
  $("clock-text").textContent = state.time.toFixed(1) + " s";
}
function span(s) {
  const range = (values) => { let [a, b] = [Infinity, -Infinity]; for (const v of values) { a = Math.min(a, v); b = Math.max(b, v); } return [a, b]; };
  const [x, y, z] = [range(s.x), range(s.y), range(s.z)];
  const extent = Math.max(1.6, x[1] - x[0], y[1] - y[0], z[1] - z[0]);
  const floor = Math.max(0, z[0] - 0.4 * extent); // the ground, or where it is far below, a grid that hovers
  return { x: (x[0] + x[1]) / 2, y: (y[0] + y[1]) / 2, z: Math.max(z[0] * 0.75 + z[1] * 0.25 - 0.08 * extent, floor + 0.2 * extent), extent, floor };
}
function rotation(roll, pitch, yaw) { // intrinsic z-y'-x''
  const [cr, sr, cp, sp, cy, sy] = [Math.cos(roll), Math.sin(roll), Math.cos(pitch), Math.sin(pitch), Math.cos(yaw), Math.sin(yaw)];
  return (x, y, z) => [
    cy * cp * x + (cy * sp * sr - sy * cr) * y + (cy * sp * cr + sy * sr) * z,
    sy * cp * x + (sy * sp * sr + cy * cr) * y + (sy * sp * cr - cy * sr) * z,
    -sp * x + cp * sr * y + cp * cr * z,
  ];
}
function turnable(canvas) {
  const fingers = new Map();
  let gap = 0;
  canvas.onpointerdown = (event) => { fingers.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); };
  canvas.onpointermove = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, event);
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()], now = Math.hypot(a.offsetX - b.offsetX, a.offsetY - b.offsetY);
      if (gap) camera.zoom = Math.min(6, Math.max(0.4, (camera.zoom * now) / gap));
      gap = now;
    } else {
      camera.azimuth += (event.offsetX - before.offsetX) * 0.008;
      camera.elevation = Math.min(1.5, Math.max(0.02, camera.elevation + (event.offsetY - before.offsetY) * 0.006));
    }
    drawStage();
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => { fingers.delete(event.pointerId); gap = 0; };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom = Math.min(6, Math.max(0.4, camera.zoom * Math.exp(-event.deltaY * 0.001)));
    drawStage();
  }, { passive: false });
}
function player() {
  let last = null;
  const tick = (now) => {
    if (last === null) return;
    state.time += ((now - last) / 1000) * Number($("speed").value);
    last = now;
    if (state.time >= Number($("clock").max)) { state.time = Number($("clock").max); stop(); }
    drawStage();
    if (last !== null) requestAnimationFrame(tick);
  };
  const stop = () => { last = null; $("play").textContent = "▶ Play"; };
  $("play").onclick = () => {
    if (last !== null) return stop();
    if (state.time >= Number($("clock").max)) state.time = 0;
    last = performance.now();
    $("play").textContent = "❚❚ Pause";
    requestAnimationFrame(tick);
  };
  $("clock").oninput = () => { state.time = Number($("clock").value); drawStage(); };
}

if (data.scenarios.length) closedLoop();
