"""Spiking attitude controllers at inference: bounds, missing samples, the chip's integers, and files."""

import numpy as np
import pytest
from controllers import CONFIG, random_snn, readings
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimators import create, names
from estimators.control import SpikingController, create_controller
from estimators.control.controller import THRUST_MAX, follow, gravity_of
from estimators.networks.network import silenced
from estimators.networks.weights_file import NetworkConfig, save_network, shipped_controllers, shipped_names
from quadsim.vehicle import GRAVITY


@pytest.fixture
def file(tmp_path):
    save_network(tmp_path / "c.safetensors", CONFIG, random_snn(CONFIG))
    return tmp_path / "c.safetensors"


def stream(controller, wanted, gyro, accel, roll_pitch):
    controller.reset(len(gyro))
    samples = (each.swapaxes(0, 1) for each in (wanted, gyro, accel, roll_pitch))
    return np.stack([controller.update(*each) for each in zip(*samples, strict=True)], 1)


def test_samples_one_by_one_as_a_sequence_alone_and_on_the_chip_give_the_same_numbers(file):
    wanted, gyro, accel = readings(4, 150)
    roll_pitch = np.random.default_rng(3).normal(size=(4, 150, 2)) * 0.3
    wanted[1, 10:14], gyro[2, 20], accel[0, 5:9], roll_pitch[3, 7] = np.nan, np.nan, np.nan, np.nan
    batch, alone, chip = create_controller(file), create_controller(file), create_controller(f"{file}-loihi")
    batch.reset(4)
    read = gravity_of(roll_pitch)
    whole = batch.sequence(wanted, gyro, read)
    assert np.abs(whole[..., :3]).max() > 1.0
    for controller in (batch, chip):
        assert np.array_equal(stream(controller, wanted, gyro, accel, roll_pitch), whole)
    third = slice(2, 3)
    assert np.array_equal(alone.sequence(wanted[third], gyro[third], read[third]), whole[third])


def test_an_attitude_stands_for_the_accelerometer(file):
    wanted, gyro, accel = readings(2, 60)
    roll_pitch = np.random.default_rng(3).normal(size=(2, 60, 2)) * 0.3
    controller = create_controller(file)
    out = stream(controller, wanted, gyro, np.full_like(accel, np.nan), roll_pitch)
    assert np.array_equal(out, stream(controller, wanted, gyro, accel, roll_pitch))
    assert not np.array_equal(out, stream(controller, wanted, gyro, accel, 0.0 * roll_pitch))
    wanted, gyro, accel = (np.zeros((1, k)) for k in (4, 3, 3))
    controller.reset(1)
    for shape in ((1, 1), (1, 3), (2, 2), (2,)):
        with pytest.raises(ValueError, match=r"roll_pitch: shape .*, should be \(1, 2\)"):
            controller.update(wanted, gyro, accel, np.zeros(shape))
    with pytest.raises(ValueError, match="roll_pitch: shape"):
        gravity_of(np.zeros((4, 3)))


@given(roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5))
@settings(max_examples=50, deadline=None)
def test_gravity_of_an_attitude_is_the_specific_force_at_rest(roll, pitch):
    wanted = Rotation.from_euler("ZYX", [0.7, pitch, roll]).inv().apply([0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(gravity_of([roll, pitch]), wanted, atol=1e-12)


def outputs_of(*signals):
    return SpikingController(CONFIG, random_snn(CONFIG)).sequence(*signals)


def test_missing_samples_keep_the_last_valid_ones():
    missing, repeated = ([each.copy() for each in readings(1, 30)] for _ in range(2))
    for each, again in zip(missing, repeated, strict=True):
        each[:, 10:20] = np.nan
        again[:, 10:20] = again[:, 9:10]
    assert np.array_equal(outputs_of(*missing), outputs_of(*repeated))
    wanted = np.zeros((1, 5, 4))
    wanted[0, :, 1] = [0.1, np.nan, np.nan, 0.3, np.nan]
    assert follow(CONFIG.set_point, wanted).followed[0, :, 1].tolist() == [0.1, 0.1, 0.1, 0.3, 0.3]


def test_before_the_first_set_point_that_is_valid_the_vehicle_is_to_hover_level():
    measured = readings(1, 5)[1:]
    level = np.tile([0.0, 0.0, 0.0, GRAVITY], (1, 5, 1))
    assert np.array_equal(outputs_of(np.nan * level, *measured), outputs_of(level, *measured))


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=10, max_size=10), st.integers(1, 20))
def test_outputs_are_bounded_whatever_comes_in(values, repeats):
    controller = SpikingController(CONFIG, random_snn(CONFIG))
    controller.reset(1)
    wanted, gyro, accel = np.split(np.array(values)[None], (4, 7), axis=1)
    for _ in range(repeats):
        action = controller.sequence(wanted[None], gyro[None], accel[None])[0]
    assert np.isfinite(action).all()
    assert np.abs(action[:, :3]).max() <= 30.0
    assert 0.0 <= action[0, 3] <= THRUST_MAX


def test_set_points_beyond_their_limits_act_as_those_at_the_limits():
    wanted, gyro, accel = readings(1, 40)
    far, edge = wanted.copy(), wanted.copy()
    far[..., :3], edge[..., :3] = (9.0, -9.0, 99.0), (1.05, -1.05, 3.0)
    assert np.array_equal(outputs_of(far, gyro, accel), outputs_of(edge, gyro, accel))


def test_a_restarted_vehicle_begins_anew_and_the_others_go_on():
    signals = readings(2, 40)
    continued, restarted, new = (SpikingController(CONFIG, random_snn(CONFIG)) for _ in range(3))
    for each in (continued, restarted):
        each.reset(2)
        each.sequence(*signals)
    restarted.restart([0])
    out = restarted.sequence(*signals)
    assert np.array_equal(out[1], continued.sequence(*signals)[1])
    assert np.array_equal(out[:1], new.sequence(*(each[:1] for each in signals)))


def test_a_silenced_controller_asks_for_no_angular_acceleration():
    controller = SpikingController(CONFIG, silenced(CONFIG, random_snn(CONFIG)))
    assert not controller.sequence(*readings(1, 30))[..., :3].any()


def test_weights_for_another_task_or_sample_rate_and_samples_of_another_shape_are_refused(file):
    with pytest.raises(ValueError, match=r"att-snn-paper: an attitude estimator, not a controller"):
        create_controller("att-snn-paper")
    with pytest.raises(ValueError, match="a controller, not an attitude estimator"):
        create(str(file))
    with pytest.raises(ValueError, match="weights are for 200 Hz, not for 500 Hz"):
        create_controller(file, 500.0)
    with pytest.raises(ValueError, match=r"set_point: shape \(1, 1, 3\), should be \(1, 1, 4\)"):
        SpikingController(CONFIG, random_snn(CONFIG)).sequence(*np.zeros((3, 1, 1, 3)))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"outputs": "roll-pitch"}, "angular-acceleration and set_point go together"),
        ({"set_point": None}, "angular-acceleration and set_point go together"),
        ({"model": "att-rnn"}, "a controller is a spiking network"),
    ],
)
def test_a_network_has_one_task(changes, reason):
    with pytest.raises(ValueError, match=reason):
        NetworkConfig(**(CONFIG.model_dump() | changes))


def test_controllers_that_ship_are_listed_apart_from_estimators():
    assert not set(shipped_controllers()) & {*shipped_names(), *names()}
