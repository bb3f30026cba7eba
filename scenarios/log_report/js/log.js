/* Stacked traces of a log on one time axis. */
import { $, all, css, node } from "../../report/js/dom.js";
import { dashes, legendKey, paint } from "../../report/js/markers.js";
import { makeSortable } from "../../report/js/tables.js";

const data = JSON.parse($("data").textContent);
const MISSING = -32768, AXES = ["#d55e00", "#009e73", "#0072b2"], PLOTS = [];
const MODELS = ["#0072b2", "#56b4e9", "#e69f00", "#009e73", "#7b5cd6"];
const shown = new Set(data.shown), sync = uPlot.sync("log");
let log = data.logs[$("log").value];

/* Traces are 16-bit integers times a scale, one channel after the other: their differences, low bytes before high
   ones, compressed (`_compress` in scenarios/log_report/page.py). */
async function unpack() {
  const packed = Uint8Array.from(atob($("packed").textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), n = bytes.length / 2;
  let last = 0, at = 0;
  const integers = Int16Array.from({ length: n }, (_, k) => (last += bytes[k] + 256 * bytes[n + k])); // modulo 2^16
  for (const each of Object.values(data.logs)) {
    each.time = Float64Array.from({ length: each.samples }, (_, k) => k * each.dt);
    each.trace = {};
    for (const [name, scale] of Object.entries(each.scales))
      each.trace[name] = Array.from(integers.subarray(at, (at += each.samples)), (q) => (q === MISSING ? null : q * scale));
  }
}

const line = (label, stroke, more = {}) => ({ label, stroke, width: 1.4, ...more });
function panels() {
  const sensor = (name, unit) => ({
    title: `${name === "gyro" ? "gyroscope" : "accelerometer"} [${unit}]`,
    lines: ["x", "y", "z"].map((axis, k) => [`${name} ${axis}`, line(axis, AXES[k], { width: 1 })]),
  });
  const angle = (name) => ({
    title: `${name} [°]`,
    lines: [[`${name}|truth`, line("truth", () => css("--ink"), { width: 2.6 })], ...estimates(name)],
  });
  const models = Object.keys(log.scales).filter((name) => name.startsWith("model|"));
  return [
    sensor("gyro", "°/s"), sensor("accel", "m/s²"), angle("roll"), angle("pitch"),
    { title: "inclination error [°]", lines: estimates("error"), low: 0 },
    ...(models.length ? [{ title: "probability of imm's models", low: 0, high: 1,
      lines: models.map((name, k) => [name, line(name.slice(6), MODELS[k % MODELS.length])]) }] : []),
  ];
}
const estimates = (kind) => data.estimators.filter((name) => shown.has(name) && `${kind}|${name}` in log.scales)
  .map((name) => [`${kind}|${name}`, line(name, data.looks[name].colour, { dash: dashes(data.looks[name], 1.4) })]);

function draw() {
  const before = PLOTS[0]?.scales.x, range = before && before.max > before.min ? [before.min, before.max] : null;
  for (const plot of PLOTS.splice(0)) plot.destroy();
  $("panels").replaceChildren();
  const list = panels().filter((panel) => panel.lines.length);
  list.forEach((panel, i) => {
    const box = node("div", { class: "panel" }, node("h3", {}, panel.title));
    $("panels").append(box);
    const last = i === list.length - 1;
    const axis = { stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
    PLOTS.push(new uPlot({
      width: $("panels").clientWidth, height: (last ? 34 : 14) + 118, pxAlign: false,
      cursor: { sync: { key: sync.key, setSeries: false }, drag: { x: true, y: false }, points: { size: 5 } },
      scales: { x: { time: false }, y: { range: (_, low, high) => bounds(panel, low, high) } },
      axes: [{ ...axis, size: last ? 34 : 6, values: (_, ticks) => ticks.map((t) => (last ? `${t} s` : "")) }, { ...axis, size: 52 }],
      series: [{ label: "time", value: (_, t) => (t === null ? "–" : `${t.toFixed(2)} s`) },
        ...panel.lines.map(([, made]) => ({ ...made, spanGaps: false, points: { show: false }, value: (_, v) => (v === null || v === undefined ? "–" : v.toFixed(2)) }))],
      hooks: { drawClear: [shade], setScale: [(plot, key) => key === "x" && follow(plot)] },
    }, [log.time, ...panel.lines.map(([name]) => log.trace[name])], box));
  });
  if (range) for (const plot of PLOTS) plot.setScale("x", { min: range[0], max: range[1] });
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", shown.has(chip.dataset.estimator));
  $("note").textContent = log.note;
}
function bounds(panel, low, high) {
  if (low === null) return [panel.low ?? -1, panel.high ?? 1];
  const pad = 0.06 * Math.max(high - low, 1e-3);
  return [panel.low ?? low - pad, panel.high ?? high + pad];
}
/* What is not scored, in grey behind the lines. */
function shade(plot) {
  const { left, top, width, height } = plot.bbox, pen = plot.ctx;
  pen.save(); pen.fillStyle = css("--line"); pen.globalAlpha = 0.5;
  for (const [from, to] of log.uncounted) {
    const a = Math.max(plot.valToPos(from, "x", true), left), b = Math.min(plot.valToPos(to, "x", true), left + width);
    if (b > a) pen.fillRect(a, top, b - a, height);
  }
  pen.restore();
}
/* All panels have the time axis of the one that was zoomed. */
function follow(plot) {
  const { min, max } = plot.scales.x;
  for (const other of PLOTS) if (other !== plot && (other.scales.x.min !== min || other.scales.x.max !== max)) other.setScale("x", { min, max });
}

$("theme").onclick = () => {
  const dark = document.documentElement.dataset.theme
    ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  draw();
};
for (const dot of all(".dot")) paint(dot, data.looks[dot.dataset.estimator]);
for (const name of data.estimators) {
  const chip = node("button", { type: "button", "data-estimator": name }, legendKey(data.looks[name]), name);
  chip.onclick = () => { shown.has(name) ? shown.delete(name) : shown.add(name); draw(); };
  $("chips").append(chip);
}
makeSortable();
$("log").onchange = () => { log = data.logs[$("log").value]; for (const plot of PLOTS.splice(0)) plot.destroy(); draw(); };
unpack().then(() => { draw(); addEventListener("resize", draw); },
  () => { $("note").textContent = "This browser cannot unpack the traces; one of 2023 or later can."; });
