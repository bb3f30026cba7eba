"""Exported networks against the ones that fly, run by a C compiler, by Norse and by ONNX Runtime."""

import importlib
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from estimators.control.controller import SpikingController
from estimators.export.formats import export_weights
from estimators.networks.encoder import scaled_inputs
from estimators.networks.network import NetworkEstimator, OnLoihi, Recurrent, real_weights
from estimators.networks.weights_file import (
    EXPONENTS,
    NetworkConfig,
    SetPointScaling,
    expected_shapes,
    exponents,
    load_network,
    save_network,
    shipped_controllers,
    shipped_network,
)
from estimators.spiking import Weights, forward


def random_snn(config, seed=0):
    rng = np.random.default_rng(seed)
    tensors = {
        name: (2 * rng.integers(-60, 61, shape)).astype(np.int16)
        if name.startswith("w_")
        else rng.integers(1, 2000, shape).astype(np.int16)
        for name, shape in expected_shapes(config).items()
    }
    return tensors | {
        exponent: rng.integers(-6 * (seed % 2), 1, config.hidden).astype(np.int16)
        for name, exponent in EXPONENTS.items()
        if name in tensors
    }


def readings(steps, seed=0):
    """Hard ones: steps, saturation, missing samples, a rest."""
    rng = np.random.default_rng(seed)
    gyro = rng.normal(0, 1.5, (steps, 3)) + np.repeat(rng.normal(0, 2, (steps // 50 + 1, 3)), 50, 0)[:steps]
    accel = rng.normal([0, 0, 9.81], 3.0, (steps, 3))
    gyro[100:110, 1], accel[200, 0], accel[300:320], gyro[400], accel[500] = np.nan, np.inf, 0.0, 1e9, -1e9
    gyro[3000:3400], accel[3000:3400] = (0.05, -0.02, 0.01), (0.4, -0.3, 9.8)
    return gyro, accel


def state_of(config):
    """The layout of an exported network's state in memory."""
    neuron = [("u", np.int32), ("v", np.int32)]
    spikes = [("encoding_spikes", np.uint16), ("hidden_spikes", np.uint16)]
    fired = [("encoding_fired", np.uint16, config.encoding), ("hidden_fired", np.uint16, config.hidden)]
    layers = [
        ("encoding", np.dtype(neuron), config.encoding),
        ("hidden", np.dtype(neuron + [("a", np.int32)] * config.after_spike), config.hidden),
        ("output", np.dtype(neuron), config.n_outputs),
    ]
    thrust = [("thrust", float)] * config.controls
    fields = [("input", np.int32, config.n_inputs), *layers, *spikes, *fired, ("skipped", np.uint32), *thrust]
    return np.dtype(fields, align=True)


@pytest.fixture
def compiled(tmp_path, request):
    """Compile the export of a network, strictly: a function from samples (T, ·) to an array of states."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")

    def build(weights, config):
        export_weights(weights, tmp_path / "c", "c99")
        driver = request.path.parents[1] / "data" / "loihi" / "driver.c"
        name, outputs = ("snn_control", 4) if config.controls else ("att_snn", config.n_outputs)
        flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{tmp_path / 'c'}"]
        flags += ["-DCONTROLLER"] * config.controls
        sources = [str(tmp_path / "c" / f"{name}.c"), str(driver)]
        subprocess.run(["cc", *flags, *sources, "-o", str(tmp_path / "run")], check=True)
        layout = np.dtype([("state", state_of(config)), ("outputs", float, outputs)])

        def run(samples):
            done = subprocess.run(
                [tmp_path / "run"], input=samples.tobytes(), capture_output=True, check=True
            )
            return np.frombuffer(done.stdout, layout)

        return run

    return build


def fired(state, layer, size):
    """Which neurons of a layer spiked, as the emulator has it."""
    found = np.zeros(size, np.uint8)
    found[state[f"{layer}_fired"][: state[f"{layer}_spikes"]]] = 1
    return found


def next_after_spike(ours, config, tensors):
    """After-spike currents of the next step, which the C code already has; see estimators.loihi.neurons."""
    hidden = slice(config.encoding, -config.n_outputs)
    own = tensors["w_after"][:, 0].astype(int) << (6 + exponents(tensors, "w_after"))
    left = np.fix(ours["a"][hidden] * (4096.0 - tensors["syn_after"]) / 4096.0)
    return left + own * ours["spikes"][hidden]


def assert_states_equal(theirs, ours, config, tensors, label):
    """The C code's state is the emulator's."""
    h0, h1, last = config.encoding, config.hidden, -config.n_outputs
    encoder, u, v, spikes = (ours[name] for name in ("encoder", "u", "v", "spikes"))
    pairs = {
        "u0": (theirs["encoding"]["u"], ours["current"]),
        "v0": (theirs["encoding"]["v"], v[:h0]),
        "u1": (theirs["hidden"]["u"], u[h0:last]),
        "v1": (theirs["hidden"]["v"], v[h0:last]),
        "u2": (theirs["output"]["u"], u[last:]),
        "v2": (theirs["output"]["v"], v[last:]),
        "s0": (fired(theirs, "encoding", h0), spikes[:h0]),
        "s1": (fired(theirs, "hidden", h1), spikes[h0:last]),
        "input": (theirs["input"][:6], encoder["inputs"]),
        "skipped": (theirs["skipped"], encoder["missing"]),
    }
    if config.after_spike:
        pairs["a1"] = theirs["hidden"]["a"], next_after_spike(ours, config, tensors)
    for name, (a, b) in pairs.items():
        np.testing.assert_array_equal(a, b, err_msg=f"{name} at {label}")


@pytest.mark.parametrize(
    ("seed", "outputs", "after_spike"),
    [(None, "", False), (0, "roll-pitch", False), (1, "roll-pitch", False), (1, "up", True)],
)
def test_c_source_equals_the_emulator_in_every_state_of_every_step(
    compiled, tmp_path, seed, outputs, after_spike
):
    if seed is None:
        config, tensors = shipped_network("att-snn")
        weights = "att-snn"
    else:
        scale = 1 / 256 if seed else 0.003
        config = NetworkConfig(
            model="att-snn",
            encoding=37,
            hidden=23,
            steps_per_sample=1 + seed,
            outputs=outputs,
            output_scale=scale,
            after_spike=after_spike,
        )
        tensors, weights = random_snn(config, seed), tmp_path / "w.safetensors"
        save_network(weights, config, tensors)
    gyro, accel = readings(4000)
    states = compiled(weights, config)(np.concatenate([gyro, accel], 1))
    est = NetworkEstimator(OnLoihi(config, tensors), config.rate_hz)
    for t, (theirs, attitude) in enumerate(states):
        out = est.update(gyro[t : t + 1], accel[t : t + 1])
        assert_states_equal(theirs, est.states[0], config, tensors, t)
        ours = out[0] if est.up is None else est.up[0]
        np.testing.assert_array_equal(attitude, ours, err_msg=f"outputs at {t}")
    assert states["state"]["encoding_spikes"].mean() > 0.01 * config.encoding
    assert states["state"]["hidden_spikes"].mean() > 0.01 * config.hidden


@pytest.mark.parametrize("seed", [0, 1])
def test_a_controllers_c_source_equals_the_emulator_in_every_state_of_every_step(compiled, tmp_path, seed):
    config = NetworkConfig(
        model="att-snn",
        encoding=41,
        hidden=35,
        after_spike=bool(seed),
        outputs="angular-acceleration",
        output_scale=20.0,
        set_point=SetPointScaling(bound=30.0),
    )
    tensors, weights = random_snn(config, seed), tmp_path / "w.safetensors"
    save_network(weights, config, tensors)
    rng = np.random.default_rng(seed)
    gyro, accel = readings(3000)
    wanted = rng.normal([0.0, 0.0, 0.0, 9.81], [0.5, 0.5, 2.0, 3.0], (3000, 4))
    wanted[50:60, 0], wanted[70:80, 3], wanted[100, 2], wanted[120, 3] = np.nan, np.nan, 1e9, -np.inf
    states = compiled(weights, config)(np.concatenate([wanted, gyro, accel], 1))
    controller = SpikingController(config, tensors, on_loihi=True)
    controller.reset(1)
    for t, (theirs, action) in enumerate(states):
        out = controller.update(wanted[t : t + 1], gyro[t : t + 1], accel[t : t + 1])
        assert_states_equal(theirs, controller.states[0], config, tensors, t)
        np.testing.assert_array_equal(action, out[0], err_msg=f"action at {t}")
    assert states["state"]["hidden_spikes"].mean() > 0.01 * config.hidden


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_nir_graph_spikes_in_norse_as_it_does_here(tmp_path, monkeypatch):
    """Chains deliver within a step in Norse: its hidden layer is one step ahead.

    Norse undoes the gains of its inputs with rounding errors, which would decide where a potential equals the
    threshold: it reads the graph in float64 here, with thresholds higher by far less than a weight.
    """
    nir = pytest.importorskip("nir")
    norse = pytest.importorskip("norse.torch", reason="Norse is not installed")
    torch = pytest.importorskip("torch")
    reader = importlib.import_module("norse.torch.utils.import_nir")
    monkeypatch.setattr(reader, "_to_tensor", lambda x: torch.as_tensor(x, dtype=torch.float64))
    gyro, accel = readings(600)
    rates = []
    own = NetworkConfig(model="att-snn", encoding=40, hidden=40, outputs="up", output_scale=1 / 256)
    save_network(tmp_path / "own.safetensors", own, random_snn(own, 1))
    for weights in ("att-snn-paper", tmp_path / "own.safetensors"):  # it reads no after-spike currents
        config, tensors = load_network(weights)
        graph = nir.read(export_weights(weights, tmp_path / f"{Path(weights).stem}.nir", "nir"))
        # Norse's reader leaves the leaky integrators out: the spikes are the graph's output here.
        spiking = ("input", "w_in", "encoding", "w_ff", "w_rec", "hidden")
        nodes = {name: graph.nodes[name] for name in spiking}
        nodes["finish"] = nir.Output({"output": np.array([config.hidden])})
        edges = [edge for edge in graph.edges if set(edge) <= set(nodes)] + [("hidden", "finish")]
        for name in ("encoding", "hidden"):
            nodes[name].v_threshold += 1e-11
        net = norse.from_nir(nir.NIRGraph(nodes, edges), dt=float(graph.metadata["dt"])).double()
        x = torch.tensor(scaled_inputs(config.inputs, gyro[None], accel[None]))
        _, _, hidden = forward(x, Weights(*map(torch.tensor, real_weights(config, tensors))))
        state, spikes = None, []
        with torch.no_grad():
            for t in range(x.shape[1]):
                spike, state = net(x[:, t], state)
                spikes.append(spike)
        rates.append(float(hidden.mean()))
        np.testing.assert_array_equal(torch.stack(spikes, 1)[:, :-1], hidden[:, 1:])
    assert np.mean(rates) > 0.1


@pytest.mark.parametrize("name", shipped_controllers())
def test_nir_graph_of_a_controller_has_its_set_points_as_inputs(tmp_path, name):
    nir = pytest.importorskip("nir")
    _, tensors = shipped_network(name)
    graph = nir.read(export_weights(name, tmp_path / "control.nir", "nir"))
    np.testing.assert_array_equal(graph.nodes["input"].input_type["input"], [9])
    np.testing.assert_array_equal(graph.nodes["w_in"].metadata["mantissa"], tensors["w_in"])
    assert graph.metadata["set_point_gain_1024"].shape == (3,)


def test_nir_graph_carries_the_integers_of_the_chip(tmp_path):
    nir = pytest.importorskip("nir")
    _, tensors = shipped_network("att-snn")
    graph = nir.read(export_weights("att-snn", tmp_path / "snn.nir", "nir"))
    for name in ("w_in", "w_ff", "w_rec", "w_out"):
        node = graph.nodes[name]
        mantissa, exponent = node.metadata["mantissa"], node.metadata["exponent"]
        np.testing.assert_array_equal(mantissa, tensors[name])
        np.testing.assert_array_equal(node.weight, mantissa * np.exp2(exponent - 8.0)[:, None])
    decays = {
        ("encoding", "du", "tau_syn"): "syn0",
        ("encoding", "dv", "tau_mem"): "mem0",
        ("synapse", "du", "tau"): "syn1",
        ("after", "du", "tau"): "syn_after",
        ("hidden", "dv", "tau"): "mem1",
    }
    for (name, decay, tau), tensor in decays.items():
        node = graph.nodes[name]
        np.testing.assert_array_equal(node.metadata[decay], tensors[tensor])
        np.testing.assert_allclose(4096 * graph.metadata["dt"] / getattr(node, tau), tensors[tensor])
    assert type(graph.nodes["output"]).__name__ == "CubaLI"


def test_nir_graph_of_a_network_that_estimates_up_has_three_outputs(tmp_path):
    nir = pytest.importorskip("nir")
    config = NetworkConfig(model="att-snn", encoding=5, hidden=7, outputs="up", output_scale=1 / 256)
    tensors = random_snn(config)
    save_network(tmp_path / "w.safetensors", config, tensors)
    graph = nir.read(export_weights(tmp_path / "w.safetensors", tmp_path / "snn.nir", "nir"))
    np.testing.assert_array_equal(graph.nodes["w_out"].weight * 256, tensors["w_out"])
    assert graph.nodes["output"].tau_mem.shape == (3,)
    assert graph.nodes["finish"].input_type["input"] == [3]
    assert graph.metadata["outputs"] == "up"


def euler_steps(graph, x):
    """Potentials of the outputs of a NIR graph, by Euler steps of its equations, (T, outputs).

    A loop delivers after a step, everything else within it.
    """
    nodes, dt = graph.nodes, float(graph.metadata["dt"])
    order = [
        *("w_in", "encoding", "w_ff", "w_rec", "synapse", "w_after", "after", "hidden", "w_out", "output")
    ]
    out, state, values = [], {name: 0.0 for name in order}, {"hidden": np.zeros(len(nodes["hidden"].tau))}
    currents = {}
    for sample in x:
        values["input"] = sample
        for name in order:
            node, drive = nodes[name], sum(values[a] for a, b in graph.edges if b == name)
            if hasattr(node, "weight"):
                values[name] = node.weight @ drive
            elif hasattr(node, "scale"):
                values[name] = node.scale * drive
            else:
                if hasattr(node, "tau_syn"):
                    rate = dt / node.tau_syn
                    drive = currents[name] = (1 - rate) * currents.get(name, 0.0) + rate * node.w_in * drive
                rate = dt / (node.tau_mem if hasattr(node, "tau_mem") else node.tau)
                v = (1 - rate) * state[name] + rate * node.r * drive
                threshold = getattr(node, "v_threshold", np.inf)
                values[name] = v if np.isinf(threshold).all() else (v > threshold + 1e-11).astype(float)
                state[name] = np.where(v > threshold + 1e-11, 0.0, v)
        out.append(state["output"])
    return np.array(out)


def test_nir_graph_with_after_spike_currents_is_the_same_network(tmp_path):
    nir = pytest.importorskip("nir")
    config = NetworkConfig(
        model="att-snn", encoding=9, hidden=7, outputs="up", output_scale=1 / 256, after_spike=True
    )
    tensors = random_snn(config, 1)
    save_network(tmp_path / "w.safetensors", config, tensors)
    graph = nir.read(export_weights(tmp_path / "w.safetensors", tmp_path / "snn.nir", "nir"))
    np.testing.assert_array_equal(graph.nodes["w_after"].metadata["mantissa"], tensors["w_after"][:, 0])
    np.testing.assert_array_equal(graph.nodes["after"].metadata["du"], tensors["syn_after"])
    gyro, accel = readings(600)
    x = scaled_inputs(config.inputs, gyro[None], accel[None])
    out, _, hidden = forward(torch.tensor(x), Weights(*map(torch.tensor, real_weights(config, tensors))))
    assert hidden.mean() > 0.02
    found = euler_steps(graph, x[0])
    np.testing.assert_allclose(found[:-2], out[0, 2:].numpy(), atol=1e-8)


def test_onnx_graph_of_a_network_that_estimates_up_has_three_outputs(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    config, tensors = shipped_network("att-rnn")
    session = runtime.InferenceSession(export_weights("att-rnn", tmp_path / "rnn.onnx", "onnx"))
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1, (50, 1, 3)), rng.normal([0, 0, 9.8], 1.0, (50, 1, 3))
    feed = {"gyro": gyro.astype(np.float32), "accel": accel.astype(np.float32)}
    feed |= {f"h{k}": np.zeros((1, 1, 100), np.float32) for k in (0, 1)}
    (up,) = session.run(["up"], feed)
    est = NetworkEstimator(Recurrent(config, tensors), config.rate_hz)
    for t in range(50):
        est.update(gyro[t], accel[t])
        np.testing.assert_allclose(up[t], est.up, atol=2e-4)


def test_onnx_runtime_estimates_as_the_network_here(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(export_weights("att-rnn-paper", tmp_path / "rnn.onnx", "onnx"))
    config, tensors = shipped_network("att-rnn-paper")
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1, (2, 300, 3)), rng.normal([0, 0, 9.8], 1.0, (2, 300, 3))
    est = NetworkEstimator(Recurrent(config, tensors), config.rate_hz)
    est.reset(2)
    expected = est.sequence(gyro, accel)
    states = {f"h{k}": np.zeros((1, 2, 100), np.float32) for k in (0, 1)}
    parts = []
    for part in np.split(np.arange(300), [100, 101]):  # whole windows and a single sample alike
        feed = {
            name: each[:, part].transpose(1, 0, 2).astype(np.float32)
            for name, each in (("gyro", gyro), ("accel", accel))
        }
        roll_pitch, h0, h1 = session.run(None, feed | states)
        states = {"h0": h0, "h1": h1}
        parts.append(roll_pitch.transpose(1, 0, 2))
    # A reading within a rounding error of half a step of 1/1024 may be rounded the other way in float32.
    np.testing.assert_allclose(np.concatenate(parts, 1), expected, atol=2e-4)


def test_what_cannot_be_exported_is_refused(tmp_path):
    for weights, format, message in (
        ("att-rnn", "c99", "weights of att-rnn are exported as onnx"),
        ("att-rnn", "nir", "weights of att-rnn are exported as onnx"),
        ("att-snn", "onnx", "weights of att-snn are exported as nir or c99"),
        ("att-snn", "csv", 'unknown format "csv"; weights of att-snn are exported as nir or c99'),
    ):
        with pytest.raises(ValueError, match=message):
            export_weights(weights, tmp_path / "x", format)
    with pytest.raises(FileNotFoundError, match="no such weights file"):
        export_weights("missing.safetensors", tmp_path / "x", "nir")
    with pytest.raises(ValueError, match="exists already"):
        export_weights("att-snn", tmp_path, "c99")


def test_the_c_header_names_the_scale_of_its_output(tmp_path):
    export_weights("att-snn", tmp_path / "c", "c99")
    header = (tmp_path / "c" / "att_snn.h").read_text()
    scale = OnLoihi(*shipped_network("att-snn")).scale
    assert f"#define ATT_SNN_UNITS_PER_ONE {round(1 / scale)}\n" in header
    assert "#define ATT_SNN_OUTPUTS 3\n" in header
    config = NetworkConfig(model="att-snn", encoding=5, hidden=7, output_scale=1 / 256)
    save_network(tmp_path / "w.safetensors", config, random_snn(config))
    export_weights(tmp_path / "w.safetensors", tmp_path / "rp", "c99")
    header = (tmp_path / "rp" / "att_snn.h").read_text()
    assert f"#define ATT_SNN_UNITS_PER_RADIAN {256 * 2**14}\n" in header
    assert "#define ATT_SNN_OUTPUTS 2\n" in header


def test_weights_of_a_type_that_numpy_lacks_are_one_line(tmp_path):
    _, tensors = shipped_network("att-snn")
    path = tmp_path / "x.safetensors"
    half = {
        name: torch.as_tensor(each.astype(np.float32)).to(torch.bfloat16) for name, each in tensors.items()
    }
    save_file(half, path, metadata={"format": "2", "config": "{}"})
    with pytest.raises(ValueError, match=r"x\.safetensors"):
        load_network(path)
