"""The estimate of a network is the work of its neurons: the host has no memory but the last good sample."""

import numpy as np
import pytest

from estimators.evaluation.flights import load_flights
from estimators.metrics import attitude_error
from estimators.networks.encoder import ENCODER, scaled_inputs
from estimators.networks.network import NetworkEstimator, OnLoihi, Recurrent, Spiking, silenced
from estimators.networks.weights_file import NetworkConfig, load_network
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe

FACTOR = 3.0
"""Least ratio of the silenced error to the network's error."""
SEED = 910_033
"""Of the flights; no training uses it."""
CORES = {"att-snn": Spiking, "att-snn-loihi": OnLoihi, "att-rnn": Recurrent}


@pytest.fixture(scope="module")
def validation(tmp_path_factory):
    """Four flights of 30 s, of the paper's domain."""
    config = load_recipe("hummingbird")
    path = tmp_path_factory.mktemp("alone") / "flights.zarr"
    return load_flights([open_dataset(generate(config, 4, 30.0, path, seed=SEED, workers=1))])


def error_deg(core, flights):
    """Mean absolute error of roll and pitch from an unknown start [deg]."""
    est = NetworkEstimator(core, flights.rate_hz)
    est.reset(len(flights.gyro))
    return attitude_error(est.sequence(flights.gyro, flights.accel), flights.truth).mean


def silenced_ratio(name, weights, flights):
    """Error with output weights of zero, over the error."""
    config, tensors = load_network(weights)
    whole, silent = (error_deg(CORES[name](config, w), flights) for w in (tensors, silenced(config, tensors)))
    return silent / whole


@pytest.mark.parametrize(
    ("name", "weights"),
    [
        ("att-snn", "att-snn"),
        ("att-snn-loihi", "att-snn"),
        ("att-snn-loihi", "att-snn-hummingbird"),
        ("att-snn-loihi", "att-snn-paper"),
        ("att-rnn", "att-rnn"),
        ("att-rnn", "att-rnn-paper"),
    ],
)
def test_the_silenced_error_is_at_least_three_times_the_error(name, weights, validation):
    assert silenced_ratio(name, weights, validation) >= FACTOR


@pytest.mark.parametrize("name", CORES)
def test_the_input_part_of_the_state_is_the_last_inputs_and_a_count(name):
    config, tensors = load_network("att-rnn" if name == "att-rnn" else "att-snn")
    est = NetworkEstimator(CORES[name](config, tensors), config.rate_hz)
    rng = np.random.default_rng(0)
    gyro, accel = rng.normal(0, 1, (5, 40, 3)), rng.normal([0, 0, 9.8], 0.5, (5, 40, 3))
    est.reset(5)
    encoder = est.states["encoder"]
    assert encoder.shape == (5,)
    assert encoder.dtype == ENCODER == [("inputs", float, 6), ("missing", np.int64)]
    est.sequence(gyro, accel)
    x = scaled_inputs(config.inputs, gyro[:, -1:], accel[:, -1:])[:, 0]
    np.testing.assert_array_equal(encoder["inputs"], 1024 * x)
    np.testing.assert_array_equal(encoder["missing"], 0)


def test_the_inputs_have_offsets_and_ranges_and_no_other_setting():
    assert set(NetworkConfig(model="att-snn").inputs.model_dump()) == {"gyro", "accel", "accel_offset"}
