"""The report: one HTML file that needs nothing else, with the verdict first."""

import base64
import json
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

import imageio.v3 as imageio
import jinja2
import numpy as np

from estimators.appearance import looks
from quadsim.runs.files import write_whole
from quadsim.vehicle import load_vehicle

from ..bench.breaking import DISTURBANCES, BreakingPoint
from ..bench.cell import Cell
from ..bench.flight_metrics import ERROR_BINS, ERROR_DECADES, METRICS, CellRow
from ..bench.pairs import ALL, PAIRED, PairRow
from ..bench.runner import Results
from ..bench.series import compress_flights
from ..bench.settings import FlightSettings
from ..bench.verdict import TRUTH, offline_verdict, verdict
from .flight_picture import Picture

SHOWN = 4
"""Estimators drawn at first in the time plots."""


@dataclass(frozen=True)
class ClosedLoopSection:
    """A benchmark, as the report shows it."""

    results: Results
    pairs: Sequence[PairRow] = ()
    points: Sequence[BreakingPoint] = ()
    still: Picture | None = None
    """Picture for the top."""


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
    title: str = "Which attitude estimator to fly",
    csv: Sequence[str] = (),
    footer: str = "",
    focus: str = "att-snn-loihi",
) -> Path:
    """Write the report.

    Args:
        path: HTML file to write.
        closed_loop: Results of a benchmark.
        offline: Results on recorded flights.
        title: Heading.
        csv: Files beside the report to link to.
        footer: How it was made.
        focus: The estimator that the verdict describes besides the best, if it ran.

    Raises:
        ValueError: If there is nothing to report.
    """
    if closed_loop is None and (offline is None or not offline.rows):
        raise ValueError("nothing to report: neither closed-loop results nor recorded flights were given")
    closed_loop = closed_loop or ClosedLoopSection(Results({}, [], FlightSettings(), []))
    results, still, offline = closed_loop.results, closed_loop.still, offline or OfflineSection(())
    rows = results.rows
    context = {
        "title": title,
        "verdict": verdict(rows, focus, closed_loop.pairs) if rows else offline_verdict(offline.rows),
        "warnings": results.warnings,
        "rows": rows,
        "metrics": METRICS if rows else (),
        "scenarios": [{"name": n, "description": s.description} for n, s in results.scenarios.items()],
        "estimators": results.estimators,
        "lookup": {(row.scenario, row.estimator): row for row in rows},
        "pairs": bool(closed_loop.pairs),
        "paired": [metric for metric in METRICS if metric.key in PAIRED],
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
        "csv": list(csv),
        "footer": footer or _footer(results),
        "script": script("report/js/report.js"),
        "payload": _payload(closed_loop, rows, offline.rows, focus),
        "flights": compress_flights(cell.series for cell in results.cells if cell.series),
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("scenarios.report", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = _number
    return write_whole(Path(path).expanduser(), environment.get_template("report.html").render(context))


def _footer(results: Results) -> str:
    if not results.cells:
        return ""
    s = results.settings
    return (
        f"{s.seeds} flight{'s' if s.seeds > 1 else ''} in each cell, seeds 0 to {s.seeds - 1} of {s.seed}, "
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


def _payload(
    closed_loop: ClosedLoopSection,
    rows: Sequence[CellRow],
    offline: Sequence[Mapping[str, object]],
    focus: str,
) -> str:
    results = closed_loop.results
    recorded = [str(row.get("estimator")) for row in offline]
    names = results.estimators or recorded
    ranked = [s.estimator for s in verdict(rows, focus).standings]
    shown = list(dict.fromkeys([*(n for n in (TRUTH, focus) if n in names), *ranked]))[:SHOWN]
    low, high = ERROR_DECADES
    data: dict[str, object] = {
        "estimators": list(dict.fromkeys(names)),
        "looks": {name: look._asdict() for name, look in looks([*names, *recorded]).items()},
        "scenarios": list(results.scenarios),
        "shown": shown,
        "metrics": [vars(metric) for metric in METRICS],
        "edges": {"low": low, "high": high, "bins": ERROR_BINS},
    }
    if results.cells:
        vehicle = load_vehicle(next(iter(results.scenarios.values())).vehicle)
        data |= {
            "cells": {
                f"{cell.scenario}|{cell.estimator}": _cell(cell, row)
                for cell, row in zip(results.cells, rows, strict=True)
            },
            "pairs": _pairs(closed_loop.pairs),
            "all": ALL,
            "best": next((name for name in ranked if name != TRUTH), None),
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


def _cell(cell: Cell, row: CellRow) -> dict[str, object]:
    """What the charts show of a cell; of its flight in time all but the integers."""
    values = {metric.key: getattr(row, metric.key) for metric in METRICS}
    series = cell.series and {
        "dt": cell.series.dt,
        "samples": cell.series.samples,
        "scales": {name: channel.scale for name, channel in cell.series.channels.items()},
    }
    return {"values": values, "histogram": cell.histogram, "series": series}


def script(entry: str) -> str:
    """A module below `scenarios/` and all that it imports as one script, imported ones first."""
    found: dict[str, str] = {}

    def visit(name: str) -> None:
        source = files("scenarios").joinpath(name).read_text(encoding="utf-8")
        for other in re.findall(r'^import .* from "(.*)";$', source, re.MULTILINE):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), other))
            if path not in found:
                visit(path)
        found[name] = re.sub(r"^(import .*\n|export )", "", source, flags=re.MULTILINE)

    visit(entry)
    return '"use strict";\n' + "\n".join(found.values())


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
