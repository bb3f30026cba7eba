"""How well a flight went, from its log; and one figure for several flights.

A log holds records (n, T) of `log_dtype`, and `end` (n,) tells how many samples each flight lasted before it
crashed. What came after is not counted.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from estimators.metrics import absolute_error, attitude_error, inclination_error
from quadsim.runs.compiled import njit
from quadsim.vehicle import Vehicle

Array = NDArray[np.float64]
Log = NDArray[np.void]

CONVERGED_DEG = 5.0
"""Inclination error below which an estimate counts as found [deg],"""
CONVERGED_S = 1.0
"""if it stays there for this long [s]."""
AWAY_M = 0.5
"""Distance from the set-point beyond which a vehicle counts as thrown off [m]."""
ERROR_DECADES = (-3.0, 2.3)
"""Range of the error histograms, powers of ten of a degree,"""
ERROR_BINS = 106
"""and how many equal parts it has."""


@cache
def log_dtype(rotors: int) -> np.dtype:
    """A sample in the log of a vehicle with so many rotors."""
    return np.dtype(
        [
            ("position", "f8", 3),
            ("euler", "f8", 3),
            ("estimate", "f8", 2),
            ("target", "f8", 3),
            ("tracking", "f8"),  # angle between the true and the wanted thrust axis [rad]
            ("tilt", "f8"),  # [rad]
            ("rotor_vel", "f8", rotors),
            ("command_change", "f8"),  # RMS over the rotors of the change since the last sample [rad/s]
        ]
    )


@dataclass(frozen=True)
class Metric:
    """A column of the tables."""

    key: str
    label: str
    unit: str
    digits: int
    help: str


METRICS = (
    Metric(
        "error_deg", "Estimation error", "deg", 2,
        "Mean absolute error of roll and pitch, pooled, in flight; the mean over flights.",
    ),
    Metric(
        "inclination_deg", "Inclination error", "deg", 2,
        "RMS of the angle between the true and the estimated direction of gravity; the mean over flights.",
    ),
    Metric(
        "crash_rate", "Crash rate", "", 2,
        "Share of flights that tilted over, hit the ground or flew away, with its 95 % Wilson interval.",
    ),
    Metric(
        "attitude_deg", "Attitude tracking", "deg", 2,
        "RMS of the angle between the true thrust axis and the wanted one; the mean over flights.",
    ),
    Metric(
        "position_m", "Position tracking", "m", 3,
        "RMS distance from the set-point; the mean over flights.",
    ),
    Metric("worst_tilt_deg", "Largest tilt", "deg", 1, "Largest tilt of any flight."),
    Metric(
        "converge_s", "Time to converge", "s", 2,
        f"When the inclination error first is below {CONVERGED_DEG:g}° and stays so for {CONVERGED_S:g} s; "
        "the median over flights, empty if most never get there.",
    ),
    Metric(
        "recover_s", "Recovery time", "s", 2,
        f"The longest time it took to come back, once more than {AWAY_M:g} m from the set-point, 0 if never "
        "there; the median over flights, empty if most crash or stay away.",
    ),
    Metric(
        "power_w", "Rotor power", "W", 1,
        "Mean mechanical power of the rotors, Σ k_m k_f ω³; the mean over flights.",
    ),
    Metric(
        "jitter", "Command jitter", "rad/s", 2,
        "RMS change of the rotor commands from one sample to the next; the mean over flights.",
    ),
)  # fmt: skip


@njit(cache=True)
def write_row(vehicles, pose, controllers, measured, target, last_command, row):
    """Write one sample of n flights into `row` (n,), and the command into `last_command` (n, rotors).

    The others are records (n,) of plant, controller and mission; `measured` holds the estimate.
    """
    for i in range(row.shape[0]):
        out, p, c = row[i], vehicles[i], controllers[i]
        axis, (w, x, y, z) = (
            c.thrust_axis,
            (pose[i].quat[0], pose[i].quat[1], pose[i].quat[2], pose[i].quat[3]),
        )
        up_x, up_y, up_z = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
        for j in range(3):
            out.position[j], out.target[j] = pose[i].position[j], target[i].position[j]
        for j in range(2):
            out.euler[j], out.estimate[j] = p.roll_pitch[j], measured[i].roll_pitch[j]
        out.euler[2] = p.yaw
        cx = up_y * axis[2] - up_z * axis[1]
        cy = up_z * axis[0] - up_x * axis[2]
        cz = up_x * axis[1] - up_y * axis[0]
        dot = up_x * axis[0] + up_y * axis[1] + up_z * axis[2]
        out.tracking = math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), dot)
        out.tilt = math.atan2(math.sqrt(up_x * up_x + up_y * up_y), up_z)
        change, rotors = 0.0, p.rotor_vel.shape[0]
        for j in range(rotors):
            out.rotor_vel[j] = p.rotor_vel[j]
            change += (c.rotor_vel_cmd[j] - last_command[i, j]) ** 2
            last_command[i, j] = c.rotor_vel_cmd[j]
        out.command_change = math.sqrt(change / rotors)


def flight_metrics(log: Log, end: NDArray[np.int64], rate_hz: float, vehicle: Vehicle) -> dict[str, Array]:
    """One number per flight for each metric but the crash rate, (n,); NaN where there is none.

    Args:
        log: (n, T) records of `log_dtype`.
        end: (n,) samples before the crash, T without one.
        rate_hz: Samples per second.
        vehicle: For the power.
    """
    flown = log.copy()
    flown[np.arange(log.shape[1]) >= np.maximum(end, 1)[:, None]] = np.nan
    estimate, truth = flown["estimate"], flown["euler"][..., :2]
    inclination = inclination_error(estimate, truth)
    apart = np.linalg.norm(flown["position"] - flown["target"], axis=-1)
    power = vehicle.motor.k_m * vehicle.motor.k_f * np.sum(flown["rotor_vel"] ** 3, axis=-1)
    return {
        "error_deg": attitude_error(estimate, truth).sequences,
        "inclination_deg": _rms(inclination),
        "attitude_deg": np.degrees(_rms(flown["tracking"])),
        "position_m": _rms(apart),
        "worst_tilt_deg": np.degrees(np.nanmax(flown["tilt"], axis=1)),
        "converge_s": convergence_time(inclination, rate_hz),
        "recover_s": recovery_time(apart, end == log.shape[1], rate_hz),
        "power_w": np.nanmean(power, axis=1),
        "jitter": _rms(flown["command_change"]),
    }


def convergence_time(inclination_deg: Array, rate_hz: float) -> Array:
    """When the error is first below `CONVERGED_DEG` for `CONVERGED_S`, (n,) [s]; NaN if never.

    Args:
        inclination_deg: (n, T) [deg]; NaN counts as large.
        rate_hz: Samples per second.
    """
    hold = max(round(CONVERGED_S * rate_hz), 1)
    good = (inclination_deg < CONVERGED_DEG).astype(np.int64)
    total = np.concatenate([np.zeros((len(good), 1), dtype=np.int64), np.cumsum(good, axis=1)], axis=1)
    held = total[:, hold:] - total[:, :-hold] == hold
    first = held.argmax(axis=1) if held.shape[1] else np.zeros(len(good), dtype=np.int64)
    found = held.any(axis=1)
    return np.where(found, first / rate_hz, np.nan)


def recovery_time(apart: Array, whole: NDArray[np.bool_], rate_hz: float) -> Array:
    """The longest time beyond `AWAY_M` before it came back, (n,) [s]; NaN where it did not.

    A flight that is away at its end has not come back if that has lasted for a second.

    Args:
        apart: (n, T) distance from the set-point [m].
        whole: (n,) whether a flight lasted to its end.
        rate_hz: Samples per second.
    """
    longest, spell = np.zeros((2, len(apart)))
    for away in (apart > AWAY_M).T:
        longest = np.where(away, longest, np.maximum(longest, spell))
        spell = np.where(away, spell + 1, 0)
    return np.where(whole & (spell < rate_hz), longest / rate_hz, np.nan)


def error_histogram(log: Log, end: NDArray[np.int64]) -> NDArray[np.int64]:
    """Counts of the absolute errors of roll and pitch over `ERROR_BINS` equal parts of `ERROR_DECADES`."""
    before = np.arange(log.shape[1]) < end[:, None]
    errors = absolute_error(log["estimate"], log["euler"][..., :2])[before]
    decades = np.log10(np.maximum(errors, 1e-12)).clip(*ERROR_DECADES)
    return np.histogram(decades, bins=ERROR_BINS, range=ERROR_DECADES)[0]


def wilson(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a share (Wilson 1927)."""
    if trials == 0:
        return 0.0, 1.0
    z = float(ndtri(0.5 + 0.5 * level))
    share, square = hits / trials, z * z / trials
    middle = (share + square / 2) / (1 + square)
    half = z * math.sqrt(share * (1 - share) / trials + square / (4 * trials)) / (1 + square)
    return max(0.0, middle - half), min(1.0, middle + half)


def summarise(flights: list[dict[str, float | int | str | None]]) -> dict[str, float | int | None]:
    """One row for the flights of a scenario on an estimator."""
    crashes = sum(bool(flight["cause"]) for flight in flights)
    low, high = wilson(crashes, len(flights))
    row: dict[str, float | int | None] = {"flights": len(flights), "crashes": crashes}
    row |= {"crash_rate": crashes / len(flights), "crash_low": low, "crash_high": high}
    for metric in METRICS:
        if metric.key != "crash_rate":
            values = np.array(
                [np.nan if f[metric.key] is None else f[metric.key] for f in flights], dtype=float
            )
            row[metric.key] = _one_figure(metric.key, values)
    return row


def _one_figure(key: str, values: Array) -> float | None:
    if key in ("converge_s", "recover_s"):
        figure = float(np.median(np.where(np.isnan(values), np.inf, values)))
    elif np.isnan(values).all():
        return None
    else:
        figure = float(np.nanmax(values) if key == "worst_tilt_deg" else np.nanmean(values))
    return figure if math.isfinite(figure) else None


def _rms(values: Array) -> Array:
    return np.sqrt(np.nanmean(values**2, axis=1))
