"""What an environment is made of, given by name, file or object: scenario, estimator and controller."""

import copy
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, TypeAlias, cast

from ..control.attitude_controller import MakeController
from ..estimator import AttitudeEstimator
from ..flight.scenario import Scenario, changed, load_scenario
from ..own import named_errors
from ..vehicle import Randomisation

Made: TypeAlias = AttitudeEstimator | str | Path | Callable[[float], AttitudeEstimator] | None
"""An estimator, or what makes one: see `made_for`."""
Spread: TypeAlias = Randomisation | Mapping[str, Any]
"""The `[randomisation]` of a recipe or a scenario, or a table of it."""


def scenario_for(scenario: object, randomisation: Spread | None = None) -> Scenario:
    """An environment's scenario, given as a name, a file or a `Scenario`, randomised as given.

    Raises:
        ValueError: It is none of these, there is no such file, or a number is out of its range.
    """
    if isinstance(scenario, str | Path):
        scenario = load_scenario(scenario)
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario = {scenario!r}: should be a name, a file or a Scenario")
    return scenario if randomisation is None else changed(scenario, {"randomisation": randomisation})


def made_for(estimator: Made, scenario: Scenario, rate_hz: float) -> AttitudeEstimator | None:
    """An environment's own estimator.

    Args:
        estimator: A name, weights or "module:Class", as `estimators.create` takes them, made for the
            scenario's vehicle and IMU; a function or class that makes one of `rate_hz`; an estimator, which
            is copied; None for the true attitude.
        scenario: The scenario of the flight.
        rate_hz: Samples per second.

    Raises:
        ValueError: No such estimator, or one that cannot be copied.
    """
    if estimator is None:
        return None
    import estimators
    from estimators.custom import tried

    if isinstance(estimator, str | Path):
        vehicle = scenario.vehicle if scenario.vehicle_known else None
        return estimators.create(str(estimator), rate_hz, vehicle=vehicle, imu=scenario.imu)
    name = getattr(estimator, "__name__", type(estimator).__name__)
    if isinstance(estimator, type | FunctionType | MethodType | partial):
        with named_errors(f"{name} is called with one argument, rate_hz, and"):
            own = estimator(rate_hz)
    elif not hasattr(estimator, "update"):
        raise ValueError(
            f"estimator = {estimator!r}: should be a name, an estimator, or a function that makes one"
        )
    else:
        try:
            own = copy.deepcopy(cast(AttitudeEstimator, estimator))
        except (Exception, SystemExit) as error:  # whatever a user's class does
            raise ValueError(
                f"{name} cannot be copied, and environments do not share an estimator: give "
                f"a function that makes one, lambda rate_hz: ... ({error})"
            ) from error
    return tried(name, own)


def controller_for(controller: str | Path | MakeController | None) -> MakeController | None:
    """What makes an environment's attitude controller, given also by a name; None for the cascade's own.

    Raises:
        ValueError: No such controller.
    """
    if not isinstance(controller, str | Path):
        return controller
    from estimators.control.controller import make_controller

    return make_controller(controller)
