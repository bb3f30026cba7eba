"""Compiled forward pass of Att-SNN: 6 inputs -> LIF -> recurrent LIF -> 2 leaky integrators (LI).

One function, `advance`, is the network for training, streaming and whole sequences alike. Per layer

    u[t] = D(u[t-1], τ_syn) + W s[t-1]
    v[t] = D(v[t-1], τ_mem) + u[t],   s[t] = v[t] > 0.5,   v[t] = 0 where s[t]

The encoding layer's current is driven by the input sample of the same step; the outputs never spike.
In floats D(x, τ) = x τ and 1.0 is 1.0. Quantised, D rounds toward zero and 1.0 is 2^14: then all numbers are
whole, float64 holds them exactly, and the result is what `estimators.loihi` computes in integers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

THRESHOLD = 0.5
STATE_ONE = 16384.0
BIAS_EXP = 4
"""Exponent of the bias by which the host drives the encoding layer: steps of 2^4 state units."""
_BIAS_STEP = 2.0**BIAS_EXP
_MANT_MAX = 4095.0
_V_MAX = 8388607.0
_OUTPUT_THRESHOLD = 131071.0 * 64.0
"""The highest that the chip has; an output that gets there all the same is reset."""
_WRAP_21 = 2097152.0
_WRAP_23 = 8388608.0


@njit(cache=True, inline="always")
def _decay(x, tau, quantised):
    return np.trunc(x * tau) if quantised else x * tau


@njit(cache=True, inline="always")
def _wrap(x, half):
    """Two's complement: into [-half, half)."""
    return x if -half <= x < half else x - 2.0 * half * np.floor((x + half) / (2.0 * half))


@njit(cache=True, inline="always")
def _integrated(y, quantised):
    """Potential of an output: on the chip it is reset at the highest threshold that there is."""
    return (0.0 if y > _OUTPUT_THRESHOLD else max(y, -_V_MAX)) if quantised else y


@njit(cache=True, inline="always")
def _bias(current):
    """The bias mantissa that stands for a current, toward zero, times its step."""
    return min(max(np.trunc(current / _BIAS_STEP), -_MANT_MAX), _MANT_MAX) * _BIAS_STEP


@njit(cache=True, inline="always")
def _list_spikes(v, threshold, spikes):
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
    whole = count - count % 4
    for k in range(1, 1 + whole, 4):
        j0, j1, j2, j3 = spikes[k], spikes[k + 1], spikes[k + 2], spikes[k + 3]
        for i in range(total.shape[0]):
            total[i] += (weights[j0, i] + weights[j1, i]) + (weights[j2, i] + weights[j3, i])
    for k in range(1 + whole, 1 + count):
        j0 = spikes[k]
        for i in range(total.shape[0]):
            total[i] += weights[j0, i]


@njit(cache=True, inline="always")
def _weigh(x, weights, total):
    """Add the rows of `weights` times the numbers in x, three at a time."""
    whole = x.shape[0] - x.shape[0] % 3
    for k in range(0, whole, 3):
        x0, x1, x2 = x[k], x[k + 1], x[k + 2]
        for i in range(total.shape[0]):
            total[i] += weights[k, i] * x0 + weights[k + 1, i] * x1 + weights[k + 2, i] * x2
    for k in range(whole, x.shape[0]):
        x0 = x[k]
        for i in range(total.shape[0]):
            total[i] += weights[k, i] * x0


@njit(cache=True, inline="always")
def _membrane(v, u, tau, threshold, quantised):
    """Reset, decay, add the current u; the potential is kept as it is before the reset."""
    x = _decay(0.0 if v > threshold else v, tau, quantised) + u
    return min(max(x, -_V_MAX), _V_MAX) if quantised else x


@njit(cache=True, inline="always")
def advance(
    x, w_in, w_ff, w_rec, w_out, taus, out_taus, quantised,
    u0, v0, u1, v1, out, s0, s1, s1_late, total, drive,
):  # fmt: skip
    """One step of one copy of the network; weights in state units, all states change in place.

    Args:
        x: Input sample, shape (inputs,).
        w_in: Encoding weights, shape (inputs, h0).
        w_ff: Weights from the encoding to the hidden layer, shape (h0, h1).
        w_rec: Recurrent weights, shape (h1, h1).
        w_out: Output weights, shape (h1, outputs).
        taus: Four vectors: τ_syn, τ_mem of the encoding and of the hidden layer.
        out_taus: τ_syn and τ_mem of the outputs, shape (2,).
        quantised: Integer arithmetic (True) or floats; a literal, for loops that branch are not vectorised.
        u0: Current of the encoding layer, shape (h0,).
        v0: Its membrane potential before the reset, shape (h0,).
        u1: Current of the hidden layer, shape (h1,).
        v1: Its membrane potential before the reset, shape (h1,).
        out: Current and potential of the outputs, shape (2, outputs).
        s0: Spikes of the encoding layer: their number, then the neurons, shape (h0 + 1,).
        s1: Spikes of the hidden layer one step ago, shape (h1 + 1,).
        s1_late: Those that the recurrent connection delivers now (s1 itself for a delay of 1).
        total: Zeros in the type of the weights, shape (h1,), to add in; zeros again afterwards.
        drive: The same, shape (h0,).
    """
    threshold = THRESHOLD * (STATE_ONE if quantised else 1.0)
    for o in range(out.shape[1]):
        arrived = 0.0
        for k in range(1, 1 + s1[0]):
            arrived += w_out[s1[k], o]
        if quantised:
            arrived = _wrap(arrived, _WRAP_21)
        out[0, o] = _decay(out[0, o], out_taus[0], quantised) + arrived
        if quantised:
            out[0, o] = _wrap(out[0, o], _WRAP_23)
        out[1, o] = _integrated(_decay(out[1, o], out_taus[1], quantised) + out[0, o], quantised)

    # What has just been stored is slow to load: current and potential share a loop, and sums are set to zero
    # where they have been used, not where they begin.
    _add_rows(total, w_ff, s0)
    _add_rows(total, w_rec, s1_late)
    for i in range(v1.shape[0]):
        u = _decay(u1[i], taus[2][i], quantised)
        if quantised:
            u = _wrap(u + _wrap(np.float64(total[i]), _WRAP_21), _WRAP_23)
        else:
            u += np.float64(total[i])
        u1[i], total[i] = u, 0
        v1[i] = _membrane(v1[i], u, taus[3][i], threshold, quantised)

    _weigh(x, w_in, drive)
    for i in range(v0.shape[0]):
        u = _decay(u0[i], taus[0][i], quantised)
        if quantised:
            u = _wrap(u + np.trunc(drive[i]), _WRAP_23)
        else:
            u += drive[i]
        u0[i], drive[i] = u, 0.0
        if quantised:
            u = _bias(u)  # reaches the chip as a bias mantissa
        v0[i] = _membrane(v0[i], u, taus[1][i], threshold, quantised)


@njit(cache=True, inline="always")
def _run(x, weights, taus, sizes, quantised, state, spikes, out):
    h0, h1, delay, substeps = sizes
    inputs, outputs = x.shape[2], out.shape[2]
    a = inputs * h0
    b = a + h0 * h1
    c = b + h1 * h1
    w_in = weights[:a].reshape(inputs, h0)
    w_ff = weights[a:b].reshape(h0, h1)
    w_rec = weights[b:c].reshape(h1, h1)
    w_out = weights[c:].reshape(h1, outputs)
    hidden = 2 * h0
    layer_taus = (
        taus[:h0], taus[h0:hidden], taus[hidden : hidden + h1], taus[hidden + h1 : hidden + 2 * h1]
    )  # fmt: skip
    out_taus = taus[hidden + 2 * h1 :]
    threshold = THRESHOLD * (STATE_ONE if quantised else 1.0)
    total, drive = np.zeros(h1, weights.dtype), np.zeros(h0)
    for n in range(x.shape[0]):
        row = state[n]
        u0, v0 = row[:h0], row[h0:hidden]
        u1, v1 = row[hidden : hidden + h1], row[hidden + h1 : hidden + 2 * h1]
        y = row[hidden + 2 * h1 :].reshape(2, outputs)
        s0 = spikes[n, : h0 + 1]
        s1 = spikes[n, h0 + 1 : h0 + h1 + 2]
        s1_before = spikes[n, h0 + h1 + 2 :]
        for t in range(x.shape[1]):
            for _ in range(substeps):
                late = s1 if delay == 1 else s1_before
                advance(
                    x[n, t], w_in, w_ff, w_rec, w_out, layer_taus, out_taus, quantised,
                    u0, v0, u1, v1, y, s0, s1, late, total, drive,
                )  # fmt: skip
                s1_before[:] = s1
                _list_spikes(v0, threshold, s0)
                _list_spikes(v1, threshold, s1)
            out[n, t] = y[1]


@njit(cache=True, nogil=True)
def run_network(x, weights, taus, sizes, quantised, state, spikes, out):
    """Run n copies over whole sequences (or one sample), from and to packed states.

    Args:
        x: Input samples, shape (n, T, inputs).
        weights: w_in, w_ff, w_rec, w_out of `advance`, flattened one after the other.
        taus: τ_syn, τ_mem of encoding, hidden and output layer, one after the other, (2 h0 + 2 h1 + 2,).
        sizes: (h0, h1, recurrent delay, network steps per sample).
        quantised: Integer arithmetic (True) or floats.
        state: u0, v0, u1, v1 and the rows of `out` in a row, shape (n, 2 h0 + 2 h1 + 2 outputs); changed.
        spikes: Lists of the spikes of the last step: encoding, hidden, hidden one step earlier; changed.
        out: Output potentials after each sample [state units], shape (n, T, outputs); written.
    """
    if quantised:
        _run(x, weights, taus, sizes, True, state, spikes, out)
    else:
        _run(x, weights, taus, sizes, False, state, spikes, out)


def state_size(h0: int, h1: int, outputs: int = 2) -> tuple[int, int]:
    """Lengths of the packed state and of the packed spike lists of one copy."""
    return 2 * h0 + 2 * h1 + 2 * outputs, h0 + 2 * h1 + 3


def zero_state(n: int, h0: int, h1: int, outputs: int = 2) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Packed states and spike lists of `n` copies at rest."""
    floats, ints = state_size(h0, h1, outputs)
    return np.zeros((n, floats)), np.zeros((n, ints), np.int32)
