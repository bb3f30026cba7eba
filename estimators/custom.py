"""A user's estimator, named by "module:Class", "file.py:Class" or an entry point."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadsim.estimator import AttitudeEstimator, receives_truth, roll_pitch_of
from quadsim.own import is_own, load_own, named_errors, own_files
from quadsim.vehicle import GRAVITY

from .filters.parameter import Parameter

GROUP = "quadsim.estimators"
"""Group of entry points for estimators of installed packages."""


def is_custom(name: str) -> bool:
    """Return whether a name refers to a user's estimator."""
    return is_own(name, GROUP)


def declared(name: str) -> dict[str, Parameter]:
    """Return the attribute `parameters` of a user's class, a mapping of `Parameter` by keyword.

    Raises:
        ValueError: The class does not exist, or its declaration is invalid.
    """
    made: Any = load_own(name, GROUP)
    found = getattr(made, "parameters", None) if isinstance(made, type) else None
    if found is None:
        return {}
    if not isinstance(found, Mapping) or not all(isinstance(each, Parameter) for each in found.values()):
        raise ValueError(
            f"{name}: parameters should be a dict of names and estimators.Parameter(default, low, high)"
        )
    return dict(found)


def made_by(
    name: str, made: Callable[..., AttitudeEstimator], rate_hz: float, values: Mapping[str, Any]
) -> AttitudeEstimator:
    """Make and test a user's estimator.

    Args:
        name: Name of the estimator in error messages.
        made: Class, or function that makes the estimator.
        rate_hz: Samples per second, the only positional argument.
        values: Keyword arguments: declared parameters, and `vehicle` if the class asks for the airframe.

    Raises:
        ValueError: The result is not an estimator.
    """
    arguments = ", ".join(["one argument, rate_hz", *(f"{key}=" for key in values)])
    with named_errors(f"{name} is made with {arguments}, and", passing=()):
        est = made(rate_hz, **values)
    tried(name, est)
    if not hasattr(est, "rate_hz"):
        est.rate_hz = rate_hz
    return est


def tried(name: str, est: AttitudeEstimator) -> AttitudeEstimator:
    """Test a user's estimator with a reset of three vehicles and an update at rest.

    Raises:
        ValueError: The object is not an estimator; the message says what is missing or wrong.
    """
    if missing := [each for each in ("reset", "update") if not callable(getattr(est, each, None))]:
        raise ValueError(f"{name} is no estimator: it has no {' and no '.join(missing)}")
    calls = "reset(n=3, roll_pitch=None) or update(gyro, accel), each (3, 3),"
    with named_errors(f"{name}: {calls}", passing=()):
        est.reset(n=3, roll_pitch=None)
        if (observe := getattr(est, "observe", None)) is not None and receives_truth(est):
            observe(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
        result = est.update(np.zeros((3, 3)), np.tile([0.0, 0.0, GRAVITY], (3, 1)))
        result = np.asanyarray(result)
    roll_pitch_of(result, (3, 2), name)
    return est


def own_sources(name: str) -> list[Path]:
    """Return the user's files that define an estimator; none for other names."""
    return own_files(name, GROUP) if is_custom(name) else []
