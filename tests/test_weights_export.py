"""Exported networks against the ones that fly, run by a C compiler, by Norse and by ONNX Runtime."""

import importlib
import shutil
import subprocess

import numpy as np
import pytest

from estimators.alignment import KEPT
from estimators.encoder import ALIGNMENT, FED, HEADING, scaled_inputs
from estimators.networks import NetworkEstimator, OnLoihi, Recurrent, real_weights
from estimators.nir_graph import nir_graph
from estimators.spiking import Weights, forward
from estimators.weights_export import export_weights
from estimators.weights_file import (
    InputScaling,
    NetworkConfig,
    expected_shapes,
    save_network,
    shipped_network,
)


def random_snn(config, seed=0):
    rng = np.random.default_rng(seed)
    return {
        name: rng.integers(-9000, 9001, shape).astype(np.int16)
        if name == "w_skip"
        else (2 * rng.integers(-60, 61, shape)).astype(np.int16)
        if name.startswith("w_")
        else rng.integers(1, 2000, shape).astype(np.int16)
        for name, shape in expected_shapes(config).items()
    }


def readings(steps, seed=0):
    """Hard ones: steps, saturation, missing samples, a rest."""
    rng = np.random.default_rng(seed)
    gyro = rng.normal(0, 1.5, (steps, 3)) + np.repeat(rng.normal(0, 2, (steps // 50 + 1, 3)), 50, 0)[:steps]
    accel = rng.normal([0, 0, 9.81], 3.0, (steps, 3))
    gyro[100:110, 1], accel[200, 0], accel[300:320], gyro[400], accel[500] = np.nan, np.inf, 0.0, 1e9, -1e9
    gyro[3000:3400], accel[3000:3400] = (0.05, -0.02, 0.01), (0.4, -0.3, 9.8)
    return gyro, accel


@pytest.fixture
def compiled(tmp_path, request):
    """Compile the export of a network, strictly: a function from samples (T, 6) to an array of states."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")

    def build(weights, h0, h1):
        export_weights(weights, tmp_path / "c", "c99")
        driver = request.path.parent / "data" / "loihi" / "driver.c"
        flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{tmp_path / 'c'}"]
        sources = [str(tmp_path / "c" / "att_snn.c"), str(driver)]
        subprocess.run(["cc", *flags, *sources, "-lm", "-o", str(tmp_path / "run")], check=True)
        sizes = [
            ("input", 6),
            ("u0", h0),
            ("v0", h0),
            ("u1", h1),
            ("v1", h1),
            ("u2", 2),
            ("v2", 2),
            ("v3", 2),
        ]
        fields = [(name, np.int32, size) for name, size in sizes]
        fields += [("s0", np.uint8, h0), ("s1", np.uint8, h1)]
        fields += [("forces", float), ("fast", float, 2), ("slow", float, 2), ("heading", float, 2)]
        fields += [("fed", float, 4), ("alignment", float, KEPT), ("roll_pitch", float, 2)]
        layout = np.dtype(fields, align=True)

        def run(samples, *start):
            command = [tmp_path / "run", *map(repr, start)]
            done = subprocess.run(command, input=samples.tobytes(), capture_output=True, check=True)
            return np.frombuffer(done.stdout, layout)

        return run

    return build


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_c_source_equals_the_emulator_in_every_state_of_every_step(compiled, tmp_path, seed):
    if seed is None:
        config, tensors = shipped_network("att-snn")
        weights = "att-snn"
    else:
        scale = 1 / 256 if seed else 1.0
        config = NetworkConfig(
            model="att-snn", encoding=37, hidden=23, steps_per_sample=1 + seed, output_scale=scale,
            inputs=InputScaling(
                bias_sd=0.04 * seed, accel_bias_sd=0.3 * seed, lead=3.0 * seed, lead_samples=(3, 40),
                align_s=5.0 * seed, align_drag=0.3, align_noise=0.05, yaw_free=bool(seed),
                lean_fed=bool(seed),
            ),
        )  # fmt: skip
        tensors, weights = random_snn(config, seed), tmp_path / "w.safetensors"
        save_network(weights, config, tensors)
    h0, h1 = config.encoding, config.hidden
    gyro, accel = readings(4000)
    states = compiled(weights, h0, h1)(np.concatenate([gyro, accel], 1))
    core = OnLoihi(config, tensors)
    mine = core.zero(1)
    out = np.empty((1, 1, 2))
    for t, theirs in enumerate(states):
        core.run(mine, gyro[None, t : t + 1], accel[None, t : t + 1], out)
        held, current, _, after, u, v, _ = mine
        expected = {
            "input": held[0, :6], "forces": held[0, 7], "fast": held[0, 8:10], "slow": held[0, 10:12],
            "heading": held[0, HEADING:FED], "fed": held[0, FED:ALIGNMENT],
            "alignment": held[0, ALIGNMENT:],
            "u0": current[0], "u1": u[0, h0:-4], "u2": u[0, -4:-2], "v0": v[0, :h0],
            "v1": v[0, h0:-4], "v2": v[0, -4:-2], "v3": v[0, -2:],
            "s0": after[0, :h0], "s1": after[0, h0:-4],
        }  # fmt: skip
        for name, value in expected.items():
            np.testing.assert_array_equal(theirs[name], value, err_msg=f"{name} at {t}")
        np.testing.assert_allclose(theirs["roll_pitch"], out[0, 0], atol=1e-12)  # sines are the C library's
    assert states["s0"].mean() > 0.01
    assert states["s1"].mean() > 0.01


@pytest.mark.parametrize("start", [(0.0, 0.0), (0.3, -0.2), (-1.2, 0.9), (2.8, -0.4)])
def test_c_source_equals_the_emulator_from_a_start_that_is_told(compiled, start):
    config, tensors = shipped_network("att-snn")
    gyro, accel = readings(600)
    states = compiled("att-snn", config.encoding, config.hidden)(np.concatenate([gyro, accel], 1), *start)
    est = NetworkEstimator(OnLoihi(config, tensors), 200.0)
    est.reset(1, roll_pitch=[start])
    out = est.sequence(gyro[None], accel[None])[0]
    np.testing.assert_allclose(states["roll_pitch"], out, atol=1e-12)
    np.testing.assert_allclose(states["alignment"][-1], est._states[0][0, ALIGNMENT:], rtol=1e-9, atol=1e-12)


def test_c_source_takes_a_start_that_is_no_number_for_an_unknown_one(compiled):
    config, _ = shipped_network("att-snn")
    run, samples = compiled("att-snn", config.encoding, config.hidden), np.concatenate(readings(600), 1)
    for start in ((np.nan, 0.0), (0.0, np.inf)):
        np.testing.assert_array_equal(run(samples, *start), run(samples))


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
    for weights_name in ("att-snn", "att-snn-robust", "att-snn-spiking"):
        config, tensors = shipped_network(weights_name)
        graph = nir.read(export_weights(weights_name, tmp_path / f"{weights_name}.nir", "nir"))
        # Norse's reader leaves the leaky integrators out: the spikes are the graph's output here.
        spiking = ("input", "w_in", "encoding", "w_ff", "w_rec", "hidden")
        nodes = {name: graph.nodes[name] for name in spiking}
        nodes["finish"] = nir.Output({"output": np.array([config.hidden])})
        edges = [edge for edge in graph.edges if set(edge) <= set(nodes)] + [("hidden", "finish")]
        for name in ("encoding", "hidden"):
            nodes[name].v_threshold += 1e-11
        net = norse.from_nir(nir.NIRGraph(nodes, edges), dt=float(graph.metadata["dt"])).double()
        x = torch.tensor(scaled_inputs(config.inputs, config.rate_hz, gyro[None], accel[None])[0])
        weights, taus = real_weights(config, tensors)
        _, _, hidden = forward(x, Weights(*map(torch.tensor, (*weights, *taus))))
        state, spikes = None, []
        with torch.no_grad():
            for t in range(x.shape[1]):
                spike, state = net(x[:, t], state)
                spikes.append(spike)
        rates.append(float(hidden.mean()))
        np.testing.assert_array_equal(torch.stack(spikes, 1)[:, :-1], hidden[:, 1:])
    assert np.mean(rates) > 0.1


def test_nir_graph_carries_the_integers_of_the_chip(tmp_path):
    nir = pytest.importorskip("nir")
    _, tensors = shipped_network("att-snn")
    graph = nir.read(export_weights("att-snn", tmp_path / "snn.nir", "nir"))
    for name in ("w_in", "w_ff", "w_rec", "w_out"):
        node = graph.nodes[name]
        np.testing.assert_array_equal(node.metadata["mantissa"], tensors[name])
        np.testing.assert_array_equal(node.weight * 256, tensors[name])
    for name, syn, mem in (("encoding", "syn0", "mem0"), ("hidden", "syn1", "mem1")):
        node = graph.nodes[name]
        np.testing.assert_array_equal(node.metadata["du"], tensors[syn])
        np.testing.assert_allclose(4096 * graph.metadata["dt"] / node.tau_mem, tensors[mem])
    assert type(graph.nodes["output"]).__name__ == "CubaLI"


def test_nir_graph_integrates_the_inputs_beside_the_spikes():
    torch = pytest.importorskip("torch")
    config = NetworkConfig(model="att-snn", quantised=False, output_scale=1 / 256, encoding=9, hidden=8)
    tensors = {name: np.full(shape, 0.5) for name, shape in expected_shapes(config).items()}
    tensors["w_out"][:] = 0.0
    graph = nir_graph(config, tensors)
    x = np.random.default_rng(0).normal(size=(1, 50, 6))
    weights, taus = real_weights(config, tensors)
    expected, _, _ = forward(torch.tensor(x), Weights(*map(torch.tensor, (*weights, *taus))))
    node, step, v = graph.nodes["direct"], graph.metadata["dt"], np.zeros(2)
    for sample, wanted in zip(x[0], expected[0], strict=True):
        v = v + step / node.tau * (node.v_leak - v + node.r * (graph.nodes["w_skip"].weight @ sample))
        np.testing.assert_allclose(v, wanted, rtol=1e-12)
    np.testing.assert_allclose(graph.nodes["wait"].delay, 2 * step)
    tensors["w_skip"][:] = 0.0
    assert "direct" not in nir_graph(config, tensors).nodes


def test_onnx_runtime_estimates_as_the_network_here(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(export_weights("att-rnn", tmp_path / "rnn.onnx", "onnx"))
    config, tensors = shipped_network("att-rnn")
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1, (2, 300, 3)), rng.normal([0, 0, 9.8], 1.0, (2, 300, 3))
    core = Recurrent(config, tensors)
    expected = np.empty((2, 300, 2))
    core.run(core.zero(2), gyro, accel, expected)
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
        ("att-rnn", "c99", "C99 needs quantised weights of att-snn"),
        ("att-rnn", "nir", "a NIR graph needs weights of att-snn"),
        ("att-snn", "onnx", "ONNX needs weights of att-rnn"),
        ("att-snn", "csv", "format is 'csv'; weights are exported as nir, c99, onnx"),
    ):
        with pytest.raises(ValueError, match=message):
            export_weights(weights, tmp_path / "x", format)
    with pytest.raises(FileNotFoundError, match="no such weights file"):
        export_weights("missing.safetensors", tmp_path / "x", "nir")
    with pytest.raises(ValueError, match="exists already"):
        export_weights("att-snn", tmp_path, "c99")


def test_onnx_refuses_a_lean_that_it_has_no_filter_for(tmp_path):
    config, tensors = shipped_network("att-rnn")
    leaning = config.model_copy(update={"inputs": config.inputs.model_copy(update={"lean_fed": True})})
    save_network(tmp_path / "leaning.safetensors", leaning, tensors)
    with pytest.raises(ValueError, match="lean_fed"):
        export_weights(tmp_path / "leaning.safetensors", tmp_path / "x.onnx", "onnx")


def test_the_c_header_names_the_scale_of_its_output(tmp_path):
    export_weights("att-snn", tmp_path / "c", "c99")
    header = (tmp_path / "c" / "att_snn.h").read_text()
    scale = OnLoihi(*shipped_network("att-snn")).scale
    assert f"#define ATT_SNN_UNITS_PER_RADIAN {round(1 / scale)}\n" in header
