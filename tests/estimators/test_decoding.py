"""Decoding of quantities from a network's activity."""

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.analysis.activity import record
from estimators.analysis.decoding import (
    FOLDS,
    READINGS_S,
    SPIKES_S,
    decode,
    low_pass_kernels,
    random_starts,
    reading_features,
    shuffled,
    spike_features,
    turned_tilt,
)
from estimators.networks.network import OnLoihi
from estimators.networks.weights_file import shipped_network
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.imu import load_imu
from quadsim.rotation import quat_from_euler

FLIGHTS, EACH, NEURONS, TIMES, STEPS = 8, 12, 40, np.array([40, 200]), 200


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Flights of 20 s with everything that there is to decode."""
    path = tmp_path_factory.mktemp("decoding") / "flights.zarr"
    return open_dataset(generate(load_recipe("hummingbird"), FOLDS, 20.0, path, seed=5))


@pytest.fixture(scope="module")
def starts(simulated):
    return random_starts(simulated, load_imu("adis16448"), 3, (0.005, 0.5, 2.0), seed=1)


@pytest.fixture
def population():
    """A constant pair of numbers for each start, and spikes (n, T, neurons) whose rates are linear in it."""
    rng = np.random.default_rng(0)
    known = rng.uniform(-1, 1, (FLIGHTS * EACH, 2))
    rates = 0.5 + 0.2 * known @ rng.uniform(-1, 1, (2, NEURONS))
    spikes = rng.random((len(known), STEPS, NEURONS)) < rates[:, None]
    return known, spikes, np.repeat(np.arange(FLIGHTS), EACH)


def decoded(known, spikes, flight):
    kernel = low_pass_kernels(TIMES, (0.5,), 200.0)[0]
    quantities = {"known": np.repeat(known[:, None], len(TIMES), axis=1)}
    return decode(np.einsum("bt,ntk->nbk", kernel, spikes), quantities, flight)["known"]


def test_what_spikes_encode_is_decoded_and_better_the_longer_they_are_observed(population):
    found = decoded(*population)
    assert found.r2.shape == (2,)
    assert found.r2[0] < found.r2[1]
    assert 0.9 < found.r2[1] < 1.0
    low, high = found.interval()
    assert np.all((low < found.r2) & (found.r2 < high))


def test_spikes_that_encode_nothing_decode_to_nothing(population):
    known, spikes, flight = population
    random = np.random.default_rng(1).random(spikes.shape) < 0.5
    found = decoded(known, random, flight)
    assert np.all((found.r2 > -0.3) & (found.r2 < 0.1))
    assert np.all(decoded(*population).gain_interval(found)[0] > 0.3)


def test_what_tells_flights_apart_but_does_not_carry_over_to_others_is_not_decoded(population):
    _, _, flight = population
    rng = np.random.default_rng(2)
    own, codes = rng.normal(size=(FLIGHTS, 1, 2)), rng.normal(size=(FLIGHTS, 1, NEURONS))
    assert decode(codes[flight], {"own": own[flight]}, flight)["own"].r2[0] < 0.2


def test_silent_neurons_are_no_obstacle(population):
    known, spikes, flight = population
    assert np.all(decoded(known, 0 * spikes, flight).r2 == 0.0)


def test_too_few_flights_are_refused_in_one_line(population):
    known, spikes, flight = population
    with pytest.raises(ValueError, match=r"^decoding: 3 flights, should be 4 or more$"):
        decoded(known, spikes, flight % 3)


def test_low_passed_values_are_those_of_the_recursive_filter():
    x = np.random.default_rng(0).normal(size=200)
    pole = np.exp(-1 / (200.0 * 0.1))
    expected = lfilter([1 - pole], [1, -pole], x)[TIMES - 1]
    np.testing.assert_allclose(low_pass_kernels(TIMES, (0.1,), 200.0)[0] @ x, expected, rtol=1e-12)


def test_every_start_has_its_own_biases_and_the_quantities_of_its_place(starts, simulated):
    assert starts.gyro.shape == starts.accel.shape == (3 * FOLDS, 400, 3)
    assert all(values.shape == (3 * FOLDS, 3, 2) for values in starts.quantities.values())
    biases = starts.quantities["gyroscope bias"][:, 0, 0]
    assert np.unique(biases).size == biases.size
    np.testing.assert_allclose(  # at the first sample no yaw has been turned since the start
        np.linalg.norm(starts.quantities["turned tilt"][:, 0], axis=-1),
        np.linalg.norm(starts.quantities["tilt"][:, 0], axis=-1),
        atol=1e-5,
    )
    with pytest.raises(ValueError, match=r"^decoding: flights of 20 s, should be 21 s or more$"):
        random_starts(simulated, load_imu("adis16448"), 1, (21.0,))


def test_turned_tilt_does_not_turn_with_yaw_after_the_start():
    tilted = quat_from_euler(0.0, 0.3, 0.0)
    start, seen = quat_from_euler(0.0, 0.0, 1.0), quat_from_euler(0.0, 0.3, 1.0)
    np.testing.assert_allclose(turned_tilt(seen, start), [np.sin(0.3), 0.0, np.cos(0.3)], atol=1e-12)
    np.testing.assert_allclose(
        turned_tilt(tilted, start)[:2], 0.29552 * np.array([0.5403, -0.84147]), atol=1e-4
    )


def test_features_are_of_the_hidden_layer_from_rest_and_of_the_readings(starts):
    core = OnLoihi(*shipped_network("att-snn"))
    features = spike_features(core, starts)
    hidden = core.chip.sizes[1]
    assert features.shape == (3 * FOLDS, 3, len(SPIKES_S) * hidden)
    assert np.all(features[:, 0] == 0.0)  # the second layer has had no input after one sample
    activity = record(core, starts.gyro, starts.accel)
    pole = np.exp(-1 / (200.0 * SPIKES_S[0]))
    spikes = activity.of_layer(activity.spikes, 1).astype(float)
    expected = lfilter([1 - pole], [1, -pole], spikes, axis=1)[:, starts.times - 1]
    np.testing.assert_allclose(features[..., :hidden], expected, atol=1e-6)
    assert reading_features(starts).shape == (3 * FOLDS, 3, 6 * len(READINGS_S))


def test_shuffling_keeps_the_weights_but_not_their_places_and_leaves_the_outputs():
    _, tensors = shipped_network("att-snn")
    mixed = shuffled(tensors)
    for name, values in tensors.items():
        assert mixed[name].shape == values.shape
        np.testing.assert_array_equal(np.sort(mixed[name], axis=None), np.sort(values, axis=None))
    assert np.any(mixed["w_rec"] != tensors["w_rec"])
    np.testing.assert_array_equal(mixed["w_out"], tensors["w_out"])
