"""The report: one HTML file that needs nothing else, with the verdict first."""

import base64
import json
import os
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path

import imageio.v3 as imageio

from estimators.appearance import looks
from quadsim.flight.faults import fault_spans
from quadsim.runs.files import write_whole
from quadsim.runs.record import RunRecord, load_record
from quadsim.vehicle import load_vehicle

from ..bench.cell import FlightSettings
from ..bench.controllers import TRUTH
from ..bench.flight_log import SHARED
from ..bench.flight_metrics import ERROR_BINS, ERROR_DECADES, METRICS, Metric
from ..bench.ranking import ALL, PAIRED, PairRow, paired_differences
from ..bench.results import Results, hours, mean_of, shown_once, totals_of
from ..bench.series import FlightSeries, compress_flights
from ..bench.verdict import ERROR, Verdict, measure_of, verdict
from .flight_picture import Picture, cover
from .template import render

SHOWN = 4
"""Estimators drawn at first in the time plots."""
TIMED = 450
"""Flights in time that are in the page, the same estimators in every scenario,"""
DETAILED = 120
"""and those whose signals are: with them, 30 scenarios × 14 estimators stay below 5 MB."""


@dataclass(frozen=True)
class ClosedLoopSection:
    """A benchmark, as the report shows it."""

    results: Results
    still: Picture | None = None
    """Picture for the top."""
    film: Path | None = None
    """Video for the top, MP4."""


@dataclass(frozen=True)
class OfflineSection:
    """Estimators on recorded flights, as the report shows them."""

    rows: Sequence[Mapping[str, object]]
    """Rows of the table, with the key "estimator"; every key is a column."""
    caption: str = "Estimators run over recorded flights, without a loop."
    pictures: Mapping[str, Path] = field(default_factory=dict)
    """PNG files to show below the table, by title."""
    headline: str = "Recorded flights"
    """Of a report without a benchmark."""


def publish(folder: str | Path, results: Results, path: Path | None = None) -> tuple[Path, str]:
    """Write the report of a benchmark's folder.

    Args:
        folder: Where `bench` wrote its tables, to which the report links.
        results: What it returned.
        path: The report, by default report.html in the folder.

    Returns:
        The report, and why there is no picture; empty if there is one.

    Raises:
        OSError: If a file cannot be written.
    """
    folder = Path(folder).expanduser()
    page = (path or folder / "report.html").expanduser()
    still, note = cover(results.cells)
    tables = [folder / "results.csv", folder / "flights.parquet"]
    links = [Path(os.path.relpath(table, page.parent)).as_posix() for table in tables]
    section = ClosedLoopSection(results, still)
    return write_report(page, section, files=links, record=load_record(folder)), note


def write_report(
    path: str | Path,
    closed_loop: ClosedLoopSection | None = None,
    offline: OfflineSection | None = None,
    *,
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
        title: Heading; empty: the question that the report answers.
        files: Files beside the report to link to.
        footer: How it was made.
        focus: An estimator whose flights are shown at first, besides the best.
        record: Of the run, for the foot.

    Raises:
        ValueError: If there is nothing to report.
    """
    if closed_loop is None and (offline is None or not offline.rows):
        raise ValueError("nothing to report: neither closed-loop results nor recorded flights were given")
    closed_loop = closed_loop or ClosedLoopSection(Results({}, [], FlightSettings(), []))
    offline = offline or OfflineSection(())
    judged = verdict(closed_loop.results) if closed_loop.results.cells else Verdict(offline.headline, [], [])
    results, _ = shown_once(closed_loop.results)
    measure, metrics = measure_of(results.estimators), _metrics(results)
    ranked = [standing.estimator for standing in judged.standings]
    place = {pair: k for k, pair in enumerate(product(results.scenarios, ranked))}
    recorded = [str(row.get("estimator")) for row in offline.rows]
    names = results.estimators or recorded
    order = list(dict.fromkeys([*(n for n in (TRUTH, focus) if n in names), *ranked, *names]))
    flights, pairs = PageFlights.of(results, order), paired_differences(results.flights)
    contender = "estimator" if measure == ERROR else "estimator and controller"
    still, film = closed_loop.still, closed_loop.film
    context = {
        "title": title or f"Which {contender} to fly",
        "kicker": "closed loop" if results.cells else "recorded flights",
        "verdict": judged,
        "results": results,
        "rows": sorted(results.rows, key=lambda row: place[row.scenario, row.estimator]),
        "metrics": metrics,
        "contender": contender.capitalize(),
        "measure": measure.name,
        "ranked": ranked,
        "totals": totals_of(results.rows),
        "axes": _axes(results),
        "pairs": bool(pairs),
        "paired": [metric for metric in metrics if metric.key in PAIRED],
        "points": {(point.estimator, point.sweep): point for point in results.points},
        "offline": offline,
        "pictures": {name: _encoded(each.read_bytes()) for name, each in offline.pictures.items()},
        "still": still and _encoded(imageio.imwrite("<bytes>", still.image, extension=".jpg", quality=88)),
        "caption": still.caption if still else "",
        "film": film and _encoded(film.read_bytes()),
        "files": files,
        "footer": footer,
        "record": record,
        "wall": record and hours(record.wall_s),
        "script": script("report/js/report.js"),
        "flights": compress_flights(flights.packed),
        **uplot(),
    }
    data: dict[str, object] = {
        "estimators": list(dict.fromkeys(names)),
        "looks": {name: look._asdict() for name, look in looks([*names, *recorded]).items()},
        "ranked": ranked,
        "scenarios": list(results.scenarios),
        "shown": order[:SHOWN],
        "metrics": [vars(metric) for metric in metrics],
    }
    if results.cells:
        data |= _closed_loop_data(results, flights, pairs)
        data["levels"] = {"|".join(key): vars(row) for key, row in results.by_level.items()}
        data["best"] = next((name for name in ranked if name not in results.unranked), None)
    payload = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return write_whole(Path(path).expanduser(), render("report/report.html", payload=payload, **context))


def _axes(results: Results) -> dict[str, list[str]]:
    """Each axis with its levels; without axes "scenario" alone."""
    found: dict[str, dict[str, None]] = {}
    for axis, level, _ in results.by_level:
        found.setdefault(axis, {})[level] = None
    return {axis: list(levels) for axis, levels in found.items()}


def _encoded(file: bytes) -> str:
    return base64.b64encode(file).decode()


@dataclass(frozen=True)
class PageFlights:
    """Flights in time as they are in the page."""

    cells: Sequence[FlightSeries | None]
    """Of each cell; with its signals where there is room for them."""
    shared: Mapping[str, FlightSeries]
    """Of each scenario: what is the same with every estimator."""

    @property
    def packed(self) -> list[FlightSeries]:
        """All of them, in the order in which the page unpacks them."""
        return [*(series for series in self.cells if series), *self.shared.values()]

    @classmethod
    def of(cls, results: Results, order: Sequence[str]) -> "PageFlights":
        """Those of a benchmark; `order` has the estimators whose signals are wanted most first."""
        wanted = sorted(order, key=lambda name: name == TRUTH)
        timed, detailed = (wanted[: most // max(len(results.scenarios), 1)] for most in (TIMED, DETAILED))
        longest: dict[str, FlightSeries] = {}
        for cell in results.cells:
            if cell.series and cell.series.signals:
                before = longest.setdefault(cell.scenario, cell.series)
                longest[cell.scenario] = max(before, cell.series, key=lambda series: series.samples)
        return cls(
            [
                _with_signals(cell.series, cell.estimator in detailed)
                if cell.series and cell.estimator in timed
                else None
                for cell in results.cells
            ],
            {
                scenario: FlightSeries(s.dt, {k: s.signals[k] for k in SHARED if k in s.signals})
                for scenario, s in longest.items()
            },
        )


def _with_signals(series: FlightSeries, signals: bool) -> FlightSeries:
    own = {name: channel for name, channel in series.signals.items() if signals and name not in SHARED}
    return replace(series, channels=series.channels | own, signals={})


def _metrics(results: Results) -> list[Metric]:
    """The columns, that which ranks first; none without flights."""
    first = measure_of(results.estimators).key
    return sorted(METRICS, key=lambda metric: metric.key != first) if results.cells else []


def _closed_loop_data(results: Results, flights: PageFlights, pairs: Sequence[PairRow]) -> dict[str, object]:
    """What the charts show of a benchmark."""
    low, high = ERROR_DECADES
    rows = {name: [row for row in results.rows if row.estimator == name] for name in results.estimators}
    means = {
        n: {m.key: mean_of([getattr(r, m.key) for r in own]) for m in METRICS} for n, own in rows.items()
    }
    return {
        "edges": {"low": low, "high": high, "bins": ERROR_BINS},
        "cells": {
            f"{cell.scenario}|{cell.estimator}": {
                "histogram": cell.histogram,
                "series": series and _described(series),
            }
            for cell, series in zip(results.cells, flights.cells, strict=True)
        },
        "means": means,
        "shared": {scenario: _described(series) for scenario, series in flights.shared.items()},
        "faults": {n: fault_spans(s.faults, s.duration_s) for n, s in results.scenarios.items()},
        "pairs": _pairs([row for row in pairs if row.scenario == ALL or not results.levels]),
        "all": ALL,
        "series_seed": 0,
        "bodies": {n: _body(s.vehicle) for n, s in results.scenarios.items()},
    }


def _body(name: str) -> dict[str, object]:
    vehicle = load_vehicle(name)
    return {"hubs": vehicle.hubs.tolist(), "prop_radius": vehicle.frame.prop_radius}


def _pairs(pairs: Sequence[PairRow]) -> dict[str, list]:
    """Compact: "metric|scenario" to lists of estimator, versus, pairs, difference, low, high, crashes."""
    out: dict[str, list] = {}
    for row in pairs:
        _, _, *entry = asdict(row).values()
        numbers = [round(v, 5) if isinstance(v, float) else v for v in entry]
        out.setdefault(f"{row.metric}|{row.scenario}", []).append(numbers)
    return out


def _described(series: FlightSeries) -> dict[str, object]:
    """All of a flight in time but its integers."""
    scales = {name: channel.scale for name, channel in series.channels.items()}
    return {"dt": series.dt, "samples": series.samples, "scales": scales}


def uplot() -> dict[str, str]:
    """Script, style and licence of uPlot (github.com/leeoniya/uPlot, MIT), which draws the traces."""
    folder = Path(__file__).parent / "uplot"
    source = (folder / "uPlot.iife.min.js").read_text("utf-8")
    return {
        "uplot": re.sub(r"^/\*!.*?\*/\s*", "", source),
        "uplot_css": (folder / "uPlot.min.css").read_text("utf-8"),
        "licence": (folder / "LICENSE").read_text("utf-8"),
    }


def script(entry: str) -> str:
    """A module below `scenarios/` and all that it imports as one script, imported ones first."""
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
