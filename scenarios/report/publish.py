"""The report of a benchmark's folder, and the tables beside it."""

import os
from collections.abc import Sequence
from pathlib import Path

from quadsim.runs.files import save_figure, write_csv
from quadsim.runs.record import load_record

from ..bench import axes
from ..bench.axes import Combination
from ..bench.breaking import BreakingPoint
from ..bench.pairs import paired_differences
from ..bench.runner import Results
from .axes_figure import axes_figure
from .axes_page import write_axes_report
from .flight_picture import cover
from .page import ClosedLoopSection, write_report

MADE = ("pairs.csv", "breaking.csv", "axes.csv", "effects.csv", "axes.png")
"""Files beside a report, not all of which every run has."""


def publish(
    folder: str | Path, results: Results, points: Sequence[BreakingPoint] = (), path: Path | None = None
) -> tuple[Path, str]:
    """Write pairs.csv, breaking.csv if there are such points, and report.html, which links to them.

    Args:
        folder: Where `bench` wrote results.csv and flights.csv.
        results: What it returned.
        points: Breaking points.
        path: The report, by default report.html in the folder.

    Returns:
        The report, and why there is no picture; empty if there is one.

    Raises:
        OSError: If a file cannot be written.
    """
    folder = Path(folder).expanduser()
    pairs = paired_differences(results.flights)
    page = (path or folder / "report.html").expanduser()
    links = _write_tables(folder, {"pairs.csv": pairs, "breaking.csv": points}, page)
    still, note = cover(results.cells)
    section = ClosedLoopSection(results, pairs, points, still)
    return write_report(page, section, csv=links, record=load_record(folder)), note


def publish_axes(
    folder: str | Path, results: Results, combinations: Sequence[Combination], path: Path | None = None
) -> Path:
    """Write axes.csv, effects.csv, axes.png and the report by condition.

    Args:
        folder: Where `bench` wrote results.csv and flights.csv.
        results: What it returned.
        combinations: The design that it flew.
        path: The report, by default report.html in the folder.

    Raises:
        OSError: If a file cannot be written.
        ValueError: No estimator flew.
    """
    folder = Path(folder).expanduser()
    effects = axes.effects(combinations, results)
    page = (path or folder / "report.html").expanduser()
    links = _write_tables(folder, {"axes.csv": axes.table(combinations), "effects.csv": effects}, page)
    save_figure(folder / "axes.png", axes_figure(effects), dpi=130)
    return write_axes_report(page, combinations, results, effects, csv=links, record=load_record(folder))


def designed(folder: str | Path, results: Results) -> list[Combination]:
    """The design that the results of a folder are of; none if they are of scenarios as they stand.

    Raises:
        ValueError: axes.csv is no table of a design.
    """
    found = axes.read_table(Path(folder).expanduser() / "axes.csv")
    return found if [each.name for each in found] == list(results.scenarios) else []


def _write_tables(folder: Path, tables: dict[str, Sequence], page: Path) -> list[str]:
    """Write those that have rows, remove those of an earlier run, and return links from the page to all."""
    filled = {name: rows for name, rows in tables.items() if rows}
    for name in set(MADE) - filled.keys():
        (folder / name).unlink(missing_ok=True)
    for name, rows in filled.items():
        write_csv(folder / name, rows)
    files = ["results.csv", "flights.csv", *filled]
    return [Path(os.path.relpath(folder / name, page.parent)).as_posix() for name in files]
