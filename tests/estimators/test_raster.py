"""Rasters hold the spikes that a network fires."""

import numpy as np
import pytest

from estimators import create
from estimators.analysis.activity import record
from estimators.analysis.raster import spikes_of
from estimators.circuit.circuit_records import EVENTS


@pytest.fixture(scope="module")
def readings():
    """Gyroscope and accelerometer of two seconds of shaking, with a sample missing, and with a gap."""
    rng = np.random.default_rng(3)
    gyro, accel = rng.normal(0.0, 1.0, (400, 3)), rng.normal([0.0, 0.0, 9.81], 2.0, (400, 3))
    gyro[50] = gyro[200:240] = np.nan
    return gyro, accel


def test_the_raster_of_the_circuit_has_the_spikes_that_it_counts(readings):
    est = create("att-snn")
    est.sequence(readings[0][None], readings[1][None])
    events = dict(zip(EVENTS, est.states["events"][0].tolist(), strict=True))
    raster = spikes_of(est, *readings)
    assert {name: len(spikes.time) for name, spikes in raster.items()} == {
        name: events[name] for name in raster
    }
    assert set(raster) == {"vectors", "innovations", "gates", "bias"}
    assert events["vectors"] > 1000
    positive = raster["vectors"].neuron % 2 == 0  # the vectors begin upright, and z spikes first
    assert positive[:20].all()
    assert not positive.all()
    times = raster["vectors"].time
    assert (np.diff(times) >= 0).all()
    assert times[-1] < 2.0
    np.testing.assert_allclose(times * 800, np.rint(times * 800), atol=1e-9)


def test_the_raster_of_layers_has_the_spikes_of_the_chip(readings):
    est = create("att-snn-loihi", weights="att-snn-paper")
    spikes = record(est.core, *(each[None] for each in readings)).spikes[0]
    encoding, hidden, _ = est.core.sizes
    for name, part in (
        ("encoding", spikes[:, :encoding]),
        ("hidden", spikes[:, encoding : encoding + hidden]),
    ):
        time, neuron = spikes_of(est, *readings)[name]
        np.testing.assert_array_equal(np.stack([np.rint(time * 200), neuron]), np.nonzero(part))


def test_an_estimator_without_spikes_has_no_raster(readings):
    assert spikes_of(create("mahony"), *readings) == {}
    assert spikes_of(create("att-rnn"), *readings) == {}
