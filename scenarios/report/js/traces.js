/* A flight in time: one quantity of several estimators, and the signals behind the estimate of one of them. */
import { cell, colour, dash, data, flights, setTime, state } from "./data.js";
import { $, css, node } from "./dom.js";
import { addPanel, AXES, line, pointAt, shade } from "./panels.js";
import { inclination, QUANTITIES, windy } from "./quantities.js";

const PLOTS = [];
const quiet = { class: "unlisted" }; // not in the legend
const gaps = (values) => Array.from(values, (v) => (Number.isNaN(v) ? null : v));
const times = (s) => Float64Array.from({ length: s.x.length }, (_, k) => k * s.dt);
const endOf = (s) => (s.x.length - 1) * s.dt;

export function drawTraces() {
  for (const plot of PLOTS.splice(0)) plot.destroy();
  for (const id of ["plot", "panels"]) $(id).replaceChildren();
  const crew = flights(), inside = cell(state.scenario, state.inside)?.flight;
  const end = Math.max(1, ...[...crew.map(([, s]) => s), ...(inside ? [inside] : [])].map(endOf));
  state.end = end;
  const [from, to] = [state.from, Math.min(state.to, end)];
  drawCompared(crew, end);
  drawInside(inside, end);
  for (const plot of PLOTS) plot.setScale("x", { min: from, max: to });
  queueMicrotask(showTime); // after uPlot has its scales
}
/** Cursors at the time of the replay, but for the plot that moved it, and one in which the pointer drags a range. */
export const showTime = () => pointAt(PLOTS.filter((plot) => plot !== state.source && plot !== dragged), state.time);
let [dragged, pressed] = [null, 0];
addEventListener("mouseup", () => { dragged = null; });
export function showAll() { for (const plot of PLOTS.slice(0, 1)) plot.setScale("x", { min: 0, max: state.end }); }

function hooks(labelled, above = () => {}) {
  return {
    drawClear: [(plot) => drawFaults(plot, labelled)],
    draw: [above],
    setCursor: [(plot) => {
      if (state.playing) return;
      if (plot.cursor.left >= 0) setTime(Math.max(0, plot.posToVal(plot.cursor.left, "x")), plot);
      else pointAt([plot], state.time);
    }],
    ready: [(plot) => {
      plot.over.addEventListener("mousedown", (event) => { [dragged, pressed] = [plot, event.offsetX]; });
      plot.over.addEventListener("click", ({ offsetX }) => { if (Math.abs(offsetX - pressed) < 4) setTime(Math.max(0, plot.posToVal(offsetX, "x"))); });
    }],
  };
}
function add(box, s, panel, options) {
  addPanel(PLOTS, box, times(s), panel, options);
  const plot = PLOTS.at(-1);
  (plot.hooks.setScale ??= []).push((_, key) => { if (key === "x") [state.from, state.to] = [plot.scales.x.min, plot.scales.x.max < state.end ? plot.scales.x.max : Infinity]; });
}
/* Faults as bands behind the lines, their names at the top of the first panel. */
function drawFaults(plot, labelled) {
  const faults = data.faults[state.scenario] ?? [], ratio = devicePixelRatio || 1, pen = plot.ctx, { left, top, width } = plot.bbox;
  shade(plot, faults.map(([, from, to]) => [from, to]), css("--accent"), 0.1);
  if (!labelled) return;
  pen.save(); pen.font = `${12 * ratio}px system-ui`; pen.fillStyle = css("--accent"); pen.textAlign = "left"; pen.textBaseline = "top";
  const ends = []; // of the labels in each row
  for (const [label, from, to] of faults) {
    const x = Math.max(plot.valToPos(from, "x", true), left) + 4 * ratio, wide = pen.measureText(label).width;
    if (plot.valToPos(to, "x", true) < left || x + wide > left + width) continue;
    let row = ends.findIndex((last) => last < x);
    if (row < 0) row = ends.length;
    if (row > 2) continue;
    ends[row] = x + wide + 8 * ratio;
    pen.fillText(label, x, top + (3 + 15 * row) * ratio);
  }
  pen.restore();
}
/* One quantity, a line for each estimator. */
function drawCompared(crew, end) {
  const quantity = QUANTITIES[$("quantity").value];
  $("plot-note").textContent = crew.length
    ? `One flight of each estimator, all with the same seed (0), hence the same wind and the same sensor noise; ${(1 / crew[0][1].dt).toFixed(0)} samples each second. ✕: crashed. Shaded: a fault.` + (quantity.truth ? " Thin: estimate or position; broad and pale: truth or set point." : "")
    : state.missing;
  if (!crew.length) return;
  const longest = crew.reduce((a, b) => (b[1].x.length > a[1].x.length ? b : a))[1], n = longest.x.length;
  const padded = (values) => gaps(Array.from({ length: n }, (_, k) => values[k] ?? null));
  const lines = crew.flatMap(([name, s]) => [
    ...(quantity.truth ? [[padded(quantity.truth(s)), line(name, colour[name] + "66", { width: 3.5, ...quiet })]] : []),
    [padded(quantity.main(s)), line(name, colour[name], { width: 1.5, dash: dash[name] })],
  ]);
  const crosses = (plot) => {
    const pen = plot.ctx, ratio = devicePixelRatio || 1;
    pen.save(); pen.font = `bold ${16 * ratio}px system-ui`; pen.textAlign = "center"; pen.textBaseline = "middle";
    for (const [name, s] of crew) {
      const last = endOf(s);
      if (last > end - 0.5 || last < plot.scales.x.min || last > plot.scales.x.max) continue;
      pen.fillStyle = colour[name];
      const at = quantity.main(s).at(-1);
      pen.fillText("✕", plot.valToPos(last, "x", true), plot.valToPos(Number.isNaN(at) ? plot.scales.y.min : at, "y", true));
    }
    pen.restore();
  };
  const low = ["inclination", "distance"].includes($("quantity").value) ? 0 : undefined;
  add($("plot"), longest, { title: quantity.label, lines, low }, { height: 300, labelled: true, end, hooks: hooks(true, crosses) });
}
/* Everything of one estimator, one panel below the other. */
function drawInside(s, end) {
  $("inside-note").replaceChildren(...insideNote(s));
  if (!s) return;
  const panels = insidePanels(s).filter((panel) => panel.lines.length);
  panels.forEach((panel, i) => {
    const box = node("div", { class: "panel" });
    $("panels").append(box);
    add(box, s, panel, { height: 110, labelled: i === panels.length - 1, end, hooks: hooks(i === 0) });
  });
}
function insideNote(s) {
  if (!s) return [state.unpacked ? "No flight is stored for this choice." : state.missing];
  const texts = [`The first flight of ${state.inside} in ${state.scenario}.`];
  if (data.shared[state.scenario] && !windy(data.shared[state.scenario].flight)) texts.push("There is no wind.");
  if (s.roll_sigma) texts.push("The band around roll and pitch is ± σ, by the filter's own covariance.");
  if (s.gyro_x) return [texts.join(" ")];
  const command = `quadsim fly ${state.scenario} --estimator ${state.inside.replace(" @ ", " --controller ")}`;
  return [texts.join(" "), " Readings, bias and rotor commands of this flight are not in this page; ", node("code", {}, command), " shows them."];
}
function insidePanels(s) {
  const vector = (title, name, from, more, kind = "") => ({
    title, lines: ["x", "y", "z"].flatMap((axis, k) => (from?.[`${name}_${axis}`] ? [[gaps(from[`${name}_${axis}`].subarray(0, s.x.length)), line(axis + kind, AXES[k] + (more?.pale ?? ""), { width: 1, ...more })]] : [])),
  });
  const shared = data.shared[state.scenario]?.flight, estimated = Boolean(s.bias_est_x);
  const truth = vector("", "bias", shared, estimated ? { width: 4, pale: "55" } : {}, estimated ? " true" : "").lines;
  const rotors = Object.keys(s).filter((name) => name.startsWith("rotor_"));
  const own = { width: 1.5 };
  const angle = (name, title) => {
    const [est, sigma] = [s[`${name}_est`], s[`${name}_sigma`]], stroke = colour[state.inside];
    const edge = (sign) => [gaps(est.map((v, k) => v + sign * sigma[k])), line("± σ", "transparent", quiet)];
    return {
      title: `${title} [°]`,
      lines: [[s[name], line("true", () => css("--ink"), { width: 2.4 })], [est, line("estimated", stroke, own)], ...(sigma ? [edge(1), edge(-1)] : [])],
      bands: sigma ? [{ series: [3, 4], fill: stroke + "33" }] : [],
    };
  };
  return [
    vector("gyroscope [°/s]", "gyro", s), vector("accelerometer [m/s²]", "accel", s),
    {
      title: "gyroscope bias [°/s]; " + (estimated ? "true and estimated" : s.gyro_x ? `true, ${state.inside} estimates none` : "true"),
      lines: [...truth, ...vector("", "bias_est", s, {}, " estimated").lines],
    },
    ...(windy(shared) ? [vector("wind, world axes [m/s]", "wind", shared)] : []),
    { title: "rotor commands [rad/s]", lines: rotors.map((name, k) => [gaps(s[name]), line(`rotor ${k}`, ROTORS[k % ROTORS.length], { width: 1 })]) },
    angle("roll", "roll"), angle("pitch", "pitch"),
    { title: "inclination error [°]", low: 0, lines: [[inclination(s), line(state.inside, colour[state.inside], own)]] },
  ];
}
const ROTORS = [...AXES, "#cc79a7", "#56b4e9", "#e69f00", "#7b5cd6", "#7f9f2f"];
