"""Training of spiking controllers: teacher, flights, rounds, networks on an estimator, runs that go on."""

import numpy as np
import pytest
import torch

from estimators.control import create_controller
from estimators.control.controller import SpikingController
from estimators.control.weights import load_controller
from estimators.networks.network import real_weights
from estimators.networks.weights_file import load_network
from quadsim.control.cascade import SET_POINT
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.rotation import quat_from_euler
from quadsim.seeding import child
from quadsim.vehicle import GRAVITY
from training.control import loop
from training.control.config import Excitation, make_control_config
from training.control.flights import (
    fly,
    joined,
    set_point_excitation,
    thrust_axis,
    thrust_axis_error,
    with_motion,
)
from training.control.loop import ControlTraining, read_flights, save_flights, train_controller, windows
from training.control.model import Frozen, estimator_of, initialise, new_model
from training.run_folder import spiking_tensors

TINY = {
    "estimator": "",
    "flights": 3,
    "flight_s": 1.0,
    "rounds": 1,
    "round_flights": 2,
    "validation_flights": 2,
    "learning": {"encoding": 16, "hidden": 18, "epochs": 2, "batches": 3, "batch_size": 4, "window_s": 0.2},
}
READS = {"estimator": "att-snn-hummingbird"}
"""A controller on an estimator's spikes."""


@pytest.fixture(scope="module")
def recipe():
    return flight_config(load_recipe("control"))


def seeds(n, key=0):
    return [child(np.random.SeedSequence(key), i) for i in range(n)]


def still(**changes):
    none = {"step_deg": 0, "chirp_deg": 0, "yaw_rate": 0, "pulse": 0, "noise": 0, "rotor_spread": 0}
    return Excitation(**(none | {"battery": 1.0, "start_tilt_deg": 0} | changes))


def test_the_teacher_flies_its_own_data_without_a_crash(recipe):
    flights = fly(make_control_config(flight_s=4.0), recipe, seeds(4))
    assert flights.crashes == 0
    assert flights.error_deg.max() < 15.0
    assert np.abs(flights.target).max() > 10.0


def test_a_flight_depends_on_its_own_seed_alone(recipe):
    config = make_control_config(**TINY)
    three, one = fly(config, recipe, seeds(3)), fly(config, recipe, seeds(3)[1:2])
    assert np.array_equal(three.target[1:2], one.target)


def test_the_teacher_integrates_against_a_constant_torque(recipe):
    config = make_control_config(flight_s=6.0, excitation=still(rotor_spread=0.1).model_dump())
    calm = recipe.model_copy(update={"wind": (), "trajectory": hover()})
    target = fly(config, calm, seeds(3)).target[:, 800:, :2]
    assert np.abs(target.mean(1)).max() > 0.3  # a trim that stays
    assert np.abs(target.mean(1)).max() > 3 * target.std(1).min()


def hover():
    from quadsim.trajectory.specs import Hover

    return Hover(position=(0.0, 0.0, 20.0))


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


def test_flights_of_two_rounds_are_aggregated(recipe, tmp_path):
    config = make_control_config(**TINY)
    training = ControlTraining(config, tmp_path)
    assert [len(each) for each in training.rounds] == [3]
    for _ in range(2):
        training.history.append(training.one_epoch())
    assert [len(each) for each in training.rounds] == [3, 2]
    assert len(joined(training.rounds)) == 5
    assert [epoch.round for epoch in training.history] == [0, 1]


def test_flights_survive_their_file(recipe, tmp_path):
    flights = fly(make_control_config(**TINY), recipe, seeds(2))
    save_flights(tmp_path / "f.npz", flights)
    again = read_flights(tmp_path / "f.npz")
    assert again.rate_hz == flights.rate_hz
    assert np.array_equal(again.target, flights.target)


def test_windows_follow_one_another_within_a_stream_and_a_flight(recipe):
    config = make_control_config(**TINY)
    flights = fly(config, recipe, seeds(3))
    found = windows(flights, config, np.random.SeedSequence(0), 4)
    before = next(found)
    assert before.reset.all()
    for _ in range(5):
        now = next(found)
        for i in np.flatnonzero(~now.reset):
            row, place = np.argwhere((flights.gyro == before.gyro[i, -1]).all(-1))[0]
            assert np.array_equal(flights.gyro[row, place + 1], now.gyro[i, 0])
        before = now


def test_a_shift_takes_targets_from_later_samples(recipe):
    plain, shifted = make_control_config(**TINY), make_control_config(**TINY, delay_shift=3)
    flights = fly(plain, recipe, seeds(3))
    window = next(windows(flights, shifted, np.random.SeedSequence(0), 4))
    row, place = np.argwhere((flights.gyro == window.gyro[0, 0]).all(-1))[0]
    assert np.array_equal(window.target[0, 0], flights.target[row, place + 3])


def test_an_estimator_in_front_keeps_its_weights_while_the_controller_learns(tmp_path):
    config = make_control_config(**TINY | READS)
    training = ControlTraining(config, tmp_path)
    training.one_epoch()
    network, tensors, _ = training.exported({})
    own, given = load_network("att-snn-hummingbird")
    ours, theirs = real_weights(network, tensors), real_weights(own, given)
    for name in ("syn0", "mem0", "syn1", "mem1", "syn_after", "w_after"):
        assert np.array_equal(getattr(ours, name)[:96], getattr(theirs, name)), name
    assert np.array_equal(ours.w_in[:96, :6], theirs.w_in)
    assert np.array_equal(ours.w_ff[:96, :96], theirs.w_ff)
    assert np.array_equal(ours.w_rec[:96, :96], theirs.w_rec)


def test_a_controller_on_an_estimator_has_connections_from_its_hidden_spikes_alone(tmp_path):
    config = make_control_config(**TINY | READS)
    tensors = ControlTraining(config, tmp_path).exported({})[1]
    assert not tensors["w_in"][:96, 6:].any()  # set-points do not reach the estimator
    assert not tensors["w_in"][96:, 3:6].any()  # nor the accelerometer the controller
    assert not tensors["w_ff"][:96, 96:].any()
    assert not tensors["w_ff"][96:, :96].any()
    assert not tensors["w_rec"][:96, 96:].any()
    assert tensors["w_rec"][96:, :96].any()
    assert not tensors["w_out"][:, :96].any()


def test_gradients_of_an_estimator_in_front_are_zero(tmp_path):
    config = make_control_config(**TINY | READS)
    training = ControlTraining(config, tmp_path)
    window = next(windows(training.rounds[0], config, np.random.SeedSequence(0), 4))
    out, _ = training.model(training._inputs(window))
    assert out.shape == (4, 40, 3)
    out.square().mean().backward()
    gradient = training.model.w_rec.grad
    assert gradient is not None
    assert not gradient[:96].any()
    assert gradient[96:].any()


def test_an_update_with_two_steps_a_sample_descends_the_error_of_what_the_chip_asks_for(tmp_path):
    learning = TINY["learning"] | {"steps_per_sample": 2, "huber_threshold": 0.0, "rate_cost": 0.0}
    training = ControlTraining(make_control_config(**TINY | {"learning": learning}), tmp_path)
    window = next(windows(training.rounds[0], training.config, np.random.SeedSequence(0), 4))
    weights = training.exported({})
    assert weights.config.steps_per_sample == 2
    chip = SpikingController(weights.config, weights.tensors, on_loihi=True)
    chip.reset(4)
    action = chip.sequence(window.set_point, window.gyro, window.accel)[..., :3]
    out = training.model(training._inputs(window))[0].detach()
    assert out.shape == (4, 80, 3)
    np.testing.assert_array_equal(out[:, 1::2], action)
    assert action.std() > 0.1
    error = (action - window.target) / np.array(training.config.error_scale)
    assert training._update(window)[0] == pytest.approx(1.5 * np.mean(error**2), rel=1e-5)
    assert 0 < training.one_epoch().imitation < np.inf


def test_a_linear_teacher_is_imitated_in_seconds():
    """Rate damping, a = -8 gyro: the loss falls below a fifth of the variance of the answer."""
    torch.manual_seed(0)
    config = make_control_config(learning={"encoding": 32, "hidden": 48}, output_scale=8.0)
    estimator = estimator_of(config)
    model = new_model(config, estimator)
    rng = np.random.default_rng(0)
    time = np.arange(300) / 200.0
    phase, frequency = rng.uniform(0, 6.28, (12, 1, 3)), rng.uniform(0.3, 1.5, (12, 1, 3))
    gyro = np.sin(6.28 * frequency * time[:, None] + phase)
    x = np.concatenate([gyro / 2.5, np.zeros((12, 300, 6))], 2)
    target = -8.0 * gyro
    initialise(model, estimator, x, target, 0)
    optimiser = torch.optim.Adam(model.parameters(), 0.02)
    inputs, wanted = torch.from_numpy(x), torch.from_numpy(target.astype(np.float32))
    for _ in range(150):
        optimiser.zero_grad()
        loss = (model(inputs)[0] - wanted)[:, 50:].square().mean()
        loss.backward()
        optimiser.step()
        model.constrain()
    assert float(loss.detach()) < 0.2 * float(wanted.var())


def test_a_run_that_was_stopped_ends_with_the_same_weights(tmp_path):
    whole = train_controller(tmp_path / "whole", **TINY)

    def stop(epoch, config):
        raise KeyboardInterrupt

    stopped = train_controller(tmp_path / "parts", progress=stop, **TINY)
    assert stopped.reason == loop.INTERRUPTED
    resumed = train_controller(tmp_path / "parts", **TINY)
    assert resumed.best.epoch == whole.best.epoch
    assert [e.name for e in sorted((tmp_path / "parts").iterdir())] == [
        e.name for e in sorted((tmp_path / "whole").iterdir())
    ]
    states = [torch.load(tmp_path / name / "checkpoint.pt")["model"] for name in ("whole", "parts")]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert whole.weights.read_bytes() == resumed.weights.read_bytes()


def test_what_a_run_writes_flies_as_a_controller(tmp_path):
    result = train_controller(tmp_path, **TINY)
    controller = create_controller(result.weights)
    controller.reset(2)
    action = controller.update(np.zeros((2, 4)), np.zeros((2, 3)), np.tile([0, 0, 9.81], (2, 1)))
    assert action.shape == (2, 4)
    config, _ = load_network(result.weights)
    assert config.training["estimator_neurons"] == [0, 0]


def test_a_run_continues_from_weights_of_a_controller(tmp_path):
    weights = train_controller(tmp_path / "first", **TINY).weights
    config = make_control_config(**TINY, init=str(weights))
    training = ControlTraining(config, tmp_path / "second")
    found, given = spiking_tensors(training.model, config.learning), load_network(weights)[1]
    assert all(np.array_equal(found[name], given[name]) for name in given if not name.startswith("exp"))


def test_another_runs_folder_is_refused(tmp_path):
    train_controller(tmp_path, **TINY)
    with pytest.raises(ValueError, match="another configuration, choose another folder"):
        train_controller(tmp_path, **TINY, seed=5)


@pytest.mark.parametrize(
    ("choices", "reason"),
    [
        ({"estimator": "att-rnn"}, "att-rnn is no Att-SNN"),
        ({"learning": {"quantised": False}}, "is trained quantised"),
        ({"learning": {"steps_per_sample": 2}}, "2, but the estimator runs a step for each sample"),
        ({"rounds": 60}, "should be at least the rounds"),
        ({"flight_s": 1.0}, "should be at most flight_s"),
        ({"flghts": 3}, 'did you mean "flights"'),
        ({"excitation": {"still": 2.0}}, "excitation.still"),
    ],
)
def test_bad_choices_are_refused_in_one_line(choices, reason):
    with pytest.raises(ValueError, match=reason) as error:
        make_control_config(**choices)
    assert "\n" not in str(error.value)


def test_epochs_are_dealt_to_rounds_in_order():
    config = make_control_config(**TINY | {"rounds": 2, "learning": TINY["learning"] | {"epochs": 6}})
    assert [config.round_of(epoch) for epoch in range(6)] == [0, 0, 1, 1, 2, 2]


def test_what_does_not_change_is_restored_after_a_constraint():
    config = make_control_config("separate", learning={"encoding": 12, "hidden": 12})
    estimator = estimator_of(config)
    model = new_model(config, estimator)
    frozen = Frozen(model, estimator)
    with torch.no_grad():
        model.w_rec += 1.0
    frozen.restore()
    assert not model.w_rec[:96].any()
    assert (model.w_rec[96:] == 1.0).all()


def test_a_controller_of_other_inputs_is_not_continued(tmp_path):
    first = train_controller(tmp_path / "a", **TINY)
    with pytest.raises(ValueError, match="has other reads, inputs than this training"):
        train_controller(tmp_path / "b", **TINY, reads="attitude", init=str(first.weights))
    faster = TINY | {"learning": TINY["learning"] | {"steps_per_sample": 2}}
    with pytest.raises(ValueError, match="has other steps_per_sample than this training"):
        train_controller(tmp_path / "c", **faster, init=str(first.weights))


def test_an_attitude_controller_is_trained_and_flies_on_its_attitude(recipe, tmp_path):
    result = train_controller(tmp_path, **TINY, reads="attitude")
    assert load_controller(result.weights).reads == "attitude"
    config = make_control_config(**TINY, reads="attitude")
    flights = fly(config, recipe, seeds(2), create_controller(result.weights))
    assert np.linalg.norm(flights.accel, axis=-1) == pytest.approx(GRAVITY, rel=1e-5)


def test_decays_are_shared_before_a_training_and_stay_so(tmp_path):
    first = train_controller(tmp_path / "a", **TINY, reads="attitude")
    more = {"init": str(first.weights), "decay_profiles": 6}
    learning = TINY["learning"] | {"fixed_taus": True}
    second = train_controller(tmp_path / "b", **TINY | {"learning": learning}, reads="attitude", **more)
    before, tensors = (
        load_controller(tmp_path / "b" / f"{n}.safetensors").tensors for n in ("begun", "best")
    )
    names = ("syn1", "mem1")
    assert all(np.array_equal(before[name], tensors[name]) for name in (*names, "mem0", "syn_after"))
    assert len(np.unique(np.stack([tensors[name] for name in names], 1), axis=0)) <= 6
    assert second.weights.is_file()
    with pytest.raises(ValueError, match="decay_profiles: give init"):
        make_control_config(**TINY, decay_profiles=6)
