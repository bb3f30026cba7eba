/* The report by condition: performance profiles, and the main effects of each axis. */
import { colour, dash, data, dotOf } from "./data.js";
import { $, all, node } from "./dom.js";
import { makeSortable } from "./tables.js";
import { themed } from "./theme.js";

const hidden = new Set();
/** Ends of all intervals: every axis has the same scale. */
const ENDS = data.effects.flatMap(([, , , error, low, high]) => (error ? [error, low || error, high ?? error] : []));
/** Leading digits of the marks of a logarithmic axis, from many to few. */
const DIGITS = [[1, 2, 3, 5, 7], [1, 2, 5], [1, 3], [1]];

/** A logarithmic axis from the values to pixels, and the marks on it. */
function logAxis(values, from, to) {
  const [low, high] = [Math.log(Math.min(...values) / 1.1), Math.log(Math.max(...values) * 1.1)];
  const X = (v) => from + ((Math.log(v) - low) / (high - low)) * (to - from);
  const marksOf = (digits) => [-2, -1, 0, 1, 2].flatMap((decade) => digits.map((d) => Number(`${d}e${decade}`))).filter((v) => X(v) >= from && X(v) <= to);
  const marks = DIGITS.map(marksOf).find((each) => each.every((v, k) => k === 0 || X(v) - X(each[k - 1]) >= 36)) ?? marksOf([1]);
  return [X, marks];
}
function canvasOf(place, height, label) {
  const width = Math.max(280, place.clientWidth);
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": label });
  place.replaceChildren(svg);
  return [svg, width];
}
function vertical(svg, x, top, bottom, text) {
  svg.append(node("line", { class: "grid", x1: x, x2: x, y1: top, y2: bottom }),
    node("text", { class: "axis", x, y: bottom + 16, "text-anchor": "middle" }, text));
}

function drawProfiles() {
  const [left, right, top, bottom] = [44, 12, 8, 312];
  const [svg, width] = canvasOf($("profile"), bottom + 24, "Share of the flights below an error, by estimator");
  const [X, marks] = logAxis([data.thresholds[0], data.thresholds.at(-1)], left, width - right);
  const Y = (share) => bottom - share * (bottom - top);
  for (const share of [0, 0.25, 0.5, 0.75, 1])
    svg.append(node("line", { class: "grid", x1: left, x2: width - right, y1: Y(share), y2: Y(share) }),
      node("text", { class: "axis", x: left - 6, y: Y(share) + 4, "text-anchor": "end" }, `${100 * share} %`));
  for (const v of marks) vertical(svg, X(v), top, bottom, `${v}°`);
  for (const name of data.ranked.filter((each) => !hidden.has(each))) {
    const points = data.profiles[name].map((share, k) => `${X(data.thresholds[k]).toFixed(1)},${Y(share).toFixed(1)}`);
    svg.append(node("g", { class: "curve", "data-estimator": name }, node("title", {}, name),
      node("polyline", { points: points.join(" "), fill: "none", stroke: colour[name], "stroke-width": 2, "stroke-dasharray": dash[name].join(" ") })));
  }
}

/** The marker of the k-th level: a circle, a square, a triangle, a diamond. */
function marker(k, x, y, paint) {
  if (k % 4 === 0) return node("circle", { cx: x, cy: y, r: 4, ...paint });
  const points = [[[-3.5, -3.5], [3.5, -3.5], [3.5, 3.5], [-3.5, 3.5]], [[0, -4.5], [4.5, 3.5], [-4.5, 3.5]], [[0, -5], [5, 0], [0, 5], [-5, 0]]][(k % 4) - 1];
  return node("polygon", { points: points.map(([dx, dy]) => `${x + dx},${y + dy}`).join(" "), ...paint });
}
function drawEffects(place) {
  const found = data.effects.filter(([axis]) => axis === place.dataset.axis);
  const levels = [...new Set(found.map(([, level]) => level))], step = 9;
  const tall = step * levels.length + 12, legend = 20 * levels.length + 8;
  const bottom = legend + data.ranked.length * tall;
  const [svg, width] = canvasOf(place, bottom + 24, `Error by ${place.dataset.axis}`);
  const left = width < 480 ? 142 : 170;
  if (!ENDS.length) return;
  const [X, marks] = logAxis(ENDS, left + 6, width - 12);
  levels.forEach((level, k) => svg.append(marker(k, left + 10, 12 + 20 * k, { fill: "var(--ink)" }), node("text", { x: left + 22, y: 16 + 20 * k }, level)));
  for (const v of marks) vertical(svg, X(v), legend, bottom, `${v}°`);
  data.ranked.forEach((name, row) => {
    const top = legend + row * tall;
    svg.append(node("line", { class: "grid", x1: 0, x2: width, y1: top, y2: top }),
      node("title", {}, name), node("text", { x: left - 4, y: top + tall / 2 + 4, "text-anchor": "end" }, name));
    for (const [, level, , error, low, high, crashes] of found.filter((each) => each[2] === name)) {
      if (!error) continue;
      const k = levels.indexOf(level), y = top + 10 + step * k, stroke = colour[name];
      svg.append(node("g", {}, node("title", {}, `${name}, ${level}: ${error.toFixed(2)}°` + (low === null ? "" : ` (${low.toFixed(2)} to ${high.toFixed(2)})`)),
        ...(low === null ? [] : [node("line", { x1: X(low || error), x2: X(high), y1: y, y2: y, stroke, "stroke-width": 2 })]),
        marker(k, X(error), y, { fill: crashes ? "var(--card)" : stroke, stroke, "stroke-width": 1.5 })));
    }
  });
}

function redraw() {
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", !hidden.has(chip.dataset.estimator));
  drawProfiles();
  for (const place of all(".effects")) drawEffects(place);
}
for (const name of data.ranked) {
  const chip = document.createElement("button");
  chip.type = "button";
  chip.append(dotOf(name), name);
  chip.dataset.estimator = name;
  chip.onclick = () => { hidden.has(name) ? hidden.delete(name) : hidden.add(name); redraw(); };
  $("chips").append(chip);
}
for (const change of ["resize", "beforeprint", "afterprint"]) addEventListener(change, redraw);
themed(redraw);
makeSortable();
redraw();
