"""A user's own estimator: a class that `module:Class` names."""

import importlib
import importlib.util
from pathlib import Path

import numpy as np

from quadsim.estimator import AttitudeEstimator
from quadsim.vehicle import GRAVITY


def own(name: str, rate_hz: float) -> AttitudeEstimator:
    """A user's estimator, "module:Class".

    Raises:
        ValueError: No such module or class, or it is no estimator.
    """
    module, _, attribute = name.partition(":")
    try:
        made = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # whatever a user's module does
        raise ValueError(f"{name} is no module:Class: {type(error).__name__}: {error}") from error
    try:
        est = made(rate_hz)
    except Exception as error:  # and its class
        kind = "" if isinstance(error, TypeError) else f"{type(error).__name__}: "
        raise ValueError(f"{name} is made with one argument, rate_hz: {kind}{error}") from error
    if not hasattr(est, "rate_hz"):
        est.rate_hz = rate_hz
    return tried(name, est)


def tried(name: str, est: AttitudeEstimator) -> AttitudeEstimator:
    """A user's estimator, after a reset of two vehicles and an update at rest.

    Raises:
        ValueError: It is no estimator: what it lacks, or what it did.
    """
    if missing := [each for each in ("reset", "update") if not callable(getattr(est, each, None))]:
        raise ValueError(f"{name} is no estimator: it has no {' and no '.join(missing)}")
    try:
        est.reset(n=2, roll_pitch=None)
        result = np.asarray(est.update(np.zeros((2, 3)), np.tile([0.0, 0.0, GRAVITY], (2, 1))), np.float64)
    except Exception as error:  # whatever a user's class does
        raise ValueError(
            f"{name}: reset(n=2, roll_pitch=None) and update(gyro, accel), each (2, 3), end with "
            f"{type(error).__name__}: {error}"
        ) from error
    if result.shape != (2, 2):
        raise ValueError(
            f"{name}: update returns an array of shape {result.shape} for two vehicles; roll and pitch, "
            "(2, 2) [rad], are required"
        )
    return est


def own_source(name: str) -> Path | None:
    """File of the module that "module:Class" names; None for other names, and where there is none."""
    try:
        spec = importlib.util.find_spec(name.partition(":")[0]) if ":" in name else None
    except (ImportError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None
