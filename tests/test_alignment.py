"""The tilt at an unknown start and the biases of both sensors, from drag and from rests."""

import numpy as np
import pytest
from drag_flight import ACCEL_SPREAD, BIAS_SPREAD, STEP, flight, found, tilt_of, variances
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.alignment import (
    ACCEL_BIAS,
    ACCEL_BIAS_MAX,
    BIAS,
    BIAS_MAX,
    GUST,
    LEAN,
    LEAN_MAX,
    REMEMBERED_S,
    REST_S,
    SPREAD,
    STATE,
    YAW_BIAS,
)
from quadsim.vehicle import GRAVITY


def test_most_of_a_tilt_at_the_start_is_found_in_a_second_in_nine_of_ten_winds():
    rng, found_most = np.random.default_rng(5), []
    for seed in range(100):
        start, wind = rng.uniform(-0.3, 0.3, 2), rng.uniform(-10, 10, 2)
        gyro, accel, heading, tilt = flight(200, seed, start, wind=wind)
        kept, _ = found(gyro, accel, heading, align_s=1.0)
        off = np.abs(tilt_of(kept) - tilt).max(1)
        found_most.append(off[-1] < 0.03 + 0.25 * np.linalg.norm(start))
    assert np.mean(found_most) >= 0.9


@settings(deadline=None)  # the first example waits for the compiler
@given(st.integers(0, 99), st.floats(-0.08, 0.08), st.floats(-0.08, 0.08), st.floats(-1, 1))
def test_a_gyroscopes_bias_is_found_in_calm_flight_within_seconds(seed, x, y, yaw):
    gyro, accel, heading, _ = flight(2400, seed, (0.1, -0.1), (x, y), yaw=yaw, roll=0.15)
    kept, _ = found(gyro, accel, heading, accel_spread=0.0)
    off = np.abs(kept[:, BIAS : BIAS + 2] - [x, y]).max(1)
    assert off[1200:].max() < np.radians(2.5)
    assert off[2399] < np.radians(1.7)


def test_a_gyroscopes_bias_is_found_in_fast_flight_too():
    """Up to 45° and 20 m/s, where the filter's guess that a vehicle stays about where it is is wrong."""
    rng, late, last = np.random.default_rng(1), [], []
    for seed in range(60):
        bias = rng.uniform(-0.08, 0.08, 2)
        gyro, accel, heading, _ = flight(2400, seed, (0.1, -0.1), bias, yaw=rng.uniform(-1, 1))
        kept, _ = found(gyro, accel, heading, accel_spread=0.0)
        off = np.abs(kept[:, BIAS : BIAS + 2] - bias).max(1)
        late.append(off[1200:].max())
        last.append(off[2399])
    assert np.quantile(late, 0.95) < np.radians(2.5)
    assert np.quantile(last, 0.95) < np.radians(1.7)


@pytest.mark.parametrize(("told", "most"), [(False, (1.2, 2.2)), (True, (1.3, 1.4))])
def test_both_biases_are_not_much_further_off_than_it_says(told, most):
    """Adrift in winds of 5 m/s of each axis, which an unknown lean is not told from at once."""
    rng, squares = np.random.default_rng(0), []
    for seed in range(60):
        bias, accel_bias = rng.normal(0, BIAS_SPREAD / 2, 2), rng.normal(0, ACCEL_SPREAD, 2)
        start, wind, yaw = rng.normal(0, 0.1, 2), rng.normal(0, 5, 2), rng.uniform(-1, 1)
        gyro, accel, heading, tilt = flight(2000, seed, start, bias, wind, yaw, 0.1, accel_bias)
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0] if told else None, align_s=1.0)
        errors = kept[400::400, BIAS : ACCEL_BIAS + 2].reshape(-1, 2, 2) - np.stack([bias, accel_bias])
        squares.append(np.sum(errors**2, -1) / (2 * variances(kept[400::400])[:, 2:4]))
    deviations = np.sqrt(np.mean(squares, 0))
    assert (deviations > 0.45).all()
    assert (deviations < most).all()


def test_a_start_that_is_told_tells_the_accelerometers_bias_in_any_steady_wind():
    rng, left = np.random.default_rng(1), []
    for seed in range(40):
        bias, wind = rng.uniform(-0.4, 0.4, 2), rng.uniform(-10, 10, 2)
        gyro, accel, heading, tilt = flight(
            4000, seed, (0.1, -0.05), (0.005, -0.003), wind, rng.uniform(-1, 1), accel_bias=bias
        )
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0])
        left.append(np.linalg.norm(kept[-1, ACCEL_BIAS:][:2] - bias) / np.linalg.norm(bias))
    assert np.median(left) < 0.25
    assert np.quantile(left, 0.9) < 0.6


def test_a_vehicle_told_to_start_level_is_at_rest_so_that_a_wind_is_known_to_blow_it_away():
    gyro, accel, heading, tilt = flight(200, wind=(8.0, -4.0), roll=0.0)
    speed = STEP * np.sum(accel[1:, :2], 0)  # level, so that nothing else drives it
    assert np.linalg.norm(speed) > 1.0
    kept, _ = found(gyro, accel, heading, told_tilt=tilt[0], accel_spread=0.0)
    np.testing.assert_allclose(kept[-1, STATE + 8 : SPREAD], speed, rtol=0.05)
    kept, _ = found(gyro, accel, heading, accel_spread=0.0)  # not told, it may have moved against the wind
    assert (np.abs(kept[-1, STATE + 8 : SPREAD]) < 0.9 * np.abs(speed)).all()


def test_a_gyroscopes_bias_about_z_is_found_where_the_vehicle_does_not_yaw_on_and_on():
    rng = np.random.default_rng(0)
    for bias in (-0.05, 0.01, 0.03):
        gyro, accel, heading, _ = flight(8000, 1)
        wobble = np.diff(0.02 * np.sin(np.linspace(0, 60, 8001)), prepend=0)[1:] / STEP
        gyro[:, 2] = bias + wobble + 0.01 * rng.standard_normal(8000)
        kept, _ = found(gyro, accel, heading)
        assert abs(kept[-1, YAW_BIAS] - bias) < 0.1 * abs(bias) + 0.002
    gyro[:, 2] = 1.0
    kept, _ = found(gyro, accel, heading)
    assert np.abs(kept[:, YAW_BIAS]).max() < 0.02


def test_at_rest_bias_and_tilt_are_found_whatever_the_drag():
    bias = np.radians([4.1, -1.2, -1.6])
    gyro, accel = np.tile(bias, (1600, 1)), np.tile([-GRAVITY * 0.2, GRAVITY * 0.1, GRAVITY], (1600, 1))
    for drag in (0.2, 0.4):
        kept, _ = found(gyro, accel, drag=drag, align_s=1.0)
        np.testing.assert_allclose(kept[300:, BIAS : BIAS + 2], np.tile(bias[:2], (1300, 1)), atol=0.004)
        np.testing.assert_allclose(tilt_of(kept)[-1], [0.1, 0.2], atol=0.02)


def test_a_hover_is_no_rest():
    gyro, accel, heading, _ = flight(2000, 1)
    kept, _ = found(0.1 * gyro, accel, heading)
    assert (kept[:, 2] < REST_S).all()


def test_a_bias_that_has_changed_is_learnt_anew():
    gyro, accel, heading, _ = flight(30000, 2, gust=0.1)
    gyro[10000:, 0] += 0.05
    kept, _ = found(gyro, accel, heading)
    assert abs(kept[9999, BIAS]) < 0.005
    assert abs(kept[-1, BIAS] - 0.05) < 0.01
    assert kept[-1, GUST] < 2 * kept[9999, GUST]  # and is no gust


def test_a_bias_that_jumps_is_found_again_within_seconds():
    left = []
    for seed in range(16):
        jump = np.radians(4.0) * np.array([np.cos(seed), np.sin(seed)])
        gyro, accel, heading, tilt = flight(4000, seed, roll=0.15)
        gyro[2000:, :2] += jump
        kept, _ = found(gyro, accel, heading, told_tilt=tilt[0])
        left.append(np.linalg.norm(kept[-1, BIAS : BIAS + 2] - jump) / np.linalg.norm(jump))
        assert np.abs(tilt_of(kept) - tilt).max() < np.radians(20)
    assert np.median(left) < 0.05
    assert max(left) < 0.5


@pytest.mark.parametrize("gust", [0.4, 0.8])
def test_the_random_walk_of_the_force_is_learnt_and_not_taken_for_less(gust):
    walks = [found(*flight(8000, seed, gust=gust)[:3])[0][2000:, GUST] for seed in range(6)]
    assert gust < np.sqrt(np.mean(walks)) < 2 * gust


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1e12, 1e12)] * 6), min_size=1, max_size=60),
    st.floats(1e-3, 10),
    st.floats(1e-3, 10),
)
def test_any_readings_leave_what_is_possible(readings, drag, noise):
    readings = np.array(readings)
    kept, told = found(readings[:, :3], readings[:, 3:], noise=noise, drag=drag)
    assert np.isfinite(kept).all()
    assert np.isfinite(told).all()
    assert np.abs(kept[:, BIAS : BIAS + 2]).max() <= BIAS_MAX
    assert np.abs(kept[:, LEAN : LEAN + 2]).max() <= LEAN_MAX
    assert np.abs(kept[:, ACCEL_BIAS : ACCEL_BIAS + 2]).max() <= ACCEL_BIAS_MAX
    assert (variances(kept) > 0).all()


def test_one_bad_reading_does_no_lasting_harm():
    gyro, accel, heading, _ = flight(3000, 3, (0.2, 0.1), gust=0.1)
    clean, _ = found(gyro, accel, heading)
    accel[1500, :2] = 1e6, -1e6
    kept, _ = found(gyro, accel, heading)
    np.testing.assert_allclose(tilt_of(kept)[-1], tilt_of(clean)[-1], atol=0.01)
    np.testing.assert_allclose(kept[-1, BIAS : BIAS + 2], 0.0, atol=0.01)


def test_what_a_bias_has_done_is_taken_back_as_far_as_it_is_remembered():
    gyro, accel, heading, _ = flight(2000, 4, bias=(0.07, -0.04), yaw=0.8)
    kept, told = found(gyro, accel, heading)
    rate = gyro[:, :2] - kept[:, BIAS : BIAS + 2] + told / STEP
    turn = np.exp(1j * heading)
    mine = whole = effect = 0.0
    for t in range(2000):
        left = 1 - STEP / REMEMBERED_S
        mine = left * mine + STEP * turn[t] * complex(*rate[t])
        whole = left * whole + STEP * turn[t] * complex(*gyro[t, :2])
        effect = left * effect + STEP * turn[t]
        # as if the bias that is now believed had been known all along
        assert mine == pytest.approx(whole - complex(*kept[t, BIAS : BIAS + 2]) * effect, abs=2e-4)
