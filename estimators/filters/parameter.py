"""Parameters of an estimator that a user or `quadsim tune` can change."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.config.toml import nearest

Scale = Literal["linear", "log", "one-minus-log"]


@dataclass(frozen=True)
class Parameter:
    """One parameter of a filter: its default value and the range of the search."""

    default: float
    """Default value; NaN for a parameter that only the vehicle's file can give."""
    low: float
    """Smallest value in the search."""
    high: float
    """Largest value in the search."""
    scale: Scale = "log"
    """Mapping of the search interval [0, 1] to low…high: linear, logarithmic, or logarithmic in the distance
    from 1."""
    minimum: float = 0.0
    maximum: float = math.inf
    searched: bool = True
    """Whether tuning searches the parameter; false for a known constant."""
    per_sample: Literal["", "weight", "memory"] = ""
    """Role of a parameter that acts once per sample, which determines its conversion to another sample
    rate."""

    def at(self, unit: ArrayLike) -> NDArray[np.float64]:
        """Return the value at a position of the search, 0…1 -> low…high."""
        x = np.asarray(unit, dtype=np.float64)
        match self.scale:
            case "linear":
                return self.low + (self.high - self.low) * x
            case "log":
                return self.low * (self.high / self.low) ** x
            case "one-minus-log":
                return 1.0 - (1.0 - self.low) * ((1.0 - self.high) / (1.0 - self.low)) ** x

    def position(self, value: float) -> float:
        """Return the position of a value in the search, within 0…1; the inverse of `at`."""
        low, high = self.low, self.high
        match self.scale:
            case "linear":
                x = (value - low) / (high - low)
            case "log":
                x = math.log(max(value, low) / low) / math.log(high / low)
            case "one-minus-log":
                share = max(1.0 - value, 1.0 - high) / (1.0 - low)
                x = math.log(share) / math.log((1.0 - high) / (1.0 - low))
        return min(max(x, 0.0), 1.0)

    def carried(self, value: float, rate_ratio: float) -> float:
        """Return the value with the same effect at another sample rate, for the ratio old rate / new rate."""
        match self.per_sample:
            case "memory":
                return value**rate_ratio
            case "weight":
                return value * rate_ratio
            case _:
                return value


def checked(owner: str, parameters: Mapping[str, Parameter], given: Mapping[str, object]) -> dict[str, float]:
    """Return parameters as floats; raise ValueError for an unknown name or a value out of range."""
    values = {}
    for name, value in given.items():
        if name not in parameters:
            raise ValueError(f'{owner} has no parameter "{name}"; {nearest(name, parameters)}')
        parameter = parameters[name]
        if not (isinstance(value, int | float | np.number) and math.isfinite(value)):
            raise ValueError(f"{owner}: {name} = {value!r} is not a finite number")
        if not parameter.minimum <= value <= parameter.maximum:
            allowed = f"{parameter.minimum:g} to {parameter.maximum:g}"
            raise ValueError(f"{owner}: {name} = {value:g} is outside {allowed}")
        values[name] = float(value)
    return values
