"""The report: one HTML file that needs nothing else, with the verdict first."""

import base64
import json
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from estimators.appearance import Look, looks
from quadsim.flight.faults import fault_spans
from quadsim.runs.files import write_whole
from quadsim.runs.record import RunRecord
from quadsim.vehicle import load_vehicle

from ..bench.breaking import DISTURBANCES, BreakingPoint
from ..bench.cell import Cell
from ..bench.controllers import TRUTH
from ..bench.flight_metrics import ERROR_BINS, ERROR_DECADES, METRICS, CellRow, Metric
from ..bench.pairs import ALL, PAIRED, PairRow
from ..bench.runner import Results, identical, shown_once
from ..bench.series import FlightSeries, compress_flights
from ..bench.settings import FlightSettings
from ..bench.signals import SHARED
from ..bench.verdict import ERROR, measure_of, offline_verdict, totals_of, verdict
from .flight_picture import Picture
from .provenance import provenance
from .template import render

SHOWN = 4
"""Estimators drawn at first in the time plots."""
DETAILED = 120
"""Flights whose signals are in the page, the same estimators in every scenario: with them, 30 scenarios × 14
estimators stay below 5 MB."""


@dataclass(frozen=True)
class ClosedLoopSection:
    """A benchmark, as the report shows it."""

    results: Results
    pairs: Sequence[PairRow] = ()
    points: Sequence[BreakingPoint] = ()
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


def write_report(
    path: str | Path,
    closed_loop: ClosedLoopSection | None = None,
    offline: OfflineSection | None = None,
    *,
    title: str = "",
    csv: Sequence[str] = (),
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
        csv: Files beside the report to link to.
        footer: How it was made.
        focus: The estimator that the verdict describes besides the best, if it ran.
        record: Of the run, for the foot.

    Raises:
        ValueError: If there is nothing to report.
    """
    if closed_loop is None and (offline is None or not offline.rows):
        raise ValueError("nothing to report: neither closed-loop results nor recorded flights were given")
    closed_loop = closed_loop or ClosedLoopSection(Results({}, [], FlightSettings(), []))
    about = provenance(closed_loop.results, record)
    closed_loop, focus, same = _once(closed_loop, focus)
    results, still, offline = closed_loop.results, closed_loop.still, offline or OfflineSection(())
    rows = results.rows
    judged = verdict(results, focus) if rows else offline_verdict(offline.rows)
    ranked = [standing.estimator for standing in judged.standings]
    place = {pair: k for k, pair in enumerate(product(results.scenarios, ranked))}
    recorded = [str(row.get("estimator")) for row in offline.rows]
    names = results.estimators or recorded
    order = list(dict.fromkeys([*(n for n in (TRUTH, focus) if n in names), *ranked, *names]))
    flights = PageFlights.of(results, order)
    measure = measure_of(results.estimators)
    controllers = measure != ERROR
    question = f"Which {'estimator and controller' if controllers else 'attitude estimator'} to fly"
    context = {
        "title": title or question,
        "kicker": "closed loop" if rows else "recorded flights",
        "verdict": judged,
        "same": same,
        "warnings": results.warnings,
        "rows": sorted(rows, key=lambda row: place[row.scenario, row.estimator]),
        "metrics": _metrics(results),
        "contender": "Estimator @ controller" if controllers else "Estimator",
        "measure": measure.name,
        "scenarios": [{"name": n, "description": s.description} for n, s in results.scenarios.items()],
        "ranked": ranked,
        "totals": totals_of(rows),
        "lookup": {(row.scenario, row.estimator): row for row in rows},
        "pairs": bool(closed_loop.pairs),
        "paired": [metric for metric in _metrics(results) if metric.key in PAIRED],
        "breaking": _breaking(closed_loop.points),
        "offline": _offline_table(offline.rows),
        "offline_caption": offline.caption,
        "pictures": {
            name.replace("-", " "): base64.b64encode(each.read_bytes()).decode()
            for name, each in offline.pictures.items()
        },
        "still": still
        and base64.b64encode(imageio.imwrite("<bytes>", still.image, extension=".jpg", quality=88)).decode(),
        "still_caption": still.caption if still else "",
        "film": closed_loop.film and base64.b64encode(closed_loop.film.read_bytes()).decode(),
        "csv": list(csv),
        "footer": footer or _footer(results),
        "provenance": about,
        "script": script("report/js/report.js"),
        "payload": _payload(closed_loop, rows, names, order, ranked, flights, looks([*names, *recorded])),
        "flights": compress_flights(flights.packed),
        **uplot(),
    }
    return write_whole(Path(path).expanduser(), render("report/report.html", **context))


def _once(section: ClosedLoopSection, focus: str) -> tuple[ClosedLoopSection, str, str]:
    """A benchmark without the estimators that flew exactly as another, what is in focus, and who they are."""
    same = identical(section.results)
    results, said = shown_once(section.results)
    pairs = [pair for pair in section.pairs if not same.keys() & {pair.estimator, pair.versus}]
    points = [point for point in section.points if point.estimator not in same]
    return replace(section, results=results, pairs=pairs, points=points), same.get(focus, focus), said


def _footer(results: Results) -> str:
    if not results.cells:
        return ""
    s = results.settings
    return (
        f"{s.seeds} flight{'s' if s.seeds > 1 else ''} in each cell, from the root seed {s.seed}, "
        f"at {s.rate_hz:g} Hz. Flight i of every estimator has the same wind, sensor noise and start. Roll "
        "and pitch come from the estimator, position, velocity and yaw from an external sensor: "
        f"{', '.join(sorted({scenario.external for scenario in results.scenarios.values()}))}."
    )


def _breaking(points: Sequence[BreakingPoint]) -> dict[str, object]:
    """Disturbances as columns, estimators as rows, each entry with the length of its bar."""
    kinds = {key: DISTURBANCES[key] for key in DISTURBANCES if any(p.disturbance == key for p in points)}
    scale = {key: max([p.flies_at or 0.0 for p in points if p.disturbance == key] or [0.0]) for key in kinds}
    found = {(p.estimator, p.disturbance): p for p in points}

    def entry(point: BreakingPoint | None, most: float) -> dict[str, object]:
        if point is None:
            return {"text": "–", "value": None, "share": 0.0, "title": ""}
        level = point.flies_at or 0.0
        value = None if point.reason else point.crashes_at or 2 * level
        title = point.reason or f"{point.cause}, of {point.seeds} flights"
        return {"text": point.text, "value": value, "share": level / most if most else 0.0, "title": title}

    names = dict.fromkeys(point.estimator for point in points)
    rows = [{"estimator": n, "entries": [entry(found.get((n, k)), scale[k]) for k in kinds]} for n in names]
    return {"kinds": list(kinds.values()), "rows": rows}


def _offline_table(rows: Sequence[Mapping[str, object]]) -> dict[str, object] | None:
    if not rows:
        return None
    keys = list(dict.fromkeys(key for row in rows for key in row))
    numeric = {k: all(isinstance(row.get(k), int | float | np.number | None) for row in rows) for k in keys}
    columns = [{"key": key, "label": _label(key), "numeric": numeric[key]} for key in keys]
    return {"columns": columns, "rows": [{key: row.get(key) for key in keys} for row in rows]}


def _label(key: str) -> str:
    """Heading for a key: `mean_deg` becomes "mean [deg]"."""
    for unit in ("deg", "m", "s", "ms", "us"):
        if key.endswith(f"_{unit}"):
            return f"{key.removesuffix(f'_{unit}').replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


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
        most = DETAILED // max(len(results.scenarios), 1)
        detailed = sorted(order, key=lambda name: name == TRUTH)[:most]
        longest: dict[str, FlightSeries] = {}
        for cell in results.cells:
            if cell.series and cell.series.signals:
                before = longest.setdefault(cell.scenario, cell.series)
                longest[cell.scenario] = max(before, cell.series, key=lambda series: series.samples)
        return cls(
            [
                cell.series and _with_signals(cell.series, cell.estimator in detailed)
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


def _payload(
    closed_loop: ClosedLoopSection,
    rows: Sequence[CellRow],
    names: Sequence[str],
    order: Sequence[str],
    ranked: Sequence[str],
    flights: PageFlights,
    drawn: Mapping[str, Look],
) -> str:
    results = closed_loop.results
    low, high = ERROR_DECADES
    data: dict[str, object] = {
        "estimators": list(dict.fromkeys(names)),
        "looks": {name: look._asdict() for name, look in drawn.items()},
        "ranked": list(ranked),
        "scenarios": list(results.scenarios),
        "shown": order[:SHOWN],
        "metrics": [vars(metric) for metric in _metrics(results)],
        "edges": {"low": low, "high": high, "bins": ERROR_BINS},
    }
    if results.cells:
        vehicle = load_vehicle(next(iter(results.scenarios.values())).vehicle)
        data |= {
            "cells": {
                f"{cell.scenario}|{cell.estimator}": _cell(cell, row, series)
                for cell, row, series in zip(results.cells, rows, flights.cells, strict=True)
            },
            "shared": {scenario: _described(series) for scenario, series in flights.shared.items()},
            "faults": {n: fault_spans(s.faults, s.duration_s) for n, s in results.scenarios.items()},
            "pairs": _pairs(closed_loop.pairs),
            "all": ALL,
            "best": next((name for name in ranked if name not in results.unranked), None),
            "series_seed": 0,
            "hubs": vehicle.hubs.tolist(),
            "prop_radius": vehicle.frame.prop_radius,
        }
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _pairs(pairs: Sequence[PairRow]) -> dict[str, list]:
    """Compact: "metric|scenario" to lists of estimator, versus, difference, low, high, pairs, crashes."""
    out: dict[str, list] = {}
    for row in pairs:
        entry = (
            row.estimator, row.versus, row.difference, row.low, row.high, row.pairs, row.crashed_alone,
            row.versus_crashed_alone,
        )  # fmt: skip
        numbers = [round(v, 5) if isinstance(v, float) else v for v in entry]
        out.setdefault(f"{row.metric}|{row.scenario}", []).append(numbers)
    return out


def _cell(cell: Cell, row: CellRow, series: FlightSeries | None) -> dict[str, object]:
    """What the charts show of a cell."""
    values = {metric.key: getattr(row, metric.key) for metric in METRICS}
    return {"values": values, "histogram": cell.histogram, "series": series and _described(series)}


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
