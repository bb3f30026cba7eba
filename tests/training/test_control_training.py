"""Training of spiking controllers: teacher, flights, rounds, runs that go on."""

import numpy as np
import pytest
import torch

from estimators.control import create_controller
from estimators.control.controller import SpikingController
from estimators.networks.weights_file import load_network
from quadsim.control.records import SET_POINT
from quadsim.flight.recipe import load_recipe
from quadsim.rotation import quat_from_euler
from quadsim.seeding import child
from quadsim.trajectory.specs import Hover
from quadsim.vehicle import GRAVITY
from training.config import ControlSettings, make_config
from training.control.excitation import Excitation, set_point_excitation
from training.control.labelled_flights import fly, thrust_axis, thrust_axis_error, with_motion
from training.control.task import ControlTask, read_flights, save_flights, windows
from training.data import network_inputs
from training.epochs import INTERRUPTED, Training, train
from training.init import initialise_controller
from training.models import AttSNN

TINY = {
    "preset": "control-attitude",
    "control": {"flights": 3, "flight_s": 1.0, "rounds": 1, "round_flights": 2, "validation_flights": 2},
    **{"encoding": 16, "hidden": 18, "epochs": 2, "batches": 3, "batch_size": 4, "window_s": 0.2},
}
SETTINGS = ControlSettings(**TINY["control"])


def training_of(out, **choices):
    config = make_config(**choices)
    training = Training(config, ControlTask(config, out))
    training.begin()
    return training


def first_windows(flights, config):
    return windows(flights, config, 40, np.random.SeedSequence(0), 4)


@pytest.fixture(scope="module")
def recipe():
    return load_recipe("control")


def seeds(n, key=0):
    return [child(np.random.SeedSequence(key), i) for i in range(n)]


def still(**changes):
    none = {"step_deg": 0, "chirp_deg": 0, "yaw_rate": 0, "pulse": 0, "noise": 0, "rotor_spread": 0}
    return Excitation(**(none | {"battery": 1.0, "start_tilt_deg": 0} | changes))


def test_the_teacher_flies_its_own_data_without_a_crash(recipe):
    flights = fly(ControlSettings(flight_s=4.0), recipe, seeds(4))
    assert flights.crashes == 0
    assert flights.error_deg.max() < 15.0
    assert np.abs(flights.target).max() > 10.0


def test_a_flight_depends_on_its_own_seed_alone(recipe):
    config = ControlSettings(flight_s=1.0)
    three, one = fly(config, recipe, seeds(3)), fly(config, recipe, seeds(3)[1:2])
    assert np.array_equal(three.target[1:2], one.target)


def test_the_teacher_integrates_against_a_constant_torque(recipe):
    calm = recipe.model_copy(update={"wind": (), "trajectory": Hover(position=(0.0, 0.0, 20.0))})
    added = still(rotor_spread=0.1)
    target = fly(ControlSettings(flight_s=6.0), calm, seeds(3), excitation=added).target[:, 800:, :2]
    assert np.abs(target.mean(1)).max() > 0.3  # a trim that stays
    assert np.abs(target.mean(1)).max() > 3 * target.std(1).min()


def test_excitation_is_within_its_limits():
    added = Excitation(step_deg=20.0, chirp_deg=10.0, yaw_rate=1.0, still=0.0)
    jumps, chirps = set_point_excitation(added, 4000, 200.0, np.random.default_rng(0))
    out = jumps + chirps
    assert np.abs(np.degrees(chirps)).max() <= 10.0
    assert np.abs(np.degrees(out[:, :2])).max() <= 20.0
    assert np.abs(out[:, 2]).max() <= 1.0
    assert (out != 0).any(1).mean() > 0.9


def test_a_chirp_is_fed_forward_as_motion_of_the_trajectory_is():
    targets, yaw = np.zeros(1, SET_POINT), np.array([0.7])
    added = np.array([[0.02, -0.05, 0.0]])
    turned = with_motion(targets, added, yaw)["acceleration"][0] + [0.0, 0.0, GRAVITY]
    wanted = thrust_axis(quat_from_euler(added[:, 0], added[:, 1], yaw))[0]
    assert turned / np.linalg.norm(turned) == pytest.approx(wanted, abs=1e-4)


def test_the_angle_between_thrust_axes_of_equal_attitudes_is_zero():
    quat = np.array([[np.cos(0.1), np.sin(0.1), 0.0, 0.0]])
    wanted = np.array([[0.2, 0.0, 0.0, 9.81]])
    assert thrust_axis_error(wanted, quat, np.zeros(1)) == pytest.approx(0.0, abs=1e-7)
    assert thrust_axis_error(0 * wanted, quat, np.zeros(1)) == pytest.approx(0.2)


def test_windows_follow_one_another_within_a_stream_and_a_flight(recipe):
    flights = fly(SETTINGS, recipe, seeds(3))
    before, *others = first_windows(flights, make_config(**TINY | {"batches": 6}))
    assert before.reset.all()
    for now in others:
        for i in np.flatnonzero(~now.reset):
            row, place = np.argwhere((flights.gyro == before.gyro[i, -1]).all(-1))[0]
            assert np.array_equal(flights.gyro[row, place + 1], now.gyro[i, 0])
            assert np.array_equal(flights.target[row, place + 1], now.target[i, 0])
        before = now


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
    rounds = [read_flights(tmp_path / "whole" / f"round-{k}.npz") for k in (0, 1)]
    assert [len(each) for each in rounds] == [3, 2]
    config = make_config(**TINY | {"control": TINY["control"] | {"rounds": 2}, "epochs": 6})
    assert [config.round_of(epoch) for epoch in range(6)] == [0, 0, 1, 1, 2, 2]
    states = [torch.load(tmp_path / name / "checkpoint.pt")["model"] for name in ("whole", "parts")]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert whole.weights.read_bytes() == resumed.weights.read_bytes()
    with pytest.raises(ValueError, match="another configuration, choose another folder"):
        train(out=tmp_path / "whole", **TINY, seed=5)
    controller = create_controller(whole.weights)
    flights = fly(SETTINGS, recipe, seeds(2), controller)
    assert np.linalg.norm(flights.accel, axis=-1) == pytest.approx(GRAVITY, rel=1e-5)
    assert load_network(whole.weights)[0].training["training_flights"] == 5


@pytest.mark.parametrize("size", [0, 1, 700])
def test_damaged_flights_of_a_round_are_named(tmp_path, size):
    file = tmp_path / "round-0.npz"
    save_flights(file, fly(SETTINGS, load_recipe("control"), [np.random.SeedSequence(0)]))
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"round-0\.npz: damaged, choose another folder"):
        read_flights(file)
