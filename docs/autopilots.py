"""Fly Betaflight's firmware, and give the readings of its flights to other estimators, for betaflight.md."""

from argparse import Namespace
from collections.abc import Sequence
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pages import ROOT, Part, Row, Values, span
from scipy.stats import t as student

from estimators import create
from estimators.evaluation.comparison import made_of
from estimators.metrics import attitude_error
from estimators.running import run_quietly
from quadsim.estimator import Readings
from quadsim.flight.scenario import changed, load_scenario
from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS
from quadsim.seeding import vehicle_seeds
from scenarios.bench.cell import FlightSettings, mission_of
from scenarios.bench.ranking import listed

Array = NDArray[np.float64]

SCENARIOS = ("hover", "step", "wind-gust", "figure-8", "dryden-moderate")
EACH, SEED = 4, 1
"""Flights of each scenario, each with its own number of this seed; settings were tried with seed 0."""
IMU = "adis16448"
CALIBRATED = ROOT / "reports" / "betaflight" / "calibrated.toml"
"""The same IMU without the turn-on bias of the gyroscope."""
BETAFLIGHT, GAIN = "betaflight", 0.25
"""Its name; its proportional gain, `imu_dcm_kp` / 10 000."""
OURS = ("mahony", "imm", "vqf", "att-snn-loihi")
RATE_MODE = "hover", "step"
SHORT_S = 10.0
"""Length of flights in rate mode [s]."""


class FirmwareFlights(NamedTuple):
    """What is recorded of n flights, over time (n, T, ·)."""

    readings: Readings
    truth: Array
    estimate: Array
    distance: Array  #: from the set-point, (n, T) [m]
    crashed: NDArray[np.bool_]  #: (n,)


def fly_betaflight(
    scenario: str, first: int, imu: str, mode: str = BETAFLIGHT, n: int = EACH, seconds: float | None = None
) -> FirmwareFlights:
    """Flights of a scenario on Betaflight, with the numbers `first`, `first` + 1, … of the seed."""
    changes = {"imu": imu} | ({"duration_s": seconds} if seconds else {})
    mission = mission_of(changed(load_scenario(scenario), changes), mode, FlightSettings(n))
    rows = []
    try:
        mission.begin(vehicle_seeds(SEED, first + n)[first:])
        for _ in range(mission.steps):
            read, plant = mission.readings, mission.plant
            offset = np.linalg.norm(plant.position - mission.target["position"], axis=-1)
            rows.append([each.copy() for each in (*read[:3], plant.roll_pitch, mission.attitude, offset)])
            rows[-1][3][mission.cause > 0] = np.nan  # what follows a crash is not counted
            mission.step()
    finally:
        mission.estimator.close()
    gyro, accel, rotor_vel, truth, estimate, distance = (
        np.stack(each, axis=1) for each in zip(*rows, strict=True)
    )
    return FirmwareFlights(Readings(gyro, accel, rotor_vel), truth, estimate, distance, mission.cause > 0)


def flight_errors(flights: Sequence[FirmwareFlights]) -> pd.DataFrame:
    """Mean absolute error of roll and pitch of all flights, by estimator [deg]."""
    made = made_of(OURS, 200.0, vehicle="hummingbird", imu=IMU)
    made[f"mahony, k_P = {GAIN}, k_I = 0"] = create("mahony", k_p=GAIN, k_i=0.0)
    found = []
    for each in flights:
        estimates = {BETAFLIGHT: each.estimate}
        estimates |= {name: run_quietly(est, each.readings, each.truth[:, 0]) for name, est in made.items()}
        estimates["always level"] = np.zeros_like(each.truth)
        errors = {name: attitude_error(own, each.truth).sequences for name, own in estimates.items()}
        found.append(pd.DataFrame(errors))
    return pd.concat(found)


def half_interval(values: pd.Series) -> float:
    """Half the 95 % interval of a mean, Student's."""
    return float(student.ppf(0.975, len(values) - 1) * values.sem())


def difference_rows(both: Sequence[pd.DataFrame]) -> list[Row]:
    """For each estimator and each IMU the mean error and the difference from Betaflight's."""
    rows = []
    for name in both[0]:
        cells = []
        for errors in both:
            own, behind = errors[name], errors[name] - errors[BETAFLIGHT]
            difference = "" if name == BETAFLIGHT else f"{behind.mean():+.2f} ± {half_interval(behind):.2f}"
            cells += [f"{own.mean():.2f} ± {half_interval(own):.2f}", difference]
        rows.append((name, *cells))
    return rows


def sentence(errors: pd.DataFrame) -> str:
    """Which of our estimators differ from Betaflight's, in words."""
    words: dict[str, list[str]] = {"smaller": [], "not significantly different": [], "larger": []}
    for name in OURS:
        behind = errors[name] - errors[BETAFLIGHT]
        how = "smaller" if behind.mean() < 0 else "larger"
        if abs(behind.mean()) <= half_interval(behind):
            how = "not significantly different"
        words[how].append(f"`{name}` ({errors[name].mean():.2f}°)")
    return ", and ".join(f"{how} for {listed(of)}" for how, of in words.items() if of)


def flight_row(scenario: str, mode: str, flight: FirmwareFlights) -> Row:
    """How a scenario was flown."""
    error = attitude_error(flight.estimate, flight.truth).sequences
    crashes = f"{flight.crashed.sum()} of {len(flight.crashed)}"
    distance = float(np.sqrt((flight.distance[:, 400:] ** 2).mean()))
    largest = float(np.degrees(np.nanmax(np.abs(flight.truth))))
    return scenario, mode, crashes, float(np.mean(error)), distance, largest


def betaflight(part: Part, given: Namespace) -> Values:
    """Fly 20 flights with each IMU, and replay their readings."""
    text = (ASSETS / "imus" / f"{IMU}.toml").read_text("utf-8")
    write_whole(CALIBRATED, text.replace("turn_on = 0.0087", "turn_on = 0.0", 1))
    suite, calibrated = (
        [fly_betaflight(name, EACH * k, imu) for k, name in enumerate(SCENARIOS)]
        for imu in (IMU, str(CALIBRATED))
    )
    both = [flight_errors(suite), flight_errors(calibrated)]
    rate = [fly_betaflight(name, 0, IMU, "betaflight-rate", n=2, seconds=SHORT_S) for name in RATE_MODE]
    own, theirs = (errors[BETAFLIGHT].mean() for errors in both)
    half = half_interval(both[0][BETAFLIGHT])
    crashes = sum(each.crashed.sum() for each in suite)
    count = EACH * len(SCENARIOS)
    return {
        "verdict": f"Betaflight's estimator has an error of {own:.2f}° (95 % interval "
        f"{span(own - half, own + half)}°) over {count} flights; {crashes or 'none'} of them crashed. On the "
        f"same readings, the errors of quadsim's estimators are {sentence(both[0])}.",
        "calibrated": f"With a calibrated gyroscope, its error is {theirs:.2f}°, and the errors of quadsim's "
        f"estimators are {sentence(both[1])}.",
        "version": version("betaflight"),
        "flights": str(count),
        "each": str(EACH),
        "errors": difference_rows(both),
        "flown": [
            *(flight_row(name, "angle", each) for name, each in zip(SCENARIOS, suite, strict=True)),
            *(flight_row(name, "rate", each) for name, each in zip(RATE_MODE, rate, strict=True)),
        ],
    }
