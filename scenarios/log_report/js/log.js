/* Stacked traces of a log on one time axis. */
import { $, all, css, node } from "../../report/js/dom.js";
import { dashes, legendKey, paint } from "../../report/js/markers.js";
import { addPanel, AXES, line, pointAt, shade } from "../../report/js/panels.js";
import { makeSortable } from "../../report/js/tables.js";
import { themed } from "../../report/js/theme.js";

const data = JSON.parse($("data").textContent);
const MISSING = -32768, PLOTS = [];
const MODELS = ["#0072b2", "#56b4e9", "#e69f00", "#009e73", "#7b5cd6"];
const shown = new Set(data.shown);
let log = data.logs[$("log").value];

/* Traces are 16-bit integers times a scale, one channel after the other: their differences, low bytes before high
   ones, compressed (`compress_flights` in scenarios/bench/flight_series.py). */
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

function panels() {
  const sensor = (name, unit) => ({
    title: `${name === "gyro" ? "gyroscope" : "accelerometer"} [${unit}]`,
    lines: ["x", "y", "z"].map((axis, k) => [`${name} ${axis}`, line(axis, AXES[k], { width: 1 })]),
  });
  const angle = (name) => ({
    title: `${name} [°]`,
    lines: [...(`${name}|truth` in log.scales ? [[`${name}|truth`, line("truth", () => css("--ink"), { width: 2.6 })]] : []),
      ...estimates(name)],
  });
  const sigmas = Object.keys(log.scales).filter((name) => name.startsWith("sigma|"));
  const models = Object.keys(log.scales).filter((name) => name.startsWith("model|"));
  return [
    sensor("gyro", "°/s"), sensor("accel", "m/s²"), angle("roll"), angle("pitch"),
    { title: "inclination error [°]", lines: estimates("error"), low: 0 },
    ...(models.length ? [{ title: "probability of imm's models", low: 0, high: 1,
      lines: models.map((name, k) => [name, line(name.slice(6), MODELS[k % MODELS.length])]) }] : []),
    { title: "standard deviation [°]", low: 0,
      lines: sigmas.map((name, k) => [name, line(name.slice(6), MODELS[k % MODELS.length])]) },
  ];
}
const estimates = (kind) => data.estimators.filter((name) => shown.has(name) && `${kind}|${name}` in log.scales)
  .sort((a, b) => data.looks[a].dash.length - data.looks[b].dash.length) // dashed lines over solid ones
  .map((name) => [`${kind}|${name}`, line(name, data.looks[name].colour, { dash: dashes(data.looks[name], 1.4) })]);

function draw() {
  const before = PLOTS[0]?.scales.x, range = before && before.max > before.min ? [before.min, before.max] : null;
  for (const plot of PLOTS.splice(0)) plot.destroy();
  $("panels").replaceChildren();
  const list = panels().filter((panel) => panel.lines.length), end = log.time.at(-1);
  const clear = (plot) => {
    shade(plot, log.uncounted, css("--line"), 0.5);
    for (const [, from, to, colour] of log.faults) shade(plot, [[from, to]], colour, 0.22);
  };
  const hooks = { drawClear: [clear], setCursor: [point] };
  list.forEach((panel, i) => {
    const box = node("div", { class: "panel" });
    $("panels").append(box);
    const lines = panel.lines.map(([name, series]) => [log.trace[name], series]);
    addPanel(PLOTS, box, log.time, { ...panel, lines }, { height: 118, labelled: i === list.length - 1, end, hooks });
  });
  if (range) for (const plot of PLOTS) plot.setScale("x", { min: range[0], max: range[1] });
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", shown.has(chip.dataset.estimator));
  $("note").textContent = log.note;
  $("faults").replaceChildren(...log.faults.map(([text, , , colour]) =>
    node("p", { class: "note" }, node("i", { class: "dot", style: `background: ${colour}; border-radius: 2px` }), text)));
}
/* The cursor of a panel is that of all. */
function point(plot) {
  const { left } = plot.cursor;
  pointAt(PLOTS.filter((other) => other !== plot), left >= 0 ? plot.posToVal(left, "x") : NaN);
}

themed(draw);
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
