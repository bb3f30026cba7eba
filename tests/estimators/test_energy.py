import numpy as np
import pytest
from controllers import CONFIG

from estimators.analysis.ablation import error_deg, pruned, without
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
from estimators.analysis.manipulation import responses
from estimators.evaluation.flights import load_flights
from estimators.networks.forward import OnLoihi
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import load_network


@pytest.fixture(scope="module")
def network():
    return load_network("att-snn-paper")


@pytest.fixture(scope="module")
def core(network):
    return OnLoihi(*network)


@pytest.fixture(scope="module")
def seen(flights):
    return load_flights([flights], 2)


@pytest.fixture(scope="module")
def activity(core, seen):
    return record(core, seen.gyro, seen.accel)


def test_what_is_recorded_is_what_flies(core, activity, seen):
    est = NetworkEstimator(core, 200.0)
    est.reset(2)
    np.testing.assert_array_equal(activity.estimate, est.sequence(seen.gyro, seen.accel))
    assert activity.of_layer(activity.rates, 2).max() == 0.0


def test_events_are_spikes_times_the_weights_that_they_meet(network, core, activity):
    config, tensors = network
    neurons = config.encoding + config.hidden + 2
    encoding, hidden = (activity.of_layer(activity.spikes, k).astype(int) for k in (0, 1))
    events = (encoding @ (tensors["w_ff"] != 0).T.sum(1)).sum()
    of_hidden = ("w_rec", "w_out")
    events += (hidden @ sum((tensors[name] != 0).sum(0) for name in of_hidden)).sum()
    counted = counts(core.cores, activity)
    assert counted["synaptic event"] == pytest.approx(events / activity.steps)
    assert counted["active neuron update"] + counted["inactive neuron update"] == pytest.approx(neurons)
    stored = sum(np.count_nonzero(tensors[name]) for name in ("w_ff", "w_rec", "w_out"))
    assert synapses(core.cores, neurons).sum() == stored


def test_the_modelled_energy_is_that_of_davies_2018():
    """Synaptic operation 23.6 pJ, neuron update 81 and 52, spike within a tile 1.7, hop 3 or 4."""
    found = [1e3 * line.nanojoules / 2 for line in costs(dict.fromkeys(PICOJOULES, 2.0))]
    assert found == pytest.approx([23.6, 81.0, 52.0, 1.7, (3 + 4) / 2])


def test_shares_are_what_a_wrong_coefficient_does_to_the_sum(core, activity, monkeypatch):
    counted = counts(core.cores, activity)
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


def test_the_host_scales_all_inputs_and_drives_each_encoding_neuron(network):
    assert list(host_operations(CONFIG).values()) == [9, 10 * 10]
    for neurons in (1, 50):
        config = network.config.model_copy(update={"encoding": neurons})
        assert list(host_operations(config).values()) == [6, neurons * 7]


def test_neurons_that_never_spike_can_go_without_a_trace(network, seen, activity):
    rates = [activity.of_layer(activity.rates, k) for k in (0, 1)]
    smaller = without(*network, [np.flatnonzero(rate) for rate in rates])
    assert smaller[0].encoding + smaller[0].hidden < network[0].encoding + network[0].hidden
    again = record(OnLoihi(*smaller), seen.gyro, seen.accel)
    np.testing.assert_array_equal(again.estimate, activity.estimate)


def test_the_least_important_go_first_and_the_curve_starts_at_the_whole(network, seen, activity):
    values = [activity.of_layer(activity.rates, k) for k in (0, 1)]
    config, tensors = pruned(*network, values, 0.3)
    left = (config.encoding + config.hidden) / (network[0].encoding + network[0].hidden)
    assert left == pytest.approx(0.7, abs=0.005)
    assert tensors["w_ff"].shape == (config.hidden, config.encoding)
    whole, most = (error_deg(*pruned(*network, values, fraction), seen) for fraction in (0.0, 0.9))
    assert whole == error_deg(*network, seen)
    assert most > 1.5 * whole
    values = np.random.default_rng(0).random(200)
    _, tensors = pruned(*network, [values[:100], values[100:]], 0.3)
    kept = np.argsort(-values)[:140]
    np.testing.assert_array_equal(tensors["mem1"], network[1]["mem1"][np.sort(kept[kept >= 100]) - 100])


def test_a_fraction_of_all_neurons_is_refused(network):
    with pytest.raises(ValueError, match=r"fraction: 1.0, should be in \[0, 1\)"):
        pruned(*network, [np.ones(100), np.ones(100)], 1.0)


def test_without_its_gyroscope_a_network_does_not_follow(network, seen):
    est = NetworkEstimator(Spiking(*network), 200.0)
    found = responses(est, seen)
    assert found["gyro removed"].fast_gain < 0.3 < 0.7 < found["intact"].fast_gain
    assert found["accel zero"].error_deg != found["accel removed"].error_deg  # the input of rest is not 0
