"""Checks of an estimator of one's own: what every caller relies on, with the first that fails named."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, receives_truth
from quadsim.vehicle import GRAVITY

from .custom import tried
from .registry import create
from .running import differ, run_quietly

Array = NDArray[np.float64]
Make = Callable[[], AttitudeEstimator]
SAMPLES, VEHICLES = 240, 3
SAME = 1e-9
"""Largest difference between numbers that should be the same [rad]."""


def check_estimator(estimator: str | Callable[[float], AttitudeEstimator], rate_hz: float = 200.0) -> None:
    """Raise unless an estimator does what benchmark, evaluation and environment rely on.

    Its outputs have the right shape, are finite, and stay so after missing samples (NaN); n vehicles at once
    give the numbers of n alone; the same input gives the same output, after a reset too; arrays that it is
    given are not changed; a known initial attitude can be given.

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
    still = np.zeros((1, 2000, 3)), np.tile([0.0, 0.0, GRAVITY], (1, 2000, 1))
    most = np.degrees(np.abs(_estimates(make(), *still)[:, -100:]).max())
    return "" if most < 5.0 else f"{most:.1f}° are seen"


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


def _deterministic(make: Make) -> str:
    return differ(_estimates(make()), _estimates(make()), SAME)


def _reset(make: Make) -> str:
    est = make()
    return differ(_estimates(est), _estimates(est), SAME)


def _keeps_its_input(make: Make) -> str:
    est, (gyro, accel) = make(), _motion()
    before = gyro.copy(), accel.copy()
    est.reset(VEHICLES, roll_pitch=None)
    if not receives_truth(est):
        est.update(gyro[:, 0], accel[:, 0])
    same = np.array_equal(gyro, before[0]) and np.array_equal(accel, before[1])
    return "" if same else "gyro or accel is another after update"


def _output_stays(make: Make) -> str:
    est, (gyro, accel) = make(), _motion()
    if receives_truth(est):
        return ""
    est.reset(VEHICLES, roll_pitch=None)
    first = est.update(gyro[:, 0], accel[:, 0])
    kept = np.array(first)
    for t in range(1, 20):
        est.update(gyro[:, t], accel[:, t])
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
    _at_rest: "a vehicle at rest and level is level within 5° after 10 s",
    _batch_equals_single: "n vehicles at once give the numbers of n alone",
    _sequence_equals_stream: "a sequence gives the numbers of its samples one by one",
    _deterministic: "the same input gives the same output",
    _reset: "reset forgets what came before",
    _keeps_its_input: "update leaves its arguments as they are",
    _output_stays: "what update has returned does not change later",
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
    up = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=-1)
    return gyro, GRAVITY * up


def _estimates(est: AttitudeEstimator, gyro: Array | None = None, accel: Array | None = None) -> Array:
    """Of the motion above, or of other readings; an estimator that is fed the truth is given level flight."""
    if gyro is None or accel is None:
        gyro, accel = _motion()
    level = np.tile([1.0, 0.0, 0.0, 0.0], (*gyro.shape[:2], 1))
    return np.asarray(run_quietly(est, gyro, accel, quat=level if receives_truth(est) else None))
