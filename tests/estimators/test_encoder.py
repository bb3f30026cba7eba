import numpy as np
import pytest
from controllers import samples
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estimators.networks.encoder import ENCODER, HOLD, INPUT_MAX, INPUT_ONE, scaled_inputs
from estimators.networks.weights_file import PAPER_SCALING, InputScaling
from estimators.sanitise import FORCE_MAX, RATE_MAX, RATE_STEP

SCALINGS = (InputScaling(), PAPER_SCALING)
READINGS = arrays(np.float64, (1, 8, 3), elements=st.floats(-1e6, 1e6) | st.just(np.nan) | st.just(np.inf))
GOOD = arrays(np.float64, (1, 1, 3), elements=st.floats(0.1, 20.0))


@pytest.mark.parametrize("inputs", SCALINGS)
def test_inputs_are_readings_less_the_offset_over_the_range_in_steps_of_a_1024th(inputs):
    gyro, accel = samples(3, 500)
    x = scaled_inputs(inputs, gyro, accel)
    exact = np.concatenate([gyro / inputs.gyro, (accel - inputs.accel_offset) / inputs.accel], axis=2)
    np.testing.assert_allclose(x, exact, atol=0.5 / INPUT_ONE + 1e-12)
    np.testing.assert_array_equal(x * INPUT_ONE, np.rint(x * INPUT_ONE))


def test_inputs_end_where_16_bits_do():
    gyro, accel = np.full((1, 1, 3), RATE_MAX), np.full((1, 1, 3), -FORCE_MAX)
    x = scaled_inputs(InputScaling(gyro=0.1, accel=(0.1, 0.1, 0.1)), gyro, accel) * INPUT_ONE
    np.testing.assert_array_equal(x[0, 0], [INPUT_MAX] * 3 + [-INPUT_MAX] * 3)


def test_the_last_good_sample_stands_for_a_missing_one_and_is_counted():
    gyro, accel = samples(1, 10)
    whole = scaled_inputs(InputScaling(), gyro, accel)
    gyro[0, 3, 1], gyro[0, 4], gyro[0, 5] = np.nan, 1e30, 1000.0
    accel[0, 6], accel[0, 7, 2], accel[0, 8] = 0.0, np.nan, -1000.0
    state = np.zeros(1, ENCODER)
    x = scaled_inputs(InputScaling(), gyro, accel, state)
    whole[0, 3:6, :3], whole[0, 6:9, 3:] = whole[0, 2, :3], whole[0, 5, 3:]
    np.testing.assert_array_equal(x, whole)
    assert state["missing"] == [6]


def test_a_rate_that_jumps_is_missing_until_it_has_lasted():
    gyro, accel = np.zeros((1, 60, 3)), np.ones((1, 60, 3))
    gyro[0, 25:27, 2] = RATE_STEP + 0.1
    gyro[0, 30:, 0] = RATE_STEP + 0.1
    gyro[0, :, 1] = np.linspace(0, RATE_STEP, 60)
    state = np.zeros(1, ENCODER)
    x = scaled_inputs(InputScaling(gyro=1.0), gyro, accel, state)[0]
    assert not x[:, 2].any()
    assert not x[:50, 0].any()
    assert (x[50:, 0] > RATE_STEP).all()
    np.testing.assert_array_equal(x[30:50, 1], x[29, 1])
    assert x[51, 1] > x[50, 1] > x[29, 1] > x[25, 1]
    assert state["missing"] == [22]


def test_a_steady_rate_beyond_the_range_of_the_integers_is_no_jump():
    gyro, accel = np.full((1, 60, 3), 13.5), np.ones((1, 60, 3))
    state = np.zeros(1, ENCODER)
    scaled_inputs(InputScaling(gyro=0.1), gyro, accel, state)
    assert state["missing"] == [0]


def test_a_rate_that_is_missing_for_long_is_zero():
    gyro, accel = np.ones((1, 60, 3)), np.ones((1, 60, 3))
    gyro[0, 5:58] = np.nan
    x = scaled_inputs(InputScaling(gyro=1.0), gyro, accel)[0, :, :3]
    assert (x[: 5 + HOLD] == 1).all()
    assert not x[5 + HOLD : 58].any()
    assert (x[58:] == 1).all()


def test_inputs_are_zero_before_the_first_good_sample():
    gyro, accel = np.full((1, 3, 3), np.nan), np.zeros((1, 3, 3))
    np.testing.assert_array_equal(scaled_inputs(PAPER_SCALING, gyro, accel), 0.0)


@given(READINGS, READINGS, GOOD, GOOD)
def test_after_a_gap_a_good_sample_gives_the_inputs_that_it_gives_a_new_encoder(
    gyro, accel, last_gyro, last_accel
):
    inputs, state, gap = InputScaling(), np.zeros(1, ENCODER), np.full((1, HOLD, 3), np.nan)
    scaled_inputs(inputs, gyro, accel, state)
    scaled_inputs(inputs, gap, gap, state)
    x = scaled_inputs(inputs, last_gyro, last_accel, state)
    np.testing.assert_array_equal(x, scaled_inputs(inputs, last_gyro, last_accel))


@given(st.integers(1, 39), st.integers(0, 100))
def test_windows_go_on_from_the_state_of_the_one_before(cut, seed):
    gyro, accel = samples(2, 40, seed)
    lost = np.random.default_rng(seed).random((2, 40)) < 0.3
    gyro[lost], accel[lost] = np.nan, 0.0
    whole, state = np.zeros(2, ENCODER), np.zeros(2, ENCODER)
    x = scaled_inputs(InputScaling(), gyro, accel, whole)
    parts = [
        scaled_inputs(InputScaling(), gyro[:, part], accel[:, part], state)
        for part in (slice(cut), slice(cut, None))
    ]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), x)
    np.testing.assert_array_equal(state, whole)
    np.testing.assert_array_equal(state["missing"], lost.sum(1))
