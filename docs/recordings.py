"""Errors on real recordings, which are not part of the repository.

A folder holds `broad/` (trials of the BROAD benchmark, Laidig et al. 2021, CC BY 4.0: hand-moved, 286 Hz,
optical truth) and `phantom4/` (flights of a DJI Phantom 4 RTK, Hurwitz & Klein 2023, CC BY 4.0: 120 Hz, truth
by the sensor's own filter).
"""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pages import Part, Values, row

from estimators import create
from estimators.evaluation.beliefs import Beliefs, beliefs
from estimators.evaluation.comparison import made_of
from estimators.evaluation.logs import KNOWN, RAW, LogScores, score_logs
from estimators.filters.drag.imm_model import MODELS
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.logs import read_log
from quadsim.rotation import roll_pitch_from_quat

Array = NDArray[np.float64]
BROAD, PHANTOM4 = "BROAD", "Phantom 4"
FOLDERS = {BROAD: "broad", PHANTOM4: "phantom4"}
SKIP_S = {BROAD: 3.0, PHANTOM4: 5.0}
"""Time at the start of a recording that is not scored [s]."""
WITHIN_DEG = 180.0
RATE_HZ = 200.0
VQF_DEFAULTS = {
    "tauAcc": 3.0,
    "biasForgettingTime": 100.0,
    "biasSigmaInit": 0.5,
    "biasSigmaMotion": 0.1,
    "biasSigmaRest": 0.03,
}
SCORED = ("imm", "vqf", "eskf", "mahony", "att-snn", "att-rnn")
FLIGHTS = 4
SETTLED_S = 3.0
"""Time at the start of a simulated flight that is not scored [s]."""
SIMULATED = (
    ("hummingbird", "hummingbird", 3),
    ("windy", "hummingbird", 43),
    ("robust", "hummingbird", 40),
    ("robust", "px4-quad", 41),
    ("robust", "crazyflie", 42),
)
"""Recipe, vehicle and seed of the simulated flights."""


def recordings(folder: Path) -> dict[str, list[xr.Dataset]]:
    """Both sets, resampled to 200 Hz.

    Raises:
        SystemExit: A set is not in the folder.
    """
    sets = {name: sorted((folder / place).glob("*.npz")) for name, place in FOLDERS.items()}
    if missing := [name for name, paths in sets.items() if not paths]:
        raise SystemExit(
            f"{folder}: no recordings of {', '.join(missing)}; give their folder with --recordings"
        )
    return {name: [read_log(path, RATE_HZ) for path in paths] for name, paths in sets.items()}


def score(name: str, logs: Sequence[xr.Dataset], estimators: Mapping[str, AttitudeEstimator]) -> LogScores:
    """Estimators on a set, from an unknown start."""
    return score_logs(logs, estimators, within_deg=WITHIN_DEG, skip_s=SKIP_S[name])


def vqf_with_defaults() -> AttitudeEstimator:
    """VQF with the parameters of its package in place of the tuned ones."""
    return create("vqf", RATE_HZ, **VQF_DEFAULTS)


def made() -> dict[str, AttitudeEstimator]:
    """What is scored on real recordings: filters that need no vehicle, and the networks."""
    return made_of(SCORED, RATE_HZ) | {"vqf, package's parameters": vqf_with_defaults()}


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
    for recipe, vehicle, seed in SIMULATED:
        flown = open_dataset(flights(data, recipe, vehicle, seed))
        gyro, accel, quat = (flown[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
        its = beliefs(create("imm", RATE_HZ), gyro, accel)
        assert its is not None
        counted = np.broadcast_to(np.arange(gyro.shape[1]) >= SETTLED_S * RATE_HZ, gyro.shape[:2])
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


def flights(data: Path, recipe: str, vehicle: str, seed: int) -> Path:
    """Flights on which nothing is trained; those of an earlier run if they are there."""
    chosen = changed(load_recipe(recipe), {"vehicle": vehicle})
    path = data / f"docs-{recipe}-{vehicle}.zarr"
    return generate(chosen, FLIGHTS, 100.0, path, seed=seed, workers=1)


def seconds(logs: Sequence[xr.Dataset]) -> str:
    """Length of all logs together."""
    return f"{sum(float(log.attrs['duration_s']) for log in logs):.0f}"


def values(part: Part, given: Namespace) -> Values:
    """Measure."""
    sets = recordings(given.recordings)
    scores = {name: score(name, logs, made()) for name, logs in sets.items()}
    return {
        "broad": recorded_rows(scores[BROAD]),
        "broad_count": str(len(sets[BROAD])),
        "broad_s": seconds(sets[BROAD]),
        "phantom4": recorded_rows(scores[PHANTOM4]),
        "phantom4_count": str(len(sets[PHANTOM4])),
        "phantom4_s": seconds(sets[PHANTOM4]),
        "models": " | ".join(MODELS),
        "believed": believed_rows(scores, given.data),
        "vqf": ", ".join(f"{key} {value:g}" for key, value in VQF_DEFAULTS.items()),
    }
