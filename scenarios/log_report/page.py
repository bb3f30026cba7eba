"""One HTML file on recorded logs that needs nothing else: what the estimators did, and when.

Traces are drawn by uPlot (github.com/leeoniya/uPlot, MIT), which is in the page with its licence.
"""

import base64
import json
import math
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimators.appearance import looks
from estimators.evaluation.logs import FAULT_COLOURS, KNOWN, LEVEL, RAW, LogScores
from estimators.metrics import inclination_error
from quadsim.runs.files import write_whole

from ..report.page import script, uplot
from ..report.template import render
from .verdict import log_verdict

Array = NDArray[np.float64]

MOST_SAMPLES = 12_000
"""Samples of a trace in the page; longer logs are decimated."""
SHOWN = 3
"""Estimators drawn at first."""
MISSING = -32768
"""The integer of a number that is missing."""


def write_log_report(
    path: Path, logs: Sequence[xr.Dataset], scores: LogScores, warnings: Sequence[str] = ()
) -> Path:
    """Write the report of `quadsim evaluate --logs`.

    Args:
        path: HTML file to write.
        logs: The logs that were scored.
        scores: From `score_logs`.
        warnings: Lines about the logs, shown below the verdict.
    """
    channels: list[NDArray[np.int16]] = []
    described = {str(log.attrs["source"]): _log(log, scores, channels) for log in logs}
    names = [name for name in scores.estimators if name != LEVEL]
    appearance = {name: look._asdict() for name, look in looks(names).items()}
    data = {"estimators": sorted(names), "looks": appearance, "shown": names[:SHOWN], "logs": described}
    page = render(
        "log_report/log.html",
        title="Attitude estimators on recorded logs",
        kicker="recorded logs",
        verdict=log_verdict(scores),
        warnings=warnings,
        logs=list(described),
        rows=_table(scores) if scores.scored else [],
        faulty=scores.faulty,
        scored=scores.scored,
        compared=_compared(scores),
        **uplot(),
        script=script("log_report/js/log.js"),
        payload=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        traces=_compress(channels),
    )
    return write_whole(path.expanduser(), page)


def _table(scores: LogScores) -> list[dict[str, object]]:
    """A row for each estimator: means over the logs, and the raw error on each log [deg]."""
    on_log = {(row.estimator, row.log): row.inclination_rmse_deg for row in scores.rows if row.bias == RAW}
    return [
        {
            "estimator": name,
            "means": [scores.mean(name, RAW), scores.mean(name, KNOWN), scores.silenced(name)],
            "logs": [on_log[name, log] for log in scores.scored],
        }
        for name in scores.estimators
        if any(row.estimator == name for row in scores.rows)
    ]


def _compared(scores: LogScores) -> list[dict[str, object]]:
    """Of each log without truth: a row for each estimator, its force and its difference from every other."""
    tables = []
    for log, found in scores.comparisons.items():
        both = dict(found.apart) | {(b, a): apart for (a, b), apart in found.apart.items()}
        names = sorted(found.force, key=lambda name: found.force[name])
        rows = [
            {"estimator": a, "force": found.force[a], "apart": [both.get((a, b)) for b in names]}
            for a in names
        ]
        tables.append({"log": log, "names": names, "rows": rows})
    return tables


def _log(log: xr.Dataset, scores: LogScores, channels: list[NDArray[np.int16]]) -> dict[str, object]:
    """What the page says of a log; its traces are appended to the channels, in the order of their scales."""
    title, rate = str(log.attrs["source"]), float(log.attrs["rate_hz"])
    every = max(1, math.ceil(log.sizes["time"] / MOST_SAMPLES))
    scales: dict[str, float] = {}

    def add(name: str, values: Array) -> None:
        integers, scales[name] = _integers(values[::every])
        channels.append(integers)

    for sensor, factor in (("gyro", 180.0 / math.pi), ("accel", 1.0)):
        for k, axis in enumerate("xyz"):
            add(f"{sensor} {axis}", factor * log[sensor].to_numpy()[0, :, k].astype(float))
    truth = scores.truth[title]
    for k, angle in enumerate(("roll", "pitch") if title not in scores.comparisons else ()):
        add(f"{angle}|truth", np.degrees(truth[:, k]))
    estimated = [name for name in sorted(scores.estimators) if (title, name) in scores.estimates]
    for name in estimated:
        estimate = scores.estimates[title, name]
        for k, angle in enumerate(("roll", "pitch")):
            add(f"{angle}|{name}", np.degrees(estimate[:, k]))
        if title not in scores.comparisons:
            add(f"error|{name}", inclination_error(estimate, truth))
    for name, believed in (
        (name, found) for (whose, name), found in scores.beliefs.items() if whose == title
    ):
        latest = np.searchsorted(believed.samples, np.arange(log.sizes["time"]), side="right") - 1
        probability = believed.probability[0, np.maximum(latest, 0)]
        for k, model in enumerate(believed.models):
            add(f"model|{model}", probability[:, k])
        if title in scores.comparisons:
            for k, angle in enumerate(("roll", "pitch")):
                add(f"sigma|{name}, {angle}", np.degrees(believed.sigma[0, np.maximum(latest, 0), k]))
    counted = scores.counted[title][::every]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~counted, [False]]).astype(int))).reshape(-1, 2)
    return {
        "dt": every / rate,
        "samples": len(counted),
        "scales": scales,
        "uncounted": (edges * every / rate).round(3).tolist(),
        "faults": [
            [fault.sentence, fault.start_s, fault.end_s, FAULT_COLOURS[fault.kind]]
            for fault in scores.faults.get(title, ())
        ],
        "note": _note(log, scores, title, every),
    }


def _note(log: xr.Dataset, scores: LogScores, title: str, every: int) -> str:
    rate = float(log.attrs["rate_hz"])
    done = "compared" if title in scores.comparisons else "scored"
    text = (
        f"{log.sizes['time'] / rate:.0f} s at {rate:g} Hz, {scores.counted[title].sum() / rate:.0f} s {done}"
    )
    text += f"; {scores.bias_text(title)}"
    return text + (f"; one sample of {every} is drawn" if every > 1 else "") + "."


def _integers(values: Array) -> tuple[NDArray[np.int16], float]:
    """16-bit integers of a trace (T,), and their scale; what is not finite is `MISSING`."""
    finite = np.isfinite(values)
    scale = max(float(np.abs(values[finite]).max(initial=0.0)), 1e-6) / 32767
    return np.where(finite, np.round(np.where(finite, values, 0.0) / scale), MISSING).astype("<i2"), scale


def _compress(channels: Sequence[NDArray[np.int16]]) -> str:
    """Differences of all channels, low bytes before high ones, as `compress_flights` has them, in base64."""
    steps = np.diff(np.concatenate([np.zeros(1, "<i2"), *channels]))
    return base64.b64encode(zlib.compress(steps.view(np.uint8).reshape(-1, 2).T.tobytes())).decode()
