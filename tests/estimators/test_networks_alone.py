"""The estimate of a network is the work of its neurons: the host has no memory but the last good sample."""

import pytest

from estimators import run
from estimators.metrics import attitude_error
from estimators.networks.forward import OnLoihi
from estimators.networks.gru import Recurrent
from estimators.networks.network import NetworkEstimator, silenced
from estimators.networks.weights_file import load_network

CORES = {"att-snn-paper": OnLoihi, "att-rnn-paper": Recurrent}


@pytest.mark.parametrize(("weights", "core"), CORES.items())
def test_the_silenced_error_is_at_least_three_times_the_error(weights, core, hummingbird):
    config, tensors = load_network(weights)
    errors = []
    for each in (tensors, silenced(config, tensors)):
        estimate = run(NetworkEstimator(core(config, each), config.rate_hz), *hummingbird.readings[:2])
        errors.append(attitude_error(estimate, hummingbird.truth).mean)
    assert errors[1] >= 3.0 * errors[0]
