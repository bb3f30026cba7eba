"""Paired differences: two estimators on the very same flights, so that wind and noise cancel.

Seed i of a scenario is the same start, wind, sensor noise and faults for every estimator. Where one of the
two crashed the pair says nothing about errors; it is counted apart.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from .cell import Row

Array = NDArray[np.float64]

PAIRED = ("error_deg", "attitude_deg", "position_m")
"""Metrics that are compared."""
ALL = "all"
"""Stands for all scenarios together."""


def paired_differences(flights: Sequence[Row], level: float = 0.95) -> list[Row]:
    """Every two estimators on the same seeds of each scenario, and of all together.

    The interval is Student's over seeds; for all scenarios a seed's difference is first averaged over them,
    for its flights share their sensor noise.

    Args:
        flights: One row per flight, as in `Results.flights`.
        level: Of the interval.

    Returns:
        Rows: scenario, metric, estimator, versus, pairs (seeds that count), difference (estimator minus
        versus), low, high, crashed_alone, versus_crashed_alone (flights that only one of them crashed).
    """
    scenarios, names, seeds = (
        list(dict.fromkeys(f[key] for f in flights)) for key in ("scenario", "estimator", "seed")
    )
    shape = len(scenarios), len(names), len(seeds)
    values, crashed = {key: np.full(shape, np.nan) for key in PAIRED}, np.zeros(shape, dtype=bool)
    for flight in flights:
        at = (
            scenarios.index(flight["scenario"]),
            names.index(flight["estimator"]),
            seeds.index(flight["seed"]),
        )
        crashed[at] = bool(flight["cause"])
        for key in PAIRED:
            value = flight[key]
            values[key][at] = np.nan if crashed[at] or value is None else float(value)
    rows: list[Row] = []
    for a, b in combinations(range(len(names)), 2):
        alone = [(crashed[:, i] & ~crashed[:, j]).sum(axis=1) for i, j in ((a, b), (b, a))]
        for key in PAIRED:
            difference = values[key][:, a] - values[key][:, b]
            parts = [(ALL, _mean_over_scenarios(difference), [each.sum() for each in alone])]
            parts += [(s, difference[i], [each[i] for each in alone]) for i, s in enumerate(scenarios)]
            for scenario, part, only in parts:
                head: Row = {"scenario": str(scenario), "metric": key}
                head |= {"estimator": str(names[a]), "versus": str(names[b])}
                crashes: Row = {"crashed_alone": int(only[0]), "versus_crashed_alone": int(only[1])}
                rows.append(head | _interval(part, level) | crashes)
    return rows


def _mean_over_scenarios(difference: Array) -> Array:
    count = np.isfinite(difference).sum(axis=0)
    return np.where(count > 0, np.nansum(difference, axis=0) / np.maximum(count, 1), np.nan)


def _interval(difference: Array, level: float) -> Row:
    kept = difference[np.isfinite(difference)]
    if not kept.size:
        return {"pairs": 0, "difference": None, "low": None, "high": None}
    mean = float(kept.mean())
    if kept.size == 1:
        return {"pairs": 1, "difference": mean, "low": None, "high": None}
    half = float(student.ppf(0.5 + 0.5 * level, kept.size - 1) * kept.std(ddof=1) / np.sqrt(kept.size))
    return {"pairs": int(kept.size), "difference": mean, "low": mean - half, "high": mean + half}
