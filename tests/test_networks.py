import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file
from scipy.signal import lfilter

from estimators.alignment import BIAS_MAX
from estimators.encoder import HELD, LEAD_CLIP, scaled_inputs
from estimators.metrics import inclination_rmse
from estimators.networks import NetworkEstimator, OnLoihi, Spiking, create_network
from estimators.spiking import Weights, forward
from estimators.weights_file import (
    InputScaling,
    NetworkConfig,
    expected_shapes,
    load_network,
    parameters,
    save_network,
    shipped_network,
)
from quadsim.dataset import generate, open_dataset
from quadsim.recipe import flight_config, load_recipe
from quadsim.rotation import roll_pitch_from_quat


def random_snn(config, seed=0):
    rng = np.random.default_rng(seed)
    tensors = {}
    for name, shape in expected_shapes(config).items():
        if not name.startswith("w_"):
            tensors[name] = np.clip(np.exp(rng.uniform(0.0, 8.3, shape)), 1, 4096).astype(np.int16)
            continue
        if name == "w_skip":
            tensors[name] = rng.integers(-9000, 9001, shape).astype(np.int16)
            continue
        scale = {"w_in": 40, "w_ff": 50, "w_rec": 30, "w_out": 60}[name]
        tensors[name] = (2 * np.clip(np.rint(rng.normal(0, scale / 2, shape)), -128, 127)).astype(np.int16)
    return tensors


def random_rnn(config, seed=0):
    rng = np.random.default_rng(seed)
    return {k: rng.normal(0, 0.2, s).astype(np.float32) for k, s in expected_shapes(config).items()}


@pytest.fixture
def snn_file(tmp_path):
    config = NetworkConfig(model="att-snn", output_scale=1 / 256)
    save_network(tmp_path / "snn.safetensors", config, random_snn(config))
    return tmp_path / "snn.safetensors"


@pytest.fixture
def rnn_file(tmp_path):
    config = NetworkConfig(model="att-rnn")
    save_network(tmp_path / "rnn.safetensors", config, random_rnn(config))
    return tmp_path / "rnn.safetensors"


def samples(n, steps, seed=1):
    rng = np.random.default_rng(seed)
    return rng.normal(0, 1, (n, steps, 3)), rng.normal([0, 0, 9.8], 0.5, (n, steps, 3))


def same_spikes_for(weights, steps, seed, steps_per_sample=1):
    """Run the float64 network and the emulator side by side and compare every state after every step."""
    gyro, accel = samples(1, steps, seed)
    floats = create_network("att-snn", weights=weights)
    chip = create_network("att-snn-loihi", weights=weights)
    config, _ = load_network(weights or "att-snn")
    h0, both = config.encoding, config.encoding + config.hidden
    counts = np.zeros(2, int)
    for t in range(steps):
        a = floats.update(gyro[:, t], accel[:, t])
        b = chip.update(gyro[:, t], accel[:, t])
        np.testing.assert_array_equal(a, b)
        _, state, lists = floats._states
        _, _, _, after, u, _, _ = chip._states
        encoding, hidden = lists[0, 1 : 1 + lists[0, 0]], lists[0, h0 + 2 : h0 + 2 + lists[0, h0 + 1]]
        np.testing.assert_array_equal(encoding, np.flatnonzero(after[0, :h0]))
        np.testing.assert_array_equal(hidden, np.flatnonzero(after[0, h0:both]))
        np.testing.assert_array_equal(state[0, 2 * h0 : h0 + both], u[0, h0:both])
        counts += len(encoding), len(hidden)
    assert np.all(counts > steps // 10)


@pytest.mark.parametrize("seed", [0, 1])
def test_quantised_network_and_emulator_spike_alike_over_2000_steps(tmp_path, seed):
    config = NetworkConfig(model="att-snn", output_scale=1 / 256, steps_per_sample=1 + seed)
    save_network(tmp_path / "w", config, random_snn(config, seed))
    same_spikes_for(tmp_path / "w", 2000, seed)


def test_shipped_network_and_emulator_spike_alike_over_2000_steps():
    same_spikes_for(None, 2000, 3)


@pytest.mark.parametrize("name", ["att-snn", "att-snn-loihi", "att-rnn"])
def test_streaming_equals_the_whole_sequence(name, snn_file, rnn_file):
    est = create_network(name, weights=rnn_file if name == "att-rnn" else snn_file)
    gyro, accel = samples(3, 80)
    gyro[0, 20], accel[1, 30:33], accel[2, 5] = np.nan, np.nan, 0.0
    est.reset(3)
    whole = est.sequence(gyro, accel)
    np.testing.assert_array_equal(est.skipped, [1, 3, 1])
    est.reset(3)
    streamed = np.stack([est.update(gyro[:, t], accel[:, t]) for t in range(80)], 1)
    np.testing.assert_array_equal(streamed, whole)
    est.reset(1)
    np.testing.assert_array_equal(est.sequence(gyro[1:2], accel[1:2])[0], whole[1])


@pytest.mark.parametrize("name", ["att-snn", "att-snn-loihi", "att-rnn"])
def test_restart_leaves_the_others_alone(name, snn_file, rnn_file):
    est = create_network(name, weights=rnn_file if name == "att-rnn" else snn_file)
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


@pytest.mark.parametrize("name", ["att-snn-loihi", "att-rnn"])
def test_shipped_networks_start_at_the_attitude_they_are_told(name):
    est = create_network(name)
    known = np.radians([[10.0, -5.0], [0.0, 8.0], [0.0, 0.0]])
    est.reset(3, roll_pitch=known)
    thrust = np.tile([0.0, 0.0, 9.81], (3, 1))
    error = np.degrees(np.abs(est.update(np.zeros((3, 3)), thrust) - known))
    assert error.max() < 3.0


def test_float64_and_integers_agree_from_a_known_attitude(snn_file):
    gyro, accel = samples(2, 50)
    runs = []
    for name in ("att-snn", "att-snn-loihi"):
        est = create_network(name, weights=snn_file)
        est.reset(2, roll_pitch=np.array([[0.1, -0.2], [0.03, 0.0]]))
        runs.append(est.sequence(gyro, accel))
    np.testing.assert_array_equal(*runs)


def test_gru_equals_torch(rnn_file):
    config, tensors = load_network(rnn_file)
    gru = torch.nn.GRU(6, 100, 2, batch_first=True)
    gru.load_state_dict({k.removeprefix("gru."): torch.tensor(v) for k, v in tensors.items() if "gru" in k})
    gyro, accel = samples(2, 50)
    x = torch.tensor(scaled_inputs(config.inputs, config.rate_hz, gyro, accel)[0], dtype=torch.float32)
    expected = gru(x)[0].detach().numpy() @ tensors["out.weight"].T + tensors["out.bias"]
    est = create_network("att-rnn", weights=rnn_file)
    est.reset(2)
    np.testing.assert_allclose(est.sequence(gyro, accel), expected, atol=1e-5)


def test_inference_does_not_import_torch(snn_file):
    code = (
        "import sys, numpy as np; from estimators.networks import create_network; "
        f"est = create_network('att-snn-loihi', weights={str(snn_file)!r}); "
        "est.update(np.zeros((1, 3)), np.ones((1, 3))); "
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_shipped_network_is_within_the_parameter_budget():

    _, tensors = shipped_network("att-snn")
    assert parameters(tensors) <= 21202


def test_bad_files_give_one_clear_line(tmp_path, snn_file, rnn_file):
    config, tensors = load_network(snn_file)
    path = tmp_path / "x.safetensors"
    with pytest.raises(FileNotFoundError, match="no such weights file"):
        create_network("att-snn", weights=tmp_path / "none")
    path.write_bytes(b"hello")
    with pytest.raises(ValueError, match="not a safetensors file"):
        create_network("att-snn", weights=path)
    with pytest.raises(ValueError, match="weights of att-rnn, att-snn-loihi needs att-snn"):
        create_network("att-snn-loihi", weights=rnn_file)
    with pytest.raises(ValueError, match=r"for 200 Hz, not for 100 Hz"):
        create_network("att-snn", 100.0, weights=snn_file)
    for change, message in (
        ({"w_ff": tensors["w_ff"][:50]}, r"w_ff has shape \(50, 100\), should be \(100, 100\)"),
        ({"w_ff": tensors["w_ff"].astype(np.float32)}, "w_ff is float32, should be int16"),
        ({"w_ff": tensors["w_ff"] + np.int16(1)}, "odd mantissas"),
        ({"mem0": tensors["mem0"] * 0}, r"mem0 spans 0\.\.\.0, allowed 1\.\.\.4096"),
        ({"more": tensors["w_ff"]}, "unknown tensor more"),
    ):
        with pytest.raises(ValueError, match=message):
            save_network(path, config, tensors | change)
    with pytest.raises(ValueError, match="no network 'att'"):
        create_network("att")
    with pytest.raises(ValueError, match=r"gyro \(1, 2\)"):
        create_network("att-snn", weights=snn_file).update(np.zeros((1, 2)), np.zeros((1, 3)))


def test_the_skip_connection_alone_is_a_leaky_integrator_of_the_inputs(tmp_path):
    config = NetworkConfig(model="att-snn", output_scale=1 / 256, encoding=9, hidden=8)
    tensors = {name: np.zeros(shape, np.int16) for name, shape in expected_shapes(config).items()}
    for name in tensors:
        if not name.startswith("w_"):
            tensors[name][:] = 64
    tensors["w_skip"][0, 0], tensors["w_skip"][1, 4] = 4096, -2048
    save_network(tmp_path / "w", config, tensors)
    est = create_network("att-snn-loihi", weights=tmp_path / "w")
    gyro, accel = np.zeros((1, 400, 3)), np.tile([0.0, 0.5, 9.81], (1, 400, 1))
    gyro[..., 0] = 0.25
    left = 1 - 64 / 4096
    grown = (1 - left ** np.arange(1, 401)) / (1 - left) / 256  # of an input of 1.0, in radians
    roll, pitch = est.sequence(gyro, accel)[0].T
    np.testing.assert_allclose(roll, 0.1 * grown, rtol=0.01)
    np.testing.assert_allclose(pitch, -0.25 * grown, rtol=0.01)


def test_files_of_before_the_skip_connection_are_read(snn_file, tmp_path):
    config, tensors = load_network(snn_file)
    old = {name: value for name, value in tensors.items() if "skip" not in name}
    save_file(old, tmp_path / "old", metadata={"config": config.model_dump_json()})
    found = load_network(tmp_path / "old")[1]
    assert not found["w_skip"].any()
    assert parameters(found) == parameters(old)


@pytest.mark.parametrize("delay", [1, 2])
def test_network_in_floats_equals_the_pytorch_loop(tmp_path, delay):
    config = NetworkConfig(model="att-snn", quantised=False, encoding=12, hidden=9, recurrent_delay=delay)
    rng = np.random.default_rng(0)
    tensors = {
        name: rng.normal(0, 0.5, shape) if name.startswith("w_") else rng.uniform(0.3, 0.95, shape)
        for name, shape in expected_shapes(config).items()
    }
    save_network(tmp_path / "w", config, tensors)
    gyro, accel = samples(2, 100)
    weights = Weights(*(torch.tensor(tensors[name]) for name in Weights._fields))
    x = torch.tensor(scaled_inputs(config.inputs, config.rate_hz, gyro, accel)[0])
    expected, _, hidden = forward(x, weights, recurrent_delay=delay)
    assert hidden.mean() > 0.05
    est = create_network("att-snn", weights=tmp_path / "w")
    est.reset(2)
    np.testing.assert_allclose(est.sequence(gyro, accel), expected, atol=1e-10)
    with pytest.raises(ValueError, match="needs quantised weights"):
        create_network("att-snn-loihi", weights=tmp_path / "w")


def test_the_bias_of_the_gyro_is_taken_off():
    inputs = InputScaling(bias_sd=0.05)
    accel = np.tile([0.0, 0.0, 9.81], (1, 6000, 1))
    rate = 0.3 * np.sin(np.arange(6000) / 50)[None, :, None] * (1, 1, 1)
    clean = scaled_inputs(InputScaling(), 200.0, rate, accel)[0]
    bias = np.array([0.07, -0.05, 0.0])
    found = scaled_inputs(inputs, 200.0, rate + bias, accel)[0]
    np.testing.assert_allclose(found[:, 4000:], clean[:, 4000:], atol=0.01)
    assert np.abs(found[:, 0] - clean[:, 0]).max() > 0.02  # the first sample knows nothing yet
    tumbling = scaled_inputs(inputs, 200.0, np.full_like(rate, 3.0), accel)[0]
    assert tumbling[..., :2].min() > (3.0 - BIAS_MAX - 0.01) / 2.5  # no manoeuvre is taken for a bias


def test_the_change_of_a_lateral_force_is_brought_out():
    inputs = InputScaling(accel=(1.0, 1.0, 4.0), lead=4.0, lead_samples=(5, 100))
    steps = np.arange(1000)
    accel = np.zeros((1, 1000, 3))
    accel[0, :, 0] = 0.5 + (steps >= 200)  # m/s²
    accel[0, :, 2] = 9.81 + (steps >= 200)
    x = scaled_inputs(inputs, 200.0, np.zeros_like(accel), accel)[0]
    fast = lfilter([1 / 5], [1, -4 / 5], accel[0, :, 0] - 0.5)
    slow = lfilter([1 / 100], [1, -99 / 100], fast)
    np.testing.assert_allclose(x[0, :, 3], accel[0, :, 0] + 4.0 * (fast - slow), atol=1e-3)
    np.testing.assert_allclose(x[0, 200:, 5], 0.25, atol=1e-3)
    accel[0, 500, 0] = 1000.0  # one bad reading
    bad = scaled_inputs(inputs, 200.0, np.zeros_like(accel), accel)[0]
    assert np.abs(bad - x)[0, 501:].max() <= 4.0 * LEAD_CLIP / 5 + 1e-3
    accel[0, :, 0] = np.sin(2 * np.pi * 73.0 * steps / 200)  # the rotors' vibration is not
    shaken = scaled_inputs(inputs, 200.0, np.zeros_like(accel), accel)[0]
    assert np.abs(shaken[0, 100:, 3]).max() < 1.6


@pytest.mark.parametrize(
    "inputs",
    [
        {"bias_sd": 0.02, "align_s": 0.0},
        {"bias_sd": 0.02, "yaw_free": True},
        {"lead": 4.0, "align_s": 0.6},
        {"yaw_free": True},
    ],
)
def test_what_the_encoder_keeps_is_the_same_streamed_carried_and_on_loihi(inputs):
    config, tensors = shipped_network("att-snn")
    config = config.model_copy(update={"inputs": config.inputs.model_copy(update=inputs)})
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0.05, 0.3, (2, 400, 3)), rng.normal((0, 0, 9.81), 0.5, (2, 400, 3))
    whole, headings = scaled_inputs(config.inputs, 200.0, gyro, accel)
    held = np.zeros((2, HELD))
    parts = [
        scaled_inputs(config.inputs, 200.0, gyro[:, k : k + 100], accel[:, k : k + 100], held)
        for k in (0, 100)
    ]
    for several, one in zip(zip(*parts, strict=True), (whole, headings), strict=True):
        np.testing.assert_array_equal(np.concatenate(several, axis=1), one[:, :200])
    outs = []
    for core in (Spiking(config, tensors), OnLoihi(config, tensors)):
        est = NetworkEstimator(core, 200.0)
        est.reset(2)
        outs.append(est.sequence(gyro, accel))
        est.reset(2)
        np.testing.assert_array_equal(
            np.stack([est.update(gyro[:, t], accel[:, t]) for t in range(50)], axis=1), outs[-1][:, :50]
        )
    np.testing.assert_array_equal(*outs)


def test_robust_weights_suffer_less_from_a_bias_of_four_degrees_a_second(tmp_path):
    config = flight_config(load_recipe("gentle"))
    flown = open_dataset(generate(config, 2, 60.0, tmp_path / "x.zarr", seed=9, workers=1))
    gyro, accel, quat = (flown[name].to_numpy().astype(float) for name in ("gyro", "accel", "quat"))
    truth, bias = roll_pitch_from_quat(quat), np.radians([4.1, -1.2, -1.6])
    errors = {}
    for name in ("att-snn-robust", "att-snn-loihi"):
        est = create_network(name)
        est.reset(2)
        errors[name] = inclination_rmse(est.sequence(gyro + bias, accel), truth).mean
    assert errors["att-snn-robust"] < 0.9 * errors["att-snn-loihi"], errors


def test_weights_of_another_version_name_the_setting_that_is_not_known(tmp_path):
    config, tensors = shipped_network("att-snn")
    about = config.model_dump(mode="json")
    about["inputs"]["align_second"] = 1.0
    save_file(tensors, tmp_path / "w.safetensors", metadata={"config": json.dumps(about)})
    with pytest.raises(
        ValueError, match=r'another version of quadsim: unknown key "inputs.align_second"; did'
    ):
        load_network(tmp_path / "w.safetensors")
