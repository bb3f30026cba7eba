"""Networks of snnTorch and Norse, and their graphs."""

import copy

import numpy as np
import pytest

nir = pytest.importorskip("nir")
torch = pytest.importorskip("torch")
from estimators.export.nir_layers import read_graph  # noqa: E402


def spikes(steps, inputs, rate=0.2, seed=0):
    return (np.random.default_rng(seed).random((1, steps, inputs)) < rate).astype(float)


def through(path, graph):
    """A graph that was written to a file and read again."""
    nir.write(path, graph)
    return read_graph(path)


def stronger(network, factor=4.0):
    """Larger weights than torch's first ones, so that all layers spike."""
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.Linear):
                module.weight *= factor
    return network


def snntorch_layers():
    """Feed-forward, with both kinds of neurons that snnTorch's exporter knows."""
    snn = pytest.importorskip("snntorch")
    torch.manual_seed(1)
    kept = {"init_hidden": True, "reset_mechanism": "zero", "reset_delay": False}
    one = torch.ones
    return stronger(
        torch.nn.Sequential(
            torch.nn.Flatten(),
            torch.nn.Linear(20, 24),
            snn.Leaky(beta=0.9 * one(24), threshold=one(24), **kept),
            torch.nn.Linear(24, 10, bias=False),
            snn.Synaptic(alpha=0.8 * one(10), beta=0.95 * one(10), threshold=one(10), output=True, **kept),
        )
    )


class Recurrent(torch.nn.Module):
    """The two recurrent neurons of snnTorch, which reset a step late, also with `reset_delay=False`."""

    def __init__(self):
        super().__init__()
        snn = pytest.importorskip("snntorch")
        kept = {"init_hidden": True, "reset_mechanism": "zero"}
        self.fc1, self.fc2 = torch.nn.Linear(20, 24), torch.nn.Linear(24, 10, bias=False)
        self.lif1 = snn.RLeaky(beta=0.9, linear_features=24, **kept)
        one_to_one = {"all_to_all": False, "V": 0.3 * torch.ones(10)}
        self.lif2 = snn.RSynaptic(alpha=0.8, beta=0.95, output=True, **one_to_one, **kept)

    def forward(self, x):
        return self.lif2(self.fc2(self.lif1(self.fc1(x))))[0]

    def reset_at_once(self):
        """Reset in the step of the spike, as in NIR."""
        for each in (self.lif1, self.lif2):
            each.mem = each.mem * (1 - each.spk)


def snntorch_recurrent():
    torch.manual_seed(2)
    return stronger(Recurrent(), 3.0)


def snntorch_graph(network, shape=(1, 20)):
    exporter = pytest.importorskip("snntorch.export_nir")
    # the example of the exporter would leave a state behind
    return exporter.export_to_nir(copy.deepcopy(network), torch.rand(*shape), ignore_dims=[0])


def norse_modules(neuron, size):
    """Linear, spiking, linear, leaky integrator, as Norse's exporter takes them to a file."""
    norse = pytest.importorskip("norse.torch")
    torch.manual_seed(3)
    rest = torch.zeros(10)
    box = norse.LIBoxParameters(tau_mem_inv=50.0 * torch.ones(10), v_leak=rest)
    readout = torch.nn.Linear(size, 10, bias=False)
    modules = [torch.nn.Linear(20, size), neuron(norse), readout, norse.LIBoxCell(box)]
    return stronger(norse.SequentialState(*modules), 20.0)


def norse_lif(norse):
    values = {"tau_mem_inv": torch.linspace(50.0, 200.0, 24), "v_th": torch.ones(24)}
    zeros = {"v_leak": torch.zeros(24), "v_reset": torch.zeros(24)}
    return norse.LIFBoxCell(norse.LIFBoxParameters(**values, **zeros))


def delivered(x):
    """What a tool has to be given to get what the chip's first layer gets: spikes, a step later."""
    return torch.tensor(np.concatenate([np.zeros_like(x[0, :1]), x[0, :-1]]), dtype=torch.float32)


def graph_of(recurrent=None, first=None, **values):
    """Eight LIF neurons behind a linear node, with any value replaced."""
    ones = np.ones(8)
    weight = values.pop("weight", np.eye(8))
    given = {"tau": 1e-3 * ones, "r": ones, "v_leak": 0 * ones, "v_threshold": ones, "v_reset": 0 * ones}
    nodes = {
        "in": nir.Input(np.array([weight.shape[1]])),
        "w": first or nir.Linear(weight),
        "lif": nir.LIF(**given | values),
        "out": nir.Output(np.array([8])),
    }
    edges = [("in", "w"), ("w", "lif"), ("lif", "out")]
    if recurrent:
        nodes["rec"] = recurrent
        edges += [("lif", "rec"), ("rec", "lif")]
    return nir.NIRGraph(nodes, edges, type_check=False)
