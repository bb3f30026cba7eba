"""The report of a benchmark's folder, and the tables beside it."""

import os
from collections.abc import Sequence
from pathlib import Path

from quadsim.runs.files import write_csv

from ..bench.breaking import BreakingPoint
from ..bench.pairs import paired_differences
from ..bench.runner import Results
from .flight_picture import cover
from .page import ClosedLoopSection, write_report


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
    files = ["results.csv", "flights.csv"]
    for name, rows in (("pairs.csv", pairs), ("breaking.csv", points)):
        (folder / name).unlink(missing_ok=True)  # of an earlier run
        if rows:
            write_csv(folder / name, rows)
            files.append(name)
    still, note = cover(results.cells)
    page = path or folder / "report.html"
    links = [Path(os.path.relpath(folder / name, page.expanduser().parent)).as_posix() for name in files]
    return write_report(page, ClosedLoopSection(results, pairs, points, still), csv=links), note
