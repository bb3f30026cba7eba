/* The entry: what the controls do. */
import { CHARTS } from "./charts.js";
import { data, dotOf, state, unpack } from "./data.js";
import { $, all } from "./dom.js";
import { QUANTITIES } from "./quantities.js";
import { drawStage, player, turnable } from "./stage.js";
import { makeSortable } from "./tables.js";
import { drawPlot, zoomable } from "./traces.js";

$("theme").onclick = () => {
  const dark = document.documentElement.dataset.theme
    ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  redraw();
};

function closedLoop() {
  for (const select of [...all("select.scenario"), ...["spread-scenario", "table-scenario", "pairs-scenario"].map($)])
    for (const name of data.scenarios) select?.add(new Option(name, name));
  const focus = data.estimators.filter((name) => data.shown.includes(name));
  for (const name of focus) state.shown.add(name);
  for (const [key, q] of Object.entries(QUANTITIES)) $("quantity").add(new Option(q.label, key));
  for (const name of data.estimators) {
    const chip = document.createElement("button");
    chip.type = "button";
    chip.append(dotOf(name), name);
    chip.onclick = () => { state.shown.has(name) ? state.shown.delete(name) : state.shown.add(name); redraw(); };
    chip.dataset.estimator = name;
    $("chips").append(chip);
  }
  for (const id of ["map-metric", "quantity", "spread-scenario"]) $(id).onchange = redraw;
  $("table-scenario").onchange = (event) => {
    for (const row of $("results").tBodies[0].rows) row.hidden = event.target.value && row.dataset.scenario !== event.target.value;
  };
  if ($("pairs")) {
    for (const name of data.estimators) $("pairs-base").add(new Option(name, name, false, name === data.best));
    for (const id of ["pairs-base", "pairs-scenario", "pairs-metric"]) $(id).onchange = redraw;
  }
  for (const select of all("select.scenario")) select.onchange = () => choose(select.value);
  for (const td of all(".heat td")) {
    td.onclick = () => { state.shown.add(td.dataset.estimator); choose(td.dataset.scenario); $("series").scrollIntoView(); };
    td.onkeydown = (event) => { if (event.key === "Enter") td.onclick(); };
  }
  zoomable($("plot"));
  turnable($("stage"));
  player();
  for (const change of ["resize", "beforeprint", "afterprint"]) addEventListener(change, redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  choose(state.scenario);
  unpack().then(() => "No flight is stored for this choice.", () => "This browser cannot unpack the flights; one of 2023 or later can.")
    .then((text) => { [state.missing, state.unpacked] = [text, true]; redraw(); });
}
function choose(scenario) {
  state.scenario = scenario;
  [state.from, state.to, state.time] = [0, Infinity, 0];
  for (const select of all("select.scenario")) select.value = scenario;
  redraw();
}
function redraw() {
  if (!data.scenarios.length) return;
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", state.shown.has(chip.dataset.estimator));
  for (const td of all(".heat td")) td.classList.toggle("chosen", td.dataset.scenario === state.scenario && state.shown.has(td.dataset.estimator));
  drawPlot();
  drawStage();
  for (const draw of CHARTS) draw();
}

makeSortable();
if (data.scenarios.length) closedLoop();
