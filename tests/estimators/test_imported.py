"""Networks of Norse, snnTorch and our own NIR files in floats and in the chip's integers."""

import ctypes
import subprocess

import numpy as np
import pytest
from c_export import STRICT

from estimators.analysis.energy import counts
from estimators.analysis.imported import (
    agreement,
    encoded_inputs,
    float_activity,
    on_chip,
    run_chip,
)
from estimators.control.controller import set_point_gain
from estimators.export.chip_network import mantissas
from estimators.export.formats import export_weights
from estimators.export.layers_c import write_layers_c
from estimators.loihi import LoihiLayer, LoihiNetwork
from estimators.loihi.chip import partition
from estimators.networks.encoder import input_scaling
from estimators.networks.forward import OnLoihi
from estimators.networks.network import zero_states
from estimators.networks.weights_file import load_network

nir = pytest.importorskip("nir")
torch = pytest.importorskip("torch")
from imported_networks import (  # noqa: E402
    delivered,
    graph_of,
    norse_lif,
    norse_modules,
    snntorch_graph,
    snntorch_layers,
    snntorch_recurrent,
    spikes,
    through,
)

from estimators.export.nir_layers import layers_of, read_graph  # noqa: E402

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def test_an_snntorch_network_spikes_the_same_in_our_floats(tmp_path):
    network = snntorch_layers()
    layers = layers_of(through(tmp_path / "a.nir", snntorch_graph(network, (1, 4, 5))), 1e-4)
    x = spikes(300, 20)
    floats, _ = float_activity(layers, x, False)
    with torch.no_grad():
        expected = np.array([network(each.reshape(1, 4, 5))[0].numpy()[0] for each in delivered(x)])
    assert 0.02 < expected.mean() < 0.9
    np.testing.assert_array_equal(floats.of_layer(floats.spikes, 1)[0, 1:], expected[:-1])


def test_a_recurrent_snntorch_network_spikes_the_same_in_our_floats(tmp_path):
    network = snntorch_recurrent()
    layers = layers_of(through(tmp_path / "a.nir", snntorch_graph(network)), 1e-4)
    assert all(layer.w_rec.any() for layer in layers)
    x = spikes(300, 20)
    floats, _ = float_activity(layers, x, False)
    first, second = [], []
    with torch.no_grad():
        for each in delivered(x):
            second.append(network(each[None]).numpy()[0])
            first.append(network.lif1.spk.numpy()[0])
            network.reset_at_once()
    assert 0.02 < np.mean(first) < 0.9
    assert 0.02 < np.mean(second) < 0.9
    np.testing.assert_array_equal(floats.of_layer(floats.spikes, 0)[0], first)
    np.testing.assert_array_equal(floats.of_layer(floats.spikes, 1)[0, 1:], second[:-1])


@pytest.mark.parametrize(("exported", "dt"), [(1.0, 1e-3), (1e-3, 1e-6)])
def test_a_norse_network_spikes_the_same_in_our_floats(tmp_path, exported, dt):
    """Norse writes each τ times the argument `dt` of its exporter."""
    norse = pytest.importorskip("norse.torch")
    network = norse_modules(norse_lif, 24)
    graph = norse.to_nir(network, torch.rand(1, 20), dt=exported)
    layers = layers_of(through(tmp_path / "a.nir", graph), dt)
    x = spikes(300, 20)
    floats, _ = float_activity(layers, x, False)
    state = [None, None]
    hidden, outputs = [], []
    with torch.no_grad():
        for each in delivered(x):
            z, state[0] = network[1](network[0](each[None]), state[0])
            v, state[1] = network[3](network[2](z), state[1])
            hidden.append(z.numpy()[0])
            outputs.append(v.numpy()[0])
    assert 0.02 < np.mean(hidden) < 0.9
    np.testing.assert_array_equal(floats.of_layer(floats.spikes, 0)[0], hidden)
    np.testing.assert_allclose(floats.estimate[0, 1:], outputs[:-1], atol=1e-4)


def test_norses_importer_runs_a_graph_with_synapses_as_our_floats_do(tmp_path):
    norse = pytest.importorskip("norse.torch")
    rng = np.random.default_rng(5)
    ones = np.ones(16)
    neurons = nir.CubaLIF(
        tau_syn=0.004 * ones, tau_mem=np.linspace(0.01, 0.03, 16), r=2.0 * ones, w_in=3.0 * ones,
        v_leak=0.0 * ones, v_threshold=np.linspace(0.5, 1.5, 16),
    )  # fmt: skip
    nodes = {"in": nir.Input(np.array([8])), "w": nir.Linear(rng.normal(0, 1, (16, 8))), "n": neurons}
    graph = nir.NIRGraph(nodes | {"out": nir.Output(np.array([16]))}, [("in", "w"), ("w", "n"), ("n", "out")])
    network, state = norse.from_nir(graph, dt=1e-3), None
    x, expected = spikes(300, 8), []
    with torch.no_grad():
        for each in delivered(x):
            z, state = network(each[None], state)
            expected.append(z.numpy()[0])
    floats, _ = float_activity(layers_of(through(tmp_path / "a.nir", graph), 1e-3), x, False)
    assert 0.02 < np.mean(expected) < 0.9
    np.testing.assert_array_equal(floats.spikes[0], expected)


def chip_and_floats(layers, x):
    network, floats = on_chip(layers, x)
    chip = run_chip(network, x)
    return network, agreement(floats.spikes, chip.spikes[..., -sum(floats.sizes) :]), chip, floats


@pytest.mark.parametrize("encoded", [False, True])
def test_most_spikes_of_a_feed_forward_network_survive_eight_bits(tmp_path, encoded):
    layers = layers_of(snntorch_graph(snntorch_layers(), (1, 4, 5)), 1e-4)
    x = spikes(500, 20) * (0.7 if encoded else 1.0)
    network, same, _, floats = chip_and_floats(layers, x)
    assert floats.spikes.mean() > 0.02
    assert same > 0.9
    assert (network.encoders is not None) == encoded
    # Thresholds that are wrong by a fifth show.
    spoilt = network._replace(
        layers=[LoihiLayer(**vars(each) | {"vth": each.vth * 6 // 5}) for each in network.layers]
    )
    assert agreement(floats.spikes, run_chip(spoilt, x).spikes[..., -34:]) < 0.85


def test_potentials_of_leaky_integrators_survive_eight_bits():
    norse = pytest.importorskip("norse.torch")
    graph = norse.to_nir(norse_modules(norse_lif, 24), torch.rand(1, 20), dt=1.0)
    network, _, chip, floats = chip_and_floats(layers_of(graph, 1e-3), spikes(500, 20))
    assert network.layers[-1].vth.min() == 131071
    difference = chip.estimate / network.ones[-1] - floats.estimate
    assert np.sqrt(np.mean(difference**2) / np.mean(floats.estimate**2)) < 0.05


def test_weights_that_the_chip_holds_are_kept_and_others_within_half_a_step():
    rng = np.random.default_rng(0)
    whole = 2 * rng.integers(-128, 128, (50, 9)) * 2.0 ** rng.integers(-6, 1, (50, 1))
    for weights, tolerance in ((whole, 0.0), (rng.uniform(-254, 254, (50, 9)), 1.0)):
        found, exponents = mantissas(weights)
        assert np.abs(found * 2.0 ** exponents[:, None] - weights).max() <= tolerance
        assert not (found % 2).any()
    small, exponents = mantissas(np.array([[1.0, -3.9], [0.0, 0.0]]))
    assert (exponents[0], small[0].tolist()) == (-6, [64, -250])


def test_scales_leave_room_in_sums_currents_and_potentials():
    rng = np.random.default_rng(0)
    ones = np.ones(8)
    for weight, slow, theta in ((1e-3, 0.9999, 1e6), (1.0, 0.999, 1e3), (100.0, 0.5, 1e-2), (1.0, 0.5, 1e-9)):
        layers = layers_of(graph_of(weight=rng.uniform(0, weight, (8, 300)), v_threshold=theta * ones), 1e-4)
        layers = [each._replace(syn=slow * ones) for each in layers]
        x = spikes(200, 300, 0.5)
        network, _ = on_chip(layers, x)
        chip = LoihiNetwork(network.layers)
        for each in x[0]:
            chip.step(each[None])
        _, peaks = float_activity(layers, x, False)
        assert np.abs(chip.u[0]).max() <= 1.1 * network.ones[0] * peaks[0].u + 300 <= 1 << 22
        assert 4 * peaks[0].arriving * network.ones[0] <= 1 << 21


def test_a_rest_that_is_not_zero_only_shifts_potentials():
    x, level = spikes(300, 8), 0.3 * np.ones(8)
    r = 4.0 * np.ones(8)
    plain = layers_of(graph_of(r=r), 1e-4)
    moved = layers_of(graph_of(r=r, v_leak=level, v_reset=level, v_threshold=1.0 + level), 1e-4)
    a, b = (float_activity(each, x, False)[0].spikes for each in (plain, moved))
    assert a.mean() > 0.02
    np.testing.assert_array_equal(a, b)


def test_an_integrator_in_front_is_a_synapse_and_scales_multiply():
    ones = np.ones(8)
    synapse = nir.LI(tau=5e-4 * ones, r=2.0 * ones, v_leak=0 * ones)
    scale = nir.Scale(np.arange(1.0, 9.0))
    graph = graph_of(r=3 * ones)
    graph.nodes |= {"li": synapse, "scale": scale}
    graph.edges = [("in", "scale"), ("scale", "w"), ("w", "li"), ("li", "lif"), ("lif", "out")]
    (layer,) = layers_of(graph, 1e-4)
    np.testing.assert_allclose(layer.syn, 0.8)
    np.testing.assert_allclose(layer.w_in, np.diag(np.arange(1.0, 9.0)) * 2.0 * 0.2 * 3.0 * 0.1)


@pytest.mark.parametrize("encoded", [False, True])
def test_a_bias_drives_neurons_with_a_synapse_as_in_floats_once_it_has_settled(encoded):
    biases = nir.Affine(np.eye(8), np.linspace(0.2, 0.5, 8))
    (layer,) = layers_of(graph_of(first=biases), 1e-4)
    x = np.zeros((1, 400, 8))
    x[0, -1] = 0.5 * encoded
    _, _, chip, floats = chip_and_floats([layer._replace(syn=np.full(8, 0.9))], x)
    late = [run.spikes[0, 100:, -8:].sum(0).astype(int) for run in (floats, chip)]
    assert late[0].min() > 20
    assert np.abs(late[0] - late[1]).max() <= 3


def test_spikes_of_inputs_are_counted_as_events():
    x = spikes(300, 8)
    network, _ = on_chip(layers_of(graph_of(weight=np.full((8, 8), 9.0)), 1e-4), x)
    chip = run_chip(network, x)
    counted = counts(partition(network.layers), chip)
    assert counted["synaptic event"] == pytest.approx(8 * x.sum() / 300)
    assert counted["spike within a tile"] == pytest.approx(x.sum() / 300)


@pytest.mark.parametrize("name", ["att-snn-paper", "control-attitude"])
def test_our_own_file_comes_back_as_the_integers_that_fly(tmp_path, name):
    config, tensors = load_network(name)
    graph = read_graph(export_weights(name, tmp_path / "snn.nir", "nir"))
    layers = layers_of(graph, float(graph.metadata["dt"]))
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1.0, (1, 300, 3)), rng.normal([0, 0, 9.81], 1.0, (1, 300, 3))
    offset, gain = input_scaling(config.inputs)
    x = np.rint((np.concatenate([gyro, accel], 2) - offset) * gain) / 1024
    points = np.zeros((1, 300, 0))
    if config.controls:
        points = np.rint(rng.normal(0, 0.1, (1, 300, 3)) * set_point_gain(config.set_point))
        x = np.concatenate([x, points / 1024], 2)
    network, floats = on_chip(layers, x, graph.metadata["vth"])
    np.testing.assert_array_equal(network.encoders[:-1].T, tensors["w_in"])
    exact = OnLoihi(config, tensors)
    for ours, theirs in zip(network.layers, exact.layers, strict=True):
        for field in ("du", "dv", "vth"):
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field), field)
        for weights, exponents in (("w_in", "exp_in"), ("w_rec", "exp_rec")):
            a, b = (getattr(each, weights) for each in (ours, theirs))
            if b is not None and b.size:
                a, b = (w * 2.0 ** getattr(each, exponents)[:, None] for w, each in ((a, ours), (b, theirs)))
                np.testing.assert_array_equal(a, b, weights)
    chip, numbers = run_chip(network, x), zero_states(exact, 1)
    out = np.empty((1, exact.outputs))
    assert chip.spikes.mean() > 0.01
    for t in range(300):
        exact.kernel(gyro[:, t].copy(), accel[:, t].copy(), points[:, t].copy(), *exact.arrays, numbers, out)
        state = numbers.view(exact.state)[:, 0]
        np.testing.assert_array_equal(chip.spikes[:, t], exact.spikes(state), f"spikes at {t}")
        np.testing.assert_array_equal(chip.estimate[:, t] / 2**14 * config.output_scale, out)
    assert agreement(floats.spikes, chip.spikes) > 0.5


@pytest.mark.parametrize("case", ["spikes", "encoded", "readout", "one encoded layer"])
def test_the_c_code_equals_the_emulator_in_every_state_of_every_step(tmp_path, case):
    if case == "readout":
        norse = pytest.importorskip("norse.torch")
        layers = layers_of(norse.to_nir(norse_modules(norse_lif, 24), torch.rand(1, 20), dt=1.0), 1e-3)
    else:
        layers = layers_of(snntorch_graph(snntorch_recurrent()), 1e-4)
    x = spikes(400, 20)
    if "encoded" in case:
        x = np.random.default_rng(4).normal(0.3, 0.6, (1, 400, 20))
    if case == "one encoded layer":
        layers = [layers[0]._replace(w_rec=np.zeros((24, 24)))]
    network, _ = on_chip(layers, x)
    write_layers_c(tmp_path, network)
    bias, emulator = encoded_inputs(network, x), LoihiNetwork(network.layers)
    library = tmp_path / "network.so"
    subprocess.run(["cc", *STRICT, "-shared", "-fPIC", tmp_path / "network.c", "-o", library], check=True)
    code = ctypes.CDLL(str(library))
    neurons = sum(len(each.w_in) for each in network.layers)
    state = np.zeros(4 * neurons + 100, np.int32)
    code.network_reset(state.ctypes)
    outputs = np.zeros(len(network.layers[-1].w_in), np.int32)
    whole = np.rint(x[0] * (1 if bias is None else 1024)).astype(np.int32)
    lines, fired = [], 0
    for t, each in enumerate(whole):
        code.network_step(state.ctypes, each.ctypes)
        code.network_outputs(state.ctypes, outputs.ctypes)
        emulator.step(x[:, t]) if bias is None else emulator.step(bias_mant=bias[:, t] >> 4)
        u, v, s = (np.concatenate(kind, 1)[0] for kind in (emulator.u, emulator.v, emulator.s))
        np.testing.assert_array_equal(state[:neurons], u, f"u at {t}")
        np.testing.assert_array_equal(state[neurons : 2 * neurons], v, f"v at {t}")
        last = emulator.v[-1][0] if case == "readout" else emulator.s[-1][0]
        np.testing.assert_array_equal(outputs, last, f"outputs at {t}")
        lines.append(" ".join(map(str, outputs)))
        fired += s.sum()
    assert fired > 0.02 * 400 * neurons
    program = tmp_path / "network"
    sources = [tmp_path / "network.c", tmp_path / "main.c"]
    subprocess.run(["cc", *STRICT, "-fsanitize=undefined", *sources, "-o", program], check=True)
    text = "\n".join(" ".join(map(str, each)) for each in whole)
    done = subprocess.run([program], input=text, capture_output=True, check=True, text=True)
    assert done.stdout.splitlines() == lines
    assert done.stderr == ""
