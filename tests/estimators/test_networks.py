import json
import math
import os
import tracemalloc

import numpy as np
import pytest
import torch
from controllers import CONFIG, random_snn, samples
from plain_network import Plain
from safetensors.numpy import save_file

from estimators import create
from estimators.networks.encoder import scaled_inputs
from estimators.networks.forward import OnLoihi, real_weights
from estimators.networks.gru import Recurrent, tanh
from estimators.networks.layer_parameters import EXPONENTS, Weights
from estimators.networks.network import NetworkEstimator, create_network, silenced
from estimators.networks.weights_file import (
    NetworkConfig,
    load_network,
    parameter_count,
    save_network,
    tensor_shapes,
)
from quadsim.estimator import rows_of


def random_rnn(config, seed=0):
    rng = np.random.default_rng(seed)
    return {k: rng.normal(0, 0.2, s).astype(np.float32) for k, s in tensor_shapes(config).items()}


SNN, RNN = NetworkConfig(model="att-snn", output_scale=1 / 256), NetworkConfig(model="att-rnn")


@pytest.fixture
def snn_file(tmp_path):
    save_network(tmp_path / "snn.safetensors", SNN, random_snn(SNN))
    return tmp_path / "snn.safetensors"


@pytest.fixture
def rnn_file(tmp_path):
    save_network(tmp_path / "rnn.safetensors", RNN, random_rnn(RNN))
    return tmp_path / "rnn.safetensors"


@pytest.mark.parametrize("config", [NetworkConfig(model="att-snn"), CONFIG])
def test_a_file_returns_what_was_saved_and_the_same_network_is_the_same_bytes(tmp_path, config):
    tensors = random_snn(config, 1)
    for k in range(20):
        save_network(tmp_path / str(k), config, tensors)
        assert (tmp_path / str(k)).read_bytes() == (tmp_path / "0").read_bytes()
    found = load_network(tmp_path / "0")
    assert found.config == config
    np.testing.assert_equal(found.tensors, tensors)
    assert (b"set_point" in (tmp_path / "0").read_bytes()) == config.controls


CIRCUIT = [(name, "") for name in ("att-snn", "att-snn-loihi", "att-rnn")]


@pytest.fixture(params=[("att-snn-loihi", "snn_file"), ("att-rnn", "rnn_file"), *CIRCUIT])
def est(request):
    """A network of random weights, or the circuit that ships."""
    name, file = request.param
    if file:
        return create_network(name, weights=request.getfixturevalue(file))
    return create(name, weights="att-snn")


def test_streaming_equals_the_whole_sequence_however_many_vehicles_there_are(est):
    steps = 520  # a float circuit takes 500 at once
    gyro, accel = samples(5, steps, rate=1.5, force=4.0)
    gyro[0, 20], accel[1, 30:33], accel[2, 5] = np.nan, np.nan, 0.0
    est.reset(5)
    whole = est.sequence(gyro, accel)
    np.testing.assert_array_equal(est.skipped, [1, 3, 1, 0, 0])
    for part in (slice(None), *(slice(k, k + 1) for k in (0, 1, 4))):
        est.reset(len(gyro[part]))
        streamed = [est.update(gyro[part, t], accel[part, t]) for t in range(steps)]
        np.testing.assert_array_equal(np.stack(streamed, 1), whole[part])


def test_vehicles_are_given_by_index_or_by_mask():
    assert rows_of([2, 0], 3).tolist() == [2, 0]
    assert rows_of(np.array([True, False, True]), 3).tolist() == [0, 2]
    assert rows_of([], 3).size == 0
    for wrong in ([3], [0.5], [True, False]):
        with pytest.raises(ValueError, match="ids of 3 vehicles"):
            rows_of(wrong, 3)


def test_restart_leaves_the_others_alone(est):
    gyro, accel = samples(3, 60)
    est.reset(3)
    whole = est.sequence(gyro, accel)
    est.reset(3)
    est.sequence(gyro[:, :30], accel[:, :30])
    est.restart([1])
    rest = est.sequence(gyro[:, 30:], accel[:, 30:])
    np.testing.assert_array_equal(rest[[0, 2]], whole[[0, 2], 30:])
    est.reset(1)
    np.testing.assert_array_equal(rest[1], est.sequence(gyro[1:2, 30:], accel[1:2, 30:])[0])


def test_the_initial_attitude_is_checked_and_ignored(est):
    gyro, accel = samples(2, 50)
    est.reset(2)
    unknown = est.sequence(gyro, accel)
    start = [[0.5, -0.3], [0.0, 1.2]]
    for begin in (lambda known: est.reset(2, known), lambda known: est.restart([0, 1], known)):
        begin(start)
        np.testing.assert_array_equal(est.sequence(gyro, accel), unknown)
        for wrong, message in (
            ([[np.inf, 0.0]] * 2, "not finite"),
            ([[0.0, 0.0]], r"\(1, 2\), should be \(2, 2\)"),
        ):
            with pytest.raises(ValueError, match=message):
                begin(wrong)


def test_the_tangent_of_the_gru_is_numpys():
    x = np.concatenate([np.linspace(-12, 12, 2001), np.geomspace(1e-30, 1, 1000)]).astype(np.float32)
    np.testing.assert_allclose([tanh(each) for each in x], np.tanh(x.astype(float)), rtol=3e-7)


@pytest.mark.parametrize("units", [7, 100])
def test_gru_equals_torch(tmp_path, units):
    config = NetworkConfig(model="att-rnn", encoding=units, hidden=units)
    tensors = random_rnn(config)
    rnn_file = tmp_path / "rnn.safetensors"
    save_network(rnn_file, config, tensors)
    gru = torch.nn.GRU(6, units, 2, batch_first=True)
    gru.load_state_dict({k.removeprefix("gru."): torch.tensor(v) for k, v in tensors.items() if "gru" in k})
    gyro, accel = samples(9, 50)
    x = torch.tensor(scaled_inputs(config.inputs, gyro, accel), dtype=torch.float32)
    expected = gru(x)[0].detach().numpy() @ tensors["out.weight"].T + tensors["out.bias"]
    est = create_network("att-rnn", weights=rnn_file)
    est.reset(9)
    np.testing.assert_allclose(est.sequence(gyro, accel), expected, atol=1e-5)


def test_the_network_by_the_papers_recipe_has_at_most_its_size():
    assert parameter_count(load_network("att-snn-paper").tensors) <= 21202


def test_bad_files_give_one_clear_line(tmp_path, snn_file, rnn_file):
    config, tensors = load_network(snn_file)
    path = tmp_path / "x.safetensors"
    path.write_bytes(b"hello")
    for name, rate_hz, weights, message in (
        ("att-snn", 200.0, path, "not a safetensors file"),
        ("att-snn-loihi", 200.0, rnn_file, "weights of att-rnn, att-snn-loihi needs att-snn"),
        ("att-snn", 100.0, snn_file, "for 200 Hz, not for 100 Hz"),
        ("att", 200.0, snn_file, "no network 'att'"),
    ):
        with pytest.raises(ValueError, match=message):
            create_network(name, rate_hz, weights=weights)
    with pytest.raises(FileNotFoundError, match="no such weights file"):
        create_network("att-snn", weights=tmp_path / "none")
    for change, message in (
        ({"w_ff": tensors["w_ff"][:50]}, r"w_ff has shape \(50, 100\), should be \(100, 100\)"),
        ({"w_ff": tensors["w_ff"].astype(np.float32)}, "w_ff is float32, should be int16"),
        ({"w_ff": tensors["w_ff"] + np.int16(1)}, "odd mantissas"),
        ({"mem0": tensors["mem0"] * 0}, r"mem0 spans 0\.\.\.0, allowed 1\.\.\.4096"),
        ({"more": tensors["w_ff"]}, "unknown tensor more"),
        ({"exp_ff": np.full(100, 1, np.int16)}, r"exp_ff spans 1\.\.\.1, allowed -6\.\.\.0"),
        ({"exp_rec": np.zeros(99, np.int16)}, r"exp_rec has shape \(99,\), should be \(100,\)"),
        ({"w_out": np.zeros((4, 100), np.int16)}, r"w_out has shape \(4, 100\), should be \(2, 100\)"),
    ):
        with pytest.raises(ValueError, match=message):
            save_network(path, config, tensors | change)
    with pytest.raises(ValueError, match="tensor w_ff is missing"):
        save_network(path, config, {name: each for name, each in tensors.items() if name != "w_ff"})
    with pytest.raises(ValueError, match=r"gyro \(1, 2\)"):
        create_network("att-snn", weights=snn_file).update(np.zeros((1, 2)), np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"w_in": ("I16", [40_000_000])}, r"w_in has shape \(40000000,\), should be \(100, 6\)"),
        ({"w_in": ("BF16", [40_000_000])}, r"w_in has shape \(40000000,\), should be \(100, 6\)"),
        ({"more": ("I16", [40_000_000])}, "unknown tensor more"),
        ({"w_rec": ("F64", [100, 100])}, "w_rec is float64, should be int16"),
        ({"w_rec": ("BF16", [100, 100])}, "w_rec is bfloat16, should be int16|of unknown numbers"),
    ],
)
def test_declared_shapes_and_types_are_refused_before_a_number_is_read(tmp_path, changes, message):
    config = NetworkConfig(model="att-snn")
    tensors = {name: ("I16", list(shape)) for name, shape in tensor_shapes(config).items()} | changes
    header: dict[str, object] = {"__metadata__": {"format": "3", "config": config.model_dump_json()}}
    end = 0
    for name, (kind, shape) in tensors.items():
        size = {"I16": 2, "BF16": 2, "F64": 8}[kind] * math.prod(shape)
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [end, end + size]}
        end += size
    text = json.dumps(header).encode()
    path = tmp_path / "sparse.safetensors"  # of which the disk holds the header alone
    path.write_bytes(len(text).to_bytes(8, "little") + text)
    os.truncate(path, 8 + len(text) + end)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=message):
            load_network(path)
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", [OnLoihi, Recurrent])
def test_silenced_networks_estimate_nothing(kind, snn_file, rnn_file):
    config, tensors = load_network(rnn_file if kind is Recurrent else snn_file)
    for each, loud in ((tensors, True), (silenced(config, tensors), False)):
        assert NetworkEstimator(kind(config, each), 200.0).sequence(*samples(1, 80)).any() == loud


@pytest.mark.parametrize("delay", [1, 2])
def test_network_in_floats_equals_the_pytorch_loop(tmp_path, delay):
    sizes = {"encoding": 12, "hidden": 9}
    config = NetworkConfig(model="att-snn", quantised=False, **sizes, recurrent_delay=delay)
    rng = np.random.default_rng(0)
    tensors = {
        name: rng.normal(0, 0.5, shape) if name.startswith("w_") else rng.uniform(0.3, 0.95, shape)
        for name, shape in tensor_shapes(config).items()
    }
    save_network(tmp_path / "w", config, tensors)
    gyro, accel = samples(2, 100)
    weights = Weights(*map(torch.tensor, real_weights(config, tensors)))
    x = torch.tensor(scaled_inputs(config.inputs, gyro, accel))
    plain = Plain(quantised=False, recurrent_delay=delay)
    expected, rates = plain.forward(x, weights)
    assert rates[1] > 0.05
    est = create_network("att-snn", weights=tmp_path / "w")
    est.reset(2)
    np.testing.assert_allclose(est.sequence(gyro, accel), expected, atol=1e-10)
    with pytest.raises(ValueError, match="needs quantised weights"):
        create_network("att-snn-loihi", weights=tmp_path / "w")


@pytest.mark.parametrize(
    ("format", "inputs", "message"),
    [
        ({}, {}, r"w.safetensors: weights of quadsim 0.1, this .* train them again$"),
        ({"format": "2"}, {}, "weights of format '2', this version of quadsim reads '3'"),
        ({"format": "3"}, {"accel_ofset": 1.0}, 'version of quadsim: unknown key "inputs.accel_ofset"; did'),
    ],
)
def test_weights_of_another_version_are_refused_in_one_line(tmp_path, format, inputs, message):
    config, tensors = load_network("att-snn-paper")
    about = config.model_dump(mode="json")
    about["inputs"] |= inputs
    save_file(tensors, tmp_path / "w.safetensors", metadata=format | {"config": json.dumps(about)})
    with pytest.raises(ValueError, match=message):
        load_network(tmp_path / "w.safetensors")


def test_an_exponent_is_a_smaller_step_of_the_weights_into_one_neuron():
    config = NetworkConfig(model="att-snn", encoding=8, hidden=8)
    tensors = random_snn(config, 1)
    coarse = tensors | {name: np.zeros(8, np.int16) for name in EXPONENTS.values()}
    fine, whole = real_weights(config, tensors), real_weights(config, coarse)
    np.testing.assert_array_equal(fine.w_ff, whole.w_ff * 2.0 ** tensors["exp_ff"][:, None])
    np.testing.assert_array_equal(fine.w_rec, whole.w_rec * 2.0 ** tensors["exp_rec"][:, None])
    np.testing.assert_array_equal(fine.w_out, whole.w_out)
    without = {name: value for name, value in coarse.items() if name not in EXPONENTS.values()}
    assert parameter_count(without) == parameter_count(coarse) == parameter_count(tensors)
    np.testing.assert_array_equal(real_weights(config, without).w_rec, whole.w_rec)
