"""Robust means, intervals, profiles and tests of benchmarks."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from scenarios.bench.statistics import (
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
    stratified_interval,
)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    assert interquartile_mean(np.array([100.0, 1.0, 2.0, 3.0, 4.0, -50.0, 2.5, 3.5])) == pytest.approx(2.75)
    assert interquartile_mean(np.arange(12.0).reshape(3, 4)).tolist() == [1.5, 5.5, 9.5]


def test_a_stratified_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = 0
    for trial in range(200):
        strata = [rng.normal(mean, 1.0, 20) for mean in (0.0, 10.0, 20.0)]
        low, high = stratified_interval(strata, lambda x: x.mean(axis=-1), seed=trial, resamples=300)
        covered += low <= 10.0 <= high
    assert 0.88 <= covered / 200 <= 0.99


def test_strata_do_not_widen_the_interval():
    """Resampling all values together would widen it by the spread between the strata."""
    strata = [np.full(10, mean) for mean in (0.0, 10.0, 20.0)]
    assert stratified_interval(strata, interquartile_mean) == (10.0, 10.0)


def test_a_performance_profile_counts_crashes_as_never():
    shares = performance_profile(np.array([0.5, 1.0, 2.0, np.inf]), np.array([0.1, 1.0, 3.0, 1e9]))
    assert shares.tolist() == [0.0, 0.5, 0.75, 0.75]


def test_the_probability_of_improvement_is_the_mann_whitney_statistic():
    rng = np.random.default_rng(1)
    x, y = rng.normal(0, 1, 40), rng.normal(1, 1, 50)
    found, low, high = probability_of_improvement([x], [y])
    assert found == pytest.approx(1 - mannwhitneyu(x, y).statistic / (40 * 50))
    assert low < found < high
    assert low > 0.5
    same, *_ = probability_of_improvement([x, y], [x, y])
    assert same == pytest.approx(0.5)
    assert probability_of_improvement([np.array([1.0, np.inf])], [np.array([2.0, np.inf])])[0] == 0.625


def test_the_interval_of_an_improvement_is_as_wide_as_its_standard_error_says():
    """Of the Mann-Whitney statistic: variances of each flight's share of wins (DeLong et al. 1988)."""
    rng = np.random.default_rng(2)
    x, y = rng.normal(0, 1, 60), rng.normal(0.5, 1, 40)
    wins = x[:, None] < y
    error = np.sqrt(wins.mean(1).var(ddof=1) / 60 + wins.mean(0).var(ddof=1) / 40)
    found, low, high = probability_of_improvement([x], [y])
    assert (high - low) / (2 * 1.96) == pytest.approx(error, rel=0.1)
    assert (low + high) / 2 == pytest.approx(found, abs=0.2 * error)
