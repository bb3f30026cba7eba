"""Measure what the page on real logs says: `python docs/pages.py logs` writes logs.md."""

import os
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import xarray as xr
from foreign import DESCRIPTION, foreign_error
from numpy.typing import NDArray
from pages import ROOT, Page, Parts, row
from recordings import BROAD, PHANTOM4, VQF_DEFAULTS, recordings, score, vqf_with_defaults

from estimators import create, run
from estimators.evaluation.beliefs import Beliefs, beliefs
from estimators.evaluation.comparison import made_of, silenced_twin
from estimators.evaluation.logs import KNOWN, RAW, LogScores, draw_log
from estimators.filters.imm_model import MODELS
from estimators.metrics import Summary, inclination_rmse
from quadsim.dataset.export import export
from quadsim.dataset.figures import STYLE
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.estimator import AttitudeEstimator
from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.imu.spec import load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs.allan import calibrate, draw
from quadsim.logs.log_report import AGREEMENT, UPRIGHT
from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample
from quadsim.rotation import roll_pitch_from_quat

Array = NDArray[np.float64]
RATE = 200.0
BIAS_DEG = (4.1, -1.2, -1.6)
"""A gyroscope's bias as uncalibrated sensors have it [°/s]."""
SHOWN = {
    BROAD: ("10_undisturbed_slow_translation_A", (60.0, 100.0)),
    PHANTOM4: ("horizontal_02", (5.0, 25.0)),
}
"""Recording that is drawn, and the part of it [s]."""
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
    command = [sys.executable, "-m", "quadsim.cli", "report", "flight"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return "\n".join(line.rstrip() for line in done.stdout.rstrip().splitlines())


def resampling_rows() -> list[str]:
    """How much of a tone is lost, or folds down."""
    lines = []
    for rate in (100.0, 200.0, 285.7, 500.0, 1000.0):
        cells = []
        for tone in (10.0, 60.0, 130.0, 190.0):
            if tone > 0.45 * rate:
                cells.append("–")
                continue
            time = np.arange(round(8 * rate)) / rate
            wave = np.sin(2 * np.pi * tone * time)[:, None] * np.ones(3)
            even, _ = resample(Recording("tone", "", time, wave, wave), RATE)
            grid, found = even["time"].to_numpy(), even["gyro"].to_numpy()[0, :, 0]
            expected = np.sin(2 * np.pi * tone * grid) if tone < 0.45 * RATE else 0.0
            error = np.sqrt(np.mean((found - expected)[200:-200] ** 2) * 2)
            cells.append(f"{100 * error:.2f} %")
        lines.append(row(f"{rate:g} Hz", *cells))
    return lines


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
            (each, its.truth[log][None], its.counted[log][None]) for (log, _), each in its.beliefs.items()
        ]
        lines.append(believed_row(f"{name}, real", found))
    for recipe, vehicle, seed in (*SIMULATED, *ROUGH):
        flown = open_dataset(flights(data, recipe, vehicle, seed)[0])
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
        found = calibrate([Recording(preset, "", np.arange(steps) / RATE, gyro[0], accel[0])])
        if preset == "adis16448":
            page.save(draw(found), "calibration.png", dpi=100, colours=48)
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            assert mine.noise is not None
            tau = mine.time_constant / (true.time_constant or np.nan)
            ratios = f"{mine.noise / true.noise:.3f}", f"{mine.random_walk / true.random_walk:.2f}"
            lines.append(row(preset, name, *ratios, f"{'' if mine.resolved else '> '}{tau:.2f}"))
    return lines


def simulated_rows(data: Path) -> list[str]:
    """Estimators on other sensors and airframes, and on RotorPy's; `ekf-drag` knows each vehicle."""
    clean, windy = ([flights(data, *each)] for each in SIMULATED)
    rough = [flights(data, *each) for each in ROUGH]
    sets = [(clean, np.zeros(3)), (windy, np.zeros(3)), (windy, np.radians(BIAS_DEG)), (rough, np.zeros(3))]
    lines = []
    for name in ("ekf-drag", *FILTERS, *NETS):
        cells = []
        for paths, bias in sets:
            errors = [rmse(made_of([name], RATE, vehicle=v)[name], path, bias) for path, v in paths]
            cells.append(f"{np.mean(errors):.2f}")
        rotorpy = foreign_error(lambda v, n=name: made_of([n], RATE, vehicle=v)[n], data, measure=settled)
        lines.append(row(name, *cells, f"{rotorpy:.2f}"))
    twin = silenced_twin(NETS[0])
    assert twin is not None
    cells = [f"{np.mean([rmse(twin, path, bias) for path, _ in paths]):.2f}" for paths, bias in sets]
    rotorpy = foreign_error(lambda _: twin, data, measure=settled)
    return [*lines, row("*networks, silenced*", *cells, f"{rotorpy:.2f}")]


def flights(data: Path, recipe: str, vehicle: str, seed: int) -> tuple[Path, str]:
    """Flights on which nothing is trained, and their vehicle; those of an earlier run if they are there."""
    chosen = changed(load_recipe(recipe), {"vehicle": vehicle})
    path = data / f"docs-{recipe}-{vehicle}.zarr"
    return generate(chosen, FLIGHTS, 100.0, path, seed=seed, workers=1), vehicle


def rmse(est: AttitudeEstimator, path: Path, bias: Array) -> float:
    """Inclination RMSE over the flights of a dataset, after 3 s [deg]."""
    data = open_dataset(path)
    gyro, accel, quat = (data[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
    return settled(run(est, gyro + bias, accel), roll_pitch_from_quat(quat)).mean


def settled(estimate: Array, truth: Array) -> Summary:
    """Inclination RMSE after 3 s of each flight [deg], from roll and pitch (n, T, 2) [rad]."""
    skip = round(SETTLED_S * RATE)
    return inclination_rmse(estimate[:, skip:], truth[:, skip:])


def seconds(logs: Sequence[xr.Dataset]) -> str:
    """Length of all logs together."""
    return f"{sum(float(log.attrs['duration_s']) for log in logs):.0f}"


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    matplotlib.rcParams.update(STYLE)
    sets = recordings(given.recordings)
    scores = {name: score(name, logs, made()) for name, logs in sets.items()}
    for name, (log, part) in SHOWN.items():
        file = name.lower().replace(" ", "") + ".png"
        page.save(draw_log(scores[name], log, part), file, dpi=100, colours=48)
    with tempfile.TemporaryDirectory() as folder:
        example = info(Path(folder))
    return {
        "info": example,
        "resampling": resampling_rows(),
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
        "simulated": simulated_rows(given.data),
        "simulated_count": str(FLIGHTS),
        "rotorpy": DESCRIPTION,
        "agreement": f"{AGREEMENT:g}",
        "upright": f"{UPRIGHT:g}",
        "bias": ", ".join(f"{each:g}" for each in BIAS_DEG),
    }
