/* Panels on a time axis, drawn by uPlot: zoom and cursor of one are those of all in a list. */
import { css, node } from "./dom.js";

const shownValue = (v) => (v === null || v === undefined ? "" : v.toFixed(Math.abs(v) < 1000 ? 2 : 0));
const GAPS = { spanGaps: false, points: { show: false }, value: (_, v) => shownValue(v) };
export const AXES = ["#d55e00", "#009e73", "#0072b2"]; // x, y, z
export const line = (label, stroke, more = {}) => ({ label, stroke, width: 1.4, ...more });

/** Add a panel { title, lines: [[values, series], …], low, high, bands } to a list, in a box of the page.
    `hooks` are further hooks of uPlot, `end` is the length of the time axis, `labelled` whether it has numbers. */
export function addPanel(plots, box, time, panel, { height, labelled, end, hooks = {} }) {
  const head = node("div", { class: "head" }, node("h3", {}, panel.title ?? ""));
  box.append(head);
  const axis = { stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
  const all = () => plot.setScale("x", { min: 0, max: end });
  const plot = new uPlot({
    width: box.clientWidth, height: height + (labelled ? 34 : 14), pxAlign: false,
    cursor: { y: false, drag: { x: true, y: false }, points: { size: 5 }, bind: { dblclick: () => all } },
    scales: { x: { time: false }, y: { range: (_, low, high) => bounds(panel, low, high) } },
    axes: [{ ...axis, size: labelled ? 34 : 6, values: (_, ticks) => ticks.map((t) => (labelled ? `${t} s` : "")) }, { ...axis, size: 56, space: 22 }],
    series: [{ label: "time", value: (_, t) => (t === null || t === undefined ? "" : `${t.toFixed(2)} s`) },
      ...panel.lines.map(([, series]) => ({ ...GAPS, ...series }))],
    legend: { mount: (_, legend) => head.append(legend) },
    bands: panel.bands ?? [],
    hooks: { ...hooks, setScale: [(_, key) => key === "x" && follow(plots, plot)] },
  }, [time, ...panel.lines.map(([values]) => values)], box);
  plots.push(plot);
}
function bounds(panel, low, high) {
  if (low === null) return [panel.low ?? -1, panel.high ?? 1];
  const pad = 0.06 * Math.max(high - low, 1e-3);
  return [panel.low ?? low - pad, panel.high ?? high + pad];
}
/* All panels have the time axis of the one that was zoomed. */
function follow(plots, plot) {
  const { min, max } = plot.scales.x;
  for (const other of plots) if (other !== plot && (other.scales.x.min !== min || other.scales.x.max !== max)) other.setScale("x", { min, max });
}
/** Put the cursor of panels at a time, without a hook. */
export function pointAt(plots, t) {
  for (const plot of plots) {
    const left = plot.valToPos(t, "x");
    plot.setCursor(left >= 0 && left <= plot.over.clientWidth ? { left, top: 0 } : { left: -10, top: -10 }, false);
  }
}
/** Shade spans [[from, to], …] of time behind the lines. */
export function shade(plot, spans, fill, alpha) {
  const { left, top, width, height } = plot.bbox, pen = plot.ctx;
  pen.save(); pen.fillStyle = fill; pen.globalAlpha = alpha;
  for (const [from, to] of spans) {
    const a = Math.max(plot.valToPos(from, "x", true), left), b = Math.min(plot.valToPos(to, "x", true), left + width);
    if (b > a) pen.fillRect(a, top, b - a, height);
  }
  pen.restore();
}
