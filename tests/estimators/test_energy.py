from dataclasses import replace

import numpy as np
import pytest

from estimators.analysis.activity import record
from estimators.analysis.energy import PICOJOULES, costs, counts, gru_flops, host_costs, snn_flops, synapses
from estimators.networks.network import OnLoihi, create_network
from estimators.networks.weights_file import shipped_network


@pytest.fixture(scope="module")
def network():
    return OnLoihi(*shipped_network("att-snn"))


@pytest.fixture(scope="module")
def activity(network, flights):
    return record(network, flights["gyro"].to_numpy()[:2, :2000], flights["accel"].to_numpy()[:2, :2000])


def test_what_is_recorded_is_what_flies(network, activity, flights):
    est = create_network("att-snn-loihi")
    est.reset(2)
    gyro, accel = (flights[name].to_numpy()[:2, :2000] for name in ("gyro", "accel"))
    np.testing.assert_array_equal(activity.estimate, est.sequence(gyro, accel))
    assert activity.of_layer(activity.rates, 2).max() == 0.0
    assert np.all(activity.potentials <= 1.0)


def test_events_are_spikes_times_the_weights_that_they_meet(network, activity):
    config, tensors = shipped_network("att-snn")
    neurons = config.encoding + config.hidden + 3
    compartments = neurons + np.count_nonzero(tensors["w_after"])
    encoding, hidden = (activity.of_layer(activity.spikes, k).astype(int) for k in (0, 1))
    events = (encoding @ (tensors["w_ff"] != 0).T.sum(1)).sum()
    of_hidden = ("w_rec", "w_out")
    events += (hidden @ sum((tensors[name] != 0).sum(0) for name in of_hidden)).sum()
    events += (hidden @ (tensors["w_after"][:, 0] != 0)).sum()  # on itself
    counted = counts(network, activity)
    assert counted["synaptic event"] == pytest.approx(events / activity.steps)
    assert counted["active neuron update"] + counted["inactive neuron update"] == pytest.approx(compartments)
    stored = sum(np.count_nonzero(tensors[name]) for name in ("w_ff", "w_rec", "w_out", "w_after"))
    assert synapses(network.cores, neurons).sum() == stored


def test_the_modelled_energy_is_that_of_davies_2018(network, activity):
    """Synaptic operation 23.6 pJ, neuron update 81 and 52, spike within a tile 1.7, hop 3 or 4."""
    counted = counts(network, activity)
    by_hand = {
        "synaptic event": 23.6 * counted["synaptic event"],
        "active neuron update": 81.0 * counted["active neuron update"],
        "inactive neuron update": 52.0 * counted["inactive neuron update"],
        "spike within a tile": 1.7 * counted["spike within a tile"],
        "hop between tiles": (3.0 + 4.0) / 2 * counted["hop between tiles"],
    }
    found = {line.operation: 1e3 * line.nanojoules for line in costs(counted)}
    assert found == pytest.approx(by_hand)
    assert found["synaptic event"] > 0.1 * sum(by_hand.values())
    apart = dict.fromkeys(by_hand, 1.0)  # the shipped networks need no hop
    assert [1e3 * line.nanojoules for line in costs(apart)] == pytest.approx([23.6, 81.0, 52.0, 1.7, 3.5])


def test_shares_are_what_a_wrong_coefficient_does_to_the_sum(network, activity, monkeypatch):
    counted = counts(network, activity)
    before = costs(counted)
    total = sum(line.nanojoules for line in before)
    assert sum(line.share for line in before) == pytest.approx(1.0)
    monkeypatch.setitem(PICOJOULES, "synaptic event", 1.2 * PICOJOULES["synaptic event"])
    after = sum(line.nanojoules for line in costs(counted))
    assert after / total - 1 == pytest.approx(0.2 * before[0].share)


def test_flops_by_hand():
    # One unit each: products 2 · 3 · (6 + 1) and 2 · 3 · 2, 16 besides in each layer, and 2 outputs of 2 + 1.
    assert gru_flops(1, 1) == 42 + 16 + 12 + 16 + 6
    # Encoder 12, neurons 5 + 5 + 8, one spike each: 1 synapse, and 1 + 2.
    assert snn_flops(1, 1, (1.0, 1.0))["sparse"] == 12 + 18 + 1 + 3
    assert snn_flops(1, 1, (0.5, 0.0))["dense"] == 12 + 18 + 2 * 4
    assert snn_flops(1, 1, (0.5, 0.0), after_spike=True)["dense"] == 12 + 18 + 3 + 2 * 4


def test_neurobench_counts_the_same(network, activity):
    """Its accumulates are our synaptic events, its sparsity our rates, where the words mean the same."""
    pytest.importorskip("neurobench", reason="NeuroBench is not installed: pip install --no-deps neurobench")
    torch = pytest.importorskip("torch")
    from neurobench.hooks.layer import LayerHook
    from neurobench.hooks.neuron import NeuronHook
    from neurobench.metrics.static.connection_sparsity import ConnectionSparsity
    from neurobench.metrics.workload import ActivationSparsity, SynapticOperations
    from neurobench.models import TorchModel

    config, tensors = shipped_network("att-snn")
    tensors["w_self"] = np.diagflat(tensors["w_after"])
    names = ("w_ff", "w_rec", "w_self", "w_out")
    h0, both = config.encoding, config.encoding + config.hidden

    class Replay(torch.nn.Module):
        """The recorded spikes, sent through the network's connections."""

        def __init__(self):
            super().__init__()
            for name in names:
                layer = torch.nn.Linear(*tensors[name].shape[::-1], bias=False)
                layer.weight.data = torch.tensor(tensors[name], dtype=torch.float32)
                setattr(self, name, layer)
            self.encoding, self.hidden = torch.nn.Identity(), torch.nn.Identity()

        def forward(self, spikes):
            first, second = self.encoding(spikes[:, :h0]), self.hidden(spikes[:, h0:both])
            of_second = (self.w_rec, self.w_self, self.w_out)
            return self.w_ff(first).sum() + sum(each(second).sum() for each in of_second)

    net = Replay()
    model = TorchModel(net)
    model.connection_hooks = [LayerHook(getattr(net, name)) for name in names]
    model.activation_hooks = [NeuronHook(layer) for layer in (net.encoding, net.hidden)]
    steps = 300
    spikes = torch.tensor(activity.spikes[0, :steps], dtype=torch.float32)
    for step in spikes:
        net(step[None])
    found = SynapticOperations()(model, None, (torch.zeros(steps), None))
    part = replace(
        activity,
        spikes=activity.spikes[:1, :steps],
        active=activity.active[:1],
        active_currents=activity.active_currents[:1],
    )
    assert found["Effective_ACs"] == pytest.approx(counts(network, part)["synaptic event"])
    assert found["Effective_MACs"] == 0
    rate = part.rates[:both].mean()
    assert ActivationSparsity()(model, None, None) == pytest.approx(1 - rate)
    stored = sum(np.count_nonzero(tensors[name]) for name in names)
    whole = sum(tensors[name].size for name in names)
    assert ConnectionSparsity()(model) == pytest.approx(1 - stored / whole, abs=1e-3)


def test_the_host_scales_six_readings_and_drives_each_encoding_neuron():
    config, _ = shipped_network("att-snn")
    one = config.model_copy(update={"encoding": 1, "steps_per_sample": 1})
    readings, currents = host_costs(one)
    assert (readings.multiplications, readings.additions) == (6, 6)
    assert (currents.multiplications, currents.additions) == (6 + 1, 6 + 1)
    assert currents.nanojoules == pytest.approx(7 * (3.1 + 0.1) / 1e3)
    twice = host_costs(one.model_copy(update={"encoding": 50, "steps_per_sample": 2}))
    assert twice[0] == readings
    assert twice[1].multiplications == 2 * 50 * 7
