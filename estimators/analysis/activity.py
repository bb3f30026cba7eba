"""What every neuron of a network on the chip does over recorded flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..loihi.neurons import step_arrays
from ..networks.encoder import encode_sample
from ..networks.network import OnLoihi, drive

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Activity:
    """Spikes and states of a network over n flights of T samples, each of one or several steps.

    Neurons stand in a row, encoding, hidden, outputs.
    """

    sizes: tuple[int, int, int]
    """Neurons of the three layers."""
    spikes: NDArray[np.int8]
    """0 or 1, (n, steps, neurons)."""
    active: NDArray[np.int64]
    """Steps in which a neuron had anything to update: a current, a potential or a bias, (n, neurons)."""
    potentials: Array
    """Membranes of the first flight after each step [threshold = 1], (steps, neurons)."""
    estimate: Array
    """Roll and pitch after each sample, (n, T, 2) [rad]."""

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


def record(core: OnLoihi, gyro: Array, accel: Array) -> Activity:
    """Run a network on the chip from rest and keep what its neurons did.

    Args:
        core: The network.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
    """
    n, samples, _ = gyro.shape
    neurons, steps = sum(core.chip.sizes), samples * core.steps
    spikes = np.zeros((n, steps, neurons), np.int8)
    active = np.zeros((n, neurons), np.int64)
    potentials = np.zeros((steps, neurons), np.int32)
    out = np.empty((n, samples, 2))
    gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
    _record(
        gyro, accel, *core.host, core.steps, core.scale, core.zero(n), core.chip.parameters,
        spikes, active, potentials, out,
    )  # fmt: skip
    threshold = np.concatenate([np.asarray(layer.vth) * 64.0 for layer in core.chip.layers])
    first, second, third = core.chip.sizes
    return Activity((first, second, third), spikes, active, potentials / threshold, out)


@njit(cache=True)
def _record(
    gyro, accel, offset, gain, w_in, du, steps, scale, states, parameters, spikes, active, potentials, out
):  # fmt: skip
    inputs, current, before, after, u, v, bias = states
    outputs = v[:, v.shape[1] - out.shape[2] :]
    for t in range(gyro.shape[1]):
        for n in range(gyro.shape[0]):
            encode_sample(gyro[n, t], accel[n, t], offset, gain, inputs[n])
        for k in range(steps):
            for n in range(gyro.shape[0]):
                drive(inputs[n], w_in, du, current[n], bias[n])
            step_arrays(before, after, u, v, bias, *parameters)
            spikes[:, t * steps + k] = after
            potentials[t * steps + k] = v[0]
            for n in range(gyro.shape[0]):
                for i in range(v.shape[1]):
                    if u[n, i] != 0 or v[n, i] != 0 or bias[n, i] != 0 or after[n, i] != 0:
                        active[n, i] += 1
        for n in range(gyro.shape[0]):
            for k in range(out.shape[2]):
                out[n, t, k] = outputs[n, k] * scale
