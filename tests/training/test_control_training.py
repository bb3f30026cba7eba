"""Training of spiking controllers: teacher, flights, rounds, runs that go on."""

import numpy as np
import pytest
import torch

from estimators.control import create_controller
from estimators.control.controller import SpikingController
from estimators.networks.weights_file import load_network
from quadsim.control.records import SET_POINT
from quadsim.flight.recipe import load_recipe
from quadsim.seeding import child
from quadsim.trajectory.specs import Hover
from quadsim.vehicle import GRAVITY
from training.config import make_config
from training.control.excitation import STANDARD, Excitation, excite_set_points
from training.control.labelled_flights import fly_labelled
from training.control.task import ControlTask, control_windows
from training.data import network_inputs
from training.epochs import INTERRUPTED, Training, train
from training.init import initialise_controller
from training.models import AttSNN

TINY = {
    "preset": "control-attitude",
    "control": {"flights": 3, "flight_s": 1.0, "rounds": 1, "round_flights": 2, "validation_flights": 2},
    **{"encoding": 16, "hidden": 18, "epochs": 2, "batches": 3, "batch_size": 4, "window_s": 0.2},
}


def training_of(out, **choices):
    config = make_config(**choices)
    training = Training(config, ControlTask(config, out))
    training.begin()
    return training


def first_windows(flights, config):
    return control_windows(flights, config, 40, (0,))


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("control")


def seeds(n, key=0):
    return [child(np.random.SeedSequence(key), i) for i in range(n)]


STILL = Excitation(*np.zeros(len(Excitation._fields)))


@pytest.fixture(scope="module")
def calm(recipe):
    return recipe.model_copy(update={"wind": (), "trajectory": Hover(position=(0.0, 0.0, 20.0))})


def test_the_teacher_flies_its_own_data_without_a_crash(recipe):
    flights = fly_labelled(recipe, seeds(4), 4.0)
    assert flights["valid"].all()
    assert np.degrees(flights["error"]).std() < 15.0
    assert np.abs(flights["target"]).max() > 10.0


def test_a_flight_depends_on_its_own_seed_alone(recipe):
    three, one = fly_labelled(recipe, seeds(3), 1.0), fly_labelled(recipe, seeds(3)[1:2], 1.0)
    assert np.array_equal(three[1:2], one)


def test_the_teacher_observes_a_constant_torque_and_cancels_it(calm):
    flights = fly_labelled(calm, seeds(3), 6.0, excitation=STILL._replace(constant=5.0))
    still = fly_labelled(calm, seeds(3), 6.0, excitation=STILL)
    change = (flights["target"] - still["target"])[:, 800:].mean(axis=1)
    assert np.abs(change[:, :2]).max() > 1.0
    assert np.abs(change[:, 2]).max() <= 0.5 + 0.05
    assert np.degrees(flights["error"][:, 800:]).max() < 1.0


def test_who_flies_does_not_change_what_is_taught(calm):
    """A student that asks for nothing falls over, at which its flight ends; the teacher asks to right it."""

    class Idle:
        def reset(self, n):
            pass

        def update(self, set_point, gyro, accel, roll_pitch):
            return np.concatenate([np.zeros((len(gyro), 3)), set_point[:, 3:]], axis=1)

    flights = fly_labelled(calm, seeds(3), 6.0, Idle(), excitation=STILL._replace(constant=2.5))
    end = flights["valid"].sum(axis=1)
    assert (end < 1200).all()
    assert (np.diff(flights["valid"], axis=1) <= 0).all()
    last = flights[np.arange(3), end - 1]
    assert (np.abs(last["target"]).max(axis=1) > 50.0).all()
    assert last["accel"][:, 2] / GRAVITY == pytest.approx(np.cos(np.radians(80.0)), abs=0.1)
    put_back = flights["accel"][np.arange(3), end + 2, 2]
    assert put_back == pytest.approx(GRAVITY, rel=0.01)
    by_teacher = fly_labelled(calm, seeds(3), 6.0, Idle(), teacher_share=1.0, excitation=STILL)
    assert np.array_equal(by_teacher, fly_labelled(calm, seeds(3), 6.0, excitation=STILL))


def test_excitation_is_within_its_limits():
    target = np.zeros(8000, SET_POINT)
    excite_set_points(target, STANDARD, 1.0, 4.0, np.random.default_rng(0))
    tilts = target["velocity"] * 4.0 / GRAVITY, target["acceleration"] / GRAVITY
    for tilt, limit in zip(tilts, (20.0, 10.0), strict=True):
        assert 0.8 * limit < np.degrees(np.abs(tilt)).max() <= limit
        assert not tilt[:, 2].any()
        assert 0.05 < tilt.any(axis=1).mean() < 0.5
    assert 0.8 < np.abs(target["yaw_rate"]).max() <= 1.0


def test_the_set_points_of_flights_are_excited(calm):
    still = fly_labelled(calm, seeds(3), 4.0, excitation=STILL)["set_point"][..., :3]
    assert np.abs(still).max() < 1e-3
    for name, size, axis in (("step_deg", 10.0, 0), ("chirp_deg", 10.0, 1), ("yaw_rate", 1.0, 2)):
        excited = fly_labelled(calm, seeds(3), 4.0, excitation=STILL._replace(**{name: size}))["set_point"]
        assert np.abs(excited[..., axis]).max() > 0.01


def test_half_of_the_streams_begin_with_a_flight_and_each_has_the_target_of_its_readings(recipe):
    flights = fly_labelled(recipe, seeds(3), 1.0)
    batches = list(first_windows(flights, make_config(**TINY | {"batches": 6})))
    gyro, target = (np.concatenate([getattr(x, k)[x.reset, 0] for x in batches]) for k in ("gyro", "target"))
    found = (flights["gyro"][:, :, None] == gyro).all(-1)
    assert 0.2 < found[:, 0].any(0).mean() < 0.8
    row, place, stream = np.nonzero(found)
    assert set(stream) == set(range(len(gyro)))
    np.testing.assert_array_equal(flights["target"][row, place], target[stream])


def test_an_update_descends_the_error_of_what_the_chip_asks_for(tmp_path):
    changes = {"huber_threshold": 0.0, "rate_cost": 0.0}
    training = training_of(tmp_path, **TINY | changes)
    window = next(first_windows(training.task.rounds[0], training.config))
    network, tensors = training.exported()
    chip = SpikingController(network, tensors, on_loihi=True)
    chip.reset(4)
    action = chip.sequence(window.set_point, window.gyro, window.accel)[..., :3]
    out = training.model(network_inputs(training.config, window))[0].detach()
    np.testing.assert_array_equal(out, action)
    assert action.std() > 0.1
    error = (action - window.target) / np.array(training.task.scale)
    assert training._update(window)[0] == pytest.approx(1.5 * np.mean(error**2), rel=1e-5)
    assert training.one_epoch(0).validation["imitation"] > 0


def test_a_linear_teacher_is_imitated_in_seconds():
    """Rate damping, a = -8 gyro: the loss falls below a fifth of the variance of the answer."""
    torch.manual_seed(0)
    model = AttSNN(make_config(**TINY | {"encoding": 32, "hidden": 48}))
    rng = np.random.default_rng(0)
    time = np.arange(300) / 200.0
    phase, frequency = rng.uniform(0, 6.28, (12, 1, 3)), rng.uniform(0.3, 1.5, (12, 1, 3))
    gyro = np.sin(6.28 * frequency * time[:, None] + phase)
    x = np.concatenate([gyro / 2.5, np.zeros((12, 300, 6))], 2)
    target = -8.0 * gyro
    initialise_controller(model, x, target, 0)
    optimiser = torch.optim.Adam(model.parameters(), 0.02)
    inputs, wanted = torch.from_numpy(x), torch.from_numpy(target.astype(np.float32))
    for _ in range(150):
        optimiser.zero_grad()
        loss = (model(inputs)[0] - wanted)[:, 50:].square().mean()
        loss.backward()
        optimiser.step()
        model.constrain()
    assert float(loss.detach()) < 0.2 * float(wanted.var())


def test_a_run_that_was_stopped_ends_with_the_same_weights_which_fly(recipe, tmp_path):
    whole = train(out=tmp_path / "whole", **TINY)

    def stop(epoch, config):
        raise KeyboardInterrupt

    stopped = train(out=tmp_path / "parts", progress=stop, **TINY)
    assert stopped.reason == INTERRUPTED
    resumed = train(out=tmp_path / "parts", **TINY)
    assert resumed.best.epoch == whole.best.epoch
    names = [sorted(each.name for each in (tmp_path / name).iterdir()) for name in ("whole", "parts")]
    assert names[0] == names[1]
    rounds = [np.load(tmp_path / "whole" / f"round-{k}.npy") for k in (0, 1)]
    assert [len(each) for each in rounds] == [3, 2]
    config = make_config(**TINY | {"control": TINY["control"] | {"rounds": 2}, "epochs": 6})
    assert [config.round_of(epoch) for epoch in range(6)] == [0, 0, 1, 1, 2, 2]
    states = [torch.load(tmp_path / name / "checkpoint.pt")["model"] for name in ("whole", "parts")]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert whole.weights.read_bytes() == resumed.weights.read_bytes()
    with pytest.raises(ValueError, match="another configuration, choose another folder"):
        train(out=tmp_path / "whole", **TINY, seed=5)
    controller = create_controller(whole.weights)
    flights = fly_labelled(recipe, seeds(2), 1.0, controller)
    assert np.linalg.norm(flights["accel"], axis=-1) == pytest.approx(GRAVITY, rel=1e-5)
    assert load_network(whole.weights)[0].training["training_flights"] == (3, 5)[whole.best.epoch]


@pytest.mark.parametrize("size", [0, 1, 700])
def test_damaged_flights_of_a_round_are_named(tmp_path, recipe, size):
    file = tmp_path / "round-0.npy"
    np.save(file, fly_labelled(recipe, seeds(1), 0.5))
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"round-0\.npy: damaged, choose another folder"):
        training_of(tmp_path, **TINY)
