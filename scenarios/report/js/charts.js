/* Charts over all flights: the map, the distributions of errors. */
import { cell, colour, data } from "./data.js";
import { $, all, css, node } from "./dom.js";

/** Every chart: drawn at first, and again when a choice, the size or the theme changes. */
export const CHARTS = [drawMap, drawViolins];

function drawMap() {
  const metric = data.metrics.find((m) => m.key === $("map-metric").value);
  const cells = all(".heat tbody td").map((td) => {
    const found = td.dataset.level === undefined ? data.means[td.dataset.estimator] : data.levels[td.dataset.level];
    return [td, found[metric.key], found.crash_rate > 0];
  });
  const positive = cells.map(([, value]) => value).filter((v) => v > 0);
  const [low, high] = [Math.log(Math.min(...positive)), Math.log(Math.max(...positive))];
  for (const [td, value, crashed] of cells) {
    const known = value !== null;
    td.querySelector("b").textContent = known ? value.toFixed(metric.digits) : "";
    td.classList.toggle("none", !known);
    td.classList.toggle("crashed", crashed);
    const t = metric.key.endsWith("rate") ? value : value > 0 && high > low ? (Math.log(value) - low) / (high - low) : 0;
    td.style.setProperty("--t", known ? t.toFixed(3) : 0);
  }
}

function drawViolins() {
  const scenario = $("spread-scenario").value, { low, high, bins } = data.edges;
  const rows = data.ranked.filter((e) => e !== "truth").map((e) => {
    const total = new Float64Array(bins);
    for (const s of scenario ? [scenario] : data.scenarios) cell(s, e)?.histogram?.forEach((count, i) => { total[i] += count; });
    return [e, total, total.reduce((a, b) => a + b, 0)];
  }).filter(([, , n]) => n > 0);
  const [left, width, tall] = [165, $("violins").clientWidth, 46], bottom = 26, height = rows.length * tall + bottom;
  const X = (decade) => left + ((decade - low) / (high - low)) * (width - left - 20);
  const svg = node("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Distribution of errors by estimator" });
  for (const v of [0.1, 1, 10, 100]) svg.append(...mark(X(Math.log10(v)), height, bottom, `${v}°`));
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

function blur(counts) {
  const kernel = [1, 4, 7, 4, 1];
  return Float64Array.from(counts, (_, i) => kernel.reduce((sum, w, j) => sum + w * (counts[i + j - 2] ?? 0), 0) / 17);
}
