"""Checks of an estimator of one's own: what every caller relies on, with the first that fails named."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.rotation import quat_from_roll_pitch
from quadsim.vehicle import GRAVITY

from .custom import tried
from .metrics import up_in_body
from .registry import create
from .running import differ, run_quietly

Array = NDArray[np.float64]
Make = Callable[[], AttitudeEstimator]
SAMPLES, VEHICLES = 240, 3
SAME = 1e-9
"""Largest difference between numbers that should be the same [rad]."""


def check_estimator(estimator: str | Callable[[float], AttitudeEstimator], rate_hz: float = 200.0) -> None:
    """Raise unless an estimator does what benchmark, evaluation and environment rely on.

    Its outputs have the right shape, are finite, and stay so after missing samples (NaN); at rest they
    are the tilt; n vehicles at once give the numbers of n alone; the same input gives the same output,
    after a reset too; arrays that it is given are not changed; a known initial attitude can be given.

    Args:
        estimator: A class or function called with `rate_hz`, or a name as `estimators.create` takes it.
        rate_hz: Samples per second.

    Raises:
        ValueError: The check that fails, and what was seen.
    """
    name = estimator if isinstance(estimator, str) else getattr(estimator, "__name__", str(estimator))

    def make() -> AttitudeEstimator:
        if isinstance(estimator, str):
            return create(estimator, rate_hz, vehicle="hummingbird")
        try:
            made = estimator(rate_hz)
        except (Exception, SystemExit) as error:
            raise ValueError(f"{name} is made with one argument, rate_hz: {error}") from error
        tried(name, made)
        if not hasattr(made, "rate_hz"):
            made.rate_hz = rate_hz
        return made

    make()
    for check, about in CHECKS.items():
        try:
            seen = check(make)
        except (Exception, SystemExit) as error:
            seen = f"{type(error).__name__}: {error}"
        if seen:
            raise ValueError(f"{name} fails {check.__name__.removeprefix('_')}: {about}; {seen}")


def _shapes(make: Make) -> str:
    for n in (1, VEHICLES):
        est = make()
        est.reset(n, roll_pitch=None)
        out = est.update(*(each[:, 0] for each in _motion(n)))
        if np.shape(out) != (n, 2):
            return f"for {n} vehicle(s) its shape is {np.shape(out)}"
    return ""


def _finite(make: Make) -> str:
    out = _estimates(make())
    return "" if np.isfinite(out).all() else f"{np.mean(~np.isfinite(out)):.0%} of them are not"


def _at_rest(make: Make) -> str:
    tilt, est = np.array([0.15, -0.15]), make()
    readings = np.zeros((1, 2000, 3)), np.tile(GRAVITY * up_in_body(tilt), (1, 2000, 1))
    quat = np.tile(quat_from_roll_pitch(tilt), (1, 2000, 1)) if receives_truth(est) else None
    most = np.degrees(np.abs(run_quietly(est, *readings, quat=quat)[:, -100:] - tilt).max())
    return "" if most < 5.0 else f"its error is {most:.1f}°"


def _batch_equals_single(make: Make) -> str:
    together = _estimates(make())
    alone = [_estimates(make(), *(each[k : k + 1] for each in _motion())) for k in range(VEHICLES)]
    return differ(together, np.concatenate(alone), SAME)


def _sequence_equals_stream(make: Make) -> str:
    gyro, accel = _motion()
    est = make()
    est.reset(VEHICLES, roll_pitch=None)
    stream = np.empty((VEHICLES, SAMPLES, 2))
    for t in range(SAMPLES):
        if receives_truth(est):
            return ""  # it is fed the truth
        stream[:, t] = est.update(gyro[:, t].copy(), accel[:, t].copy())
    return differ(_estimates(make()), stream, SAME)


def _repeatable(make: Make) -> str:
    est = make()
    first = _estimates(est)
    return differ(first, _estimates(est), SAME) or differ(first, _estimates(make()), SAME)


def _keeps_arrays(make: Make) -> str:
    est, (gyro, accel) = make(), _motion()
    if receives_truth(est):
        return ""
    est.reset(VEHICLES, roll_pitch=None)
    given = gyro.copy(), accel.copy()
    first = est.update(given[0][:, 0], given[1][:, 0])
    kept = np.array(first)
    for t in range(1, 20):
        est.update(given[0][:, t], given[1][:, t])
    if not (np.array_equal(given[0], gyro) and np.array_equal(given[1], accel)):
        return "gyro or accel is another after update"
    return differ(np.asarray(first), kept, SAME)


def _missing_samples(make: Make) -> str:
    gyro, accel = _motion()
    gyro[:, 50:60], accel[1, 70:80] = np.nan, np.nan
    out = _estimates(make(), gyro, accel)
    return "" if np.isfinite(out[:, -100:]).all() else "estimates after missing samples are not finite"


def _known_start(make: Make) -> str:
    est = make()
    est.reset(VEHICLES, roll_pitch=np.full((VEHICLES, 2), 0.1))
    if receives_truth(est):
        return ""
    out = np.asarray(est.update(*(each[:, 0] for each in _motion())))
    return "" if np.isfinite(out).all() else "then the estimate is not finite"


CHECKS: dict[Callable[[Make], str], str] = {
    _shapes: "update returns roll and pitch of n vehicles, (n, 2)",
    _finite: "estimates are finite",
    _at_rest: "the tilt of a vehicle at rest is found in 10 s, within 5°, in radians",
    _batch_equals_single: "n vehicles at once give the numbers of n alone",
    _sequence_equals_stream: "a sequence gives the numbers of its samples one by one",
    _repeatable: "the same input gives the same output, after a reset too",
    _keeps_arrays: "update changes neither its arguments nor, later, what it has returned",
    _missing_samples: "samples of NaN are bridged",
    _known_start: "reset accepts roll_pitch (n, 2)",
}
"""Each returns what it saw that it should not; empty if nothing."""


def _motion(n: int = VEHICLES) -> tuple[Array, Array]:
    """Readings of n vehicles that swing about roll and pitch, (n, SAMPLES, 3) each."""
    t, phase = np.arange(SAMPLES) / 200.0, np.arange(n)[:, None]
    roll, pitch = 0.4 * np.sin(3.0 * t + phase), 0.3 * np.sin(2.0 * t + 0.5 * phase)
    rate = 1.2 * np.cos(3.0 * t + phase), 0.6 * np.cos(2.0 * t + 0.5 * phase)
    gyro = np.stack([*rate, 0.1 * np.ones_like(roll)], axis=-1)
    return gyro, GRAVITY * up_in_body(np.stack([roll, pitch], axis=-1))


def _estimates(est: AttitudeEstimator, gyro: Array | None = None, accel: Array | None = None) -> Array:
    """Of the motion above, or of other readings; an estimator that is fed the truth is given level flight."""
    if gyro is None or accel is None:
        gyro, accel = _motion()
    level = np.tile([1.0, 0.0, 0.0, 0.0], (*gyro.shape[:2], 1))
    return np.asarray(run_quietly(est, gyro, accel, quat=level if receives_truth(est) else None))
