"""Measure what the page on real logs says: `python docs/pages.py logs` writes logs.md."""

import tempfile
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pages import ROOT, Page, Parts, row
from recordings import BROAD, PHANTOM4, VQF_DEFAULTS, recordings, score, vqf_with_defaults

from estimators.evaluation.comparison import made_of
from estimators.evaluation.logs import KNOWN, RAW, LogScores
from quadsim.dataset.export import export
from quadsim.dataset.generation import generate
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.recipe import load_recipe
from quadsim.imu.spec import load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs import read_log
from quadsim.logs.allan import calibrate, draw
from quadsim.logs.log_report import AGREEMENT, UPRIGHT, show_report
from quadsim.logs.recording import Recording
from quadsim.runs.console import output

Array = NDArray[np.float64]
RATE = 200.0
FILTERS = ("imm", "vqf", "eskf", "mahony")
NETS = ("att-snn", "att-rnn")


def info(folder: Path) -> str:
    """`quadsim report` on a flight that has lost samples."""
    data = generate(load_recipe("hummingbird"), 1, 20.0, folder / "x.zarr", seed=1, workers=1)
    csv = export(data, folder / "flight", "csv") / "flight_000" / "mav0" / "imu0" / "data.csv"
    rows = csv.read_text().splitlines(keepends=True)
    csv.write_text("".join(rows[:1000] + rows[1050:2000] + rows[2001:3000] + rows[3001:]))
    with output.capture() as shown:
        show_report(Path("flight"), read_log(folder / "flight").attrs["log"])
    return "\n".join(line.rstrip() for line in shown.get().rstrip().splitlines())


def made() -> dict[str, AttitudeEstimator]:
    """What is scored on real recordings: filters that need no vehicle, and the networks."""
    return made_of([*FILTERS, *NETS], RATE) | {"vqf, package's parameters": vqf_with_defaults()}


def recorded_rows(scores: LogScores) -> list[str]:
    """Errors on a set of recordings, the smallest first."""
    return [
        row(
            name,
            *(number(e) for e in (scores.mean(name, RAW), scores.silenced(name), scores.mean(name, KNOWN))),
        )
        for name in scores.estimators
    ]


def number(value: float) -> str:
    """A number of a table, or a dash where there is none."""
    return "–" if np.isnan(value) else f"{value:.2f}"


def calibration_rows(page: Page) -> list[str]:
    """An hour at rest of two sensors, calibrated."""
    lines = []
    steps = int(3600 * RATE)
    force = np.tile([0.0, 0.0, 9.81], (1, steps, 1))
    for preset in ("adis16448", "px4-mini"):
        imu = load_imu(preset)
        gyro, accel = simulate_imu(imu, np.zeros_like(force), force, RATE, seed=1)
        found = calibrate([Recording(preset, "", np.arange(steps) / RATE, gyro[0], accel[0])])
        if preset == "adis16448":
            page.save(draw(found), "calibration.png", dpi=100, colours=48)
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            assert mine.noise is not None
            tau = mine.time_constant / (true.time_constant or np.nan)
            ratios = f"{mine.noise / true.noise:.3f}", f"{mine.random_walk / true.random_walk:.2f}"
            lines.append(row(preset, name, *ratios, f"{'' if mine.resolved else '> '}{tau:.2f}"))
    return lines


def seconds(logs: Sequence[xr.Dataset]) -> str:
    """Length of all logs together."""
    return f"{sum(float(log.attrs['duration_s']) for log in logs):.0f}"


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    sets = recordings(given.recordings)
    scores = {name: score(name, logs, made()) for name, logs in sets.items()}
    with tempfile.TemporaryDirectory() as folder:
        example = info(Path(folder))
    return {
        "info": example,
        "columns": (ROOT / "docs" / "columns.toml").read_text().rstrip(),
        "broad": recorded_rows(scores[BROAD]),
        "broad_count": str(len(sets[BROAD])),
        "broad_s": seconds(sets[BROAD]),
        "phantom4": recorded_rows(scores[PHANTOM4]),
        "phantom4_count": str(len(sets[PHANTOM4])),
        "phantom4_s": seconds(sets[PHANTOM4]),
        "vqf": ", ".join(f"{key} {value:g}" for key, value in VQF_DEFAULTS.items()),
        "calibration": calibration_rows(page),
        "agreement": f"{AGREEMENT:g}",
        "upright": f"{UPRIGHT:g}",
    }
