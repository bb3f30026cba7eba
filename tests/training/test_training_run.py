import errno
import json
import os
from copy import deepcopy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from plain_network import Plain

from estimators.networks.forward import OnLoihi
from estimators.networks.layer_parameters import EXPONENTS
from estimators.networks.network import NetworkEstimator, create_network
from estimators.networks.weights_file import load_network
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from quadsim.runs.fingerprint import code_digest
from quadsim.runs.record import commit
from training import epochs
from training.config import make_config
from training.data import AttitudeTask, attitude_windows, network_inputs
from training.epochs import train
from training.optim import finished, total_cost
from training.run_folder import tensorboard_events

TINY = {
    "optimisation": "layered", "rate_cost": 0.03, "epochs": 3, "batches": 4, "batch_size": 4, "window_s": 0.5,
    "windows_per_stream": 2, "encoding": 20, "hidden": 16,
}  # fmt: skip


def weights_of(folder):
    return load_network(folder / "best.safetensors")[1]


def killed_and_resumed(out, after=1, **choices):
    """A run that is killed after an epoch and resumes; the epochs since then."""

    def die(epoch, config):
        if epoch.epoch == after:
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        train(out=out, progress=die, **choices)
    rows = []
    train(out=out, progress=lambda epoch, config: rows.append(epoch.epoch), **choices)
    return rows


@pytest.fixture
def trained(dataset, tmp_path):
    """The arguments of a run of one epoch that is done."""
    choices = TINY | {"data": dataset, "out": tmp_path, "epochs": 1}
    train(**choices)
    return choices


def test_tiny_run_learns_and_leaves_its_files(dataset, tmp_path):
    rows = []
    changes = {"epochs": 8, "batches": 40, "windows_per_stream": 6, "rate_cost": 0.0}
    result = train(data=dataset, out=tmp_path, progress=lambda row, _: rows.append(row), **TINY | changes)
    assert rows[-1].train_loss < 0.8 * rows[0].train_loss
    assert result.best.score == min(row.validation["loss"] for row in rows)
    logged = pd.read_csv(tmp_path / "log.csv", float_precision="round_trip")["validation_error_deg"]
    assert logged.tolist() == [row.validation["error_deg"] for row in rows]
    assert (tmp_path / "curve.png").stat().st_size > 1000
    config, _ = load_network(result.weights)
    assert config.training["epoch"] == result.best.epoch + 1
    assert config.training["vehicles"] == ["hummingbird"]
    est = create_network("att-snn-loihi", weights=result.weights)
    assert est.update(np.zeros((1, 3)), np.array([[0.0, 0.0, 9.81]])).shape == (1, 2)


@pytest.mark.parametrize("model", ["att-snn", "att-rnn"])
def test_a_killed_run_resumes_to_the_same_weights(dataset, tmp_path, model):
    choices = TINY | {"data": dataset, "model": model, "hidden": 20}
    train(out=tmp_path / "whole", **choices)
    assert killed_and_resumed(tmp_path / "cut", **choices) == [2]
    whole, cut = (torch.load(tmp_path / run / "checkpoint.pt", weights_only=True) for run in ("whole", "cut"))
    for name in whole["model"]:
        np.testing.assert_array_equal(whole["model"][name], cut["model"][name])
    np.testing.assert_equal(weights_of(tmp_path / "cut"), weights_of(tmp_path / "whole"))


def test_a_neuron_has_the_finest_exponent_that_holds_its_weights(dataset, tmp_path):
    _, tensors = load_network(train(data=dataset, out=tmp_path, finest_exponent=-6, **TINY).weights)
    for name, exponents in EXPONENTS.items():  # the finest steps that hold the largest weight into a neuron
        largest = np.abs(tensors[name]).max(1)
        assert (largest[tensors[exponents] > -6] >= 127).all()
        assert tensors[exponents].min() < 0


def test_the_folder_of_another_run_is_refused_in_one_line(trained, tmp_path):
    assert json.loads((tmp_path / "contents.json").read_text())["code"] == code_digest("training.epochs")
    for file, change, message in (
        ("config.json", {"of_before": 1.0}, "a run of another version of quadsim, choose another folder$"),
        ("config.json", {"epochs": 9}, "a run with another configuration, choose another folder$"),
        ("contents.json", {"data": "of others"}, r"a run on other files \(data changed\)"),
        ("contents.json", {"code": "of others"}, r"a run on other files \(code changed\)"),
    ):
        before = (tmp_path / file).read_text()
        written = json.loads(before)
        assert change.keys() - written.keys() <= {"of_before"}
        (tmp_path / file).write_text(json.dumps(written | change))
        with pytest.raises(ValueError, match=f"holds {message}"):
            train(**trained)
        (tmp_path / file).write_text(before)


def test_what_a_run_reads_has_digests_of_its_own(dataset, tmp_path):
    other = generate(load_recipe("hummingbird"), 5, 4.0, tmp_path / "o.zarr", seed=9, workers=1)
    configs = [make_config(data=path, window_s=1.0) for path in (dataset, dataset, other)]
    found = [AttitudeTask(config).contents() for config in configs]
    assert found[0] == found[1]
    assert all(found[0][name] != found[2][name] for name in ("data", "validation"))
    slow = generate(load_recipe("hummingbird"), 3, 4.0, tmp_path / "s.zarr", rate_hz=100.0, workers=1)
    with pytest.raises(ValueError, match="validation at 100 Hz, but the data are at 200 Hz"):
        train(data=dataset, validation=slow, out=tmp_path / "run", **TINY)


def test_files_that_are_not_there_are_named(dataset, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.zarr"):
        train(data=tmp_path / "none.zarr", out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_of_another_version_is_refused_in_one_line(trained, tmp_path):
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    more = state["model"] | {"w_more": torch.zeros(2, 6)}
    less = {name: value for name, value in state["model"].items() if name != "w_in_scale"}
    for model in (more, less):
        torch.save(state | {"model": model}, tmp_path / "checkpoint.pt")
        with pytest.raises(ValueError, match="checkpoint is damaged or of another version of quadsim"):
            train(**trained)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("checkpoint.pt", "garbage", "its checkpoint is damaged or of another version"),
        ("checkpoint.pt", "", "its checkpoint is damaged or of another version"),
        ("contents.json", "{", r"contents\.json: damaged, choose another folder"),
        ("contents.json", "[1]", r"contents\.json: damaged, choose another folder"),
        ("best.safetensors", None, r"best\.safetensors is missing beside its checkpoint"),
    ],
)
def test_a_run_with_a_damaged_file_is_refused_in_one_line(trained, tmp_path, file, content, message):
    (tmp_path / file).unlink()
    if content is not None:
        (tmp_path / file).write_text(content)
    with pytest.raises(ValueError, match=message):
        train(**trained)


def test_a_loss_that_is_not_a_number_stops_the_run(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(epochs, "error_loss", lambda estimate, *_: estimate.sum() * float("nan"))
    with pytest.raises(ValueError, match="the loss is nan at epoch 0, update 0"):
        train(data=dataset, out=tmp_path, **TINY)


def test_weights_that_are_not_numbers_stop_the_run_and_keep_the_best(dataset, tmp_path, monkeypatch):
    def spoil(self):
        self.w_out.data[:] = float("nan")

    rows = []

    def after_one(epoch, config):
        rows.append(epoch)
        monkeypatch.setattr(epochs.AttSNN, "constrain", spoil)

    result = train(data=dataset, out=tmp_path, progress=after_one, **TINY | {"batches": 1})
    assert result.reason == "training diverged: the weights are not finite after epoch 1"
    assert (result.best.epoch, len(rows)) == (0, 1)
    load_network(result.weights)


def test_a_run_that_stopped_early_has_nothing_left_to_do(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(epochs, "finished", lambda losses: "enough" if len(losses) >= 2 else None)
    choices = TINY | {"data": dataset, "out": tmp_path, "batches": 1}
    assert train(**choices | {"out": tmp_path / "to-the-end"}).reason == "all 3 epochs done"
    first = train(**choices | {"optimisation": "paper"})
    log = (tmp_path / "log.csv").read_text()
    assert train(**choices | {"optimisation": "paper"}) == first
    assert first.reason == "enough"
    assert (tmp_path / "log.csv").read_text() == log


def test_stopping_rules_of_the_paper():
    falling = list(np.linspace(1, 0.5, 60))
    old = "the lowest validation loss is 50 epochs old"
    for going_on in (falling, [1.0] * 50, [1.0] * 20 + [1.09] * 20):
        assert finished(going_on) is None
    assert finished([*falling, *[0.6] * 50]) == finished([1.0] * 51) == old
    for rising in ([*falling, *[0.9] * 20], [1.0] * 20 + [1.11] * 20):
        assert "20-epoch average" in str(finished(rising))


def test_fixed_time_constants_stay_and_do_not_count_in_the_gradients_norm(dataset, tmp_path):
    choices = TINY | {"preset": "paper", "windows_per_stream": 1, "fixed_taus": True, "data": dataset}
    train(out=tmp_path, **choices)
    tensors = weights_of(tmp_path)
    for name in ("syn0", "mem0", "syn1", "mem1", "syn2", "mem2"):
        assert np.unique(tensors[name]).size == 1
    config = make_config(**choices)
    training = epochs.Training(config, AttitudeTask(config))
    training.begin()
    frozen = {name for name, p in training.model.named_parameters() if not p.requires_grad}
    assert frozen == {"syn0", "mem0", "syn1", "mem1", "syn2", "mem2"}


def test_a_full_disk_names_the_file_and_leaves_no_part(trained, tmp_path, monkeypatch):
    before = (tmp_path / "best.safetensors").read_bytes()
    write = Path.write_bytes

    def full(path, data):
        write(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"No space left on device: .*config\.json"):
        train(**trained)
    assert (tmp_path / "best.safetensors").read_bytes() == before
    assert not [each for each in os.listdir(tmp_path) if "part" in each]


@pytest.fixture(scope="module")
def begun(dataset):
    """A run in float64, and its first batches."""
    config = make_config(data=dataset, **TINY | {"rate_cost": 0.5})
    task = AttitudeTask(config)
    training = epochs.Training(config, task)
    training.begin()
    training.model.double()
    return training, list(attitude_windows(task.flights, config, 100, (0, 1)))


def chip_of(training):
    return NetworkEstimator(OnLoihi(*training.exported()), 200.0)


def test_the_trainers_forward_pass_is_the_chips(begun):
    training, batches = begun
    chip, state = chip_of(training), training._input_state
    chip.reset(len(batches[0].gyro))
    continued = 0
    for batch in batches:
        chip.restart(np.flatnonzero(batch.reset))
        state[batch.reset] = 0.0
        outputs = training.model(network_inputs(training.config, batch, state), batch.reset)[0]
        estimate = chip.sequence(batch.gyro, batch.accel)
        np.testing.assert_array_equal(outputs.detach(), estimate)
        assert estimate.std() > 0.01
        continued += np.sum(~batch.reset)
    assert continued > 0


def test_an_update_descends_the_error_of_the_chips_estimates(begun):
    """Its loss is theirs, and its gradient that of PyTorch's autograd through the plain network."""
    training, (batch, *_) = begun
    config = training.config
    target, plain = torch.from_numpy(batch.target), deepcopy(training.model)
    plain.kernels = Plain()
    every, rates = plain(network_inputs(config, batch))
    total_cost(every, target, rates, config).backward()
    torch.nn.utils.clip_grad_norm_(plain.parameters(), config.method.clip)
    chip = chip_of(training)
    chip.reset(len(batch.gyro))
    error = np.mean((chip.sequence(batch.gyro, batch.accel) - batch.target) ** 2)
    assert training._update(batch)[0] == pytest.approx(error, rel=1e-12)
    for (name, mine), theirs in zip(training.model.named_parameters(), plain.parameters(), strict=True):
        scale = float(theirs.grad.abs().max())
        assert scale > 0, name
        np.testing.assert_allclose(mine.grad / scale, theirs.grad / scale, rtol=0, atol=1e-10, err_msg=name)


def test_a_run_without_git_names_no_commit(monkeypatch):
    assert commit()
    monkeypatch.setenv("PATH", "")
    assert commit() == ""


def test_events_for_tensorboard_are_the_rows_of_the_log(dataset, tmp_path):
    """Also of a run that was killed after its second epoch and continued."""
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")

    def log_until(last, write):
        def progress(epoch, _):
            write(epoch)
            if epoch.epoch == last:
                raise RuntimeError("killed")

        train(data=dataset, out=tmp_path, progress=progress, **TINY)

    with pytest.raises(RuntimeError, match="killed"), tensorboard_events(tmp_path) as write:
        log_until(1, write)
    with tensorboard_events(tmp_path) as write:
        log_until(None, write)
    events = accumulator.EventAccumulator(str(tmp_path)).Reload()
    rows = pd.read_csv(tmp_path / "log.csv").drop(columns="epoch")
    assert set(events.Tags()["scalars"]) == set(rows)
    for name in rows:
        found = [(event.step, event.value) for event in events.Scalars(name)]
        assert [step for step, _ in found] == [1, 2, 3]
        assert [value for _, value in found] == pytest.approx(rows[name].tolist())
