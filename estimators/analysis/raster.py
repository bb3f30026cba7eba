"""Which neurons of a spiking network spike when, on one recording."""

import numpy as np

from quadsim.estimator import AttitudeEstimator
from quadsim.pictures.timeline import Array, Spikes

from ..circuit.spikes import SpikingCircuit, record_circuit
from ..networks.forward import Spiking
from ..networks.network import NetworkEstimator, zero_states


def spikes_of(est: AttitudeEstimator | None, gyro: Array, accel: Array) -> dict[str, Spikes]:
    """Run the network of an estimator over a recording again; a network begins alike at every start.

    Args:
        est: The estimator; it is left as it is.
        gyro: Body rate (T, 3) [rad/s]; NaN where missing.
        accel: Specific force (T, 3) [m/s²]; NaN where missing.

    Returns:
        Spikes by population, from the first sample at 0 s. A neuron of the circuit that spikes with a sign is
        two, 2 k and, of negative spikes, 2 k + 1. Nothing for an estimator that does not spike.
    """
    if not isinstance(est, NetworkEstimator):
        return {}
    core = est.core
    if isinstance(core, SpikingCircuit):
        return _of_circuit(core, gyro, accel, est.rate_hz)
    if not isinstance(core, Spiking):
        return {}
    again, fired = NetworkEstimator(core, est.rate_hz), np.zeros((len(gyro), sum(core.sizes)), bool)
    for k in range(len(gyro)):
        again.update(gyro[k : k + 1], accel[k : k + 1])
        fired[k] = core.spikes(again.states)[0]
    encoding, hidden, _ = core.sizes
    parts = {"encoding": fired[:, :encoding], "hidden": fired[:, encoding : encoding + hidden]}
    return _listed(parts, est.rate_hz)


def _of_circuit(core: SpikingCircuit, gyro: Array, accel: Array, rate_hz: float) -> dict[str, Spikes]:
    settings, numbers = core.arrays
    steps, vectors, gates = (int(settings[k]) for k in (12, 15, 16))
    sizes = {"vectors": 3 * vectors, "innovations": 3 * gates, "gates": gates, "bias": 3}
    fired = np.zeros((len(gyro) * steps, sum(sizes.values())), np.int8)
    record_circuit(gyro, accel, settings, numbers, zero_states(core, 1)[0], fired)
    parts = np.split(fired, np.cumsum(list(sizes.values()))[:-1], axis=1)
    signed = {}
    for name, part in zip(sizes, parts, strict=True):
        rows = part if name == "gates" else np.stack([part > 0, part < 0], axis=2)
        signed[name] = rows.reshape(len(part), -1)
    return _listed(signed, rate_hz * steps)


def _listed(rasters: dict[str, np.ndarray], rate_hz: float) -> dict[str, Spikes]:
    """Rasters (steps, neurons) as lists of their spikes; a population without one is left out."""
    found = {name: np.nonzero(raster) for name, raster in rasters.items()}
    return {name: Spikes(step / rate_hz, neuron) for name, (step, neuron) in found.items() if step.size}
