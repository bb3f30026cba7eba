"""The report: one self-contained HTML file, with the verdict first."""

import base64
import json
import os
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from estimators.appearance import looks
from quadsim.flight.faults import fault_spans
from quadsim.runs.files import write_whole
from quadsim.runs.record import RunRecord, load_record
from quadsim.vehicle import load_vehicle

from ..bench.cell import FlightSettings
from ..bench.controllers import TRUTH
from ..bench.flight_log import SHARED
from ..bench.flight_metrics import ERROR_BINS, ERROR_DECADES, METRICS
from ..bench.flight_series import CHANNELS, FlightSeries, compress_flights
from ..bench.results import Results, hours
from ..bench.verdict import ERROR, Verdict, measure_of, verdict
from .template import render

SHOWN = 4
"""Number of estimators that the time plots show initially."""
TIMED = 450
"""Number of estimators per scenario with time series in the page."""
DETAILED = 120
"""Number of estimators per scenario with signals; with these, 30 scenarios × 14 estimators stay below 5
MB."""


@dataclass(frozen=True)
class OfflineSection:
    """Section of the report on recorded flights."""

    rows: Sequence[Mapping[str, object]]
    """Rows of the table, with the key "estimator"; every key is a column."""
    caption: str = "Estimators run over recorded flights, without a loop."
    pictures: Mapping[str, Path] = field(default_factory=dict)
    """PNG files to show below the table, by title."""
    headline: str = "Recorded flights"
    """Headline of a report without a benchmark."""


def publish(folder: str | Path, results: Results, path: Path | None = None) -> Path:
    """Write the report of a benchmark's folder.

    Args:
        folder: Folder with the tables of the benchmark, to which the report links.
        results: Results of the benchmark.
        path: The report, by default report.html in the folder.

    Raises:
        OSError: A file cannot be written.
    """
    folder = Path(folder).expanduser()
    page = (path or folder / "report.html").expanduser()
    tables = [folder / "results.csv", folder / "flights.parquet"]
    links = [Path(os.path.relpath(table, page.parent)).as_posix() for table in tables]
    return write_report(page, results, files=links, record=load_record(folder))


def write_report(
    path: str | Path,
    closed_loop: Results | None = None,
    offline: OfflineSection | None = None,
    *,
    film: Path | None = None,
    title: str = "",
    files: Sequence[str] = (),
    footer: str = "",
    focus: str = "att-snn-loihi",
    record: RunRecord | None = None,
) -> Path:
    """Write the report.

    Args:
        path: HTML file to write.
        closed_loop: Results of a benchmark.
        offline: Results on recorded flights.
        film: Video for the top, MP4.
        title: Heading; empty for the default one.
        files: Files in the same folder to link to.
        footer: Text about the origin of the report.
        focus: An estimator whose flights are shown initially, in addition to the best ones.
        record: Record of the run, for the footer.

    Raises:
        ValueError: There are no results.
    """
    if closed_loop is None and (offline is None or not offline.rows):
        raise ValueError("nothing to report: neither closed-loop results nor recorded flights were given")
    offline = offline or OfflineSection(())
    judged = verdict(closed_loop) if closed_loop else Verdict(offline.headline, [], [])
    results = closed_loop or Results({}, [], FlightSettings(), [])
    measure, scenarios = measure_of(results.estimators), results.scenarios
    metrics = sorted(METRICS, key=lambda metric: metric.key != measure.key) if results.cells else []
    ranked = [standing.estimator for standing in judged.standings]
    place = {pair: k for k, pair in enumerate(product(scenarios, ranked))}
    recorded = [str(row.get("estimator")) for row in offline.rows]
    names = results.estimators or recorded
    order = list(dict.fromkeys([*(n for n in (TRUTH, focus) if n in names), *ranked, *names]))
    cells, shared = page_flights(results, order)
    contender = "estimator" if measure == ERROR else "estimator and controller"
    context = {
        "title": title or f"Which {contender} to fly",
        "kicker": "closed loop" if results.cells else "outside the loop",
        "verdict": judged,
        "results": results,
        "rows": sorted(results.rows, key=lambda row: place[row.scenario, row.estimator]),
        "metrics": metrics,
        "contender": contender.capitalize(),
        "measure": measure.name,
        "ranked": ranked,
        "by_scenario": not results.levels,
        "offline": offline,
        "pictures": {name: _encoded(each) for name, each in offline.pictures.items()},
        "film": film and _encoded(film),
        "files": files,
        "footer": footer,
        "record": record,
        "wall": record and hours(record.wall_s),
        "script": script("report/js/report.js"),
        "flights": compress_flights([*filter(None, cells), *shared.values()]),
        **uplot(),
    }
    vehicles = {name: load_vehicle(each.vehicle) for name, each in scenarios.items()}
    data = {
        "estimators": list(dict.fromkeys(names)),
        "looks": {name: look._asdict() for name, look in looks([*names, *recorded]).items()},
        "ranked": ranked,
        "scenarios": list(scenarios),
        "shown": order[:SHOWN],
        "metrics": [vars(metric) for metric in metrics],
        "edges": dict(zip(("low", "high", "bins"), (*ERROR_DECADES, ERROR_BINS), strict=True)),
        "cells": {
            f"{cell.scenario}|{cell.estimator}": {
                "histogram": cell.histogram,
                "series": series and described(series),
            }
            for cell, series in zip(results.cells, cells, strict=True)
        },
        "means": {name: total._asdict() for name, total in results.totals.items()},
        "levels": {"|".join(key): row._asdict() for key, row in results.by_level.items()},
        "shared": {name: described(series) for name, series in shared.items()},
        "faults": {name: fault_spans(each.faults, each.duration_s) for name, each in scenarios.items()},
        "bodies": {
            name: {"hubs": vehicle.hubs.tolist(), "prop_radius": vehicle.frame.prop_radius}
            for name, vehicle in vehicles.items()
        },
        "best": next((name for name in ranked if name not in results.unranked), None),
    }
    payload = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return write_whole(Path(path).expanduser(), render("report/report.html", payload=payload, **context))


def _encoded(file: Path) -> str:
    return base64.b64encode(file.read_bytes()).decode()


def page_flights(
    results: Results, order: Sequence[str]
) -> tuple[list[FlightSeries | None], dict[str, FlightSeries]]:
    """Return the time series of flights for the page.

    Args:
        results: Results of the benchmark.
        order: Estimators, in order of priority for signals.

    Returns:
        The series of each cell, with signals for some estimators; and for each scenario, the signals that do
        not depend on the estimator, from the longest flight.
    """
    wanted = sorted(order, key=lambda name: name == TRUTH)
    timed, detailed = (wanted[: most // max(len(results.scenarios), 1)] for most in (TIMED, DETAILED))
    cells: list[FlightSeries | None] = []
    shared: dict[str, FlightSeries] = {}
    for cell in results.cells:
        own = None
        if cell.series:
            kept = (lambda name: name not in SHARED) if cell.estimator in detailed else CHANNELS.__contains__
            own = cell.series.only(kept) if cell.estimator in timed else None
            if (found := cell.series.only(SHARED.__contains__)).channels:
                shared[cell.scenario] = max(shared.get(cell.scenario, found), found, key=lambda s: s.samples)
        cells.append(own)
    return cells, shared


def described(series: FlightSeries) -> dict[str, object]:
    """Return the description of a time series without its integers, for the scripts of pages."""
    scales = {name: channel.scale for name, channel in series.channels.items()}
    return {"dt": series.dt, "samples": series.samples, "scales": scales}


def uplot() -> dict[str, str]:
    """Return script, style and licence of uPlot (github.com/leeoniya/uPlot, MIT), which draws the traces."""
    folder = Path(__file__).parent / "uplot"
    source = (folder / "uPlot.iife.min.js").read_text("utf-8")
    return {
        "uplot": re.sub(r"^/\*!.*?\*/\s*", "", source),
        "uplot_css": (folder / "uPlot.min.css").read_text("utf-8"),
        "licence": (folder / "LICENSE").read_text("utf-8"),
    }


def script(entry: str) -> str:
    """Join a JavaScript module below `scenarios/` and its imports to one script, imports first."""
    found: dict[str, str] = {}

    def visit(name: str) -> None:
        source = Path(__file__).parents[1].joinpath(name).read_text(encoding="utf-8")
        for other in re.findall(r'^import .* from "(.*)";$', source, re.MULTILINE):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), other))
            if path not in found:
                visit(path)
        found[name] = re.sub(r"^(import .*\n|export )", "", source, flags=re.MULTILINE)

    visit(entry)
    return '"use strict";\n' + "\n".join(found.values())
