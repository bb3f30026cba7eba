"""The tilt at an unknown start, from how the drag changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.alignment import GRAVITY, KEPT, TILT_MAX, align
from estimators.gyro_bias import TILT_VARIANCE
from estimators.networks import (
    ALIGNMENT,
    HELD,
    INPUT_ONE,
    NetworkEstimator,
    Spiking,
    scaled_inputs,
)
from estimators.weights_file import InputScaling, shipped_network

STEP, DRAG = 0.005, 0.25


def found(rates, forces, noise=1e-6, drag=DRAG):
    """The tilt at the start (T, 2) believed after each reading of (T, 2), and the sum of what is returned."""
    kept = np.zeros(KEPT)
    out, further = np.empty((len(rates), 2)), np.zeros(2)
    for t, (rate, force) in enumerate(zip(rates, forces, strict=True)):
        further += align(*rate, *force, STEP, drag, noise, kept)
        kept[0] += STEP
        out[t] = kept[-2:]
    return out, further


def flown(start, rates, wind=(0.0, 0.0)):
    """Lateral forces (T, 2) of a vehicle that drag slows, from its tilt (2,) at the start and turn (T, 2)."""
    velocity, turned, forces = np.zeros(2), np.zeros(2), np.empty_like(rates)
    for t, rate in enumerate(rates):
        turned += STEP * rate
        x, y = np.asarray(start) + turned
        forces[t] = -DRAG * (velocity - wind)
        velocity += STEP * (forces[t] + GRAVITY * np.array([y, -x]))
    return forces


def turning(steps, seed):
    """Rates (T, 2) of a tilt that wanders by a few tenths."""
    rng = np.random.default_rng(seed)
    hz, phase = rng.uniform(0.1, 1.0, (2, 2, 3)), rng.uniform(0, 2 * np.pi, (2, 3))
    return np.cos(2 * np.pi * hz[0] * STEP * np.arange(steps)[:, None, None] + phase).sum(-1) * 0.4


@settings(deadline=None)  # the first example waits for the compiler
@given(st.integers(0, 99), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-10, 10), st.floats(-10, 10))
def test_the_tilt_at_the_start_is_found_exactly_in_any_steady_wind(seed, x, y, wind_x, wind_y):
    rates = turning(40, seed)
    tilt, further = found(rates, flown((x, y), rates, (wind_x, wind_y)))
    np.testing.assert_allclose(tilt[5:], np.broadcast_to([x, y], (35, 2)), atol=2e-5)
    np.testing.assert_allclose(further, tilt[-1], atol=1e-12)


def test_at_rest_it_is_what_gravity_says_whatever_the_drag():
    forces = np.tile([-GRAVITY * 0.2, GRAVITY * 0.1], (40, 1))
    for drag in (0.1, 0.4):
        tilt, _ = found(np.zeros((40, 2)), forces, drag=drag)
        np.testing.assert_allclose(tilt[5:], np.tile([0.1, 0.2], (35, 1)), atol=2e-5)


def test_it_is_the_slope_by_least_squares_with_a_prior():
    rng = np.random.default_rng(0)
    rates, noise = turning(150, 1), 0.3
    forces = flown((0.2, -0.1), rates) + rng.normal(0, noise, (150, 2))
    turned = STEP * np.cumsum(rates, axis=0)
    drive = forces + GRAVITY * turned[:, ::-1] * [1, -1]
    left = forces + DRAG * STEP * (np.cumsum(drive, axis=0) - drive)
    time = STEP * np.arange(150)
    prior = [noise / TILT_VARIANCE**0.5, 0.0]
    design = np.vstack([np.stack([-DRAG * GRAVITY * time, np.ones(150)], -1), prior])
    about_y, minus_x = np.linalg.lstsq(design, np.vstack([left, [0, 0]]), rcond=None)[0][0]
    np.testing.assert_allclose(found(rates, forces, noise)[0][-1], [-minus_x, about_y], rtol=1e-9)


def test_noise_is_not_taken_for_a_tilt():
    rng = np.random.default_rng(0)
    tilts = [
        found(np.zeros((200, 2)), rng.normal(0, 0.25, (200, 2)), noise=0.25, drag=0.2)[0] for _ in range(20)
    ]
    spread = np.std(tilts, axis=(0, 2))
    assert spread.max() < TILT_VARIANCE**0.5  # never worse than to believe nothing
    assert spread[[0, 10]].max() < 0.03
    assert spread[-1] < 0.05


@settings(deadline=None)  # the first example waits for the compiler
@given(
    st.lists(st.tuples(*[st.floats(-1e12, 1e12)] * 4), min_size=1, max_size=40),
    st.floats(1e-3, 10),
    st.floats(1e-3, 10),
)
def test_any_readings_leave_a_tilt_that_is_possible(readings, drag, noise):
    readings = np.array(readings)
    tilt, _ = found(readings[:, :2], readings[:, 2:], noise, drag)
    assert np.isfinite(tilt).all()
    assert np.linalg.norm(tilt, axis=1).max() <= TILT_MAX * (1 + 1e-9)


def test_one_bad_reading_does_no_lasting_harm():
    rates = turning(200, 3)
    forces = flown((0.2, 0.1), rates)
    forces[100] = 1e6, -1e6
    np.testing.assert_allclose(found(rates, forces, noise=0.1)[0][-1], [0.2, 0.1], atol=0.1)


INPUTS = InputScaling(align_s=0.6, align_drag=DRAG, align_noise=1e-3, yaw_free=True)


def readings(start, yaw_rate=0.0):
    """Readings (1, T, 3) twice of such a flight, in a body that yaws."""
    rates = turning(200, 5)
    angle = yaw_rate * STEP * np.arange(1, 201)
    turn = np.exp(-1j * angle)
    gyro, accel = np.full((1, 200, 3), yaw_rate), np.full((1, 200, 3), GRAVITY)
    for out, lateral in ((gyro, rates), (accel, flown(start, rates))):
        body = (lateral[:, 0] + 1j * lateral[:, 1]) * turn
        out[0, :, 0], out[0, :, 1] = body.real, body.imag
    return gyro, accel, STEP * np.cumsum(rates, axis=0)


@pytest.mark.parametrize("yaw_rate", [0.0, 1.5])
def test_the_network_is_told_by_a_turn_from_level(yaw_rate):
    gyro, accel, turned = readings((0.15, -0.25), yaw_rate)
    x, _ = scaled_inputs(INPUTS, 200.0, gyro, accel)
    integral = STEP * np.cumsum(x[0, :, :2], axis=0) * INPUTS.gyro
    np.testing.assert_allclose(integral[60:] - turned[60:], np.tile([0.15, -0.25], (140, 1)), atol=5e-3)


def test_samples_that_are_missing_leave_a_gap_in_time_alone():
    calm = np.zeros((1, 200, 3))
    rest = np.tile([0.0, 0.0, GRAVITY], (1, 200, 1))
    rest[0, :, :2] = flown((0.15, -0.25), np.zeros((200, 2)))
    whole, _ = scaled_inputs(INPUTS, 200.0, calm, rest)
    rest[0, 20:40] = np.nan
    parts, _ = scaled_inputs(INPUTS, 200.0, calm, rest)
    told = [STEP * x[0, :, :2].sum(0) * INPUTS.gyro for x in (whole, parts)]
    np.testing.assert_allclose(told[0], [0.15, -0.25], atol=5e-3)
    np.testing.assert_allclose(told[1], [0.15, -0.25], atol=2e-2)


def test_it_ends_in_time_and_is_left_out_where_the_attitude_is_known():
    gyro, accel, _ = readings((0.15, -0.25))
    x, _ = scaled_inputs(INPUTS, 200.0, gyro, accel)
    plain, _ = scaled_inputs(INPUTS.model_copy(update={"align_s": 0.0}), 200.0, gyro, accel)
    differs = np.abs(x - plain)[0].max(1) * INPUT_ONE > 0.5
    assert differs[2:100].any()
    assert not differs[120:].any()
    held = np.zeros((1, HELD))
    held[:, ALIGNMENT] = np.inf
    np.testing.assert_array_equal(scaled_inputs(INPUTS, 200.0, gyro, accel, held)[0], plain)
    config, tensors = shipped_network("att-snn")
    est = NetworkEstimator(Spiking(config, tensors), 200.0)
    est.reset(1, roll_pitch=[[0.1, 0.0]])
    assert est._states[0][0, ALIGNMENT] == np.inf
