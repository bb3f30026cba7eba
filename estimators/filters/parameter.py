"""The numbers of an estimator that a user or `quadsim tune` may change."""

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
    """One number of a filter: its default, what is allowed, and where a search looks for it."""

    default: float
    """NaN for one that only the vehicle's file gives."""
    low: float
    """Lower end of the search."""
    high: float
    """Upper end of the search."""
    scale: Scale = "log"
    """How the search's [0, 1] maps to low…high: evenly, by factors, or by factors of the distance from 1."""
    minimum: float = 0.0
    maximum: float = math.inf
    searched: bool = True
    """False for a known constant that tuning leaves alone."""
    per_sample: Literal["", "weight", "memory"] = ""
    """What a number that acts once per sample does, so that it can be converted to another sample rate."""

    def at(self, unit: ArrayLike) -> NDArray[np.float64]:
        """Value at a position of the search, 0…1 -> low…high."""
        x = np.asarray(unit, dtype=np.float64)
        match self.scale:
            case "linear":
                return self.low + (self.high - self.low) * x
            case "log":
                return self.low * (self.high / self.low) ** x
            case "one-minus-log":
                return 1.0 - (1.0 - self.low) * ((1.0 - self.high) / (1.0 - self.low)) ** x

    def position(self, value: float) -> float:
        """Where a value lies in the search, the inverse of `at`, within 0…1."""
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
        """The value that acts alike at another sample rate, old rate / new rate given."""
        match self.per_sample:
            case "memory":
                return value**rate_ratio
            case "weight":
                return value * rate_ratio
            case _:
                return value


def checked(owner: str, parameters: Mapping[str, Parameter], given: Mapping[str, object]) -> dict[str, float]:
    """The given parameters as floats; ValueError for an unknown name or a value out of range."""
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
