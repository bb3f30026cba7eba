"""What the filter finds as it is fed to a network: by turns, beside gaps, and where a start is told."""

import numpy as np
import pytest
from drag_flight import DRAG, STEP, flight, tilt_of

from estimators.alignment import ACCEL_BIAS, BIAS
from estimators.encoder import ALIGNMENT, HEADING, HELD, INPUT_ONE, known_to, lean_found, scaled_inputs
from estimators.networks import NetworkEstimator, Spiking
from estimators.tilt import tilt_of as tilt_of_roll_pitch
from estimators.weights_file import InputScaling, shipped_network
from quadsim.vehicle import GRAVITY

INPUTS = InputScaling(align_s=0.6, align_drag=DRAG, align_noise=1e-4, yaw_free=True)


def test_a_bias_that_is_known_to_be_none_stays_none():
    gyro, accel, _, _ = flight(4000, 2, bias=(0.05, -0.03))
    held = np.zeros((1, HELD))
    scaled_inputs(INPUTS, 200.0, gyro[None], accel[None], held)
    np.testing.assert_array_equal(held[0, ALIGNMENT + BIAS :][:4], 0.0)


@pytest.mark.parametrize("yaw", [0.0, 1.5])
def test_the_network_is_told_by_a_turn_from_level(yaw):
    gyro, accel, _, tilt = flight(200, 5, (0.15, -0.25), yaw=yaw)
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    integral = STEP * np.cumsum(x[0, :, :2], axis=0) * INPUTS.gyro
    np.testing.assert_allclose(integral[120:] - tilt[120:], 0.0, atol=0.07)


def test_samples_that_are_missing_leave_a_gap_in_time_alone():
    gyro, accel, _, tilt = flight(200, 6, (0.15, -0.25))
    accel[20:40] = np.nan
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    integral = STEP * np.cumsum(x[0, :, :2], axis=0) * INPUTS.gyro
    np.testing.assert_allclose(integral[120:] - tilt[120:], 0.0, atol=0.07)


def test_it_ends_in_time_and_is_left_out_where_the_attitude_is_known():
    gyro, accel, _, _ = flight(200, 5, (0.15, -0.25))
    x, _ = scaled_inputs(INPUTS, 200.0, gyro[None], accel[None])
    plain, _ = scaled_inputs(INPUTS.model_copy(update={"align_s": 0.0}), 200.0, gyro[None], accel[None])
    differs = np.abs(x - plain)[0, :, :2].max(1) * INPUT_ONE > 0.5
    assert differs[2:100].any()
    assert not differs[120:].any()
    held = np.zeros((1, HELD))
    held[:, ALIGNMENT] = np.inf
    np.testing.assert_array_equal(scaled_inputs(INPUTS, 200.0, gyro[None], accel[None], held)[0], plain)


def test_a_start_that_is_told_is_known_to_the_filter_too():
    config, tensors = shipped_network("att-snn")
    est = NetworkEstimator(Spiking(config, tensors), 200.0)
    gyro, accel, _, tilt = flight(200, 7, (0.15, -0.25))
    est.reset(1, roll_pitch=tilt[:1])
    kept = est._states[0][0, ALIGNMENT:]
    assert kept[0] == np.inf
    np.testing.assert_allclose(tilt_of(kept), tilt[0], atol=0.02)
    est.sequence(gyro[None], accel[None])
    np.testing.assert_allclose(tilt_of(est._states[0][0, ALIGNMENT:]), tilt[-1], atol=0.03)


@pytest.mark.parametrize("told", [np.nan, np.inf])
def test_an_attitude_that_is_no_number_is_refused(told):
    est = NetworkEstimator(Spiking(*shipped_network("att-snn")), 200.0)
    with pytest.raises(ValueError, match="not finite"):
        est.reset(1, roll_pitch=[[told, 0.0]])


def test_the_lean_that_is_fed_is_that_of_the_filter_alone_and_near_the_truth():
    gyro, accel, _, tilt = flight(2000, 8, (0.1, -0.2), wind=(6.0, -3.0), yaw=0.5, climb=0.5)
    start = np.array([[np.arcsin(0.1 / np.sqrt(1 - 0.2**2)), np.arcsin(-0.2)]])
    found_alone = lean_found(INPUTS, 200.0, gyro[None], accel[None], start)[0]
    inclination = np.arccos(np.cos(found_alone[:, 0]) * np.cos(found_alone[:, 1]))
    np.testing.assert_allclose(inclination, np.arcsin(np.linalg.norm(tilt, axis=1)), atol=0.02)
    assert np.ptp(tilt) > 0.5
    x, heading = scaled_inputs(
        INPUTS.model_copy(update={"lean_fed": True}), 200.0, gyro[None], accel[None], known_to(start)
    )
    about_y, about_x = (-x[..., 3:5] * INPUTS.accel[:2] / GRAVITY * (1, -1))[0].T
    turned = tilt_of_roll_pitch(found_alone[None], heading)[0]
    np.testing.assert_allclose(np.stack([about_x, about_y], -1), turned, atol=2e-3)


def test_rates_that_are_fed_sum_up_to_the_lean_over_any_gap():
    gyro, accel, _, _ = flight(2000, 8, wind=(6.0, -3.0), yaw=0.5)
    gyro[700:720], accel[700:720], accel[1300:1310] = np.nan, 0.0, 0.0
    inputs = INPUTS.model_copy(update={"lean_fed": True})
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], known_to(np.zeros((1, 2))))
    summed = STEP * inputs.gyro * np.cumsum(x[0, :, :2], 0)
    about_y, about_x = (-x[..., 3:5] * inputs.accel[:2] / GRAVITY * (1, -1))[0].T
    off = np.abs(summed - np.stack([about_x, about_y], -1)).max(1)
    found = np.isfinite(gyro[:, 0]) & (accel[:, 2] > 0)
    assert off[found].max() < STEP * inputs.gyro / INPUT_ONE + 2 / INPUT_ONE / GRAVITY
    assert off[~found].max() > 0.01


def test_what_makes_up_for_a_gap_does_not_go_on_in_the_next():
    """Four of five samples are lost: what is fed in between goes on as the body turned."""
    gyro, accel, _, tilt = flight(4000, 8, roll=0.15)
    lost = np.random.default_rng(0).random(4000) < 0.8
    gyro[lost], accel[lost] = np.nan, np.nan
    inputs = INPUTS.model_copy(update={"lean_fed": True})
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], known_to(np.zeros((1, 2))))
    fed = np.sin(STEP * inputs.gyro * np.cumsum(x[0, :, :2], 0))
    assert np.sqrt(np.mean((fed - tilt) ** 2)) < np.radians(1.5)


def test_the_force_is_fed_freed_of_its_bias_where_the_lean_is_not():
    gyro, accel, _, _ = flight(400, 9, accel_bias=(0.2, -0.1))
    inputs = INPUTS.model_copy(update={"accel_bias_sd": 0.2, "yaw_free": False})
    held = known_to(np.zeros((1, 2)))
    x, _ = scaled_inputs(inputs, 200.0, gyro[None], accel[None], held)
    fed = x[0, -1, 3:5] * np.array(inputs.accel[:2])
    np.testing.assert_allclose(fed, accel[-1, :2] - held[0, ALIGNMENT + ACCEL_BIAS :][:2], atol=2e-3)


def test_a_lean_that_is_fed_is_looked_for_where_no_bias_is():
    gyro, accel, _, tilt = flight(400, 10, (0.1, -0.2))
    start = np.array([[np.arcsin(0.1 / np.sqrt(1 - 0.2**2)), np.arcsin(-0.2)]])
    alone = lean_found(InputScaling(align_drag=DRAG), 200.0, gyro[None], accel[None], start)[0, -1]
    np.testing.assert_allclose(np.sin(alone[1]), tilt[-1, 1], atol=0.02)


@pytest.mark.parametrize(
    ("gyro", "accel", "start", "match"),
    [
        ((2, 9, 3), (2, 8, 3), (2, 2), "one shape"),
        ((9, 3), (9, 3), (1, 2), "one shape"),
        ((2, 9, 3), (2, 9, 3), (1, 2), "shape"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(gyro, accel, start, match):
    with pytest.raises(ValueError, match=match):
        lean_found(INPUTS, 200.0, np.zeros(gyro), np.ones(accel), np.zeros(start))


def test_a_start_of_the_filter_alone_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        lean_found(INPUTS, 200.0, np.zeros((1, 9, 3)), np.ones((1, 9, 3)), [[np.nan, 0.0]])


def test_a_heading_that_drifts_is_no_bias_of_the_accelerometer():
    """A hover in a steady wind, and a gyroscope that is off about z by half a degree a second."""
    lean, bias = 0.16, 0.0087
    gyro = np.tile([0.0, 0.0, bias], (20000, 1))
    accel = np.tile([-GRAVITY * lean, 0.0, GRAVITY], (20000, 1))
    held = np.zeros((1, HELD))
    held[0, ALIGNMENT:] = known_to(np.array([[0.0, np.arcsin(lean)]]))[0, ALIGNMENT:]
    shaken = gyro + 0.02 * np.random.default_rng(0).standard_normal(gyro.shape)  # a rest it is not
    scaled_inputs(shipped_network("att-snn")[0].inputs, 200.0, shaken[None], accel[None], held)
    assert np.abs(held[0, ALIGNMENT + ACCEL_BIAS :][:2]).max() < 0.05
    assert abs(np.arctan2(held[0, HEADING + 1], held[0, HEADING])) < 0.06
