"""Spike rasters of spiking networks on one recording."""

import numpy as np

from quadsim.estimator import AttitudeEstimator
from quadsim.pictures.timeline import Array, SpikeRaster

from ..circuit.spikes import SpikingCircuit
from ..networks.forward import Spiking
from ..networks.network import NO_SET_POINTS, NetworkEstimator, zero_states
from .activity import record


def spikes_of(est: AttitudeEstimator | None, gyro: Array, accel: Array) -> dict[str, SpikeRaster]:
    """Run the network of an estimator on a recording and return its spikes.

    Args:
        est: The estimator, which is not changed.
        gyro: Body rate (T, 3) [rad/s]; NaN where missing.
        accel: Specific force (T, 3) [m/s²]; NaN where missing.

    Returns:
        Spikes by population; the first sample is at 0 s. Neuron k of the circuit has the index 2 k for
        positive spikes and 2 k + 1 for negative spikes. The result is empty for an estimator without spikes.
    """
    if not isinstance(est, NetworkEstimator):
        return {}
    core = est.core
    if isinstance(core, SpikingCircuit):
        return _of_circuit(core, gyro, accel, est.rate_hz)
    if not isinstance(core, Spiking):
        return {}
    fired = record(core, gyro[None], accel[None]).spikes[0]
    encoding, hidden, _ = np.split(fired, np.cumsum(core.sizes[:2]), axis=1)
    return _listed({"encoding": encoding, "hidden": hidden}, est.rate_hz)


def _of_circuit(core: SpikingCircuit, gyro: Array, accel: Array, rate_hz: float) -> dict[str, SpikeRaster]:
    steps, vectors, gates = (int(core.arrays[0][k]) for k in (12, 15, 16))
    sizes = {"vectors": 3 * vectors, "innovations": 3 * gates, "gates": gates, "bias": 3}
    fired = np.zeros((1, len(gyro) * steps, sum(sizes.values())), np.int8)
    readings = (np.ascontiguousarray(each, np.float64).reshape(1, -1) for each in (gyro, accel))
    out = np.empty((1, 3 * len(gyro)))
    core.kernel(*readings, NO_SET_POINTS, *core.arrays, zero_states(core, 1), out, fired)
    parts = np.split(fired[0], np.cumsum(list(sizes.values()))[:-1], axis=1)
    signed = {}
    for name, part in zip(sizes, parts, strict=True):
        rows = part if name == "gates" else np.stack([part > 0, part < 0], axis=2)
        signed[name] = rows.reshape(len(part), -1)
    return _listed(signed, rate_hz * steps)


def _listed(rasters: dict[str, np.ndarray], rate_hz: float) -> dict[str, SpikeRaster]:
    """Convert rasters (steps, neurons) to lists of spikes; populations without spikes are omitted."""
    found = {name: np.nonzero(raster) for name, raster in rasters.items()}
    return {name: SpikeRaster(step / rate_hz, neuron) for name, (step, neuron) in found.items() if step.size}
