"""What every neuron of a network on the chip does over recorded flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.block import fields, zero_blocks

from ..networks.encoder import encode
from ..networks.network import NO_SET_POINTS, OnLoihi, roll_pitch_of_outputs, step_on_loihi

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
    active_currents: NDArray[np.int64]
    """Steps in which an after-spike current, which has a compartment of its own, was not 0, (n, neurons)."""
    potentials: Array
    """Membranes of the first flight after each step [threshold = 1], (steps, neurons)."""
    estimate: Array
    """Roll and pitch after each sample, (n, T, 2) [rad]; of a controller its outputs, (n, T, 3) [rad/s²]."""

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
    gyro, accel = np.asarray(gyro, np.float64), np.asarray(accel, np.float64)
    n, samples, _ = gyro.shape
    neurons, steps = sum(core.chip.sizes), samples * core.steps
    spikes = np.zeros((n, steps, neurons), np.int8)
    active, active_currents = np.zeros((2, n, neurons), np.int64)
    potentials = np.zeros((steps, neurons), np.int32)
    outputs = np.empty((n, samples, core.outputs))
    states = zero_blocks(n, core.state)
    state = fields(states, core.state)
    s, u, v, a, bias = (state[name] for name in ("spikes", "u", "v", "a", "bias"))
    for t in range(samples):
        encode(gyro[:, t], accel[:, t], core.host, state["encoder"])
        for k in range(t * core.steps, (t + 1) * core.steps):
            step_on_loihi(core.network, states, NO_SET_POINTS if set_points is None else set_points[:, t])
            spikes[:, k], potentials[k] = s, v[0]
            active += (u != 0) | (v != 0) | (a != 0) | (bias != 0) | (s != 0)
            active_currents += a != 0
        outputs[:, t] = v[:, -core.outputs :] * core.scale
    threshold = np.concatenate([np.asarray(layer.vth) * 64.0 for layer in core.chip.layers])
    first, second, third = core.chip.sizes
    estimate = roll_pitch_of_outputs(outputs) if set_points is None else outputs
    sizes = first, second, third
    return Activity(sizes, spikes, active, active_currents, potentials / threshold, estimate)
