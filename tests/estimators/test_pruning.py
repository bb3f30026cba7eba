import numpy as np
import pytest

from estimators.analysis.ablation import ablation, error_deg, pruned, without
from estimators.analysis.activity import record
from estimators.analysis.manipulation import responses
from estimators.evaluation.flights import load_flights
from estimators.networks.forward import OnLoihi
from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import load_network


@pytest.fixture(scope="module")
def network():
    return load_network("att-snn-paper")


@pytest.fixture(scope="module")
def seen(flights):
    return load_flights([flights], 2)


@pytest.fixture(scope="module")
def activity(network, seen):
    return record(OnLoihi(*network), seen.gyro, seen.accel)


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
    curve = ablation(*network, values, (0.0, 0.9), seen)
    assert curve[0] == error_deg(*network, seen)
    assert curve[1] > 1.5 * curve[0]
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
