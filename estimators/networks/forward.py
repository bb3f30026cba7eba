"""Compiled forward pass of Att-SNN: 6 inputs -> LIF -> recurrent LIF -> 2 or 3 leaky integrators (LI).

A controller is the same network with 9 inputs: set-points follow the readings.

One function, `step`, is the network for training, streaming and whole sequences alike. Per layer

    u[t] = D(u[t-1], τ_syn) + W s[t-1]
    a[t] = D(a[t-1], τ_after) + w_after s[t-1]
    v[t] = D(v[t-1], τ_mem) + u[t] + a[t],   s[t] = v[t] > 0.5,   v[t] = 0 where s[t]

The encoding layer's current is driven by the input sample of the same step; the outputs never spike. Hidden
neurons may have an after-spike current a, driven by their own spikes alone: with a negative weight it is
spike-frequency adaptation, with a positive one it holds activity up (Teeter et al. 2018, "Generalized leaky
integrate-and-fire models classify multiple neuron types").
In floats D(x, τ) = x τ and 1.0 is 1.0. Quantised, D rounds toward zero and 1.0 is 2^14: then all numbers are
whole, float64 holds them exactly, and the result is what `estimators.loihi` computes in integers.
"""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import numpy as np

from quadsim.runs.block import block_type, matrix, vector
from quadsim.runs.compiled import njit

from ..loihi import neurons
from .encoder import ENCODER, INPUT_ONE, Scaling, encode_sample

Values = TypeVar("Values")
THRESHOLD = 0.5
STATE_ONE = float(neurons.STATE_ONE)
BIAS_EXP = 4
"""Exponent of the bias by which the host drives the encoding layer: steps of 2^4 state units."""
BIAS_STEP, MANT_MAX = 2.0**BIAS_EXP, float(neurons.BIAS_MANT_MAX)
V_MAX = float(neurons.STATE_MAX)
OUTPUT_THRESHOLD = neurons.VTH_MAX * 64.0
"""The highest that the chip has; an output that gets there all the same is reset."""
_WRAP_21, _WRAP_23 = 2.0**21, 2.0**23


class Weights(NamedTuple, Generic[Values]):
    """Parameters of the network, arrays or tensors, in units of 1.0.

    `step` and `run_floats` take the matrices transposed, one row for each source, and in state units.
    """

    w_in: Values  #: encoding weights, shape (h0, inputs)
    w_ff: Values  #: encoding to hidden layer, shape (h1, h0)
    w_rec: Values  #: recurrent weights, shape (h1, h1)
    w_out: Values  #: hidden layer to outputs, shape (outputs, h1)
    w_after: Values
    """Hidden neurons to their own after-spike currents, shape (h1, 1); (h1, 0) in a network without."""
    syn0: Values  #: τ_syn of the encoding layer, shape (h0,)
    mem0: Values  #: τ_mem of the encoding layer, shape (h0,)
    syn1: Values  #: τ_syn of the hidden layer, shape (h1,)
    mem1: Values  #: τ_mem of the hidden layer, shape (h1,)
    syn2: Values  #: τ_syn of the outputs, shape (1,)
    mem2: Values  #: τ_mem of the outputs, shape (1,)
    syn_after: Values  #: τ_after of the hidden layer, shape (h1,), or (0,) without after-spike currents


MATRICES, TIME_CONSTANTS = Weights._fields[:5], Weights._fields[5:]


class NetworkState(NamedTuple, Generic[Values]):
    """Currents u, membrane potentials v and spikes s of the layers, one row for each copy of the network."""

    u0: Values  #: encoding layer, shape (n, h0)
    v0: Values  #: before the reset, as are the others, shape (n, h0)
    s0: Values  #: number of spikes of the last step, then the neurons that spiked, shape (n, h0 + 1)
    u1: Values  #: hidden layer, shape (n, h1)
    v1: Values  #: shape (n, h1)
    s1: Values  #: shape (n, h1 + 1)
    s1_delayed: Values
    """Spikes that the recurrent connection delivers next: `s1` where the delay is 1, shape (n, h1 + 1)."""
    a1: Values  #: after-spike currents of the hidden layer, 0 without them, shape (n, h1)
    u2: Values  #: outputs, shape (n, outputs)
    v2: Values  #: shape (n, outputs)


@njit(cache=True, inline="always")
def _decay(x, tau, quantised):
    return np.trunc(x * tau) if quantised else x * tau


@njit(cache=True, inline="always")
def _wrap(x, half):
    """Two's complement: into [-half, half)."""
    return x - 2.0 * half * np.floor((x + half) * (0.5 / half))


@njit(cache=True, inline="always")
def _integrated(y, quantised):
    """Potential of an output: on the chip it is reset at the highest threshold that there is."""
    return (0.0 if y > OUTPUT_THRESHOLD else max(y, -V_MAX)) if quantised else y


@njit(cache=True, inline="always")
def _bias(current):
    """The bias mantissa of a current, rounded toward zero, times its step."""
    return min(max(np.trunc(current / BIAS_STEP), -MANT_MAX), MANT_MAX) * BIAS_STEP


@njit(cache=True, inline="always")
def list_spikes(v, threshold, spikes):
    """Write the number of neurons above the threshold and then their indices into `spikes`."""
    count = 0
    for i in range(v.shape[0]):
        spikes[1 + count] = i
        count += v[i] > threshold
    spikes[0] = count


@njit(cache=True, inline="always")
def _add_rows(total, weights, spikes):
    """Add the rows of `weights` that belong to the neurons that spiked, four at a time."""
    count = spikes[0]
    fours = count - count % 4
    for k in range(1, 1 + fours, 4):
        j0, j1, j2, j3 = spikes[k], spikes[k + 1], spikes[k + 2], spikes[k + 3]
        for i in range(total.shape[0]):
            total[i] += (weights[j0, i] + weights[j1, i]) + (weights[j2, i] + weights[j3, i])
    for k in range(1 + fours, 1 + count):
        j0 = spikes[k]
        for i in range(total.shape[0]):
            total[i] += weights[j0, i]


@njit(cache=True, inline="always")
def _weigh(x, weights, total):
    """Add the rows of `weights` times the numbers in x, three at a time."""
    threes = x.shape[0] - x.shape[0] % 3
    for k in range(0, threes, 3):
        x0, x1, x2 = x[k], x[k + 1], x[k + 2]
        for i in range(total.shape[0]):
            total[i] += weights[k, i] * x0 + weights[k + 1, i] * x1 + weights[k + 2, i] * x2
    for k in range(threes, x.shape[0]):
        x0 = x[k]
        for i in range(total.shape[0]):
            total[i] += weights[k, i] * x0


@njit(cache=True, inline="always")
def _membrane(v, u, tau, threshold, quantised):
    """Reset, decay, add the current u; the potential is stored before the reset."""
    x = _decay(0.0 if v > threshold else v, tau, quantised) + u
    return min(max(x, -V_MAX), V_MAX) if quantised else x


@njit(cache=True, inline="always")
def step(x, w, state, total, drive, quantised):
    """One step of one copy of the network, whose currents and potentials change in place.

    The spikes are those of the step before; `list_spikes` finds the new ones.

    Args:
        x: Input sample, shape (inputs,).
        w: Weights by source, in state units.
        state: State of the copy.
        total: Zeros in the type of the weights, shape (h1,), to add in; zeros again afterwards.
        drive: The same, shape (h0,).
        quantised: Integer arithmetic (True) or floats; a literal, for loops that branch are not vectorised.
    """
    threshold = THRESHOLD * (STATE_ONE if quantised else 1.0)
    u0, v0, u1, v1, u2, v2 = state.u0, state.v0, state.u1, state.v1, state.u2, state.v2
    a1 = state.a1
    for o in range(u2.shape[0]):
        delivered = 0.0
        for k in range(1, 1 + state.s1[0]):
            delivered += w.w_out[state.s1[k], o]
        if quantised:
            delivered = _wrap(delivered, _WRAP_21)
        u2[o] = _decay(u2[o], w.syn2[0], quantised) + delivered
        if quantised:
            u2[o] = _wrap(u2[o], _WRAP_23)
        v2[o] = _integrated(_decay(v2[o], w.mem2[0], quantised) + u2[o], quantised)

    # What has just been stored is slow to load: current and potential share a loop, and sums are set to zero
    # where they have been used, not where they begin.
    for k in range(w.w_after.shape[0]):
        for i in range(v1.shape[0]):
            own = np.float64(w.w_after[k, i]) if v1[i] > threshold else 0.0
            a1[i] = _decay(a1[i], w.syn_after[i], quantised) + own
            if quantised:
                a1[i] = _wrap(a1[i], _WRAP_23)
    _add_rows(total, w.w_ff, state.s0)
    _add_rows(total, w.w_rec, state.s1_delayed)
    for i in range(v1.shape[0]):
        u = _decay(u1[i], w.syn1[i], quantised)
        if quantised:
            u = _wrap(u + _wrap(np.float64(total[i]), _WRAP_21), _WRAP_23)
        else:
            u += np.float64(total[i])
        u1[i], total[i] = u, 0
        v1[i] = _membrane(v1[i], u + a1[i], w.mem1[i], threshold, quantised)

    _weigh(x, w.w_in, drive)
    for i in range(v0.shape[0]):
        u = _decay(u0[i], w.syn0[i], quantised)
        if quantised:
            u = _wrap(u + np.trunc(drive[i]), _WRAP_23)
        else:
            u += drive[i]
        u0[i], drive[i] = u, 0.0
        if quantised:
            u = _bias(u)  # reaches the chip as a bias mantissa
        v0[i] = _membrane(v0[i], u, w.mem0[i], threshold, quantised)


def state_type(h0: int, h1: int, outputs: int) -> np.dtype:
    """Record type of a copy's state: that of its encoder, and the fields of `NetworkState`."""
    potentials = {name: (np.float64, (h0,)) for name in ("u0", "v0")}
    potentials |= {name: (np.float64, (h1,)) for name in ("u1", "v1", "a1")}
    potentials |= {name: (np.float64, (outputs,)) for name in ("u2", "v2")}
    spikes = {"s0": (np.int32, (h0 + 1,))} | {name: (np.int32, (h1 + 1,)) for name in ("s1", "s1_delayed")}
    ordered = {name: (potentials | spikes)[name] for name in NetworkState._fields}
    return block_type({"encoder": (ENCODER, ())} | ordered)


@njit(cache=True)
def _weights(network):
    w_in, w_ff = matrix(network, 2, np.float64), matrix(network, 3, np.float64)
    w_rec, w_out = matrix(network, 4, np.float64), matrix(network, 5, np.float64)
    w_after = matrix(network, 6, np.float64)
    syn0, mem0 = vector(network, 7, np.float64), vector(network, 8, np.float64)
    syn1, mem1 = vector(network, 9, np.float64), vector(network, 10, np.float64)
    syn2, mem2 = vector(network, 11, np.float64), vector(network, 12, np.float64)
    syn_after = vector(network, 13, np.float64)
    return Weights(w_in, w_ff, w_rec, w_out, w_after, syn0, mem0, syn1, mem1, syn2, mem2, syn_after)


@njit(cache=True)
def _state(block, recurrent_delay):
    u0, v0, s0 = vector(block, 1, np.float64), vector(block, 2, np.float64), vector(block, 3, np.int32)
    u1, v1, s1 = vector(block, 4, np.float64), vector(block, 5, np.float64), vector(block, 6, np.int32)
    delayed = s1 if recurrent_delay == 1 else vector(block, 7, np.int32)
    a1, u2, v2 = vector(block, 8, np.float64), vector(block, 9, np.float64), vector(block, 10, np.float64)
    return NetworkState(u0, v0, s0, u1, v1, s1, delayed, a1, u2, v2)


@njit(cache=True, inline="always")
def _run(gyro, accel, set_points, network, states, quantised, out):
    scaling = Scaling(vector(network, 0, np.float64), vector(network, 1, np.float64))
    weights = _weights(network)
    steps, delay, scale = vector(network, 14, np.float64)
    threshold = THRESHOLD * (STATE_ONE if quantised else 1.0)
    outputs = weights.w_out.shape[1]
    x = np.empty(weights.w_in.shape[0])
    more = x.size - 6
    total, drive = np.zeros(weights.w_ff.shape[1]), np.zeros(weights.w_ff.shape[0])
    for n in range(states.shape[0]):
        encoder, copy = vector(states[n], 0, ENCODER)[0], _state(states[n], delay)
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[n, 3 * t : 3 * t + 3], accel[n, 3 * t : 3 * t + 3], scaling, encoder)
            for k in range(6):
                x[k] = encoder.inputs[k] / INPUT_ONE
            for k in range(more):
                x[6 + k] = set_points[n, more * t + k] / INPUT_ONE
            for _ in range(int(steps)):
                step(x, weights, copy, total, drive, quantised)
                for k in range(1 + copy.s1[0]):
                    copy.s1_delayed[k] = copy.s1[k]
                list_spikes(copy.v0, threshold, copy.s0)
                list_spikes(copy.v1, threshold, copy.s1)
            for o in range(outputs):
                out[n, outputs * t + o] = copy.v2[o] * scale


@njit(cache=True, nogil=True)
def run_floats(gyro, accel, set_points, network, states, out):
    """Run n copies over whole sequences, or one sample, from and to their states.

    Args:
        gyro: Body rate, one sample after the other, shape (n, 3 T) [rad/s].
        accel: Specific force, the same shape [m/s²].
        set_points: A controller's further inputs, integers, shape (n, inputs T); of others not read.
        network: Packed: the scaling of the readings; the weights by source, in state units; and the network
            steps for each sample, the recurrent delay, and the radians for an output of 1 state unit.
        states: Blocks of `state_type`, shape (n, words); changed.
        out: Outputs after each sample, shape (n, outputs T); written.
    """
    _run(gyro, accel, set_points, network, states, False, out)


@njit(cache=True, nogil=True)
def run_quantised(gyro, accel, set_points, network, states, out):
    """The same in integer arithmetic."""
    _run(gyro, accel, set_points, network, states, True, out)
