/* The entry: what the controls do. */
import { CHARTS } from "./charts.js";
import { data, dotOf, state, timeListeners, unpack } from "./data.js";
import { $, all } from "./dom.js";
import { QUANTITIES } from "./quantities.js";
import { drawStage, player, turnable } from "./stage.js";
import { makeSortable } from "./tables.js";
import { themed } from "./theme.js";
import { drawTraces, showAll, showTime } from "./traces.js";

function closedLoop() {
  for (const select of [...all("select.scenario"), ...["spread-scenario", "table-scenario"].map($)])
    if (select) for (const name of data.scenarios) select.add(new Option(name, name));
  const focus = data.estimators.filter((name) => data.shown.includes(name));
  for (const name of focus) state.shown.add(name);
  for (const name of data.estimators) $("inside").add(new Option(name, name, false, name === state.inside));
  $("inside").onchange = (event) => look(event.target.value);
  for (const [key, q] of Object.entries(QUANTITIES)) $("quantity").add(new Option(q.label, key));
  for (const name of data.ranked) {
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
  for (const select of all("select.scenario")) select.onchange = () => choose(select.value);
  for (const td of all(".heat td[data-scenario]")) {
    td.onclick = () => { look(td.dataset.estimator); choose(td.dataset.scenario); $("series").scrollIntoView(); };
    td.onkeydown = (event) => { if (event.key === "Enter") td.onclick(); };
  }
  $("traces").onkeydown = (event) => { if (event.key === "Escape") showAll(); };
  timeListeners.push(showTime, drawStage);
  turnable($("stage"));
  player();
  let wide = innerWidth; // a phone's window changes its height as one scrolls
  addEventListener("resize", () => { if (innerWidth !== wide) { wide = innerWidth; redraw(); } });
  for (const change of ["beforeprint", "afterprint"]) addEventListener(change, redraw);
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
/* Choose the estimator whose signals are shown. */
function look(estimator) {
  $("inside").value = state.inside = estimator;
  state.shown.add(estimator);
  redraw();
}
function redraw() {
  if (!data.scenarios.length) return;
  for (const chip of all("#chips button")) chip.setAttribute("aria-pressed", state.shown.has(chip.dataset.estimator));
  for (const td of all(".heat td[data-scenario]")) td.classList.toggle("chosen", td.dataset.scenario === state.scenario && state.shown.has(td.dataset.estimator));
  drawTraces();
  drawStage();
  for (const draw of CHARTS) draw();
}

themed(redraw);
makeSortable();
if (data.scenarios.length) closedLoop();
