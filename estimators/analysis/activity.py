"""Activity of every neuron of a network on the chip during recorded flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..networks.forward import Spiking
from ..networks.network import BatchedNetwork, roll_pitch_of_outputs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Activity:
    """Spikes and states of a network over n flights of T samples, with one step per sample.

    The neurons are in the order encoding, hidden, outputs.
    """

    sizes: tuple[int, ...]
    """Number of neurons in each layer."""
    spikes: NDArray[np.int8]
    """Spikes, 0 or 1, (n, steps, neurons); spiking inputs come before the neurons."""
    active: NDArray[np.int64]
    """Number of steps in which a neuron had a current, a potential or a bias to update, (n, neurons)."""
    estimate: Array
    """Outputs after each sample: roll and pitch (n, T, 2) [rad]; for an imported network, output potentials
    (n, T, outputs)."""

    @property
    def rates(self) -> Array:
        """Spikes per step of each neuron, (neurons,)."""
        return self.spikes.mean(axis=(0, 1))

    @property
    def steps(self) -> int:
        """Total number of steps in all flights."""
        return self.spikes.shape[0] * self.spikes.shape[1]

    def of_layer(self, values: NDArray, layer: int) -> NDArray:
        """Return the part of an array (..., neurons) that belongs to a layer."""
        edges = np.cumsum((0, *self.sizes))
        return values[..., edges[layer] : edges[layer + 1]]


def record(core: Spiking, gyro: Array, accel: Array) -> Activity:
    """Run a spiking network from rest and record the activity of its neurons.

    Args:
        core: The network.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
    """
    n, samples, _ = np.shape(gyro)
    network, neurons = BatchedNetwork(core), sum(core.sizes)
    network.begin(n)
    spikes, active = np.zeros((n, samples, neurons), np.int8), np.zeros((n, neurons), np.int64)
    outputs = np.empty((n, samples, core.outputs))
    for k in range(samples):
        part = slice(k, k + 1)
        outputs[:, part] = network.outputs(gyro[:, part], accel[:, part])
        spikes[:, k] = core.spikes(network.states)
        active += core.active(network.states)
    return Activity(core.sizes, spikes, active, roll_pitch_of_outputs(outputs))
