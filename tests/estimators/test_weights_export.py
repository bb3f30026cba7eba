"""Exported networks against the ones that fly, run by a C compiler, Norse, snnTorch and ONNX Runtime."""

import numpy as np
import pytest
import torch
from c_export import SAMPLES, built, hard_readings
from controllers import CONFIG, random_snn, samples
from plain_network import Plain

from estimators.control.controller import SpikingController
from estimators.export.formats import export_weights
from estimators.networks.encoder import scaled_inputs
from estimators.networks.forward import OnLoihi, real_weights
from estimators.networks.gru import Recurrent
from estimators.networks.layer_parameters import Weights
from estimators.networks.network import NetworkEstimator
from estimators.networks.weights_file import NetworkConfig, load_network, save_network


def state_of(config):
    neuron = [("u", np.int32), ("v", np.int32)]
    spikes = [("encoding_spikes", np.uint16), ("hidden_spikes", np.uint16)]
    fired = [("encoding_fired", np.uint16, config.encoding), ("hidden_fired", np.uint16, config.hidden)]
    layers = [
        ("encoding", np.dtype(neuron), config.encoding),
        ("hidden", np.dtype(neuron), config.hidden),
        ("output", np.dtype(neuron), config.n_outputs),
    ]
    thrust = [("thrust", float)] * config.controls
    counts = [("skipped", np.uint32), ("age", np.int32), ("good", np.int32)]
    fields = [("input", np.int32, config.n_inputs), *layers, *spikes, *fired, *counts, *thrust]
    return np.dtype(fields, align=True)


@pytest.fixture
def compiled(tmp_path):
    """Compile the export of a network: a function from samples (T, ·) to an array of states and outputs."""

    def build(weights, config):
        source = export_weights(weights, tmp_path / "c", "c99")
        name, outputs = ("snn_control", 4) if config.controls else ("att_snn", config.n_outputs)
        layout = np.dtype([("state", state_of(config)), ("outputs", float, outputs)])
        return built(source, name, layout, *["-DCONTROLLER"] * config.controls)

    return build


def fired(state, layer, size):
    found = np.zeros(size, np.uint8)
    found[state[f"{layer}_fired"][: state[f"{layer}_spikes"]]] = 1
    return found


def assert_states_equal(theirs, est, config, label):
    h0, h1, last = config.encoding, config.hidden, -config.n_outputs
    ours, spikes = est.states[0], est.core.spikes(est.states)[0]
    u, v = ours["u"], np.where(spikes, 0, ours["v"])
    pairs = {
        "u0": (theirs["encoding"]["u"], ours["current"]),
        "v0": (theirs["encoding"]["v"], v[:h0]),
        "u1": (theirs["hidden"]["u"], u[:last]),
        "v1": (theirs["hidden"]["v"], v[h0:last]),
        "u2": (theirs["output"]["u"], u[last:]),
        "v2": (theirs["output"]["v"], v[last:]),
        "s0": (fired(theirs, "encoding", h0), spikes[:h0]),
        "s1": (fired(theirs, "hidden", h1), spikes[h0:last]),
        "input": (theirs["input"][:6], ours["inputs"][:6]),
        "skipped": (theirs["skipped"], ours["missing"]),
    }
    for name, (a, b) in pairs.items():
        np.testing.assert_array_equal(a, b, err_msg=f"{name} at {label}")


def saved(path, config, seed=1):
    """Random weights and their file."""
    tensors = random_snn(config, seed)
    save_network(path / "w.safetensors", config, tensors)
    return tensors, path / "w.safetensors"


ESTIMATOR = NetworkConfig(model="att-snn", encoding=37, hidden=23, output_scale=0.003)
CONTROLLER = CONFIG.model_copy(update={"encoding": 41, "hidden": 35})


@pytest.mark.parametrize(
    ("config", "seed"), [(None, 0), (ESTIMATOR, 0), (ESTIMATOR, 1), (CONTROLLER, 0), (CONTROLLER, 1)]
)
def test_c_source_equals_the_emulator_in_every_state_of_every_step(compiled, tmp_path, config, seed):
    if config is None:
        config, tensors = load_network(weights := "att-snn-paper")
    else:
        tensors, weights = saved(tmp_path, config, seed)
    readings, rng = hard_readings(seed), np.random.default_rng(seed)
    wanted = rng.normal([0.0, 0.0, 0.0, 9.81], [0.5, 0.5, 2.0, 3.0], (SAMPLES, 4))
    wanted[50:60, 0], wanted[70:80, 3], wanted[100, 2], wanted[120, 3] = np.nan, np.nan, 1e9, -np.inf
    readings = np.hstack([wanted, readings]) if config.controls else readings
    states = compiled(weights, config)(readings)
    if config.controls:
        ours = SpikingController(config, tensors, on_loihi=True)
    else:
        ours = NetworkEstimator(OnLoihi(config, tensors), config.rate_hz)
    ours.reset(1)
    for t, (theirs, outputs) in enumerate(states):
        out = ours.sequence(*np.split(readings[None, t : t + 1], [4, 7] if config.controls else [3], axis=2))
        assert_states_equal(theirs, ours, config, t)
        np.testing.assert_array_equal(outputs, out[0, 0], err_msg=f"outputs at {t}")
    for layer, size in (("encoding", config.encoding), ("hidden", config.hidden)):
        assert states["state"][f"{layer}_spikes"].mean() > 0.01 * size


def norse_network(graph):
    norse = pytest.importorskip("norse.torch", reason="Norse is not installed")
    return norse.from_nir(graph, dt=float(graph.metadata["dt"])), lambda state: state.cache["06_hidden"]


def snntorch_network(graph):
    """SnnTorch as it comes; its spikes are float32."""
    reader = pytest.importorskip("snntorch.import_nir", reason="snnTorch is not installed")
    return reader.import_from_nir(graph), lambda state: state["06_hidden_prev_output"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("tool", "name"),
    [
        *((norse_network, name) for name in ("att-snn-paper", "random")),
        *((snntorch_network, name) for name in ("att-snn-paper", "control-attitude")),
    ],
)
def test_a_nir_file_spikes_in_other_tools_as_the_network_in_floats(tmp_path, hummingbird, tool, name):
    """Chains deliver within a step there: hidden spikes come a step early, outputs two."""
    nir = pytest.importorskip("nir")
    random = NetworkConfig(model="att-snn", encoding=40, hidden=30)
    weights = saved(tmp_path, random)[1] if name == "random" else name
    config, tensors = load_network(weights)
    network, spikes_of = tool(nir.read(export_weights(weights, tmp_path / "snn.nir", "nir")))
    flown = hummingbird.map(lambda each: each[:1, :400])
    x = torch.tensor(scaled_inputs(config.inputs, flown.gyro, flown.accel))
    x = torch.cat([x, torch.zeros(*x.shape[:2], config.n_inputs - x.shape[2])], 2)
    plain = Plain(quantised=False)
    outputs, _ = plain.forward(x, Weights(*map(torch.tensor, real_weights(config, tensors))))
    _, hidden = plain.spikes()
    state, found, spikes = None, [], []
    with torch.no_grad():
        for sample in x.float().unbind(1):
            out, state = network(sample, state)
            found.append(out)
            spikes.append(spikes_of(state))
    assert hidden.mean() > 0.02
    np.testing.assert_array_equal(torch.stack(spikes, 1)[:, :-1], hidden[:, 1:])
    size = float(outputs.abs().max())
    np.testing.assert_allclose(torch.stack(found, 1)[:, :-2], outputs[:, 2:], atol=1e-6 * size, rtol=0)


def node_of(graph, name):
    return next(node for key, node in graph.nodes.items() if key[3:] == name)


@pytest.mark.parametrize("config", [CONFIG, NetworkConfig(model="att-snn", encoding=9, hidden=8)])
def test_nir_graph_says_what_its_inputs_and_outputs_are(tmp_path, config):
    nir = pytest.importorskip("nir")
    graph = nir.read(export_weights(saved(tmp_path, config)[1], tmp_path / "snn.nir", "nir"))
    np.testing.assert_array_equal(node_of(graph, "input").input_type["input"], [config.n_inputs])
    np.testing.assert_array_equal(node_of(graph, "finish").input_type["input"], [config.n_outputs])
    assert graph.metadata["outputs"] == config.outputs
    assert ("set_point_gain_1024" in graph.metadata) == config.controls


def test_nir_graph_carries_the_integers_of_the_chip(tmp_path):
    """What the nodes compute, other tools run above."""
    nir = pytest.importorskip("nir")
    _, tensors = load_network("control-attitude")
    graph = nir.read(export_weights("control-attitude", tmp_path / "snn.nir", "nir"))
    for name, key, tensor in (
        *((name, "mantissa", name) for name in ("w_in", "w_ff", "w_rec", "w_out")),
        ("w_ff", "exponent", "exp_ff"),
        ("w_rec", "exponent", "exp_rec"),
        ("encoding", "du", "syn0"),
        ("encoding", "dv", "mem0"),
        ("current_decay", "du", "syn1"),
        ("hidden", "dv", "mem1"),
        ("output_current_decay", "du", "syn2"),
        ("output_decay", "dv", "mem2"),
    ):
        np.testing.assert_array_equal(node_of(graph, name).metadata[key], tensors[tensor], f"{name} {key}")


def test_onnx_runtime_computes_the_network(tmp_path):
    name = "att-rnn-paper"
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(export_weights(name, tmp_path / "rnn.onnx", "onnx"))
    config, tensors = load_network(name)
    readings = dict(zip(("gyro", "accel"), samples(2, 300, force=1.0), strict=True))
    est = NetworkEstimator(Recurrent(config, tensors), config.rate_hz)
    est.reset(2)
    expected = est.outputs(**readings)
    states = {f"h{k}": np.zeros((1, 2, 100), np.float32) for k in (0, 1)}
    parts = []
    for part in np.split(np.arange(300), [100, 101]):  # whole windows and a single sample alike
        feed = {key: each[:, part].swapaxes(0, 1).astype(np.float32) for key, each in readings.items()}
        found, *hidden = session.run(None, feed | states)
        states = dict(zip(states, hidden, strict=True))
        parts.append(found.swapaxes(0, 1))
    # A reading within a rounding error of half a step of 1/1024 may be rounded the other way in float32.
    np.testing.assert_allclose(np.concatenate(parts, 1), expected, atol=2e-4)


def test_what_cannot_be_exported_is_refused(tmp_path):
    for weights, format, message in (
        ("att-rnn-paper", "c99", "weights of att-rnn are exported as onnx"),
        ("att-rnn-paper", "nir", "weights of att-rnn are exported as onnx"),
        ("att-snn-paper", "onnx", "weights of att-snn are exported as nir or c99"),
        ("att-snn-paper", "csv", 'unknown format "csv"; weights of att-snn are exported as nir or c99'),
    ):
        with pytest.raises(ValueError, match=message):
            export_weights(weights, tmp_path / "x", format)
    with pytest.raises(FileNotFoundError, match="no such weights file"):
        export_weights("missing.safetensors", tmp_path / "x", "nir")
    with pytest.raises(ValueError, match="exists already"):
        export_weights("att-snn-paper", tmp_path, "c99")


def test_the_c_header_names_what_comes_in_and_the_scale_of_what_goes_out(tmp_path):
    export_weights("att-snn-paper", tmp_path / "c", "c99")
    header = (tmp_path / "c" / "att_snn.h").read_text()
    assert f"#define ATT_SNN_UNITS_PER_RADIAN {2**14}\n" in header
    config = NetworkConfig(model="att-snn", encoding=5, hidden=7, output_scale=1 / 256)
    header = export_weights(saved(tmp_path, config)[1], tmp_path / "rp", "c99") / "att_snn.h"
    assert f"#define ATT_SNN_UNITS_PER_RADIAN {256 * 2**14}\n" in header.read_text()
    assert "#define ATT_SNN_OUTPUTS 2\n" in header.read_text()
