"""Checks of a user's estimator against the protocol `AttitudeEstimator`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import AttitudeEstimator, Readings, receives_truth
from quadsim.own import named_errors
from quadsim.rotation import quat_from_roll_pitch
from quadsim.vehicle import GRAVITY

from .custom import made_by
from .metrics import up_in_body
from .registry import create
from .running import differ, run_quietly, stream

Array = NDArray[np.float64]
Make = Callable[[], AttitudeEstimator]
SAMPLES, VEHICLES = 240, 3
SAME = 1e-9
"""Largest difference between numbers that should be equal [rad]."""


def check_estimator(
    estimator: str | Callable[[float], AttitudeEstimator], rate_hz: float = 200.0, *, accurate: bool = True
) -> None:
    """Check that an estimator fulfils the requirements of benchmark, evaluation and environment.

    The requirements are:

    - Outputs have the right shape and are finite, even after missing samples (NaN).
    - At rest, the outputs are the tilt of the vehicle.
    - n vehicles in one batch give the same numbers as n single vehicles.
    - The same input gives the same output, also after a reset.
    - Instances share no state.
    - The estimator does not change its input arrays.
    - `reset` accepts a known initial attitude.

    Args:
        estimator: A class or function called with `rate_hz`, or a name as `estimators.create` takes it.
        rate_hz: Samples per second.
        accurate: Whether to check the tilt at rest.

    Raises:
        ValueError: A check fails; the message names the check and the observed values.
    """
    name = estimator if isinstance(estimator, str) else getattr(estimator, "__name__", str(estimator))

    def make() -> AttitudeEstimator:
        if isinstance(estimator, str):
            return create(estimator, rate_hz, vehicle="hummingbird")
        return made_by(name, estimator, rate_hz, {})

    make()
    for check, about in CHECKS.items():
        if check is _at_rest and not accurate:
            continue
        failing = f"{name} fails {check.__name__.removeprefix('_')}: {about};"
        with named_errors(f"{failing} it", passing=()):
            seen = check(make)
        if seen:
            raise ValueError(f"{failing} {seen}")


def _finite(make: Make) -> str:
    out = _estimates(make())
    return "" if np.isfinite(out).all() else f"{100 * np.mean(~np.isfinite(out)):.0f} % of them are not"


def _at_rest(make: Make) -> str:
    tilt = np.array([0.15, -0.15])
    accel = np.tile(GRAVITY * up_in_body(tilt), (1, 2000, 1))
    out = _estimates(make(), Readings(np.zeros_like(accel), accel), tilt=tilt)
    most = np.degrees(np.abs(out[:, -100:] - tilt).max())
    return "" if most < 5.0 else f"its error is {most:.1f}°"


def _batch_equals_single(make: Make) -> str:
    together, motion = _estimates(make()), _motion()
    alone = [_estimates(make(), motion.map(lambda each, k=k: each[k : k + 1])) for k in range(VEHICLES)]
    return differ(together, np.concatenate(alone), SAME)


def _sequence_equals_stream(make: Make) -> str:
    est = make()
    return "" if receives_truth(est) else differ(_estimates(est), stream(est, _motion(), None), SAME)


def _repeatable(make: Make) -> str:
    est = make()
    first = _estimates(est)
    return differ(first, _estimates(est), SAME) or differ(first, _estimates(make()), SAME)


def _instances_apart(make: Make) -> str:
    """Compare two instances that take turns with a single one."""
    motion, first, second = _motion(), make(), make()
    if receives_truth(first):
        return ""
    for est in (first, second):
        est.reset(VEHICLES, roll_pitch=None)
    out = np.empty((VEHICLES, SAMPLES, 2))
    for t in range(SAMPLES):
        out[:, t] = first.update(motion.gyro[:, t].copy(), motion.accel[:, t].copy())
        second.update(-motion.gyro[:, t], motion.accel[:, -t - 1].copy())
    return differ(out, stream(make(), _motion(), None), SAME)


def _keeps_arrays(make: Make) -> str:
    est, given, same = make(), _motion(), _motion()
    if receives_truth(est):
        return ""
    est.reset(VEHICLES, roll_pitch=None)
    first = est.update(given.gyro[:, 0], given.accel[:, 0])
    kept = np.array(first)
    for t in range(1, 20):
        est.update(given.gyro[:, t], given.accel[:, t])
    if not (np.array_equal(given.gyro, same.gyro) and np.array_equal(given.accel, same.accel)):
        return "gyro or accel is another after update"
    return differ(np.asarray(first), kept, SAME)


def _missing_samples(make: Make) -> str:
    readings = _motion()
    readings.gyro[:, 50:60], readings.accel[1, 70:80] = np.nan, np.nan
    out = _estimates(make(), readings)
    return "" if np.isfinite(out[:, -100:]).all() else "estimates after missing samples are not finite"


def _known_start(make: Make) -> str:
    out = _estimates(make(), start=np.full((VEHICLES, 2), 0.1))
    return "" if np.isfinite(out[:, 0]).all() else "then the estimate is not finite"


CHECKS: dict[Callable[[Make], str], str] = {
    _finite: "estimates are finite",
    _at_rest: "the tilt of a vehicle at rest is found in 10 s, within 5°, in radians",
    _repeatable: "the same input gives the same output, after a reset too",
    _instances_apart: "instances share no state",
    _batch_equals_single: "n vehicles at once give the numbers of n alone",
    _sequence_equals_stream: "a sequence gives the numbers of its samples one by one",
    _keeps_arrays: "update changes neither its arguments nor, later, what it has returned",
    _missing_samples: "samples of NaN are bridged",
    _known_start: "reset accepts roll_pitch (n, 2)",
}
"""Checks, each of which returns a description of its failure, empty if there is none."""


def _motion() -> Readings:
    """Return readings of vehicles that swing about roll and pitch, (VEHICLES, SAMPLES, 3) each."""
    t, phase = np.arange(SAMPLES) / 200.0, np.arange(VEHICLES)[:, None]
    roll, pitch = 0.4 * np.sin(3.0 * t + phase), 0.3 * np.sin(2.0 * t + 0.5 * phase)
    rate = 1.2 * np.cos(3.0 * t + phase), 0.6 * np.cos(2.0 * t + 0.5 * phase)
    gyro = np.stack([*rate, 0.1 * np.ones_like(roll)], axis=-1)
    return Readings(gyro, GRAVITY * up_in_body(np.stack([roll, pitch], axis=-1)))


def _estimates(
    est: AttitudeEstimator,
    readings: Readings | None = None,
    start: Array | None = None,
    tilt: ArrayLike = (0.0, 0.0),
) -> Array:
    """Return estimates for the readings of `_motion` or for other readings."""
    readings = _motion() if readings is None else readings
    truth = np.tile(quat_from_roll_pitch(tilt), (*readings.gyro.shape[:2], 1))
    return run_quietly(est, readings, start, truth)
