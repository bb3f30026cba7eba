/* The time plot: one line per estimator, with zoom and a cursor. */
import { prepare, rule, ticks } from "./canvas.js";
import { colour, dash, data, dotOf, flights, state } from "./data.js";
import { $, css, node } from "./dom.js";
import { QUANTITIES } from "./quantities.js";

const BOX = { left: 52, right: 14, top: 12, bottom: 30 };
let frame = null;
export function drawPlot() {
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
  high += pad; low = quantity === QUANTITIES.inclination || quantity === QUANTITIES.distance ? 0 : low - pad;
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
    ? `One flight of each estimator, all with the same seed (${data.series_seed}), hence the same wind and the same sensor noise; ${(1 / lines[0].dt).toFixed(0)} samples each second. ✕: crashed.` + (quantity.truth ? " Thin: estimate or position; broad and pale: truth or set point." : "")
    : state.missing;
}
function trace(pen, values, dt, X, Y, t0, t1, stroke, thick, pattern) {
  pen.beginPath(); pen.strokeStyle = stroke; pen.lineWidth = thick; pen.lineJoin = "round"; pen.setLineDash(pattern);
  const first = Math.max(0, Math.floor(t0 / dt) - 1), last = Math.min(values.length - 1, Math.ceil(t1 / dt) + 1);
  for (let k = first; k <= last; k++) k === first ? pen.moveTo(X(k * dt), Y(values[k])) : pen.lineTo(X(k * dt), Y(values[k]));
  pen.stroke(); pen.setLineDash([]);
}
export function zoomable(canvas) {
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
