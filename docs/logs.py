"""Measure what the page on real logs says: `python docs/pages.py logs` writes logs.md."""

import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pages import ROOT, Page, Parts, row
from recordings import BROAD, PHANTOM4, VQF_DEFAULTS, recordings, score, vqf_with_defaults

from estimators import create
from estimators.evaluation.beliefs import Beliefs, beliefs
from estimators.evaluation.comparison import made_of
from estimators.evaluation.logs import KNOWN, RAW, LogScores
from estimators.filters.drag.imm_model import MODELS
from quadsim.dataset.export import export
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.imu.spec import load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs import read_log
from quadsim.logs.allan import calibrate, draw
from quadsim.logs.log_report import AGREEMENT, UPRIGHT, show_report
from quadsim.logs.recording import Recording
from quadsim.rotation import roll_pitch_from_quat
from quadsim.runs.console import output

Array = NDArray[np.float64]
RATE = 200.0
FILTERS = ("imm", "vqf", "eskf", "mahony")
NETS = ("att-snn", "att-rnn")
FLIGHTS = 4
SETTLED_S = 3.0
"""Time at the start of a simulated flight that is not scored [s]."""
SIMULATED = (("hummingbird", "hummingbird", 3), ("windy", "hummingbird", 43))
ROUGH = (("robust", "hummingbird", 40), ("robust", "px4-quad", 41), ("robust", "crazyflie", 42))
"""Recipe, vehicle and seed of the simulated flights."""


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


def believed_rows(scores: Mapping[str, LogScores], data: Path) -> list[str]:
    """What imm believes on real recordings and on simulated flights, and how honest its interval is."""
    lines = []
    for name, its in scores.items():
        found = [
            (each, log.truth[None], log.counted[None])
            for log in its.logs.values()
            for each in log.beliefs.values()
        ]
        lines.append(believed_row(f"{name}, real", found))
    for recipe, vehicle, seed in (*SIMULATED, *ROUGH):
        flown = open_dataset(flights(data, recipe, vehicle, seed))
        gyro, accel, quat = (flown[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
        its = beliefs(create("imm", RATE), gyro, accel)
        assert its is not None
        counted = np.broadcast_to(np.arange(gyro.shape[1]) >= SETTLED_S * RATE, gyro.shape[:2])
        lines.append(believed_row(f"{recipe}, {vehicle}", [(its, roll_pitch_from_quat(quat), counted)]))
    return lines


def believed_row(name: str, found: Sequence[tuple[Beliefs, Array, NDArray[np.bool_]]]) -> str:
    """Mean shares of the models, coverage and σ over error of recordings: beliefs, truth, what counts."""
    shares = np.mean([list(each.share().values()) for each, _, _ in found], axis=0)
    its = [each.interval(truth, counted) for each, truth, counted in found]
    inside = np.mean([each.inside for each in its])
    ratio = np.mean([each.sigma_deg / each.rmse_deg for each in its])
    return row(name, *(f"{100 * share:.0f} %" for share in shares), f"{100 * inside:.0f} %", f"{ratio:.1f}")


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
        found = calibrate(Recording(preset, "", np.arange(steps) / RATE, gyro[0], accel[0]))
        if preset == "adis16448":
            page.save(draw(found), "calibration.png", dpi=100, colours=48)
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            tau = mine.time_constant / (true.time_constant or np.nan)
            ratios = f"{mine.noise / true.noise:.3f}", f"{mine.random_walk / true.random_walk:.2f}"
            lines.append(row(preset, name, *ratios, f"{'' if mine.resolved else '> '}{tau:.2f}"))
    return lines


def flights(data: Path, recipe: str, vehicle: str, seed: int) -> Path:
    """Flights on which nothing is trained; those of an earlier run if they are there."""
    chosen = changed(load_recipe(recipe), {"vehicle": vehicle})
    path = data / f"docs-{recipe}-{vehicle}.zarr"
    return generate(chosen, FLIGHTS, 100.0, path, seed=seed, workers=1)


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
        "models": " | ".join(MODELS),
        "believed": believed_rows(scores, given.data),
        "vqf": ", ".join(f"{key} {value:g}" for key, value in VQF_DEFAULTS.items()),
        "calibration": calibration_rows(page),
        "agreement": f"{AGREEMENT:g}",
        "upright": f"{UPRIGHT:g}",
    }
