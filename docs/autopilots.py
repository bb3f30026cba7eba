"""Fly Betaflight's firmware, and give the readings of its flights to other estimators, for betaflight.md."""

from argparse import Namespace
from collections.abc import Sequence
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pages import ROOT, Part, Row, Values, span
from scipy.stats import t as student

from estimators import create
from estimators.metrics import attitude_error
from estimators.running import run_quietly
from quadsim.estimator import Readings
from quadsim.flight.scenario import changed, load_scenario
from quadsim.flight.world import CAUSES
from quadsim.runs.console import progress_bar
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
REPEATS, REPEATED = 5, "step"
SHORT_S = 10.0
"""Length of flights in rate mode and of those that are repeated [s]."""


class Flight(NamedTuple):
    """What is recorded of n flights, over time (n, T, ·)."""

    readings: Readings
    truth: Array
    estimate: Array
    distance: Array  #: from the set-point, (n, T) [m]
    causes: list[str]


def flown(
    scenario: str, first: int, imu: str, mode: str = BETAFLIGHT, n: int = EACH, seconds: float | None = None
) -> Flight:
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
    causes = [CAUSES[cause] for cause in mission.cause]
    return Flight(Readings(gyro, accel, rotor_vel), truth, estimate, distance, causes)


def errors_of(flight: Flight) -> dict[str, Array]:
    """Mean absolute error of roll and pitch of each flight, by estimator, (n,) [deg]."""
    estimates = {BETAFLIGHT: flight.estimate}
    start = flight.truth[:, 0]
    for name in OURS:
        made = create(name, vehicle="hummingbird", imu=IMU)
        estimates[name] = run_quietly(made, flight.readings, start)
    same = create("mahony", k_p=GAIN, k_i=0.0)
    estimates[f"mahony, k_P = {GAIN}, k_I = 0"] = run_quietly(same, flight.readings, start)
    estimates["always level"] = np.zeros_like(flight.truth)
    return {name: np.array(attitude_error(each, flight.truth).sequences) for name, each in estimates.items()}


def interval(values: Array) -> float:
    """Half the 95 % interval of a mean, Student's."""
    return float(student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))


def compared(flights: Sequence[Flight]) -> dict[str, Array]:
    """Errors of all flights, by estimator."""
    found = [errors_of(each) for each in flights]
    return {name: np.concatenate([each[name] for each in found]) for name in found[0]}


def rows_of(both: Sequence[dict[str, Array]]) -> list[Row]:
    """For each estimator and each IMU the mean error and the difference from Betaflight's."""

    def cells(errors: dict[str, Array], name: str) -> Row:
        mean = f"{errors[name].mean():.2f} ± {interval(errors[name]):.2f}"
        behind = errors[name] - errors[BETAFLIGHT]
        return mean, "" if name == BETAFLIGHT else f"{behind.mean():+.2f} ± {interval(behind):.2f}"

    return [(name, *cells(both[0], name), *cells(both[1], name)) for name in both[0]]


def sentence(errors: dict[str, Array]) -> str:
    """Which of our estimators differ from Betaflight's, in words."""
    words: dict[str, list[str]] = {"smaller": [], "not significantly different": [], "larger": []}
    for name in OURS:
        behind = errors[name] - errors[BETAFLIGHT]
        how = "smaller" if behind.mean() < 0 else "larger"
        if abs(behind.mean()) <= interval(behind):
            how = "not significantly different"
        words[how].append(f"`{name}` {errors[name].mean():.2f}°")
    return listed([f"{how} ({', '.join(of)})" for how, of in words.items() if of])


def flight_row(scenario: str, mode: str, flight: Flight) -> Row:
    """How a scenario was flown."""
    error = attitude_error(flight.estimate, flight.truth).sequences
    crashed, settled = [each for each in flight.causes if each], flight.distance[:, 400:]
    return (
        scenario, mode, f"{len(crashed)} of {len(flight.causes)}", float(np.mean(error)),
        float(np.sqrt((settled**2).mean())), float(np.degrees(np.nanmax(np.abs(flight.truth)))),
    )  # fmt: skip


def betaflight(part: Part, given: Namespace) -> Values:
    """Fly 20 flights with each IMU, replay their readings, and repeat one flight."""
    text = (ASSETS / "imus" / f"{IMU}.toml").read_text("utf-8")
    write_whole(CALIBRATED, text.replace("turn_on = 0.0087", "turn_on = 0.0", 1))
    flights: dict[str, list[Flight]] = {}
    with progress_bar("betaflight", "flights") as bar:
        jobs = [(imu, k) for imu in (IMU, str(CALIBRATED)) for k in range(len(SCENARIOS))]
        for done, (imu, k) in enumerate(jobs, 1):
            flights.setdefault(imu, []).append(flown(SCENARIOS[k], EACH * k, imu))
            bar(done, len(jobs))
    suite, calibrated = flights.values()
    both = [compared(suite), compared(calibrated)]
    rate = [flown(name, 0, IMU, "betaflight-rate", n=2, seconds=SHORT_S) for name in RATE_MODE]
    repeats = [flown(REPEATED, 0, IMU, n=1, seconds=SHORT_S) for _ in range(REPEATS)]
    ends = np.array([each.distance[0, -1] for each in repeats])
    means = np.array([attitude_error(each.estimate, each.truth).sequences[0] for each in repeats])
    same = all(np.array_equal(each.estimate, repeats[0].estimate) for each in repeats)
    own, theirs = (errors[BETAFLIGHT].mean() for errors in both)
    half = interval(both[0][BETAFLIGHT])
    crashes = sum(bool(cause) for each in suite for cause in each.causes)
    count = EACH * len(SCENARIOS)
    return {
        "verdict": f"Betaflight's estimator has an error of {own:.2f}° (95 % interval "
        f"{span(own - half, own + half)}°) over {count} flights, and {crashes or 'none'} of them crashed. On "
        f"the same readings, quadsim's estimators have errors that are {sentence(both[0])}.",
        "calibrated": f"With a calibrated gyroscope, its error is {theirs:.2f}°, and quadsim's "
        f"estimators have errors that are {sentence(both[1])}.",
        "version": version("betaflight"),
        "flights": str(count),
        "each": str(EACH),
        "errors": rows_of(both),
        "flown": [
            *(flight_row(name, "angle", each) for name, each in zip(SCENARIOS, suite, strict=True)),
            *(flight_row(name, "rate", each) for name, each in zip(RATE_MODE, rate, strict=True)),
        ],
        "repeats": f"{REPEATS} flights of `{REPEATED}` ({SHORT_S:g} s) with the same seed have standard "
        f"deviations of {(ends - ends[0]).std(ddof=1):.3g} m in the final distance from the set-point and "
        f"{(means - means[0]).std(ddof=1):.3g}° in the error of the estimate. Their estimates are "
        f"{'equal in every bit' if same else 'not equal'}.",
    }
