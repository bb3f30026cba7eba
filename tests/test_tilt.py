"""The attitude in axes that do not yaw."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimators.encoder import HELD, scaled_inputs
from estimators.networks import NetworkEstimator, OnLoihi, Recurrent, Spiking
from estimators.tilt import RATE_MAX, tilt_of, to_roll_pitch, yawed
from estimators.weights_file import InputScaling, shipped_network

ANGLE = st.floats(-1.5, 1.5)


def heading_of(angle):
    return np.stack([np.cos(angle), np.sin(angle)], -1)


@given(ANGLE, ANGLE, st.floats(-10.0, 10.0))
def test_tilt_is_the_rotation_vector_from_level_and_turns_as_a_vector(roll, pitch, yaw):
    up = Rotation.from_euler("ZYX", [0.3, pitch, roll]).inv().apply([0.0, 0.0, 1.0])
    up = Rotation.from_rotvec([0.0, 0.0, yaw]).apply(up)
    tilt = tilt_of(np.array([roll, pitch]), heading_of(yaw))
    back = Rotation.from_rotvec([*tilt, 0.0]).inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(back, up, atol=1e-9)


@given(ANGLE, ANGLE, st.floats(-10.0, 10.0))
def test_roll_and_pitch_come_back(roll, pitch, yaw):
    known = np.array([[[roll, pitch]]])
    heading = heading_of(np.array([[yaw]]))
    found = tilt_of(known, heading)
    to_roll_pitch(found, heading)
    np.testing.assert_allclose(found, known, atol=1e-9)


def test_heading_is_the_integral_of_the_yaw_rate_on_the_unit_circle():
    angle = 0.0
    cosine, sine = 1.0, 0.0
    for rate in np.random.default_rng(0).normal(0, 2, 20000):
        cosine, sine = yawed(cosine, sine, rate, 0.005)
        angle += 2 * np.arctan(rate * 0.005 / 2)
    np.testing.assert_allclose([cosine, sine], [np.cos(angle), np.sin(angle)], atol=1e-9)
    assert abs(np.hypot(cosine, sine) - 1.0) < 1e-15
    assert yawed(1.0, 0.0, 1e30, 0.005) == yawed(1.0, 0.0, RATE_MAX, 0.005)


def turning(rate_hz=200.0):
    """A constant tilt in space, seen from a body that turns about its z axis: readings and up, (1, T, 3)."""
    yaw = 1.3 * np.arange(400) / rate_hz
    turns = Rotation.from_euler("z", -yaw[:, None])
    gyro = np.zeros((1, 400, 3))
    gyro[0, 1:, 2] = 1.3
    force = turns.apply([0.4, -0.2, 9.7])[None]
    return gyro, force, turns


def test_a_force_that_stands_still_in_space_stands_still_in_the_inputs():
    gyro, force, _ = turning()
    x, heading = scaled_inputs(InputScaling(yaw_free=True), 200.0, gyro, force)
    np.testing.assert_allclose(x[0, :, 3:5], np.broadcast_to([0.4, -0.2], (400, 2)), atol=1e-3)
    np.testing.assert_allclose(
        np.arctan2(heading[0, -1, 1], heading[0, -1, 0]), 1.3 * 399 / 200 - 2 * np.pi * 0, atol=1e-4
    )
    x, heading = scaled_inputs(InputScaling(), 200.0, gyro, force)
    np.testing.assert_array_equal(heading[0], np.broadcast_to([1.0, 0.0], (400, 2)))


@pytest.mark.parametrize("name", ["att-snn", "att-rnn"])
def test_a_network_without_yaw_answers_a_turning_body_as_one_that_does_not_turn(name):
    config, tensors = shipped_network(name)
    inputs = {"yaw_free": True, "accel_bias_sd": 0.0}  # a bias would turn with the body
    config = config.model_copy(update={"inputs": config.inputs.model_copy(update=inputs)})
    if name == "att-snn":  # deaf to the yaw rate itself
        tensors = tensors | {"w_in": tensors["w_in"] * (np.arange(6) != 2).astype(np.int16)}
    else:
        tensors = tensors | {"gru.weight_ih_l0": tensors["gru.weight_ih_l0"] * (np.arange(6) != 2)}
    gyro, force, turns = turning()
    still = np.broadcast_to([0.4, -0.2, 9.7], force.shape)
    for core in (
        [Spiking(config, tensors), OnLoihi(config, tensors)]
        if name == "att-snn"
        else [Recurrent(config, tensors)]
    ):
        ups = []
        for readings in ((gyro, force), (0 * gyro, still)):
            est = NetworkEstimator(core, 200.0)
            roll, pitch = np.moveaxis(est.sequence(*readings)[0], -1, 0)
            ups.append(
                np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], -1)
            )
        np.testing.assert_allclose(turns.inv().apply(ups[0]), ups[1], atol=0.003)


def test_a_known_attitude_is_read_back_whatever_the_heading_was():
    config, tensors = shipped_network("att-snn")
    config = config.model_copy(update={"inputs": config.inputs.model_copy(update={"yaw_free": True})})
    gyro, force, _ = turning()
    known = np.array([[0.3, -0.5]])
    for core in (Spiking(config, tensors), OnLoihi(config, tensors)):
        est = NetworkEstimator(core, 200.0)
        est.sequence(gyro, force)
        est.restart([0], known)
        assert est._states[0].shape == (1, HELD)
        np.testing.assert_allclose(
            est.update(np.zeros((1, 3)), np.array([[0.0, 0.0, 9.81]])), known, atol=0.02
        )
