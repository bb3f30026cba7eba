import csv
import errno
import json
import os
from copy import deepcopy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from plain_network import Plain

from estimators.metrics import up_in_body
from estimators.networks.network import NetworkEstimator, OnLoihi, create_network
from estimators.networks.symmetry import is_symmetric
from estimators.networks.weights_file import EXPONENTS, load_network, parameters
from quadsim.cli.options import fields_of
from quadsim.config.toml import load_toml, preset_names
from quadsim.dataset.generation import generate
from quadsim.flight.mission import Mission
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.flight.scenario import load_scenario
from quadsim.imu import simulate_imu
from quadsim.imu.spec import ImuSpec
from quadsim.seeding import vehicle_seeds
from training import loop
from training.augment import Augmentation, augment
from training.config import Preset, TrainConfig, make_config
from training.data import flights_of, load_training_flights, network_inputs, split, windows
from training.fused import Fused
from training.init import (
    DEAD,
    initialise_from_data,
    initialise_from_weights,
    initialise_random,
    layer_spikes,
    reinitialise_dead_neurons,
)
from training.loop import train
from training.loss import finished, total_cost
from training.models import CURRENT_MAX, AttSNN, prune_connections
from training.run_folder import commit, exported

TINY = {
    "preset": "best", "epochs": 3, "batches": 4, "batch_size": 4, "window_s": 0.5, "windows_per_stream": 2,
    "encoding": 20, "hidden": 16,
}  # fmt: skip


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.zarr"
    config = flight_config(load_recipe("hummingbird"))
    return generate(config, flights=5, duration_s=4.0, out=path, seed=3, workers=1)


def weights_of(folder):
    return load_network(folder / "best.safetensors")[1]


def same(a, b):
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def killed_and_resumed(dataset, out, **choices):
    """A run that is killed in its second epoch and resumes."""

    def die(epoch, config):
        if epoch.epoch == 1:
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        train(data=dataset, out=out, progress=die, **choices)
    train(data=dataset, out=out, **choices)


def test_tiny_run_learns_and_leaves_its_files(dataset, tmp_path):
    rows = []
    result = train(
        data=dataset,
        out=tmp_path / "run",
        progress=lambda epoch, config: rows.append(epoch),
        **TINY
        | {"initialisation": "random", "epochs": 8, "batches": 40, "windows_per_stream": 6, "rate_cost": 0.0},
    )
    assert rows[-1].train_rmse_deg < 0.9 * rows[0].train_rmse_deg
    assert result.best.val_mse == min(row.val_mse for row in rows)
    with (tmp_path / "run" / "log.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 8
    assert (tmp_path / "run" / "curve.png").stat().st_size > 1000
    config, _ = load_network(result.weights)
    assert config.training["epoch"] == result.best.epoch + 1
    est = create_network("att-snn-loihi", weights=result.weights)
    assert est.update(np.zeros((1, 3)), np.array([[0.0, 0.0, 9.81]])).shape == (1, 2)


@pytest.mark.parametrize("outputs", ["roll-pitch", "up"])
@pytest.mark.parametrize("model", ["att-snn", "att-rnn"])
def test_a_killed_run_resumes_to_the_same_weights(dataset, tmp_path, model, outputs):
    choices = TINY | {"model": model, "hidden": 20, "outputs": outputs}
    train(data=dataset, out=tmp_path / "whole", **choices)

    killed_and_resumed(dataset, tmp_path / "cut", **choices)
    whole, cut = (torch.load(tmp_path / run / "checkpoint.pt", weights_only=True) for run in ("whole", "cut"))
    for name in whole["model"]:
        np.testing.assert_array_equal(whole["model"][name], cut["model"][name])
    same(weights_of(tmp_path / "whole"), weights_of(tmp_path / "cut"))


def test_a_run_on_up_is_judged_by_the_inclination_and_goes_on(dataset, tmp_path):
    rows = []
    more = {"outputs": "up", "batches": 30, "window_s": 1.0, "pruning_target": 600, "rate_cost": 0.0}
    more |= {"finest_exponent": -6, "after_spike": True}
    result = train(
        data=dataset, out=tmp_path / "run", progress=lambda row, config: rows.append(row), **TINY | more
    )
    for row in rows:
        assert row.val_mse == pytest.approx(np.radians(row.val_inclination_deg) ** 2 / 2)
    config, tensors = load_network(result.weights)
    assert (config.outputs, len(tensors["w_out"])) == ("up", 3)
    assert parameters(tensors) <= 600
    for name, exponents in EXPONENTS.items():  # the finest steps that hold the largest weight into a neuron
        largest = np.abs(tensors[name]).max(1)
        assert (largest[tensors[exponents] > -6] >= 127).all()
        assert tensors[exponents].min() < 0
    assert is_symmetric(tensors)
    est = create_network("att-snn-loihi", weights=result.weights)
    flights = load_training_flights([dataset])
    est.reset(len(flights))
    est.sequence(flights.gyro, flights.accel)
    assert est.up[:, 2].mean() > 0.3  # towards the unit vector, of zero at the start
    with pytest.raises(ValueError, match="outputs: the weights of init have up, it cannot be roll-pitch"):
        make_config("tune", data=str(dataset), init=str(result.weights), outputs="roll-pitch")
    on = train(data=dataset, out=tmp_path / "on", preset="tune", init=str(result.weights), epochs=1,
               batches=2, batch_size=4, window_s=0.5)  # fmt: skip
    assert load_network(on.weights)[0].outputs == "up"


def test_a_sensor_upside_down_is_within_the_range_of_the_outputs():
    config = make_config("best", data="none.zarr", encoding=24, hidden=24, outputs="up")
    model = AttSNN(24, 24, Fused(), config.output_scale, outputs="up")
    x = np.round(np.random.default_rng(0).normal(size=(2, 600, 6)).cumsum(1) * 20) / 1024
    initialise_from_data(model, x, np.broadcast_to([0.0, 0.0, -1.0], (2, 600, 3)), seed=0)
    up = model(torch.from_numpy(x))[0].detach().numpy()[:, 300:].mean((0, 1))
    np.testing.assert_allclose(up, [0.0, 0.0, -1.0], atol=0.2)


def test_targets_of_a_batch_are_one_attitude(dataset):
    config = make_config("best", data=str(dataset), **{k: v for k, v in TINY.items() if k != "preset"})
    batch = next(windows(load_training_flights([dataset]), config, 100, (0,)))
    np.testing.assert_allclose(np.linalg.norm(batch.up, axis=-1), 1.0, atol=1e-6)
    np.testing.assert_allclose(batch.up, up_in_body(batch.roll_pitch), atol=1e-6)


PRUNED = TINY | {"pruning_target": 300, "reinitialise_until": 0.25, "epochs": 4}


def test_a_pruned_run_reaches_its_target_and_resumes_to_the_same_weights(dataset, tmp_path):
    rows = []
    whole = train(
        data=dataset, out=tmp_path / "whole", progress=lambda epoch, config: rows.append(epoch), **PRUNED
    )
    counts = [row.parameters for row in rows]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 700
    assert counts[-2] <= 300
    assert whole.best.parameters <= 300  # whatever the loss of an earlier, larger network was
    config, tensors = load_network(whole.weights)
    assert parameters(tensors) <= 300
    assert (config.encoding, config.hidden) == (len(tensors["w_in"]), len(tensors["w_ff"]))
    assert is_symmetric(tensors)

    killed_and_resumed(dataset, tmp_path / "cut", **PRUNED)
    same(tensors, weights_of(tmp_path / "cut"))


def test_a_run_does_not_stop_early_before_it_is_pruned_to_its_target(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "finished", lambda losses: "enough" if losses else None)
    result = train(data=dataset, out=tmp_path / "run", **PRUNED | {"stop_early": True})
    assert result.reason == "enough"
    assert result.best.parameters <= 300


def test_a_run_from_a_pruned_network_adds_no_connections(dataset, tmp_path):
    first = train(data=dataset, out=tmp_path / "first", **PRUNED)
    before = weights_of(tmp_path / "first")
    on = {k: v for k, v in TINY.items() if k not in ("encoding", "hidden")} | {"pruning_target": 300}
    train(data=dataset, out=tmp_path / "on", init=str(first.weights), optimiser_lr=0.3, **on)
    state = torch.load(tmp_path / "on" / "checkpoint.pt", weights_only=True)["model"]
    assert state["w_in"].any()
    for name in ("w_in", "w_ff", "w_rec", "w_out"):
        assert not (state[name].numpy()[before[name] == 0]).any()


def test_connections_with_the_smallest_effect_are_pruned_first():
    model = AttSNN(6, 5, Fused())
    rng = np.random.default_rng(0)
    names = ("w_in", "w_ff", "w_rec", "w_out")
    for name in names:
        model.set_weights(name, rng.normal(size=getattr(model, name).shape))
    squares = {name: torch.tensor(rng.random(getattr(model, name).shape)) for name in names}
    cost = {name: getattr(model, name).detach().double() ** 2 * squares[name] for name in names}
    prune_connections(model, squares, 24 + 40)
    assert model.parameter_count == 24 + 40
    connected = torch.cat([getattr(model, f"{name}_connected").ravel() for name in names])
    every = torch.cat([cost[name].ravel() for name in names])
    assert every[connected].min() > every[~connected].max()
    for name in names:
        assert ((getattr(model, name) != 0) == getattr(model, f"{name}_connected")).all()


@pytest.mark.parametrize("symmetric", [True, False])
def test_neurons_that_nothing_joins_to_the_outputs_leave_in_mid_stream_and_nothing_changes(symmetric):
    model = AttSNN(24, 20, Fused(), output_scale=0.1, symmetric=symmetric)
    rng = np.random.default_rng(1)
    x = torch.from_numpy(np.round(rng.normal(size=(3, 100, 6)) * 1024) / 1024)
    initialise_from_data(model, x.numpy(), rng.normal(size=(3, 100, 2)), seed=0)
    model.w_in_connected[:8] = False  # never spike
    model.w_rec_connected[:, 8:16] = model.w_out_connected[:, 8:16] = False  # nobody hears
    model.constrain()
    both = model, model.subset(model.connected_neurons)
    assert [w.shape[0] for w in both[1].weights()[:2]] == [16, 12]
    model(x)
    both = model, model.subset(model.connected_neurons)
    (out, _), (left, _) = (net(x, np.array([False, True, False])) for net in both)
    assert out.abs().max() > 0
    np.testing.assert_array_equal(out.detach(), left.detach())
    (out.square().mean() + left.square().mean()).backward()
    for name, parameter in both[1].named_parameters():
        of_all = model.select(name, getattr(model, name).grad, model.connected_neurons)
        torch.testing.assert_close(parameter.grad, of_all, rtol=1e-3, atol=1e-3 * float(of_all.abs().max()))


def test_a_checkpoint_of_another_version_is_refused_in_one_line(dataset, tmp_path):
    train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})
    file = tmp_path / "run" / "checkpoint.pt"
    state = torch.load(file, weights_only=True)
    more = state["model"] | {"w_more": torch.zeros(2, 6)}
    less = {name: value for name, value in state["model"].items() if name != "w_in_connected"}
    for model in (more, less):
        torch.save(state | {"model": model}, file)
        with pytest.raises(ValueError, match="checkpoint is of another version of quadsim"):
            train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})


def test_ctrl_c_keeps_the_best_weights(dataset, tmp_path):
    def interrupt(epoch, config):
        raise KeyboardInterrupt

    result = train(data=dataset, out=tmp_path / "run", progress=interrupt, **TINY)
    assert result.reason == "interrupted"
    assert result.weights.is_file()


def test_a_loss_that_is_not_a_number_stops_the_run(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "attitude_loss", lambda estimate, *_: estimate.sum() * float("nan"))
    with pytest.raises(ValueError, match="the loss is nan at epoch 0, update 0"):
        train(data=dataset, out=tmp_path / "run", **TINY)


def test_another_configuration_does_not_overwrite_a_run(dataset, tmp_path):
    train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})
    with pytest.raises(ValueError, match="holds a run with another configuration"):
        train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 2})


def test_the_folder_of_another_version_is_refused_in_one_line(dataset, tmp_path):
    train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})
    file = tmp_path / "run" / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"of_before": 1.0}))
    with pytest.raises(
        ValueError, match=r"run: holds a run of another version of quadsim, choose another folder$"
    ):
        train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})


def test_bad_choices_give_one_clear_line(tmp_path):
    with pytest.raises(
        ValueError,
        match=r'unknown preset "fast"; did you mean "best"\? valid: best, humm.*, tune, or a path',
    ):
        make_config("fast", data="x.zarr")
    with pytest.raises(ValueError, match='unknown key "epoch"; did you mean "epochs"'):
        make_config(data="x.zarr", epoch=3)
    with pytest.raises(ValueError, match=r"training: batch_size = 0: should be 1 to"):
        make_config(data="x.zarr", batch_size=0)
    with pytest.raises(ValueError, match=r"training: layer_steps\[1\] = -1: should be 1e-06 to"):
        make_config(data="x.zarr", layer_steps=[1, -1, 1])
    with pytest.raises(ValueError, match="training: pruning_target: 600, but time constants alone are 642"):
        make_config("best", data="x.zarr", pruning_target=600)
    with pytest.raises(
        ValueError, match=r"reinitialise_until: 0\.6, but connections are pruned from 0\.25 on"
    ):
        make_config("best", data="x.zarr", pruning_target=9000, reinitialise_until=0.6)
    with pytest.raises(ValueError, match=r'unknown key "inputs\.gyros"; did you mean "gyro"\?'):
        make_config("best", data="x.zarr", inputs={"gyros": 4.0})
    with pytest.raises(ValueError, match=r"training: pruning_span: .*should be two rising shares"):
        make_config("best", data="x.zarr", pruning_span=(0.7, 0.2))
    with pytest.raises(FileNotFoundError, match=r"none\.zarr"):
        train(data=tmp_path / "none.zarr", out=tmp_path / "run")
    with pytest.raises(ValueError, match="a dataset is given twice"):
        make_config(data=("x.zarr", "./x.zarr"))
    with pytest.raises(
        ValueError, match=r"augmentation\.vibration = .*should be the least and then the largest"
    ):
        make_config(data="x.zarr", augmentation={"vibration": (3.0, 1.0)})
    with pytest.raises(ValueError, match=r"augmentation\.accel_noise = -1"):
        make_config(data="x.zarr", augmentation={"accel_noise": -1})


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"output_scale": 1.0}, "output_scale: the weights of init have 0.0078125, it cannot be 1.0"),
        ({"hidden": 20}, r"hidden: the weights of init have \d+, it cannot be 20"),
        ({"init": "att-snn-paper", "symmetric": True}, "symmetric: att-snn-paper does not share its weights"),
        ({"init": "att-rnn", "model": "att-snn", "symmetric": True}, "att-rnn does not share its weights"),
    ],
)
def test_what_the_weights_have_cannot_be_chosen_again(choices, message):
    with pytest.raises(ValueError, match=message):
        make_config("best", **{"data": "x.zarr", "init": "att-snn"} | choices)


def test_a_run_does_not_go_on_with_other_flights_or_weights(dataset, tmp_path):
    config = flight_config(load_recipe("hummingbird"))
    path = generate(config, 5, 4.0, tmp_path / "other.zarr", seed=9, workers=1)
    for name in ("data", "init"):
        here, out = tmp_path / f"{name}.zarr", tmp_path / name
        choices = TINY | {"epochs": 1, "out": out, "data": dataset}
        if name == "data":
            here.symlink_to(dataset)
            choices["data"] = here
        else:
            first = train(data=dataset, out=tmp_path / "first", **TINY | {"epochs": 1})
            choices["init"] = str(first.weights)
        train(**choices)
        if name == "data":
            here.unlink()
            here.symlink_to(path)
        else:
            train(data=path, out=tmp_path / "second", **TINY | {"epochs": 1})
            (tmp_path / "second" / "best.safetensors").replace(first.weights)
        with pytest.raises(ValueError, match=rf"holds a run on other files \({name}.* changed\)"):
            train(**choices)


def test_rates_that_differ_are_refused(dataset, tmp_path):
    config = flight_config(load_recipe("hummingbird"))
    slow = generate(config, 3, 4.0, tmp_path / "slow.zarr", rate_hz=100.0, seed=9, workers=1)
    with pytest.raises(ValueError, match="validation at 100 Hz, but the data are at 200 Hz"):
        train(data=dataset, validation=slow, out=tmp_path / "run", **TINY)
    with pytest.raises(ValueError, match="data at 100 Hz, but the weights of init are for 200 Hz"):
        train(data=slow, out=tmp_path / "run", preset="tune", init="att-snn")


def test_a_run_without_git_names_no_commit(monkeypatch):
    assert commit()
    monkeypatch.setenv("PATH", "")
    assert commit() == ""


@pytest.mark.parametrize("model", ["att-snn", "att-rnn"])
def test_a_window_longer_than_the_flights_is_refused(dataset, tmp_path, model):
    with pytest.raises(ValueError, match="windows of 1000 samples, but the flights have 800: give a smaller"):
        train(data=dataset, out=tmp_path / "run", **TINY | {"model": model, "hidden": 20, "window_s": 5.0})


@pytest.mark.parametrize("model", ["att-snn", "att-rnn"])
@pytest.mark.parametrize("name", preset_names("presets"))
def test_every_shipped_preset_loads(name, model):
    preset = load_toml(name, "presets", Preset)
    config = make_config(name, data="x", model=model, **({"init": model} if preset.needs_init else {}))
    assert (config.preset, config.prunes) == (name, False)


def test_a_preset_of_the_user_s_is_a_file(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("epochs = 7\n[augmentation]\ngyro_bias = 0.02\n[att-rnn]\nepochs = 9\n")
    config = make_config(mine, data="x", augmentation={"accel_bias": 0.3})
    bias = config.augmentation
    assert (config.epochs, bias.gyro_bias, bias.accel_bias, bias.accel_noise) == (7, 0.02, 0.3, 0.004)
    assert make_config(str(mine), data="x", model="att-rnn").epochs == 9
    mine.write_text("[augmentation]\ngyro_bia = 0.02\n")
    with pytest.raises(
        ValueError, match=r'mine\.toml: unknown key "augmentation\.gyro_bia"; did you mean "gyro'
    ):
        make_config(mine, data="x")


def test_every_field_is_documented():
    assert all(field.description for field in TrainConfig.model_fields.values())


def test_windows_of_a_stream_are_successive(dataset):
    flights = load_training_flights([dataset])
    quiet = {"gyro_noise": 0, "accel_noise": 0, "accel_bias": 0}
    config = make_config(data="x", batches=12, batch_size=20, windows_per_stream=4, augmentation=quiet)
    batches = list(windows(flights, config, 100, (0, 1)))
    assert batches[0].reset.all()
    reset = np.array([batch.reset for batch in batches[1:]])
    assert 0 < reset.mean() < 1
    flown = [flight.tobytes() for flight in flights.ang_vel]
    for before, after in pairwise(batches):
        for row in np.flatnonzero(~after.reset):
            joined = np.concatenate([before.gyro[row], after.gyro[row]]).tobytes()
            assert any(joined in flight for flight in flown)
    again = list(windows(flights, config, 100, (0, 1)))
    np.testing.assert_array_equal(batches[7].accel, again[7].accel)


def test_streams_of_a_batch_differ_and_do_not_depend_on_how_many_others_there_are(dataset):
    flights = load_training_flights([dataset])
    few, more = (
        list(
            windows(
                flights, make_config(data="x", batches=6, batch_size=size, windows_per_stream=4), 100, (0, 1)
            )
        )
        for size in (8, 12)  # one stream in each of eight cohorts; two in four of them, one in the others
    )
    for batch in more:
        assert len(np.unique(batch.accel[:, 0], axis=0)) == 12
    resets = np.array([batch.reset for batch in few])
    assert len(np.unique(resets, axis=1).T) > 4
    for one, other in zip(few, more, strict=True):
        for alone, among in zip(one, other, strict=True):
            np.testing.assert_array_equal(alone[4:], among[8:])


def test_a_stream_lasts_from_one_window_to_the_most(dataset):
    flights = load_training_flights([dataset])
    config = make_config(data="x", batches=300, batch_size=8, windows_per_stream=4)
    starts = np.array([batch.reset for batch in windows(flights, config, 20, (3, 1))])
    lengths = np.concatenate([np.diff(np.flatnonzero(column)) for column in starts.T])
    assert set(lengths) == {1, 2, 3, 4}
    shares = np.bincount(lengths)[1:] / lengths.size  # evenly in the logarithm, up to 5
    np.testing.assert_allclose(shares, np.diff(np.log([1, 2, 3, 4, 5])) / np.log(5), atol=0.06)


@pytest.mark.parametrize(("model", "steps"), [("att-snn", 1), ("att-snn", 3), ("att-rnn", 1)])
@pytest.mark.parametrize("preset", ["paper", "best", "hummingbird"])
def test_networks_are_fed_scaled_readings_and_nothing_else(dataset, preset, model, steps):
    config = make_config(
        preset,
        data=dataset,
        model=model,
        steps_per_sample=steps,
        batches=3,
        batch_size=8,
        windows_per_stream=2,
        augmentation={"drop_share": 0.0},
    )
    scaling = config.inputs
    for batch in windows(load_training_flights([dataset]), config, 100, (0, 1)):
        readings = np.concatenate([batch.gyro, batch.accel - np.array(scaling.accel_offset)], 2)
        expected = readings / np.array([*[scaling.gyro] * 3, *scaling.accel])
        x = network_inputs(config, batch).numpy()
        assert x.shape == (8, 100 * steps, 6)
        np.testing.assert_allclose(x, np.repeat(expected, steps, 1), rtol=0, atol=1 / 2048 + 1e-6)


def test_split_has_every_flight_once():
    parts = split(35, seed=0)
    assert [len(p) for p in parts] == [24, 7, 4]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(35))


def test_symmetry_keeps_kinematics_and_gravity(dataset):
    flights = load_training_flights([dataset])
    quiet = Augmentation(gyro_noise=0, accel_noise=0, accel_bias=0, yaw_symmetry=True)
    rng = np.random.default_rng(0)
    rate, force, up = (getattr(flights, k).astype(float) for k in ("ang_vel", "specific_force", "up"))
    gyro, accel, turned = augment(rate, force, up, quiet, 200.0, rng)
    np.testing.assert_allclose((accel * turned).sum(-1), (force * up).sum(-1), atol=1e-5)
    # d up / dt = up x rate, in the turned axes as in the old ones.
    slope = (turned[:, 2:] - turned[:, :-2]) * 100.0
    residual = slope - np.cross(turned, gyro)[:, 1:-1]
    assert np.abs(residual).max() < 0.1 * np.abs(slope).max()
    assert not np.allclose(turned, up)


def test_noise_has_the_density_that_is_asked_for():
    zero = np.zeros((20, 2000, 3), np.float32)
    both = Augmentation(gyro_noise=0.01, accel_noise=0.02, gyro_bias=0.1, accel_bias=0.3)
    gyro, accel, _ = augment(zero, zero, zero, both, 200.0, np.random.default_rng(0))
    for signal, density, bias in ((gyro, 0.01, 0.1), (accel, 0.02, 0.3)):
        np.testing.assert_allclose(signal.std(1).mean(), density * np.sqrt(200), rtol=0.02)
        np.testing.assert_allclose(signal.mean(1).std(), bias, rtol=0.3)


def test_an_imu_off_the_centre_on_a_turntable_feels_the_centripetal_force():
    rate, force = np.zeros((200, 50, 3)), np.zeros((200, 50, 3))
    rate[..., 2] = 4.0
    quiet = Augmentation(gyro_noise=0, accel_noise=0, accel_bias=0, lever_arm_max=0.1)
    _, accel, _ = augment(rate, force, force, quiet, 200.0, np.random.default_rng(0))
    arm = accel[..., :2] / -(4.0**2)
    assert 0.09 < np.abs(arm).max() < 0.1
    assert 0.3 < (arm != 0).any((1, 2)).mean() < 0.7
    np.testing.assert_allclose(accel[..., 2], 0)
    np.testing.assert_allclose(accel, accel[:, :1] * np.ones((1, 50, 1)))


def test_an_imu_off_the_centre_feels_what_the_simulators_imu_feels():
    """Spins about z and x tell the arm; then any rate that grows evenly, ω̇ × r + ω × (ω × r)."""
    quiet = Augmentation(gyro_noise=0, accel_noise=0, accel_bias=0, lever_arm_max=0.1)

    def felt(rate):
        rates = np.broadcast_to(rate, (6, 20, 3))
        return augment(rates, 0 * rates, 0 * rates, quiet, 200.0, np.random.default_rng(1))[1]

    about_z, about_x = (felt(spin)[:, 0] / -(4.0**2) for spin in ([0.0, 0.0, 4.0], [4.0, 0.0, 0.0]))
    arms = np.column_stack([about_z[:, :2], about_x[:, 2]])
    assert arms.any(1).sum() >= 2
    turn = np.array([30.0, -20.0, 50.0])
    rate = np.array([1.0, 2.0, -3.0]) + turn * np.arange(20)[:, None] / 200.0
    for arm, accel in zip(arms, felt(rate), strict=True):
        spec, ang_acc = ImuSpec(lever_arm=tuple(arm)), np.broadcast_to(turn, (1, 20, 3))
        _, expected = simulate_imu(spec, rate[None], 0 * rate[None], 200.0, seed=0, ang_acc=ang_acc)
        np.testing.assert_allclose(accel[1:], expected[0, 1:], atol=1e-12)


def test_vibration_has_its_size_in_the_accelerometer_and_a_hundredth_in_the_gyroscope():
    """Two tones a sin + b cos, a and b uniform within ± size / 2: a root mean square of size / √6."""
    zero = np.zeros((2000, 100, 3), np.float32)
    vibration = Augmentation(
        vibration=(6.0, 6.0), vibration_share=1.0, gyro_noise=0, accel_noise=0, accel_bias=0
    )
    gyro, accel, _ = augment(zero, zero, zero, vibration, 200.0, np.random.default_rng(0))
    for signal, size in ((accel, 6.0), (gyro, 0.06)):
        rms = np.sqrt(np.mean(signal.astype(float) ** 2, axis=(0, 1)))
        np.testing.assert_allclose(rms, size / np.sqrt(6), rtol=0.05)


def test_lost_samples_are_missing_in_both_sensors_at_their_share():
    zero = np.zeros((400, 500, 3), np.float32)
    lossy = Augmentation(drop_share=0.5, drop_max=0.2)
    gyro, accel, up = augment(zero, zero, zero, lossy, 200.0, np.random.default_rng(0))
    np.testing.assert_array_equal(np.isnan(gyro), np.isnan(accel))
    lost = np.isnan(gyro).all(2).mean(1)
    assert 0.4 < (lost > 0).mean() < 0.6
    assert lost.max() < 0.26
    assert lost[lost > 0].mean() == pytest.approx(0.1, abs=0.02)
    assert not np.isnan(up).any()


def test_stopping_rules_of_the_paper():
    falling = list(np.linspace(1, 0.5, 60))
    assert finished(falling) is None
    assert finished([*falling, *[0.6] * 50]) == "the lowest validation loss is 50 epochs old"
    assert "20-epoch average" in str(finished([*falling, *[0.9] * 20]))
    assert finished([1.0] * 50) is None
    assert finished([1.0] * 51) == "the lowest validation loss is 50 epochs old"
    assert finished([1.0] * 20 + [1.09] * 20) is None
    assert "20-epoch average" in str(finished([1.0] * 20 + [1.11] * 20))


def test_rough_sensors_are_drawn_within_their_limits():
    rng, n, steps = np.random.default_rng(0), 400, 400
    still, force = np.zeros((n, steps, 3), np.float32), np.zeros((n, steps, 3), np.float32)
    force[..., 2] = 9.81
    up = force / np.float32(9.81)
    gyro, accel, _ = augment(
        still,
        force,
        up,
        Augmentation(gyro_bias_max=0.1, accel_bias=0, accel_noise=0, gyro_noise=0),
        200.0,
        rng,
    )
    assert 0.08 < np.abs(gyro).max() <= 0.1
    assert np.ptp(gyro, axis=1).max() == 0
    np.testing.assert_array_equal(accel, force)
    _, accel, _ = augment(
        still, force, up, Augmentation(mounting_max_deg=5.0, accel_bias=0, accel_noise=0), 200.0, rng
    )
    tilt = np.degrees(np.arccos(accel[:, 0, 2] / 9.81))
    assert 3.0 < tilt.max() < 7.1  # roll and pitch of at most 5° each
    vibrating = Augmentation(vibration=(1.0, 2.0), vibration_share=0.5, accel_bias=0, accel_noise=0)
    _, accel, _ = augment(still, force, up, vibrating, 200.0, rng)
    spread = accel.std(axis=1).max(axis=1)
    assert 0.4 < (spread > 0.05).mean() < 0.6
    assert spread.max() < 2.0


def test_readings_are_low_passed_and_delayed():
    rng = np.random.default_rng(0)
    step = np.zeros((200, 400, 3), np.float32)
    step[:, 200:] = 1.0
    plain = {"accel_bias": 0.0, "accel_noise": 0.0, "gyro_noise": 0.0}
    gyro, _, _ = augment(step, step, step, Augmentation(delay_max_s=0.02, **plain), 200.0, rng)
    assert set(np.argmax(gyro[..., 0] > 0.5, axis=1)) == {200, 201, 202, 203, 204}
    gyro, _, _ = augment(step, step, step, Augmentation(low_pass_hz=(10.0, 10.0), **plain), 200.0, rng)
    assert gyro[0, 200 + 3, 0] == pytest.approx(1 - np.exp(-2 * np.pi * 10 * 4 / 200), abs=1e-3)


def test_hand_held_sensors_measure_gravity_along_the_true_vertical():
    rng = np.random.default_rng(0)
    roll = np.full((50, 2000), 0.5, np.float32)
    up = np.stack([np.zeros_like(roll), np.sin(roll), np.cos(roll)], -1)
    thrust = np.zeros_like(up)
    thrust[..., 2] = 9.81
    plain = Augmentation(hand_held=1.0, accel_bias=0.0, accel_noise=0.0)
    _, accel, _ = augment(np.zeros_like(up), thrust, up, plain, 200.0, rng)
    np.testing.assert_allclose(accel.mean(axis=(0, 1)), 9.81 * up[0, 0], atol=0.1)


def test_tuning_goes_on_from_weights_and_says_whether_it_helped(dataset, tmp_path):
    first = train(data=dataset, out=tmp_path / "first", **TINY)
    assert first.before is None
    tuned = train(
        data=dataset, out=tmp_path / "tuned", preset="tune", init=str(first.weights), epochs=2, batches=4,
        batch_size=4, window_s=0.5,
    )  # fmt: skip
    config, _ = load_network(tuned.weights)
    assert (config.encoding, config.hidden) == (20, 16)  # taken over
    assert tuned.before == pytest.approx(first.best.val_mse, rel=1e-3)
    assert tuned.helped == (tuned.best.val_mse < first.best.val_mse)
    with pytest.raises(ValueError, match="preset tune continues from weights"):
        train(data=dataset, out=tmp_path / "none", preset="tune")
    with pytest.raises(FileNotFoundError, match=r"no such weights file; shipped: att-rnn, att-rnn-paper, "):
        train(data=dataset, out=tmp_path / "none", init="att-ssn")


def test_a_run_that_stopped_early_has_nothing_left_to_do(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "finished", lambda losses: "enough" if len(losses) >= 2 else None)
    choices = TINY | {"stop_early": True}
    first = train(data=dataset, out=tmp_path / "run", **choices)
    log = (tmp_path / "run" / "log.csv").read_text()
    again = train(data=dataset, out=tmp_path / "run", **choices)
    assert first == again
    assert again.reason == "enough"
    assert (tmp_path / "run" / "log.csv").read_text() == log


def test_weights_that_are_not_numbers_stop_the_run_and_keep_the_best(dataset, tmp_path, monkeypatch):
    def spoil(self):
        self.w_out.data[:] = float("nan")

    rows = []

    def after_one(epoch, config):
        rows.append(epoch)
        monkeypatch.setattr(loop.AttSNN, "constrain", spoil)

    result = train(data=dataset, out=tmp_path / "run", progress=after_one, **TINY | {"batches": 1})
    assert result.reason == "training diverged: the weights are not finite after epoch 1"
    assert (result.best.epoch, len(rows)) == (0, 1)
    load_network(result.weights)


@pytest.mark.parametrize("symmetric", [False, True])
def test_currents_that_would_leave_the_chip_s_range_are_brought_back(symmetric):
    rng = np.random.default_rng(0)
    x = torch.from_numpy(np.round(rng.normal(size=(2, 2000, 6)) * 1024) / 1024)
    model = AttSNN(16, 16, Fused(), symmetric=symmetric)
    model.set_weights("w_in", rng.normal(0, 0.2, (16, 6)))
    model.set_weights("w_ff", -np.abs(rng.normal(0, 0.3, (16, 16))))
    with torch.no_grad():
        model.syn1.fill_(8.0)  # remembered for 3000 steps
    model.constrain()

    def currents():
        with torch.no_grad():
            model(x)
        return model.kernels._last.traces[0].u1

    assert currents().max() > 400  # what should only be negative has wrapped round
    for _ in range(10):
        currents()
        model.limit_currents()
        model.constrain()
    assert currents().max() <= 0.0
    assert -1.05 * CURRENT_MAX < currents().min() < -0.2 * CURRENT_MAX
    for name in model.sharing:
        w = getattr(model, name).detach().numpy()
        np.testing.assert_array_equal(model.shared(name, w), w)
    with torch.no_grad():
        model.w_ff.mul_(0.5)  # and what is far from the ends is left as it is
    kept = model.w_ff.clone()
    currents()
    model.limit_currents()
    assert torch.equal(kept, model.w_ff)


@pytest.mark.parametrize("parametrisation", ["decays", "logits"])
def test_limits_of_the_chip_leave_weights_that_fit_it_as_they_are(parametrisation):
    network, _ = load_network("att-snn-hummingbird")
    sizes = network.encoding, network.hidden, Fused(quantised=True, recurrent_delay=1)
    how = {"outputs": network.outputs, "parametrisation": parametrisation}
    model = AttSNN(*sizes, finest_exponent=-6, after_spike=True, **how)
    initialise_from_weights(model, "att-snn-hummingbird")
    before = model.weights()
    model.constrain()
    for value, kept in zip(before, model.weights(), strict=True):
        torch.testing.assert_close(kept, value, rtol=0, atol=0)


@pytest.mark.parametrize("parametrisation", ["decays", "logits"])
def test_a_weight_can_be_trained_to_the_ends_of_the_chips_range_and_no_further(parametrisation):
    model = AttSNN(8, 8, Fused(quantised=True, recurrent_delay=1), parametrisation=parametrisation)
    initialise_random(model, 0)
    with torch.no_grad():
        model.w_ff.mul_(1e6)
        model.w_in.mul_(-1e6)
    model.constrain()
    weights = model.weights()
    assert (
        set(weights.w_ff.abs().unique().tolist()) == set(weights.w_in.abs().unique().tolist()) == {127 / 128}
    )


def test_fixed_time_constants_stay_and_do_not_count_in_the_gradients_norm(dataset, tmp_path):
    choices = TINY | {"preset": "paper", "windows_per_stream": 1, "fixed_taus": True}
    train(data=dataset, out=tmp_path / "run", **choices)
    tensors = weights_of(tmp_path / "run")
    for name in ("syn0", "mem0", "syn1", "mem1", "syn2", "mem2"):
        assert np.unique(tensors[name]).size == 1
    made = make_config(data=dataset, **choices)
    run = loop.Training(made, *loop.flights_of(made)[:2])
    frozen = {name for name, p in run.model.named_parameters() if not p.requires_grad}
    assert frozen == {"syn0", "mem0", "syn1", "mem1", "syn2", "mem2"}
    with pytest.raises(ValueError, match="reinitialise_until"):
        make_config(data=dataset, **choices, reinitialise_until=0.5)


def test_a_run_continues_with_another_number_of_threads(dataset, tmp_path):
    choices = {"data": dataset, "out": tmp_path / "run", **TINY}

    def die(epoch, config):
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        train(progress=die, **choices)
    rows = []
    train(progress=lambda epoch, config: rows.append(epoch.epoch), threads=2, **choices)
    assert rows == [1, 2]


@pytest.mark.parametrize("symmetric", [False, True])
def test_reinitialised_neurons_spike_and_leave_the_estimate_as_it_was(symmetric):
    rng = np.random.default_rng(0)
    x = np.round(rng.normal(size=(4, 600, 6)).cumsum(1) * 20) / 1024
    model = AttSNN(32, 40, Fused(), symmetric=symmetric)
    initialise_from_data(model, x, 0.1 * x[:, :, :2], seed=0)
    with torch.no_grad():  # eight say nothing, and sixteen often the same
        model.w_ff[:8] = model.w_rec[:8] = model.w_rec[:, :24] = 0.0
        model.w_ff[8:24] = 1.0 / model.w_ff_scale[8:24]
        model.w_rec[8:24] = 0.0
        before = model(torch.from_numpy(x))[0].clone()
    rate = layer_spikes(model, x)[1].mean((0, 1))
    if symmetric:
        rate = model.sharing["mem1"].mean(rate)
    dead = (rate < DEAD[0]) | (rate > DEAD[1])
    assert dead[:8].all()
    count = reinitialise_dead_neurons(model, x, seed=1)
    assert count == dead.sum() - (rate > DEAD[1]).any() * (8 if symmetric else 1)
    with torch.no_grad():
        after = model(torch.from_numpy(x))[0]
    assert after.numpy() == pytest.approx(before.numpy(), abs=0.02 * float(before.std()))
    still = layer_spikes(model, x)[1].mean((0, 1))
    assert np.mean((still[dead] > DEAD[0]) & (still[dead] < DEAD[1])) > 0.6
    for name in model.sharing:
        values = getattr(model, name).detach().numpy()
        np.testing.assert_array_equal(model.shared(name, values), values)


def test_a_full_disk_names_the_file_and_leaves_no_part(dataset, tmp_path, monkeypatch):
    train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})
    before = (tmp_path / "run" / "best.safetensors").read_bytes()
    write = Path.write_bytes

    def full(path, data):
        write(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"No space left on device: .*run/config\.json"):
        train(data=dataset, out=tmp_path / "run", **TINY | {"epochs": 1})
    assert (tmp_path / "run" / "best.safetensors").read_bytes() == before
    assert not [each for each in os.listdir(tmp_path / "run") if "part" in each]


def test_a_setting_of_a_table_leaves_its_other_keys():
    whole = make_config(data="x")
    changed = make_config(data="x", augmentation={"gyro_noise": 0.5})
    assert changed.augmentation.gyro_noise == 0.5
    rest = changed.augmentation.model_dump() | {"gyro_noise": whole.augmentation.gyro_noise}
    assert rest == whole.augmentation.model_dump()
    with pytest.raises(ValueError, match=r'did you mean "augmentation\.gyro_noise"'):
        make_config(data="x", gyro_noise=0.5)


def test_dotted_settings_of_the_command_line_add_up():
    found = fields_of(["augmentation.gyro_noise=0.5", "augmentation.accel_noise=0.25", "epochs=3"])
    assert found == {"augmentation": {"gyro_noise": 0.5, "accel_noise": 0.25}, "epochs": 3}


def test_windows_grow_over_the_epochs_and_a_run_resumes_across_a_change(dataset, tmp_path):
    grow = TINY | {"later_windows": ((0.5, 1.0),)}
    config = make_config(data=str(dataset), **grow)
    assert [config.window_s_in(epoch) for epoch in range(3)] == [0.5, 0.5, 1.0]
    whole = train(data=dataset, out=tmp_path / "whole", **grow)

    def stop(epoch, _):
        if epoch.epoch == 1:
            raise KeyboardInterrupt

    train(data=dataset, out=tmp_path / "parts", progress=stop, **grow)
    resumed = train(data=dataset, out=tmp_path / "parts", **grow)
    assert resumed.weights.read_bytes() == whole.weights.read_bytes()
    with pytest.raises(
        ValueError, match=r"later_windows: shares \[0.5, 0.2\], each should be above the one before"
    ):
        make_config(data="x.zarr", later_windows=((0.5, 1.0), (0.2, 2.0)))


# --- several network steps for each sample ----------------------------------------------------------


STEPS = {"outputs": "roll-pitch", "symmetric": False, "clip": 0.0, "rate_cost": 0.5}


@pytest.fixture(scope="module", params=[1, 2, 3])
def with_steps(request, dataset):
    """A run of some network steps for each sample, in float64, and its first batches."""
    config = make_config(data=str(dataset), **TINY | STEPS | {"steps_per_sample": request.param})
    flights, validation, _ = flights_of(config)
    training = loop.Training(config, flights, validation)
    training.model.double()
    return training, list(windows(flights, config, 100, (0, 1)))


def chip_of(training):
    """The network so far on the emulated chip."""
    return NetworkEstimator(OnLoihi(*exported(training.model, training.config, 200.0, {})), 200.0)


def test_the_trainers_forward_pass_is_the_chips_after_the_last_step_of_each_sample(with_steps):
    training, batches = with_steps
    steps, chip, state = training.config.steps_per_sample, chip_of(training), training._input_state
    chip.reset(len(batches[0].gyro))
    continued = 0
    for batch in batches:
        chip.restart(np.flatnonzero(batch.reset))
        state[batch.reset] = 0.0
        outputs = training.model(network_inputs(training.config, batch, state), batch.reset)[0]
        assert outputs.shape[1] == steps * batch.gyro.shape[1]
        estimate = chip.sequence(batch.gyro, batch.accel)
        np.testing.assert_array_equal(outputs.detach()[:, steps - 1 :: steps], estimate)
        assert estimate.std() > 0.01
        continued += np.sum(~batch.reset)
    assert continued > 0


def test_an_update_descends_the_error_of_the_chips_estimates(with_steps):
    """Its loss is theirs, and its gradient that of PyTorch's autograd through the plain network."""
    training, (batch, *_) = with_steps
    config, steps = training.config, training.config.steps_per_sample
    target, plain = torch.from_numpy(batch.roll_pitch), deepcopy(training.model)
    plain.kernels = Plain()
    every, rates = plain(network_inputs(config, batch))
    total_cost(every[:, steps - 1 :: steps], target, rates, config).backward()
    chip = chip_of(training)
    chip.reset(len(batch.gyro))
    error = np.mean((chip.sequence(batch.gyro, batch.accel) - batch.roll_pitch) ** 2)
    assert training._update(batch)[0] == pytest.approx(error, rel=1e-12)
    for (name, mine), theirs in zip(training.model.named_parameters(), plain.parameters(), strict=True):
        scale = float(theirs.grad.abs().max())
        assert scale > 0, name
        np.testing.assert_allclose(mine.grad / scale, theirs.grad / scale, rtol=0, atol=1e-10, err_msg=name)


def test_a_run_with_two_steps_a_sample_is_validated_as_it_flies(dataset, tmp_path):
    result = train(data=dataset, out=tmp_path / "run", **TINY | STEPS | {"steps_per_sample": 2})
    assert load_network(result.weights)[0].steps_per_sample == 2
    _, flights, _ = flights_of(make_config(data=str(dataset), **TINY))
    chip = create_network("att-snn-loihi", weights=result.weights)
    chip.reset(len(flights))
    error = chip.sequence(flights.gyro, flights.accel) - flights.roll_pitch
    assert result.best.val_mse == pytest.approx(np.mean(error**2), rel=1e-9)
    mission = Mission(load_scenario("hover"), create_network("att-snn-loihi", weights=result.weights), 2)
    mission.begin(vehicle_seeds(0, 2))
    for _ in range(100):
        mission.step()
    assert mission.loop.attitude.any()
    assert not mission.cause.any()
