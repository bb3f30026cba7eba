"""The estimate of a network is the work of its neurons: the host has no memory but the last good sample."""

import numpy as np
import pytest
from controllers import samples

from estimators import run
from estimators.metrics import attitude_error
from estimators.networks.encoder import ENCODER, scaled_inputs
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


@pytest.mark.parametrize(("weights", "core"), CORES.items())
def test_the_input_part_of_the_state_is_the_last_inputs_and_three_counts(weights, core):
    config, tensors = load_network(weights)
    est = NetworkEstimator(core(config, tensors), config.rate_hz)
    gyro, accel = samples(5, 40)
    est.reset(5)
    encoder = est.states
    assert encoder.shape == (5,)
    assert encoder.dtype.names[:4] == ENCODER.names == ("inputs", "missing", "age", "good")
    est.sequence(gyro, accel)
    x = scaled_inputs(config.inputs, gyro[:, -1:], accel[:, -1:])[:, 0]
    np.testing.assert_array_equal(encoder["inputs"], 1024 * x)
    np.testing.assert_array_equal(encoder["missing"], 0)
