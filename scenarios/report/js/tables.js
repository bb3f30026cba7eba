/* Tables that a heading sorts, and the fading edge of those that are wider than the page. */
import { all, node } from "./dom.js";

export function makeSortable() {
  for (const box of all(".scroll")) markCut(box);
  for (const table of all("table.sortable")) {
    all("thead th", table).forEach((th, column) => {
      th.querySelector("button").onclick = () => sortBy(table, th, column);
    });
  }
}
function markCut(box) {
  const hint = node("p", { class: "hint print-hide" }, "Scroll the table sideways for more columns →");
  const mark = () => {
    hint.hidden = box.scrollWidth <= box.clientWidth + 1;
    box.classList.toggle("cut", box.scrollLeft + box.clientWidth < box.scrollWidth - 1);
  };
  box.before(hint);
  box.addEventListener("scroll", mark, { passive: true });
  new ResizeObserver(mark).observe(box);
}
function sortBy(table, th, column) {
  const up = !th.classList.contains("up");
  for (const other of all("th", table)) { other.classList.remove("up", "down"); other.removeAttribute("aria-sort"); }
  th.classList.add(up ? "up" : "down");
  th.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = (row) => {
    const td = row.cells[column];
    if (!td) return null;
    if (td.dataset.value === undefined) return td.classList.contains("failed") ? null : td.textContent.trim();
    return td.dataset.value === "" ? null : Number(td.dataset.value);
  };
  const compare = (a, b) => {
    const [x, y] = [key(a), key(b)];
    if (x === null || y === null) return (x === null) - (y === null); // what has no value stays last
    return (up ? 1 : -1) * (typeof x === "number" ? x - y : x.localeCompare(y));
  };
  const body = table.tBodies[0];
  body.append(...[...body.rows].sort(compare));
}
