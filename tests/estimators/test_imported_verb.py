"""`quadsim export FILE.nir`: integers, C99 and a report, and what it refuses."""

import json

import numpy as np
import pytest
from safetensors.numpy import load_file

from estimators.analysis.imported import (
    ImportSettings,
    float_activity,
    import_nir,
)
from estimators.export.chip_network import quantise
from estimators.loihi import LoihiLayer, LoihiNetwork

nir = pytest.importorskip("nir")
torch = pytest.importorskip("torch")
from imported_networks import graph_of, snntorch_graph, snntorch_recurrent, spikes  # noqa: E402

from estimators.export.nir_layers import layers_of  # noqa: E402

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def test_the_verb_writes_integers_c_and_a_report(tmp_path, printed):
    nir.write(tmp_path / "a.nir", snntorch_graph(snntorch_recurrent()))
    out = tmp_path / "chip"
    last = printed("export", "a.nir", "--set", "dt=1e-4", "--set", "steps=200", "--out", out).splitlines()[-1]
    report = json.loads((out / "report.json").read_text())
    same = f"{100 * report['agreement']:.1f} % of {report['spikes']} spikes agree with floats"
    assert last == f"{out}: 1 of a chip's 128 cores, {same}"
    assert report["latency_steps"] == 2
    assert report["energy_nJ_per_step"] > 1.0
    assert [each["node"] for each in report["layers"]] == ["lif1.lif", "lif2.lif"]
    tensors = load_file(out / "network.safetensors")
    layers = [
        LoihiLayer(**{name[2:]: each for name, each in tensors.items() if name.startswith(f"{k}.")})
        for k in range(2)
    ]
    x = spikes(200, 20, 0.1, 0)[:1]
    assert LoihiNetwork(layers).step(x[:, 0]).shape == (1, 10)
    assert {each.name for each in out.iterdir()} == {
        "network.safetensors", "network.c", "network.h", "main.c", "report.json",
    }  # fmt: skip


def test_runs_on_the_users_input_are_of_its_length_and_kind(tmp_path):
    nir.write(tmp_path / "a.nir", graph_of(r=9.0 * np.ones(8)))
    np.save(tmp_path / "x.npy", np.full((50, 8), 0.5))
    settings = ImportSettings(dt=1e-4, input=str(tmp_path / "x.npy"))
    report = import_nir(tmp_path / "a.nir", tmp_path / "out", settings)
    assert report["latency_steps"] == 0
    assert report["operations_per_step"]["synaptic event"] == 0
    assert report["layers"][0]["spikes_per_step"] > 0.05


def nodes_with(**nodes):
    graph = graph_of()
    graph.nodes |= nodes
    return graph


def branched():
    graph = nodes_with(again=nir.Linear(np.eye(8)))
    graph.edges += [("w", "again"), ("again", "out")]
    return graph


def between_layers():
    graph = nodes_with(w2=nir.Linear(np.eye(8)), lif2=graph_of().nodes["lif"], back=nir.Linear(np.eye(8)))
    graph.edges = [("in", "w"), ("w", "lif"), ("lif", "w2"), ("w2", "lif2"), ("lif2", "out")]
    graph.edges += [("lif2", "back"), ("back", "lif")]
    return graph


def potentials_between():
    graph = nodes_with(lif=nir.LI(tau=np.ones(8), r=np.ones(8), v_leak=np.zeros(8)), w2=nir.Linear(np.eye(8)))
    graph.edges = [("in", "w"), ("w", "lif"), ("lif", "w2"), ("w2", "out")]
    return graph


NAN = np.diag([np.nan, *np.ones(7)])
CONV = nir.Conv1d(
    input_shape=8, weight=np.ones((1, 1, 3)), stride=1, padding=1, dilation=1, groups=1, bias=np.zeros(1)
)
REFUSED = {
    'node "w" is a Conv1d, supported are Input, Output, Flatten, Affine': lambda: graph_of(first=CONV),
    'node "w": weight has values that are not finite': lambda: graph_of(weight=NAN),
    'node "w": weight of shape (8, 5) for 8 inputs': lambda: graph_of(first=nir.Linear(np.ones((8, 5)))),
    'node "lif": v_reset is not v_leak': lambda: graph_of(v_reset=np.full(8, 0.2)),
    'node "lif": v_threshold is not above v_leak': lambda: graph_of(v_threshold=np.zeros(8)),
    'node "lif": tau has values that are not finite': lambda: graph_of(tau=np.full(8, np.nan)),
    'node "lif": tau = 1e-05 s is below the step, dt = 0.0001 s': lambda: graph_of(tau=np.full(8, 1e-5)),
    'node "w": scale has 3 values, should have 1 or 8': lambda: graph_of(first=nir.Scale(np.ones(3))),
    'node "rec": weight of shape (8, 3) for 8 inputs': lambda: graph_of(nir.Linear(np.ones((8, 3)))),
    'node "w" leads to 2 others or back; supported is one chain': branched,
    'node "lif2" leads to 2 others or back; supported is one chain': between_layers,
    'node "lif" sends potentials to "w2"; the chip sends spikes': potentials_between,
    "1 nodes Input and 2 Output": lambda: nodes_with(more=nir.Output(np.array([8]))),
    "20000 inputs and neurons, the emulator takes 8192": lambda: graph_of(weight=np.zeros((8, 20000))),
    "5000 fan-in axons, a core has 4096: 904 too many": lambda: graph_of(weight=np.ones((8, 5000))),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_the_chip_cannot_run_is_refused_in_a_line_that_names_the_node(tmp_path, refused, message):
    nir.write(tmp_path / "a.nir", REFUSED[message]())
    assert message in refused("export", "a.nir", "--set", "dt=1e-4", "--set", "steps=10", "--out", "out")
    assert not (tmp_path / "out").exists()


def test_files_that_are_none_or_damaged_are_refused(tmp_path):
    path, settings = tmp_path / "a.nir", ImportSettings(dt=1e-4)
    nir.write(path, graph_of())
    whole = path.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2], whole[:2000] + bytes(500) + whole[2500:]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.nir: not a NIR graph, or damaged"):
            import_nir(path, tmp_path / "out", settings)
    with pytest.raises(FileNotFoundError, match="no such NIR file"):
        import_nir(tmp_path / "b.nir", tmp_path / "out", settings)
    path.write_bytes(whole)
    with pytest.raises(ValueError, match="has no dt; give the step of its time constants"):
        import_nir(path, tmp_path / "out", ImportSettings())
    with pytest.raises(ValueError, match="exists already"):
        import_nir(path, tmp_path, settings)
    for content, message in (
        (np.zeros((5, 3)), r"shape \(5, 3\), should be \(T, 8\)"),
        (np.full((5, 8), 40.0), r"should be finite and within ±32\.00"),
        (np.full((5, 8), np.nan), "should be finite"),
        (np.array(["a"]), "not an array of numbers"),
    ):
        np.save(tmp_path / "x.npy", content)
        with pytest.raises(ValueError, match=message):
            import_nir(path, tmp_path / "out", ImportSettings(dt=1e-4, input=str(tmp_path / "x.npy")))


def test_a_scale_that_does_not_suit_is_refused():
    layers = layers_of(graph_of(), 1e-4)
    _, peaks = float_activity(layers, spikes(20, 8), False)
    with pytest.raises(ValueError, match='node "lif": bias_mant: value'):
        quantise([layers[0]._replace(bias=np.full(8, 1e6))], peaks, one=2.0**14)
