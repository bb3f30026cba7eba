"""Scenario, estimator and controller of an environment, each given by name, file or object."""

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
"""An estimator, or a function that makes one; see `made_for`."""
Spread: TypeAlias = Randomisation | Mapping[str, Any]
"""The `[randomisation]` of a recipe or a scenario, as a model or as a table."""


def scenario_for(scenario: object, randomisation: Spread | None = None) -> Scenario:
    """Return the scenario given as a name, a file or a `Scenario`, with the given randomisation.

    Raises:
        ValueError: The scenario has another type, the file does not exist, or a number is out of range.
    """
    if isinstance(scenario, str | Path):
        scenario = load_scenario(scenario)
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario = {scenario!r}: should be a name, a file or a Scenario")
    return scenario if randomisation is None else changed(scenario, {"randomisation": randomisation})


def made_for(estimator: Made, scenario: Scenario, rate_hz: float) -> AttitudeEstimator | None:
    """Return an estimator for one environment.

    Args:
        estimator: A name, weights or "module:Class", as for `estimators.create`; a function or class that is
            called with `rate_hz`; an estimator, which is copied; or None for the true attitude.
        scenario: The scenario of the flight.
        rate_hz: Samples per second.

    Raises:
        ValueError: The estimator does not exist or cannot be copied.
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
    """Return the function that makes an environment's attitude controller; None for the cascade.

    Raises:
        ValueError: The controller does not exist.
    """
    if not isinstance(controller, str | Path):
        return controller
    from estimators.control.controller import make_controller

    return make_controller(controller)
