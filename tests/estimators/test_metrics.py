"""Error metrics against their definitions."""

import numpy as np
import pytest

from estimators.metrics import (
    Summary,
    absolute_error,
    attitude_error,
    inclination_error,
    inclination_rmse,
    share_without_number,
)
from quadsim.rotation import quat_conjugate, quat_multiply, quat_normalize, roll_pitch_from_quat


def random_quats(shape, seed):
    return quat_normalize(np.random.default_rng(seed).normal(size=(*shape, 4)))


def test_inclination_is_that_of_the_broad_benchmark():
    """2 arccos √(w² + z²) of the error quaternion in world axes (Laidig et al. 2021)."""
    estimate, truth = random_quats((3, 50), 1), random_quats((3, 50), 2)
    error = quat_multiply(estimate, quat_conjugate(truth))
    broad = 2.0 * np.arccos(np.clip(np.hypot(error[..., 0], error[..., 3]), 0.0, 1.0))
    ours = inclination_error(roll_pitch_from_quat(estimate), roll_pitch_from_quat(truth))
    np.testing.assert_allclose(ours, np.degrees(broad), atol=1e-6)


def test_small_inclinations_are_resolved():
    assert inclination_error([1e-9, 0.0], [0.0, 0.0]) == pytest.approx(np.degrees(1e-9), rel=1e-6)


def test_roll_wraps_around():
    np.testing.assert_allclose(absolute_error([np.pi - 0.01, 0.0], [-np.pi + 0.01, 0.0])[0], np.degrees(0.02))


def test_attitude_error_pools_roll_and_pitch_and_summarises_over_sequences():
    truth = np.zeros((3, 10, 2))
    estimate = np.radians(np.array([1.0, 2.0, 6.0]))[:, None, None] * np.array([1.0, -1.0])
    error = attitude_error(np.broadcast_to(estimate, truth.shape), truth)
    np.testing.assert_allclose(error.sequences, [1.0, 2.0, 6.0])
    assert (error.median, error.mean) == (pytest.approx(2.0), pytest.approx(3.0))
    assert error.sd == pytest.approx(np.std([1.0, 2.0, 6.0], ddof=1))


def test_samples_without_truth_are_not_scored():
    truth = np.zeros((1, 4, 2))
    truth[0, 2:] = np.nan
    estimate = np.radians([[[1.0, 1.0], [1.0, 1.0], [50.0, 50.0], [50.0, 50.0]]])
    assert attitude_error(estimate, truth).mean == pytest.approx(1.0)
    assert inclination_rmse(estimate, truth).mean == pytest.approx(np.sqrt(2.0), rel=1e-3)


def test_an_estimate_that_is_no_number_is_180_degrees_wrong():
    truth = np.radians([[[10.0, -20.0]] * 4])
    truth[0, 3] = np.nan
    estimate = np.zeros_like(truth)
    estimate[0, :2] = truth[0, :2]
    estimate[0, 2:] = np.nan, np.inf
    assert attitude_error(estimate, truth).mean == pytest.approx(60.0)
    np.testing.assert_allclose(inclination_error(estimate, truth)[0, :3], [0.0, 0.0, 180.0], atol=1e-6)
    assert np.isnan(inclination_error(estimate, truth)[0, 3])
    assert share_without_number(estimate, truth) == pytest.approx(1 / 3)


def test_bootstrap_interval_covers_the_mean_and_shrinks_with_more_sequences():
    rng = np.random.default_rng(0)
    widths = []
    for n in (10, 1000):
        sample = Summary(rng.normal(5.0, 1.0, n))
        low, high = sample.mean_interval()
        assert low < sample.mean < high
        widths.append(high - low)
    assert widths[1] == pytest.approx(2 * 1.96 / np.sqrt(1000), rel=0.1)
    assert widths[1] < widths[0]


def test_shapes_that_do_not_match_are_named():
    with pytest.raises(ValueError, match="must both have one shape"):
        attitude_error(np.zeros((1, 4, 2)), np.zeros((1, 5, 2)))
