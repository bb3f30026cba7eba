/* Markers of estimators (estimators/appearance.py), alone and on their line. */
import { node } from "./dom.js";

/** Paths about the origin, about as large as a circle of radius 1, by matplotlib's names. */
export const MARKERS = {
  o: "M1 0A1 1 0 1 1 -1 0A1 1 0 1 1 1 0Z",
  s: "M-0.88 -0.88H0.88V0.88H-0.88Z",
  D: "M0 -1.2L1.2 0L0 1.2L-1.2 0Z",
  "^": "M0 -1.1L1.1 0.9H-1.1Z",
  v: "M0 1.1L1.1 -0.9H-1.1Z",
  P: "M-0.4 -1.15H0.4V-0.4H1.15V0.4H0.4V1.15H-0.4V0.4H-1.15V-0.4H-0.4Z",
  "<": "M-1.1 0L0.9 -1.1V1.1Z",
  ">": "M1.1 0L-0.9 -1.1V1.1Z",
  X: "M-1.1 -0.53L-0.53 -1.1L0 -0.57L0.53 -1.1L1.1 -0.53L0.57 0L1.1 0.53L0.53 1.1L0 0.57L-0.53 1.1L-1.1 0.53L-0.57 0Z",
  "*": "M0 -1.3L0.32 -0.44L1.24 -0.4L0.52 0.17L0.76 1.05L0 0.55L-0.76 1.05L-0.52 0.17L-1.24 -0.4L-0.32 -0.44Z",
  p: "M0 -1.1L1.05 -0.34L0.65 0.89L-0.65 0.89L-1.05 -0.34Z",
  h: "M0 -1.1L0.95 -0.55L0.95 0.55L0 1.1L-0.95 0.55L-0.95 -0.55Z",
  d: "M0 -1.3L0.78 0L0 1.3L-0.78 0Z",
};
export const markerPath = (look, x, y, size) => node("path", { d: MARKERS[look.marker], transform: `translate(${x} ${y}) scale(${size})`, fill: look.colour, stroke: look.colour });
export function drawMarker(pen, look, x, y, size) {
  pen.save(); pen.translate(x, y); pen.scale(size, size); pen.fillStyle = look.colour; pen.fill(new Path2D(MARKERS[look.marker])); pen.restore();
}
/** Lengths on and off in pixels, for a line of some width. */
export const dashes = (look, width) => look.dash.map((length) => length * width);

/** The marker inside an element of class "dot"; one without a look stays a grey circle. */
export function paint(dot, look) {
  if (look) dot.replaceChildren(node("svg", { viewBox: "-6 -6 12 12" }, markerPath(look, 0, 0, 4.4)));
}
/** A piece of the line with its marker, for a legend. */
export function legendKey(look) {
  const line = node("line", { x1: -17, x2: 17, y1: 0, y2: 0, stroke: look.colour, "stroke-width": 1.8, "stroke-dasharray": dashes(look, 1.5).join(" ") });
  return node("i", { class: "dot key" }, node("svg", { viewBox: "-17 -6 34 12" }, line, markerPath(look, 0, 0, 4.4)));
}
