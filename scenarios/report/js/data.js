/* The results in the page, what of them is shown, and the looks of the estimators. */
import { all } from "./dom.js";
import { dashes, legendKey, paint } from "./markers.js";

export const data = JSON.parse(document.getElementById("data").textContent);
export const cell = (scenario, estimator) => data.cells[scenario + "|" + estimator];
export const state = { scenario: data.scenarios[0], shown: new Set(), from: 0, to: Infinity, end: 1, time: 0, source: null, playing: false, inside: data.best ?? data.estimators[0], unpacked: false, missing: "Unpacking the flights …" };

/* Whoever shows the time of the replay is called when it changes, with the plot whose cursor changed it in `state.source`. */
export const timeListeners = [];
export function setTime(time, source = null) {
  [state.time, state.source] = [time, source];
  for (const show of timeListeners) show();
}

export const colour = Object.fromEntries(Object.entries(data.looks).map(([name, look]) => [name, look.colour]));
export const dash = Object.fromEntries(Object.entries(data.looks).map(([name, look]) => [name, dashes(look, 1.5)]));
for (const dot of all(".dot")) paint(dot, data.looks[dot.dataset.estimator]);
export const dotOf = (name) => legendKey(data.looks[name]);

/* Flights in time are 16-bit integers times a scale, one channel of one cell after the other, then those that are the
   same with every estimator of a scenario. The page holds their
   differences, low bytes before high ones, compressed (`compress_flights` in scenarios/bench/flight_series.py). */
const MISSING = -32768;
export async function unpack() {
  const packed = Uint8Array.from(atob(document.getElementById("flights").textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer()), n = bytes.length / 2;
  let last = 0, at = 0;
  const integers = Int16Array.from({ length: n }, (_, k) => (last += bytes[k] + 256 * bytes[n + k])); // modulo 2^16
  for (const c of [...Object.values(data.cells), ...Object.values(data.shared).map((series) => ({ series }))]) {
    if (!c.series) continue;
    c.flight = c.series.flight = { dt: c.series.dt };
    for (const [name, scale] of Object.entries(c.series.scales))
      c.flight[name] = Float32Array.from(integers.subarray(at, at += c.series.samples), (q) => (q === MISSING ? NaN : q * scale));
  }
}
export const flights = () => data.estimators.filter((e) => state.shown.has(e)).map((e) => [e, cell(state.scenario, e)?.flight]).filter(([, s]) => s);
