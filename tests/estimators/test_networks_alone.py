"""The estimate of a network is the work of its neurons: the host has no memory but the last good sample."""

import numpy as np
import pytest

from estimators.evaluation.flights import load_flights
from estimators.metrics import attitude_error
from estimators.networks.encoder import ENCODER, scaled_inputs
from estimators.networks.forward import OnLoihi
from estimators.networks.gru import Recurrent
from estimators.networks.network import NetworkEstimator, silenced
from estimators.networks.weights_file import load_network
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe

FACTOR = 3.0
"""Least ratio of the silenced error to the network's error."""
SEED = 910_033
"""Of the flights; no training uses it."""
CORES = {"att-snn-loihi": OnLoihi, "att-rnn": Recurrent}


@pytest.fixture(scope="module")
def validation(tmp_path_factory):
    """Four flights of 30 s, of the paper's domain."""
    config = load_recipe("hummingbird")
    path = tmp_path_factory.mktemp("alone") / "flights.zarr"
    return load_flights([open_dataset(generate(config, 4, 30.0, path, seed=SEED, workers=1))])


@pytest.mark.parametrize(
    ("name", "weights"),
    [
        ("att-snn-loihi", "att-snn-paper"),
        ("att-rnn", "att-rnn-paper"),
    ],
)
def test_the_silenced_error_is_at_least_three_times_the_error(name, weights, validation):
    config, tensors = load_network(weights)
    errors = []
    for each in (tensors, silenced(config, tensors)):
        est = NetworkEstimator(CORES[name](config, each), config.rate_hz)
        est.reset(len(validation.gyro))
        estimate = est.sequence(validation.gyro, validation.accel)
        errors.append(attitude_error(estimate, validation.truth).mean)
    assert errors[1] >= FACTOR * errors[0]


@pytest.mark.parametrize("name", CORES)
def test_the_input_part_of_the_state_is_the_last_inputs_and_three_counts(name):
    config, tensors = load_network("att-rnn-paper" if name == "att-rnn" else "att-snn-paper")
    est = NetworkEstimator(CORES[name](config, tensors), config.rate_hz)
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1, (5, 40, 3)), rng.normal([0, 0, 9.8], 0.5, (5, 40, 3))
    est.reset(5)
    encoder = est.states
    assert encoder.shape == (5,)
    assert encoder.dtype.names[:4] == ENCODER.names == ("inputs", "missing", "age", "good")
    est.sequence(gyro, accel)
    x = scaled_inputs(config.inputs, gyro[:, -1:], accel[:, -1:])[:, 0]
    np.testing.assert_array_equal(encoder["inputs"], 1024 * x)
    np.testing.assert_array_equal(encoder["missing"], 0)
