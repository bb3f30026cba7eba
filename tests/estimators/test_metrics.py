"""Error metrics against their definitions."""

import numpy as np
import pytest

from estimators.metrics import (
    RANGE,
    Summary,
    absolute_error,
    attitude_error,
    flaw_of,
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
    estimate = truth.copy()
    estimate[0, 2:] = np.nan, np.inf
    assert attitude_error(estimate, truth).mean == pytest.approx(60.0)
    np.testing.assert_allclose(inclination_error(estimate, truth)[0, :3], [0.0, 0.0, 180.0], atol=1e-6)
    assert np.isnan(inclination_error(estimate, truth)[0, 3])
    assert share_without_number(estimate, truth) == pytest.approx(1 / 3)


@pytest.mark.parametrize("size", [101.0, 1e16, 3e16, 1e18, 1e20, 1e300, -1e20])
def test_an_estimate_beyond_the_range_of_angles_is_180_degrees_wrong(size):
    truth = np.radians([[[10.0, -20.0]] * 4])
    estimate = np.full_like(truth, size)
    np.testing.assert_allclose(absolute_error(estimate, truth), 180.0)
    np.testing.assert_allclose(inclination_error(estimate, truth), 180.0)
    assert share_without_number(estimate, truth) == 1.0


def test_a_filter_that_counts_turns_is_scored_modulo_a_turn():
    turns = 2.0 * np.pi * np.arange(-15, 16)[:, None] * np.ones(2)
    assert np.abs(turns).max() < RANGE
    np.testing.assert_allclose(absolute_error(turns, np.zeros_like(turns)), 0.0, atol=1e-10)


def moving(n=2, samples=100):
    """True roll and pitch of vehicles that swing, (n, samples, 2) [rad]."""
    time, phase = np.arange(samples) / 200.0, np.arange(n)[:, None]
    return np.stack([0.3 * np.sin(3.0 * time + phase), 0.2 * np.cos(2.0 * time + 0 * phase)], axis=-1)


NO_NUMBER = "returned roll or pitch that is not a finite number in"


def spoiled(value, part):
    estimate = moving() + 0.01
    estimate[part] = value
    return estimate


@pytest.mark.parametrize(
    ("estimate", "flaw"),
    [
        (spoiled(0.0, (0, slice(3), 0)), ""),
        (spoiled(0.1, 0), ""),
        (spoiled(np.nan, (0, slice(24), 1)), f"{NO_NUMBER} 12.0 % of the samples"),
        (spoiled(np.inf, (0, 0, 0)), f"{NO_NUMBER} 0.5 % of the samples"),
        (spoiled(1e20, (1, slice(6), 0)), "returned angles beyond ±100 rad in 3.0 % of the samples"),
        (spoiled(np.array([0.1, 0.0]), slice(None)), "returned the same roll and pitch at every sample"),
    ],
)
def test_flaws_of_estimates_are_named(estimate, flaw):
    assert flaw_of(estimate, moving()) == flaw
    assert flaw_of(estimate.reshape(-1, 2), moving().reshape(-1, 2)) == flaw


def test_a_flaw_in_few_samples_is_not_rounded_to_none():
    estimate = np.zeros((2000, 2))
    estimate[7] = np.nan
    assert "in less than 0.1 % of the samples" in flaw_of(estimate, moving(1, 2000)[0])


def test_a_constant_is_a_flaw_only_where_the_truth_moves():
    still = np.zeros((2, 100, 2))
    assert flaw_of(still, still) == ""
    assert flaw_of(still[:, :1], moving()[:, :1]) == ""
    assert flaw_of(np.stack([still[0], moving()[1]]), moving()) == ""
    assert flaw_of(np.stack([still[0], still[1] + 0.1]), moving())


def test_samples_without_truth_show_no_flaw():
    truth, estimate = moving(), moving() + 0.01
    truth[:, :50], estimate[:, :50] = np.nan, np.nan
    assert flaw_of(estimate, truth) == ""
    estimate[:, 50:] = 0.0
    assert flaw_of(estimate, truth) == "returned the same roll and pitch at every sample"
    assert flaw_of(estimate, np.full_like(truth, np.nan)) == ""


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
