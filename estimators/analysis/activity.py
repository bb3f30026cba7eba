"""What every neuron of a network on the chip does over recorded flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..networks.forward import Spiking
from ..networks.network import BatchedNetwork, roll_pitch_of_outputs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Activity:
    """Spikes and states of a network over n flights of T samples, a step each.

    Neurons stand in a row, encoding, hidden, outputs.
    """

    sizes: tuple[int, ...]
    """Neurons of the layers, of Att-SNN three."""
    spikes: NDArray[np.int8]
    """0 or 1, (n, steps, neurons); those of inputs that spike stand before them."""
    active: NDArray[np.int64]
    """Steps in which a neuron had anything to update: a current, a potential or a bias, (n, neurons)."""
    estimate: Array
    """Roll and pitch after each sample, (n, T, 2) [rad]; of an imported network the output potentials
    (n, T, outputs)."""

    @property
    def rates(self) -> Array:
        """Spikes of each neuron per step, (neurons,)."""
        return self.spikes.mean(axis=(0, 1))

    @property
    def steps(self) -> int:
        """Steps in all flights together."""
        return self.spikes.shape[0] * self.spikes.shape[1]

    def of_layer(self, values: NDArray, layer: int) -> NDArray:
        """The part of an array (..., neurons) that belongs to a layer."""
        edges = np.cumsum((0, *self.sizes))
        return values[..., edges[layer] : edges[layer + 1]]


def record(core: Spiking, gyro: Array, accel: Array) -> Activity:
    """Run a spiking network from rest and record what its neurons do.

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
