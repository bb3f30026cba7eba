"""Spiking attitude controllers at inference: bounds, missing samples, the chip's integers, and files."""

import numpy as np
import pytest
from controllers import CONFIG, random_tensors, readings
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import create, names
from estimators.analysis.activity import record
from estimators.analysis.energy import host_costs
from estimators.control import SpikingController, create_controller
from estimators.control.controller import THRUST_MAX, follow
from estimators.networks.network import OnLoihi, silenced
from estimators.networks.weights_file import (
    NetworkConfig,
    expected_shapes,
    load_network,
    save_network,
    shipped_controllers,
    shipped_names,
)
from quadsim.vehicle import GRAVITY


@pytest.fixture
def file(tmp_path):
    save_network(tmp_path / "c.safetensors", CONFIG, random_tensors())
    return tmp_path / "c.safetensors"


def test_a_controller_has_nine_inputs_and_three_outputs():
    shapes = expected_shapes(CONFIG)
    assert shapes["w_in"] == (10, 9)
    assert shapes["w_out"] == (3, 12)


def test_a_file_returns_what_was_saved(file):
    config, tensors = load_network(file)
    assert config == CONFIG
    assert all(np.array_equal(tensors[name], value) for name, value in random_tensors().items())


def test_a_file_of_an_attitude_network_does_not_mention_set_points(tmp_path):
    config, tensors = load_network("att-snn-hummingbird")
    save_network(tmp_path / "a.safetensors", config, tensors)
    assert b"set_point" not in (tmp_path / "a.safetensors").read_bytes()


def test_samples_one_by_one_and_as_a_sequence_give_the_same_numbers(file):
    stream, batch = create_controller(file), create_controller(file)
    stream.reset(3)
    batch.reset(3)
    wanted, gyro, accel = readings(3, 80)
    wanted[1, 10:14], gyro[2, 20], accel[0, 5:9] = np.nan, np.nan, np.nan
    each = [stream.update(wanted[:, t], gyro[:, t], accel[:, t], np.zeros((3, 2))) for t in range(80)]
    whole = batch.sequence(wanted, gyro, accel)
    assert np.array_equal(np.stack(each, 1), whole)
    assert np.abs(whole[..., :3]).max() > 1.0


def test_a_vehicle_of_a_batch_flies_as_it_does_alone(file):
    batch, alone = create_controller(file), create_controller(file)
    batch.reset(4)
    alone.reset(1)
    signals = readings(4, 60)
    assert np.array_equal(batch.sequence(*signals)[2:3], alone.sequence(*(each[2:3] for each in signals)))


def test_the_emulated_chip_gives_the_same_outputs(file):
    plain, chip = create_controller(file), create_controller(f"{file}-loihi")
    for each in (plain, chip):
        each.reset(2)
    signals = readings(2, 200)
    assert np.array_equal(plain.sequence(*signals), chip.sequence(*signals))


def test_activity_on_the_chip_ends_with_the_outputs_of_the_controller(file):
    wanted, gyro, accel = readings(2, 40)
    core = OnLoihi(CONFIG, random_tensors())
    inputs = follow(CONFIG.set_point, wanted).inputs
    activity = record(core, gyro, accel, inputs)
    plain = create_controller(file)
    plain.reset(2)
    out = plain.sequence(wanted, gyro, accel)[..., :3]
    assert np.array_equal(np.clip(activity.estimate, -30.0, 30.0), out)


def test_the_host_multiplies_nine_inputs_for_each_encoding_neuron():
    assert [cost.multiplications for cost in host_costs(CONFIG)] == [9, 100]


def test_missing_samples_keep_the_last_valid_ones(file):
    signals = readings(1, 30)
    missing = [each.copy() for each in signals]
    repeated = [each.copy() for each in signals]
    for each, again in zip(missing, repeated, strict=True):
        each[:, 10:20] = np.nan
        again[:, 10:20] = again[:, 9:10]
    outputs = []
    for each in (missing, repeated):
        controller = create_controller(file)
        controller.reset(1)
        outputs.append(controller.sequence(*each))
    assert np.array_equal(*outputs)


def test_before_the_first_set_point_that_is_valid_the_vehicle_is_to_hover_level(file):
    controller = create_controller(file)
    nothing = controller.sequence(np.full((1, 5, 4), np.nan), *readings(1, 5)[1:])
    controller.reset(1)
    level = controller.sequence(np.tile([0.0, 0.0, 0.0, GRAVITY], (1, 5, 1)), *readings(1, 5)[1:])
    assert np.array_equal(nothing, level)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=10, max_size=10), st.integers(1, 20))
def test_outputs_are_bounded_whatever_comes_in(values, repeats):
    controller = SpikingController(CONFIG, random_tensors())
    controller.reset(1)
    wanted, gyro, accel = np.split(np.array(values)[None], (4, 7), axis=1)
    for _ in range(repeats):
        action = controller.update(wanted, gyro, accel)
    assert np.isfinite(action).all()
    assert np.abs(action[:, :3]).max() <= 30.0
    assert 0.0 <= action[0, 3] <= THRUST_MAX


def test_set_points_beyond_their_limits_act_as_those_at_the_limits(file):
    wanted, gyro, accel = readings(1, 40)
    far, edge = wanted.copy(), wanted.copy()
    far[..., :3], edge[..., :3] = (9.0, -9.0, 99.0), (1.05, -1.05, 3.0)
    outputs = []
    for each in (far, edge):
        controller = create_controller(file)
        controller.reset(1)
        outputs.append(controller.sequence(each, gyro, accel))
    assert np.array_equal(*outputs)


def test_a_restarted_vehicle_begins_anew_and_the_others_go_on(file):
    signals = readings(2, 40)
    continued, restarted, new = (create_controller(file) for _ in range(3))
    for each, n in ((continued, 2), (restarted, 2), (new, 1)):
        each.reset(n)
    for each in (continued, restarted):
        each.sequence(*signals)
    restarted.restart([0])
    out = restarted.sequence(*signals)
    assert np.array_equal(out[1], continued.sequence(*signals)[1])
    assert np.array_equal(out[:1], new.sequence(*(each[:1] for each in signals)))


def test_held_values_are_the_last_that_are_numbers():
    wanted = np.zeros((1, 5, 4))
    wanted[0, :, 1] = [0.1, np.nan, np.nan, 0.3, np.nan]
    assert follow(CONFIG.set_point, wanted).followed[0, :, 1].tolist() == [0.1, 0.1, 0.1, 0.3, 0.3]


def test_a_silenced_controller_asks_for_no_angular_acceleration():
    controller = SpikingController(CONFIG, silenced(CONFIG, random_tensors()))
    assert not controller.sequence(*readings(1, 30))[..., :3].any()


def test_an_attitude_network_is_refused_as_a_controller():
    with pytest.raises(ValueError, match=r"att-snn-hummingbird: an attitude estimator, not a controller"):
        create_controller("att-snn-hummingbird")


def test_a_controller_is_refused_as_an_attitude_estimator(file):
    with pytest.raises(ValueError, match="a controller, not an attitude estimator"):
        create(str(file))


def test_a_controller_at_another_sample_rate_is_refused(file):
    with pytest.raises(ValueError, match="weights are for 200 Hz, not for 500 Hz"):
        create_controller(file, 500.0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"outputs": "up"}, "angular-acceleration and set_point go together"),
        ({"set_point": None}, "angular-acceleration and set_point go together"),
        ({"model": "att-rnn"}, "a controller is a spiking network"),
    ],
)
def test_a_network_has_one_task(changes, reason):
    with pytest.raises(ValueError, match=reason):
        NetworkConfig(**(CONFIG.model_dump() | changes))


def test_samples_of_another_shape_are_refused(file):
    with pytest.raises(ValueError, match=r"should be \(1, T, 4\), \(1, T, 3\) and \(1, T, 3\)"):
        create_controller(file).update(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))


def test_controllers_that_ship_are_listed_apart_from_estimators():
    assert not set(shipped_controllers()) & {*shipped_names(), *names()}


@pytest.mark.parametrize("name", shipped_controllers())
def test_a_controller_that_ships_runs_alike_in_floats_and_on_the_emulated_chip(name):
    plain, chip = create_controller(name), create_controller(f"{name}-loihi")
    signals = readings(1, 300)
    assert np.array_equal(plain.sequence(*signals), chip.sequence(*signals))
