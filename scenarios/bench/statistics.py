"""Statistics of benchmarks: robust means, intervals, profiles and tests.

What Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (NeurIPS 2021),
recommend: interquartile means with stratified bootstrap intervals, performance profiles, and the probability
of improvement. Strata are scenarios: their flights differ more between them than within.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

Array = NDArray[np.float64]
RESAMPLES = 1000


def interquartile_mean(values: Array) -> Array:
    """Mean of the middle half along the last axis."""
    return trim_mean(values, 0.25, axis=-1)


def stratified_interval(
    strata: Sequence[Array],
    statistic: Callable[[Array], Array],
    seed: int = 0,
    level: float = 0.95,
    resamples: int = RESAMPLES,
) -> tuple[float, float]:
    """Percentile bootstrap interval; values are drawn again within each stratum.

    Args:
        strata: Values of each stratum, (n,).
        statistic: Of all values together, along the last axis.
        seed: Of the draws.
        level: Of the interval.
        resamples: How many.
    """
    rng = np.random.default_rng(seed)
    drawn = [each[rng.integers(0, len(each), (resamples, len(each)))] for each in strata if len(each)]
    found = statistic(np.concatenate(drawn, axis=1))
    low, high = np.quantile(found, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def performance_profile(errors: Array, thresholds: Array) -> Array:
    """Share of flights whose error is at most each threshold; crashed flights have an infinite one."""
    return np.mean(np.ravel(errors)[:, None] <= thresholds, axis=0)


def probability_of_improvement(
    first: Sequence[Array], second: Sequence[Array], seed: int = 0
) -> tuple[float, float, float]:
    """Chance that a flight with the first estimator has a smaller error than one with the second.

    The mean over strata of P(X < Y) + P(X = Y) / 2, the Mann-Whitney statistic, with its 95 % bootstrap
    interval. Crashed flights have an infinite error.

    Args:
        first: Errors of the first estimator in each stratum, (n,).
        second: The same of the second.
        seed: Of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    whole, draws = [], []
    for x, y in zip(first, second, strict=True):
        better = (x[:, None] < y) + 0.5 * (x[:, None] == y)
        whole.append(better.mean())
        rows = rng.integers(0, len(x), (RESAMPLES, len(x)))
        columns = rng.integers(0, len(y), (RESAMPLES, len(y)))
        draws.append(better[rows[:, :, None], columns[:, None, :]].mean(axis=(1, 2)))
    low, high = np.quantile(np.mean(draws, axis=0), [0.025, 0.975])
    return float(np.mean(whole)), float(low), float(high)
