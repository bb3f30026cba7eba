"""A network for another sample rate."""

import numpy as np
import pytest

from estimators.networks.network import NetworkEstimator, Spiking
from estimators.networks.weights_file import shipped_network
from training.rescale import rescaled

STILL = np.array([0.0, 0.0, 9.81])


def estimate(config, tensors, seconds=6.0):
    """Roll and pitch over a slow roll manoeuvre, sampled at the network's own rate."""
    time = np.arange(round(seconds * config.rate_hz)) / config.rate_hz
    gyro = np.zeros((1, time.size, 3))
    gyro[0, :, 0] = 0.4 * np.cos(2 * np.pi * 0.3 * time)
    est = NetworkEstimator(Spiking(config, tensors), config.rate_hz)
    return time, est.sequence(gyro, np.broadcast_to(STILL, gyro.shape))[0]


def test_there_and_back_is_the_same_network():
    config, tensors = rescaled(*shipped_network("att-snn"), 200.0)  # in floats
    back_config, back = rescaled(*rescaled(config, tensors, 700.0), 200.0)
    assert back_config == config
    for name, value in tensors.items():
        np.testing.assert_allclose(back[name], value, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("rate_hz", [100.0, 400.0, 1000.0])
def test_a_spike_leaves_the_same_charge(rate_hz):
    config, tensors = rescaled(*shipped_network("att-snn"), 200.0)
    _, other = rescaled(config, tensors, rate_hz)
    for weight, syn in (("w_ff", "syn1"), ("w_rec", "syn1"), ("w_out", "syn2")):
        charge, wanted = (t[weight] / (1 - t[syn].astype(float))[:, None] for t in (other, tensors))
        np.testing.assert_allclose(charge, wanted, rtol=2e-3, atol=1e-6)
    drive, wanted = (t["w_in"] / (1 - t["syn0"].astype(float))[:, None] for t in (other, tensors))
    np.testing.assert_allclose(drive * rate_hz, wanted * 200.0, rtol=2e-3, atol=1e-6)


def test_a_rescaled_network_estimates_about_the_same():
    config, tensors = rescaled(*shipped_network("att-snn"), 200.0)
    time, at_200 = estimate(config, tensors)
    late, at_400 = estimate(*rescaled(config, tensors, 400.0))
    apart = np.degrees(at_400[:, 0] - np.interp(late, time, at_200[:, 0]))[800:]
    assert np.degrees(at_200[:, 0]).std() > 2.0
    assert np.sqrt(np.mean(apart**2)) < 0.5 * np.degrees(at_200[:, 0]).std()


def test_what_cannot_be_rescaled_is_said():
    with pytest.raises(ValueError, match="att-rnn has no time constants"):
        rescaled(*shipped_network("att-rnn"), 100.0)
    with pytest.raises(ValueError, match="rate_hz = 0"):
        rescaled(*shipped_network("att-snn"), 0.0)
