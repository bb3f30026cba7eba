"""Contenders: an estimator with the cascade, or "ESTIMATOR @ CONTROLLER" with another attitude controller."""

from collections.abc import Sequence

import estimators
from estimators.control.controller import CASCADED

MARK = " @ "
TRUTH = "truth"
"""The estimator that returns the true attitude."""
LEFT_OUT = {"ukf-filterpy": "ten times as slow as ekf-filterpy", "att-snn": "the numbers of att-snn-loihi"}
"""Estimators that do not fly by default, with the reason."""


def default_estimators() -> list[str]:
    """Return the default estimators."""
    return [name for name in estimators.names() if name not in LEFT_OUT]


def contenders(names: Sequence[str], controllers: Sequence[str]) -> list[str]:
    """Return every estimator with every controller."""
    return [contender(estimator, each) for each in controllers or [CASCADED] for estimator in names]


def contender(estimator: str, controller: str = CASCADED) -> str:
    """Return the name of an estimator with a controller."""
    return estimator if controller == CASCADED else f"{estimator}{MARK}{controller}"


def estimator_of(name: str) -> str:
    """Return the estimator of a contender."""
    return name.partition(MARK)[0]


def controller_of(name: str) -> str:
    """Return the controller of a contender."""
    return name.partition(MARK)[2] or CASCADED
