"""Paired differences: two estimators on the very same flights, so that wind and noise cancel.

Seed i of a scenario is the same start, wind, sensor noise and faults for every estimator. A pair of which one
crashed has no difference in error; such pairs are counted separately.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from .flight_metrics import FlightRow

Array = NDArray[np.float64]

PAIRED = ("error_deg", "attitude_deg", "position_m")
"""Metrics that are compared."""
ALL = "all"
"""Means all scenarios together."""


@dataclass(frozen=True)
class PairRow:
    """Two estimators, one metric and one scenario."""

    scenario: str
    """`ALL` for all together."""
    metric: str
    estimator: str
    versus: str
    pairs: int
    """Seeds on which neither crashed."""
    difference: float | None
    """Mean of `estimator` minus `versus`; None without pairs."""
    low: float | None
    """Ends of the interval; None with fewer than two pairs."""
    high: float | None
    crashed_alone: int
    """Flights that only `estimator` crashed."""
    versus_crashed_alone: int

    @property
    def is_tied(self) -> bool:
        """Whether the difference is not significant: the interval includes 0."""
        return self.low is not None and self.high is not None and self.low <= 0 <= self.high


def paired_differences(flights: Sequence[FlightRow], level: float = 0.95) -> list[PairRow]:
    """Every two estimators on the same seeds of each scenario, and of all together.

    The interval of a `level` is Student's over seeds; for all scenarios a seed's difference is first averaged
    over them, for its flights share their sensor noise.
    """
    scenarios = list(dict.fromkeys(f.scenario for f in flights))
    names = list(dict.fromkeys(f.estimator for f in flights))
    seeds = list(dict.fromkeys(f.seed for f in flights))
    shape = len(scenarios), len(names), len(seeds)
    values, crashed = {key: np.full(shape, np.nan) for key in PAIRED}, np.zeros(shape, dtype=bool)
    for f in flights:
        at = scenarios.index(f.scenario), names.index(f.estimator), seeds.index(f.seed)
        crashed[at] = bool(f.cause)
        for key in PAIRED:
            value = getattr(f, key)
            values[key][at] = np.nan if crashed[at] or value is None else value
    rows: list[PairRow] = []
    for a, b in combinations(range(len(names)), 2):
        alone = [(crashed[:, i] & ~crashed[:, j]).sum(axis=1) for i, j in ((a, b), (b, a))]
        for key in PAIRED:
            difference = values[key][:, a] - values[key][:, b]
            parts = [(ALL, _mean_over_scenarios(difference), [each.sum() for each in alone])]
            parts += [(s, difference[i], [each[i] for each in alone]) for i, s in enumerate(scenarios)]
            rows += [
                PairRow(scenario, key, names[a], names[b], *_interval(part, level), int(own), int(other))
                for scenario, part, (own, other) in parts
            ]
    return rows


def _mean_over_scenarios(difference: Array) -> Array:
    count = np.isfinite(difference).sum(axis=0)
    return np.where(count > 0, np.nansum(difference, axis=0) / np.maximum(count, 1), np.nan)


def _interval(difference: Array, level: float) -> tuple[int, float | None, float | None, float | None]:
    """Number of pairs, mean, and the ends of its interval."""
    known = difference[np.isfinite(difference)]
    n = known.size
    if n < 2:
        return n, float(known[0]) if n else None, None, None
    mean = float(known.sum()) / n
    sd = math.sqrt(((known - mean) ** 2).sum() / (n - 1))
    half = float(stdtrit(n - 1, 0.5 + 0.5 * level)) * sd / math.sqrt(n)
    return n, mean, mean - half, mean + half
