"""What every neuron of a network on the chip does over recorded flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..networks.forward import OnLoihi
from ..networks.network import roll_pitch_of_outputs, zero_states

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
    """Roll and pitch after each sample, (n, T, 2) [rad]; of a controller its outputs, (n, T, 3) [rad/s²]; of
    an imported network the output potentials (n, T, outputs)."""

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


def record(core: OnLoihi, gyro: Array, accel: Array, set_points: Array | None = None) -> Activity:
    """Run a network on the chip from rest and record what its neurons do.

    Args:
        core: The network.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        set_points: Of a controller, as integer inputs (n, T, 3).
    """
    n, samples, _ = np.shape(gyro)
    more = np.zeros((n, samples, 0)) if set_points is None else set_points
    by_sample = [np.array(np.swapaxes(each, 0, 1), np.float64, order="C") for each in (gyro, accel, more)]
    neurons = sum(core.sizes)
    spikes, active = np.zeros((n, samples, neurons), np.int8), np.zeros((n, neurons), np.int64)
    outputs, numbers = np.empty((samples, n, core.outputs)), zero_states(core, n)
    state = numbers.view(core.state)[:, 0]
    for k in range(samples):
        core.kernel(*(each[k] for each in by_sample), *core.arrays, numbers, outputs[k])
        spikes[:, k] = core.spikes(state)
        active += core.active(state)
    answers = outputs.swapaxes(0, 1)
    estimate = roll_pitch_of_outputs(answers) if set_points is None else answers
    return Activity(core.sizes, spikes, active, estimate)
