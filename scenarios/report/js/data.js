/* The results in the page, what of them is shown, and the colours of the estimators. */
import { all, node } from "./dom.js";

export const data = JSON.parse(document.getElementById("data").textContent);
export const cell = (scenario, estimator) => data.cells[scenario + "|" + estimator];
export const state = { scenario: data.scenarios[0], shown: new Set(), from: 0, to: Infinity, time: 0 };

/* One colour per estimator, the same in every chart; after Paul Tol's and Okabe & Ito's colour-blind safe sets. */
const PALETTE = ["#8a8f98", "#0072b2", "#56b4e9", "#e69f00", "#009e73", "#7b5cd6", "#b294e8", "#cc79a7", "#a6761d", "#c9a27a", "#12aebd", "#7f9f2f", "#ff8a75", "#d62728"];
const DASHES = [[], [7, 3], [2, 2]]; // the palette a second and a third time over
export const colour = Object.fromEntries(data.estimators.map((name, i) => [name, PALETTE[i % PALETTE.length]]));
export const dash = Object.fromEntries(data.estimators.map((name, i) => [name, DASHES[Math.floor(i / PALETTE.length) % DASHES.length]]));
for (const dot of all(".dot")) dot.style.setProperty("--colour", colour[dot.dataset.estimator] ?? "#888");
export const dotOf = (name) => { const dot = node("i", { class: "dot" }); dot.style.setProperty("--colour", colour[name]); return dot; };

/* Time series are stored as 16-bit integers in base64, times a scale. */
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
export const flights = () => data.estimators.filter((e) => state.shown.has(e)).map((e) => [e, series(state.scenario, e)]).filter(([, s]) => s);
