"""One HTML file on recorded logs that needs nothing else: what the estimators did, and when.

Traces are drawn by uPlot (github.com/leeoniya/uPlot, MIT), which is in the page with its licence.
"""

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators.appearance import looks
from estimators.evaluation.logs import KINDS, LEVEL, LogScores, ScoredLog
from estimators.evaluation.without_truth import Comparison
from estimators.metrics import inclination_error
from quadsim.dataset.stretches import stretches
from quadsim.runs.files import write_whole

from ..bench.flight_series import FlightSeries, compress_flights, pack_channel
from ..report.page import described, script, uplot
from ..report.template import render
from .log_verdict import log_verdict

Array = NDArray[np.float64]

MOST_SAMPLES = 12_000
"""Samples of a trace in the page; longer logs are decimated."""
SHOWN = 4
"""Estimators drawn at first."""
FAULT_COLOURS = {
    "bias jump": "#cc79a7",
    "stuck axis": "#7f7f7f",
    "saturation": "#e69f00",
    "vibration": "#d55e00",
}
"""Kind of fault to the colour of its band."""


def write_log_report(path: Path, scores: LogScores, warnings: Sequence[str] = ()) -> Path:
    """Write the report of `quadsim evaluate --logs`.

    Args:
        path: HTML file to write.
        scores: From `score_logs`.
        warnings: Lines about the logs, shown below the verdict.
    """
    series, about = {}, {}
    for name, log in scores.logs.items():
        every = math.ceil(len(log.truth) / MOST_SAMPLES)
        channels = {each: pack_channel(values[::every]) for each, values in _traces(log)}
        series[name] = FlightSeries(every / log.flights.rate_hz, channels)
        about[name] = described(series[name]) | _about(log, every)
    names = [name for name in scores.estimators if name != LEVEL]
    on_log, by_log = scores.on_logs(), scores.scored if len(scores.scored) > 1 else []
    data = {
        "estimators": names,
        "looks": {name: look._asdict() for name, look in looks(names).items()},
        "shown": names[:SHOWN],
        "logs": about,
    }
    page = render(
        "log_report/log.html",
        title="Attitude estimators on recorded logs",
        kicker="recorded logs",
        verdict=log_verdict(scores),
        warnings=warnings,
        logs=list(scores.logs),
        rows=[
            {"estimator": name, "values": [*means, *on_log.loc[name, by_log]]}
            for name in scores.estimators
            if name in on_log.index
            for means in [[scores.mean(name, kind) for kind in KINDS]]
        ],
        faulty=scores.faulty,
        by_log=by_log,
        compared=[{"log": log} | _compared(found) for log, found in scores.compared.items()],
        **uplot(),
        script=script("log_report/js/log.js"),
        payload=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        traces=compress_flights(series.values()),
    )
    return write_whole(path.expanduser(), page)


def _compared(found: Comparison) -> dict[str, object]:
    """Of a log without truth: a row for each estimator, its force and its difference from every other."""
    both = dict(found.apart) | {(b, a): apart for (a, b), apart in found.apart.items()}
    names = sorted(found.force, key=lambda name: found.force[name])
    rows = [
        {"estimator": a, "force": found.force[a], "apart": [both.get((a, b)) for b in names]} for a in names
    ]
    return {"names": names, "rows": rows}


def _about(log: ScoredLog, every: int) -> dict[str, object]:
    """What the page says of a log beside its traces."""
    rate, done = log.flights.rate_hz, "scored" if log.comparison is None else "compared"
    note = f"{len(log.truth) / rate:.0f} s at {rate:g} Hz, {log.counted_s:.0f} s {done}; {log.bias_text}"
    return {
        "uncounted": (stretches(~log.counted[::every]) * every / rate).round(3).tolist(),
        "faults": [[f.sentence, f.start_s, f.end_s, FAULT_COLOURS[f.kind]] for f in log.faults],
        "note": note + (f"; one sample of {every} is drawn" if every > 1 else "") + ".",
    }


def _traces(log: ScoredLog) -> Iterator[tuple[str, Array]]:
    """Names and values of what is drawn of a log, (T,)."""
    for k, axis in enumerate("xyz"):
        yield f"gyro {axis}", np.degrees(log.flights.gyro[0, :, k])
    for k, axis in enumerate("xyz"):
        yield f"accel {axis}", log.flights.accel[0, :, k]
    angles, scored = ("roll", "pitch"), log.comparison is None
    for k, angle in enumerate(angles if scored else ()):
        yield f"{angle}|truth", np.degrees(log.truth[:, k])
    for name, estimate in sorted(log.estimates.items()):
        for k, angle in enumerate(angles):
            yield f"{angle}|{name}", np.degrees(estimate[:, k])
        if scored:
            yield f"error|{name}", inclination_error(estimate, log.truth)
    for name, believed in log.beliefs.items():
        latest = np.searchsorted(believed.samples, np.arange(len(log.truth)), side="right") - 1
        latest = np.maximum(latest, 0)
        for k, model in enumerate(believed.models):
            yield f"model|{model}", believed.probability[0, latest, k]
        for k, angle in enumerate(() if scored else angles):
            yield f"sigma|{name}, {angle}", np.degrees(believed.sigma[0, latest, k])
