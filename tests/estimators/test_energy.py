import numpy as np
import pytest

from estimators.analysis.activity import record
from estimators.analysis.energy import (
    PICOJOULES,
    costs,
    counts,
    gru_flops,
    host_operations,
    snn_flops,
    synapses,
)
from estimators.networks.forward import OnLoihi
from estimators.networks.network import create_network
from estimators.networks.weights_file import load_network


@pytest.fixture(scope="module")
def network():
    return OnLoihi(*load_network("att-snn-paper"))


@pytest.fixture(scope="module")
def activity(network, flights):
    return record(network, flights["gyro"].to_numpy()[:2, :2000], flights["accel"].to_numpy()[:2, :2000])


def test_what_is_recorded_is_what_flies(network, activity, flights):
    est = create_network("att-snn-loihi", weights="att-snn-paper")
    est.reset(2)
    gyro, accel = (flights[name].to_numpy()[:2, :2000] for name in ("gyro", "accel"))
    np.testing.assert_array_equal(activity.estimate, est.sequence(gyro, accel))
    assert activity.of_layer(activity.rates, 2).max() == 0.0


def test_events_are_spikes_times_the_weights_that_they_meet(network, activity):
    config, tensors = load_network("att-snn-paper")
    neurons = config.encoding + config.hidden + 2
    encoding, hidden = (activity.of_layer(activity.spikes, k).astype(int) for k in (0, 1))
    events = (encoding @ (tensors["w_ff"] != 0).T.sum(1)).sum()
    of_hidden = ("w_rec", "w_out")
    events += (hidden @ sum((tensors[name] != 0).sum(0) for name in of_hidden)).sum()
    counted = counts(network, activity)
    assert counted["synaptic event"] == pytest.approx(events / activity.steps)
    assert counted["active neuron update"] + counted["inactive neuron update"] == pytest.approx(neurons)
    stored = sum(np.count_nonzero(tensors[name]) for name in ("w_ff", "w_rec", "w_out"))
    assert synapses(network.cores, neurons).sum() == stored


def test_the_modelled_energy_is_that_of_davies_2018():
    """Synaptic operation 23.6 pJ, neuron update 81 and 52, spike within a tile 1.7, hop 3 or 4."""
    found = costs(dict.fromkeys(PICOJOULES, 2.0))
    assert [1e3 * line.nanojoules / 2 for line in found] == pytest.approx(
        [23.6, 81.0, 52.0, 1.7, (3 + 4) / 2]
    )


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


def test_the_host_scales_six_readings_and_drives_each_encoding_neuron():
    config, _ = load_network("att-snn-paper")
    one = host_operations(config.model_copy(update={"encoding": 1}))
    assert list(one.values()) == [6, 6 + 1]
    more = host_operations(config.model_copy(update={"encoding": 50}))
    assert list(more.values()) == [6, 50 * 7]
