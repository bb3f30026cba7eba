"""Att-SNN over a window, compiled: forward, and the backward pass with the surrogate gradient.

The steps are those of `estimators.loihi.neurons`. Forward pass and weight gradients add only rows of neurons
that spiked. The gradient of the spikes is one matrix product per step for the whole batch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.loihi.neurons import NeuronState, list_spikes, neurons_of, step_network
from estimators.networks.forward import advance_encoders
from estimators.networks.layer_parameters import THRESHOLD, Weights
from estimators.spiking import SURROGATE_WIDTH
from quadsim.runs.compiled import njit

Floats = NDArray[np.floating]


class ForwardTrace(NamedTuple):
    """Trace of the forward pass for the backward pass, time first, in units of 1.0.

    The neurons are in the order encoding (h0), hidden (h1), outputs. Rows 0 and 1 come before the window.
    """

    u: Floats  #: currents, row t + 1 is step t, shape (T + 1, n, neurons)
    v: Floats  #: potentials before the reset (outputs: after), row t + 2 is step t, shape (T + 2, n, neurons)
    spikes: NDArray[np.uint16]  #: `list_spikes` of both layers, rows as of v, shape (T + 2, n, h0 + h1 + 2)

    @classmethod
    def empty(cls, steps: int, n: int, sizes: tuple[int, int, int], dtype: np.dtype) -> ForwardTrace:
        """Return buffers for one window of a network with these layers."""
        u, v = np.zeros((steps + 1, n, sum(sizes)), dtype), np.zeros((steps + 2, n, sum(sizes)), dtype)
        spikes = np.zeros((steps + 2, n, sizes[0] + sizes[1] + 2), np.uint16)
        return cls(u, v, spikes)

    def begin(self, reset: NDArray[np.bool_]) -> None:
        """Start from the end of the last window; sequences in `reset` (n,) start from rest."""
        for rows in (self.v, self.spikes):
            rows[:2] = rows[-2:]
            rows[:2, reset] = 0
        self.u[0] = self.u[-1]
        self.u[0, reset] = 0


@njit(inline="always")
def _copy(source, factor, target):
    """Write `source` times a factor into `target`."""
    for i in range(target.shape[0]):
        target[i] = source[i] * factor


@njit(cache=True, nogil=True)
def forward_window(x, encoders, table, weights, sums, one, trace):
    """Run the window x (T, n, inputs) of integers, starting from the rows before it.

    The next three arguments are the fields of `PackedWeights`; `sums` is temporary storage as in `step`, and
    `one` is the number of state units of 1.0.
    """
    h0, targets, n, number, unit = encoders.shape[1], weights.shape[2], x.shape[1], table.dtype, 1.0 / one
    neurons, hidden = neurons_of(weights, h0, table), weights.shape[1] - h0
    total, bias = np.zeros(h0, number), np.zeros(h0, number)
    current, first_v = np.zeros((n, h0), number), np.zeros((n, h0), number)
    u, v = np.zeros((n, targets), number), np.zeros((n, targets), number)
    for b in range(n):
        _copy(trace.u[0, b], one, current[b])
        _copy(trace.u[0, b, h0:], one, u[b])
        _copy(trace.v[1, b], one, first_v[b])
        _copy(trace.v[1, b, h0:], one, v[b])
    for t in range(x.shape[0]):
        for b in range(n):
            advance_encoders(x[t, b], encoders, current[b], bias, total)
            state = NeuronState(first_v[b], u[b], v[b])
            step_network(neurons, bias, state, trace.spikes[t + 1, b], trace.spikes[t, b], sums)
            list_spikes(neurons, first_v[b], v[b], trace.spikes[t + 2, b])
            _copy(current[b], unit, trace.u[t + 1, b, :h0])
            _copy(u[b], unit, trace.u[t + 1, b, h0:])
            _copy(first_v[b], unit, trace.v[t + 2, b, :h0])
            _copy(v[b], unit, trace.v[t + 2, b, h0:])
            for o in range(hidden, targets):
                if v[b, o] > neurons.vth[o]:
                    trace.v[t + 2, b, h0 + o] = 0.0


class Gradients(NamedTuple):
    """Sums of gradients over a window; the weights between neurons are by source."""

    w_in: Floats  #: (inputs, h0)
    w: Floats  #: from both layers to the hidden layer and the outputs, (h0 + h1, h1 + outputs)
    w_later: Floats  #: the same of a connection with a delay of 2, (h0 + h1, h1); else (0, h1)
    syn: Floats  #: of both layers, (n, h0 + h1)
    mem: Floats  #: as syn
    outputs: Floats  #: syn and mem of the outputs, (2,)


def new_gradients(weights: Weights[Floats], n: int, later: bool) -> Gradients:
    """Return zero sums for n sequences."""
    (h0, inputs), (outputs, h1) = weights.w_in.shape, weights.w_out.shape
    both = h0 + h1
    shapes = (inputs, h0), (both, h1 + outputs), (both * later, h1), (n, both), (n, both), (2,)
    return Gradients(*(np.zeros(shape, weights.w_ff.dtype) for shape in shapes))


def of_weights(gradients: Gradients) -> Weights[Floats]:
    """Return the gradients of the weights, summed over sequences."""
    w_in, w, w_later, syn, mem, outputs = gradients
    h0, h1 = w_in.shape[1], w_later.shape[1]
    recurrent = w_later if len(w_later) else w
    syn, mem = syn.sum(0), mem.sum(0)
    matrices = w_in.T, w[:h0, :h1].T, recurrent[h0:, :h1].T, w[h0:, h1:].T
    return Weights(*matrices, syn[:h0], mem[:h0], syn[h0:], mem[h0:], outputs[:1], outputs[1:])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def backward_window(x, grad, of_spikes, weights, trace, gradients):
    """Add the gradients of a window.

    Args:
        x: Input, shape (T, n, inputs).
        grad: Gradient of the outputs, shape (T, n, outputs).
        of_spikes: Gradient of each spike of the encoding and of the hidden layer, (2,).
        weights: `Weights` in units of 1.0.
        trace: Trace of the forward pass.
        gradients: Sums of gradients, which are changed.
    """
    of_encoding, of_hidden_spike = of_spikes
    number = grad.dtype
    threshold, width = number.type(THRESHOLD), number.type(SURROGATE_WIDTH)
    one, zero = number.type(1.0), number.type(0.0)
    steps, n, outputs = grad.shape
    h1, h0 = weights.w_ff.shape
    both, u, v, spikes, w_out = h0 + h1, trace.u, trace.v, trace.spikes, weights.w_out
    w_down = np.concatenate((weights.w_ff, weights.w_rec), 1)
    syn, mem = np.concatenate((weights.syn0, weights.syn1)), np.concatenate((weights.mem0, weights.mem1))
    syn2, mem2, later = weights.syn2[0], weights.mem2[0], gradients.w_later.shape[0] > 0
    ds, dv = np.zeros((n, both), number), np.zeros((n, both + outputs), number)
    du, down, down_before = np.zeros_like(dv), np.zeros_like(ds), np.zeros_like(ds)
    for t in range(steps - 1, -1, -1):
        for b in range(n):
            delivered, of_hidden = (down_before if later else down)[b, h0:], ds[b, h0:]
            for i in range(h0):
                ds[b, i] = down[b, i] + of_encoding
            for i in range(h1):
                of_hidden[i] = delivered[i] + of_hidden_spike
            for o in range(outputs):
                d = du[b, both + o]
                for i in range(h1):
                    of_hidden[i] += d * w_out[o, i]
            for o in range(outputs):
                k = both + o
                dv[b, k] = grad[t, b, o] + mem2 * dv[b, k]
                du[b, k] = dv[b, k] + syn2 * du[b, k]
                gradients.outputs[0] += du[b, k] * u[t, b, k]
                gradients.outputs[1] += dv[b, k] * v[t + 1, b, k]
            now, before, current = v[t + 2, b], v[t + 1, b], u[t, b]
            ds_b, dv_b, du_b, sum_syn, sum_mem = ds[b], dv[b], du[b], gradients.syn[b], gradients.mem[b]
            for i in range(both):
                start = before[i] if before[i] <= threshold else zero
                slope = one + width * abs(now[i] - threshold)
                d = (zero if now[i] > threshold else mem[i] * dv_b[i]) + ds_b[i] / (slope * slope)
                dv_b[i] = d
                du_b[i] = d + syn[i] * du_b[i]
                sum_mem[i] += d * start
                sum_syn[i] += du_b[i] * current[i]
            for k in range(x.shape[2]):
                sample, into = x[t, b, k], gradients.w_in[k]
                for i in range(h0):
                    into[i] += sample * du[b, i]
            _add_to_rows(gradients.w, du[b, h0:], spikes[t + 1, b])
            if later:
                _add_to_rows(gradients.w_later, du[b, h0:both], spikes[t, b])
        down, down_before = down_before, down
        _product(du[:, h0:both], w_down, down)


@njit(inline="always")
def _add_to_rows(rows, values, spikes):
    """Add `values` to the rows of neurons that spiked."""
    for k in range(2, 2 + spikes[0]):
        j = spikes[k]
        for i in range(values.shape[0]):
            rows[j, i] += values[i]


@njit(nogil=True, fastmath={"contract"})
def _product(a, b, out):
    """Write the product a b to `out`, in blocks of four rows of a and b, so that sums stay in registers."""
    out[:] = 0
    n, inner = a.shape
    for i in range(0, n - n % 4, 4):
        p0, p1, p2, p3 = out[i], out[i + 1], out[i + 2], out[i + 3]
        for k in range(0, inner - inner % 4, 4):
            b0, b1, b2, b3 = b[k], b[k + 1], b[k + 2], b[k + 3]
            a00, a01, a02, a03 = a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3]
            a10, a11, a12, a13 = a[i + 1, k], a[i + 1, k + 1], a[i + 1, k + 2], a[i + 1, k + 3]
            a20, a21, a22, a23 = a[i + 2, k], a[i + 2, k + 1], a[i + 2, k + 2], a[i + 2, k + 3]
            a30, a31, a32, a33 = a[i + 3, k], a[i + 3, k + 1], a[i + 3, k + 2], a[i + 3, k + 3]
            for j in range(out.shape[1]):
                c0, c1, c2, c3 = b0[j], b1[j], b2[j], b3[j]
                p0[j] += a00 * c0 + a01 * c1 + a02 * c2 + a03 * c3
                p1[j] += a10 * c0 + a11 * c1 + a12 * c2 + a13 * c3
                p2[j] += a20 * c0 + a21 * c1 + a22 * c2 + a23 * c3
                p3[j] += a30 * c0 + a31 * c1 + a32 * c2 + a33 * c3
        for k in range(inner - inner % 4, inner):
            for r in range(4):
                for j in range(out.shape[1]):
                    out[i + r, j] += a[i + r, k] * b[k, j]
    for i in range(n - n % 4, n):
        for k in range(inner):
            for j in range(out.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
