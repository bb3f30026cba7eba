"""Metrics of flights from their logs.

`log` (n, T) has the type `flight_log.log_dtype`. `end` (n,) is the number of samples before a crash; later
samples are not used.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.metrics import absolute_error, attitude_error, inclination_error
from quadsim.vehicle import Vehicle

from .flight_log import Log

Array = NDArray[np.float64]

CONVERGED_DEG = 5.0
"""Inclination error below which an estimate counts as converged [deg]."""
CONVERGED_S = 1.0
"""Time for which the error must stay below `CONVERGED_DEG` [s]."""
OUT_OF_BOUNDS_M = 0.5
"""Distance from the set-point beyond which a vehicle counts as out of bounds [m]."""
ERROR_DECADES = (-3.0, 2.3)
"""Range of the error histograms, as powers of ten of a degree."""
ERROR_BINS = 106
"""Number of equal parts of the error histograms."""


@dataclass(frozen=True)
class Metric:
    """A column of the tables."""

    key: str
    label: str
    unit: str
    digits: int
    help: str


METRICS = tuple(Metric(*row) for row in (
    ("error_deg", "Estimation error", "deg", 2,
     "Mean absolute error of roll and pitch, pooled; the mean over flights without a crash."),
    ("inclination_deg", "Inclination error", "deg", 2,
     "RMS of the angle between the true and the estimated direction of gravity; the mean over flights "
     "without a crash."),
    ("crash_rate", "Crash rate", "", 2,
     "Share of flights that tilted over, hit the ground or went out of bounds; 95 % Wilson interval."),
    ("attitude_deg", "Attitude tracking", "deg", 2,
     "RMS of the angle between the true thrust axis and the commanded one; the mean over flights without "
     "a crash."),
    ("position_m", "Position tracking", "m", 3,
     "RMS distance from the set-point; the mean over flights without a crash."),
    ("worst_tilt_deg", "Largest tilt", "deg", 1, "Largest tilt of any flight."),
    ("converge_s", "Time to converge", "s", 2,
     f"When the inclination error first is below {CONVERGED_DEG:g}° and stays so for {CONVERGED_S:g} s; "
     "the median over flights, empty if most never get there."),
    ("recover_s", "Recovery time", "s", 2,
     f"The longest time it took to come back, once more than {OUT_OF_BOUNDS_M:g} m from the set-point, "
     "0 if never there; the median over flights, empty if most crash or stay away."),
    ("power_w", "Rotor power", "W", 1,
     "Mean mechanical power of the rotors, Σ k_m k_f ω³; the mean over flights without a crash."),
    ("jitter", "Command jitter", "rad/s", 2,
     "RMS change of the rotor commands from one sample to the next; the mean over flights without a crash."),
))  # fmt: skip
MEASURED = [metric for metric in METRICS if metric.key != "crash_rate"]
"""Metrics of a single flight."""
KEYS = ["scenario", "estimator"]
FLIGHT = ["seed", "cause", "flown_s", *(metric.key for metric in MEASURED)]
"""Columns of a flight: number, cause of a crash (empty without one), duration, and metrics."""


def flight_metrics(log: Log, end: NDArray[np.int64], rate_hz: float, vehicle: Vehicle) -> dict[str, Array]:
    """Compute every metric of each flight, (n,), by the keys of `MEASURED`; NaN without a value."""
    valid = log.copy()
    valid[np.arange(log.shape[1]) >= np.maximum(end, 1)[:, None]] = np.nan
    estimate, truth = valid["estimate"], valid["euler"][..., :2]
    inclination = inclination_error(estimate, truth)
    distance = np.linalg.norm(valid["position"] - valid["target"], axis=-1)
    power = vehicle.motor.k_m * vehicle.motor.k_f * np.sum(valid["rotor_vel"] ** 3, axis=-1)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of flights without a number
        return {
            "error_deg": attitude_error(estimate, truth).sequences,
            "inclination_deg": _rms(inclination),
            "attitude_deg": np.degrees(_rms(valid["tracking"])),
            "position_m": _rms(distance),
            "worst_tilt_deg": np.degrees(np.nanmax(valid["tilt"], axis=1)),
            "converge_s": convergence_time(inclination, rate_hz),
            "recover_s": recovery_time(distance, end == log.shape[1], rate_hz),
            "power_w": np.nanmean(power, axis=1),
            "jitter": _rms(valid["command_change"]),
        }


def convergence_time(inclination_deg: Array, rate_hz: float) -> Array:
    """Return when the error (n, T) [deg] is first below `CONVERGED_DEG` for `CONVERGED_S`, (n,) [s].

    Or NaN.
    """
    steps = max(round(CONVERGED_S * rate_hz), 1)
    if inclination_deg.shape[1] < steps:
        return np.full(len(inclination_deg), np.nan)
    total = np.cumsum(np.pad(inclination_deg < CONVERGED_DEG, ((0, 0), (1, 0))), axis=1)
    settled = total[:, steps:] - total[:, :-steps] == steps
    return np.where(settled.any(axis=1), settled.argmax(axis=1) / rate_hz, np.nan)


def recovery_time(distance: Array, complete: NDArray[np.bool_], rate_hz: float) -> Array:
    """Return the longest time beyond `OUT_OF_BOUNDS_M` before a return, (n,) [s]; NaN without a return.

    A flight that is out of bounds during its last second has not returned. `distance` (n, T) is the distance
    from the set-point [m]; `complete` (n,) marks flights of full length.
    """
    longest, spell = np.zeros((2, len(distance)))
    for outside in (distance > OUT_OF_BOUNDS_M).T:
        longest = np.where(outside, longest, np.maximum(longest, spell))
        spell = np.where(outside, spell + 1, 0)
    return np.where(complete & (spell < rate_hz), longest / rate_hz, np.nan)


def error_histogram(log: Log, end: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the absolute errors of roll and pitch in `ERROR_BINS` equal parts of `ERROR_DECADES`."""
    before = np.arange(log.shape[1]) < end[:, None]
    errors = absolute_error(log["estimate"], log["euler"][..., :2])[before]
    decades = np.log10(np.maximum(errors, 1e-12)).clip(*ERROR_DECADES)
    return np.histogram(decades, bins=ERROR_BINS, range=ERROR_DECADES)[0]


def _rms(values: Array) -> Array:
    return np.sqrt(np.nanmean(values**2, axis=1))
