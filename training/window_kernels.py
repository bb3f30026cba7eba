"""Att-SNN over a window, compiled: forward, and the backward pass with the surrogate gradient.

The steps are those of `estimators.networks.forward`. Forward pass and weight gradients add rows of the
neurons that spiked; the gradient of the spikes is one matrix product per step for the whole batch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.networks.forward import STATE_ONE, THRESHOLD, NetworkState, list_spikes, step
from quadsim.runs.compiled import njit

Floats = NDArray[np.floating]
Sizes = tuple[int, int, int, int]
"""Neurons of the encoding layer, of the hidden layer and outputs; after-spike currents."""


class Trace(NamedTuple):
    """What the forward pass leaves for the backward pass, time first. Rows 0 and 1 come before the window.

    Encoding layer (0), hidden layer (1) and outputs (2), of size h each: currents u, row t + 1 is step t,
    shape (T + 1, n, h); potentials v before the reset, row t + 2 is step t, shape (T + 2, n, h); spikes s,
    their number and then the neurons, shape (T + 2, n, h + 1). After-spike currents a have rows as u, and no
    columns in a network without them.
    """

    u0: Floats
    v0: Floats
    s0: NDArray[np.uint16]
    u1: Floats
    v1: Floats
    s1: NDArray[np.uint16]
    a1: Floats
    u2: Floats
    v2: Floats

    @classmethod
    def empty(cls, steps: int, n: int, sizes: Sizes, dtype: np.dtype) -> Trace:
        """Buffers for one window."""
        u0, u1, u2, a1 = (np.zeros((steps + 1, n, size), dtype) for size in sizes)
        v0, v1, v2 = (np.zeros((steps + 2, n, size), dtype) for size in sizes[:3])
        s0, s1 = (np.zeros((steps + 2, n, size + 1), np.uint16) for size in sizes[:2])
        return cls(u0, v0, s0, u1, v1, s1, a1, u2, v2)

    def begin(self, reset: NDArray[np.bool_]) -> None:
        """Start where the last window ended, the sequences in `reset` (n,) from rest."""
        for rows in (self.v0, self.v1, self.v2, self.s0, self.s1):
            rows[:2] = rows[-2:]
            rows[:2, reset] = 0
        for rows in (self.u0, self.u1, self.u2, self.a1):
            rows[0] = rows[-1]
            rows[0, reset] = 0


@njit(cache=True, inline="always")
def _copy(source, factor, target):
    """Write `source` times a factor into `target`."""
    for i in range(target.shape[0]):
        target[i] = source[i] * factor


@njit(cache=True, inline="always")
def _forward(x, weights, trace, delay, quantised):
    one = STATE_ONE if quantised else 1.0
    unit, threshold = 1.0 / one, THRESHOLD * one
    total, drive = np.zeros(weights.w_ff.shape[1], weights.w_ff.dtype), np.zeros(weights.w_ff.shape[0])
    u0, v0 = trace.u0[0].astype(np.float64) * one, trace.v0[1].astype(np.float64) * one
    u1, v1 = trace.u1[0].astype(np.float64) * one, trace.v1[1].astype(np.float64) * one
    u2, v2 = trace.u2[0].astype(np.float64) * one, trace.v2[1].astype(np.float64) * one
    a1 = np.zeros(u1.shape)
    a1[:, : trace.a1.shape[2]] = trace.a1[0].astype(np.float64) * one
    s0, s1 = trace.s0, trace.s1
    for t in range(x.shape[0]):
        for b in range(x.shape[1]):
            delayed = s1[t + 2 - delay, b]
            state = NetworkState(
                u0[b], v0[b], s0[t + 1, b], u1[b], v1[b], s1[t + 1, b], delayed, a1[b], u2[b], v2[b]
            )
            step(x[t, b], weights, state, total, drive, quantised)
            list_spikes(state.v0, threshold, s0[t + 2, b])
            list_spikes(state.v1, threshold, s1[t + 2, b])
            _copy(state.v0, unit, trace.v0[t + 2, b])
            _copy(state.u0, unit, trace.u0[t + 1, b])
            _copy(state.v1, unit, trace.v1[t + 2, b])
            _copy(state.u1, unit, trace.u1[t + 1, b])
            _copy(state.a1, unit, trace.a1[t + 1, b])
            _copy(state.v2, unit, trace.v2[t + 2, b])
            _copy(state.u2, unit, trace.u2[t + 1, b])


@njit(cache=True, nogil=True)
def forward_window(x, weights, trace, delay, quantised):
    """Run the window x (T, n, inputs) from the rows before it; weights by source, in state units."""
    if quantised:
        _forward(x, weights, trace, delay, True)
    else:
        _forward(x, weights, trace, delay, False)


class LayerGradients(NamedTuple):
    """Time constants of a layer and gradients of its state, all of shape (n h,)."""

    syn: Floats
    mem: Floats
    ds: Floats
    dv: Floats
    du: Floats
    sum_syn: Floats
    """Gradients of the time constants, summed over the steps."""
    sum_mem: Floats


@njit(cache=True, inline="always")
def _layer_gradients(syn, mem, n):
    """Gradients of 0 for a layer of n sequences with the time constants `syn` and `mem` (h,)."""
    each = np.ones((n, 1), syn.dtype)
    syn, mem = (each * syn).ravel(), (each * mem).ravel()
    ds, dv, du = np.zeros_like(syn), np.zeros_like(syn), np.zeros_like(syn)
    return LayerGradients(syn, mem, ds, dv, du, np.zeros_like(syn), np.zeros_like(syn))


@njit(cache=True, inline="always", error_model="numpy", fastmath={"contract"})
def _step_back(v, before, current, layer, constants):
    """Gradients of a layer's currents and potentials, from those of its spikes and of the next step."""
    threshold, width, one, zero, _, _ = constants
    syn, mem, ds, dv, du, sum_syn, sum_mem = layer
    for i in range(v.shape[0]):
        start = before[i] if before[i] <= threshold else zero
        slope = one + width * abs(v[i] - threshold)
        d = (zero if v[i] > threshold else mem[i] * dv[i]) + ds[i] / (slope * slope)
        dv[i] = d
        du[i] = d + syn[i] * du[i]
        sum_mem[i] += d * start
        sum_syn[i] += du[i] * current[i]


@njit(cache=True, inline="always", error_model="numpy", fastmath={"contract"})
def _after_spikes_back(v, before, weights, taus, layer, da, sums, constants):
    """Gradients of after-spike currents from those of the potentials; those of the spikes that drove them.

    Args:
        v: Potentials before the reset of the step before, whose spikes drove the currents, (n h,).
        before: Currents of the step before, (n h,).
        weights: Of the currents, for each sequence, (n h,).
        taus: Their time constants, (n h,).
        layer: Gradients of the layer; `ds` is set to those of the spikes of the step before.
        da: Gradients of the currents, (n h,); changed.
        sums: Gradients of weights and time constants, (2, n h); changed.
        constants: As `backward_window` has them.
    """
    threshold, zero = constants[0], constants[3]
    for i in range(da.shape[0]):
        d = layer.dv[i] + taus[i] * da[i]
        da[i] = d
        sums[0, i] += d if v[i] > threshold else zero
        sums[1, i] += d * before[i]
        layer.ds[i] = weights[i] * d


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def backward_window(x, grad, weights, trace, gradients, constants, delay):
    """Add the gradients of a window.

    Args:
        x: Input, shape (T, n, inputs).
        grad: Gradient of the outputs, shape (T, n, outputs).
        weights: Weights in units of 1.0, in the floating type of the computation.
        trace: What the forward pass left.
        gradients: Of the weights, matrices by source; changed.
        constants: Threshold, surrogate width, 1.0, 0.0, and the gradient of every spike of the encoding
            and of the hidden layer, in the floating type of the computation.
        delay: Of the recurrent connection, 1 or 2.
    """
    _, _, _, _, cost0, cost1 = constants
    v0, v1, v2, u0, u1, u2 = trace.v0, trace.v1, trace.v2, trace.u0, trace.u1, trace.u2
    w_out, g_in, g_out = weights.w_out, gradients.w_in, gradients.w_out
    w_down = np.concatenate((weights.w_ff, weights.w_rec), 1)
    steps, n = x.shape[:2]
    h0, h1, outputs = v0.shape[2], v1.shape[2], v2.shape[2]
    layer0 = _layer_gradients(weights.syn0, weights.mem0, n)
    layer1 = _layer_gradients(weights.syn1, weights.mem1, n)
    ds0, du0, ds1, du1 = layer0.ds, layer0.du, layer1.ds, layer1.du
    syn2, mem2 = weights.syn2[0], weights.mem2[0]
    du2, dv2 = np.zeros((n, outputs), v0.dtype), np.zeros((n, outputs), v0.dtype)
    down, down_before = np.zeros((n, h0 + h1), v0.dtype), np.zeros((n, h0 + h1), v0.dtype)
    used = _used(w_down)
    each = np.ones((n, 1), v0.dtype)
    w_after, syn_after = (each * weights.w_after.ravel()).ravel(), (each * weights.syn_after).ravel()
    da, of_after = np.zeros_like(w_after), np.zeros((2, w_after.size), v0.dtype)
    for t in range(steps - 1, -1, -1):
        delivered = down if delay == 1 else down_before
        for b in range(n):
            first, second, into0, into1 = down[b], delivered[b, h0:], ds0[b * h0 :], ds1[b * h1 :]
            for i in range(h0):
                into0[i] = first[i] + cost0
            if da.size:
                for i in range(h1):
                    into1[i] += second[i] + cost1
            else:
                for i in range(h1):
                    into1[i] = second[i] + cost1
            for o in range(outputs):
                d = du2[b, o]
                for i in range(h1):
                    into1[i] += d * w_out[o, i]
            for o in range(outputs):
                dv2[b, o] = grad[t, b, o] + mem2 * dv2[b, o]
                du2[b, o] = dv2[b, o] + syn2 * du2[b, o]
                gradients.syn2[0] += du2[b, o] * u2[t, b, o]
                gradients.mem2[0] += dv2[b, o] * v2[t + 1, b, o]

        _step_back(v1[t + 2].reshape(-1), v1[t + 1].reshape(-1), u1[t].reshape(-1), layer1, constants)
        if da.size:
            before = v1[t + 1].reshape(-1)
            _after_spikes_back(
                before, trace.a1[t].reshape(-1), w_after, syn_after, layer1, da, of_after, constants
            )
        _step_back(v0[t + 2].reshape(-1), v0[t + 1].reshape(-1), u0[t].reshape(-1), layer0, constants)
        for b in range(n):
            d0, d1 = du0[b * h0 : (b + 1) * h0], du1[b * h1 : (b + 1) * h1]
            for k in range(x.shape[2]):
                sample = x[t, b, k]
                into = g_in[k]
                for i in range(h0):
                    into[i] += sample * d0[i]
            _add_to_rows(gradients.w_ff, d1, trace.s0[t + 1, b])
            _add_to_rows(gradients.w_rec, d1, trace.s1[t + 2 - delay, b])
            spikes = trace.s1[t + 1, b]
            for k in range(1, 1 + spikes[0]):
                for o in range(outputs):
                    g_out[spikes[k], o] += du2[b, o]
        down, down_before = down_before, down
        _product(du1.reshape(n, h1), w_down, used, down)
    for b in range(n):
        for i in range(h0):
            gradients.syn0[i] += layer0.sum_syn[b * h0 + i]
            gradients.mem0[i] += layer0.sum_mem[b * h0 + i]
        for i in range(h1):
            gradients.syn1[i] += layer1.sum_syn[b * h1 + i]
            gradients.mem1[i] += layer1.sum_mem[b * h1 + i]
        for i in range(gradients.syn_after.size):
            gradients.w_after[0, i] += of_after[0, b * h1 + i]
            gradients.syn_after[i] += of_after[1, b * h1 + i]


@njit(cache=True, inline="always")
def _add_to_rows(rows, values, spikes):
    """Add `values` to the rows of the neurons that spiked, four at a time."""
    count = spikes[0]
    fours = count - count % 4
    for k in range(1, 1 + fours, 4):
        j0, j1, j2, j3 = spikes[k], spikes[k + 1], spikes[k + 2], spikes[k + 3]
        for i in range(values.shape[0]):
            value = values[i]
            rows[j0, i] += value
            rows[j1, i] += value
            rows[j2, i] += value
            rows[j3, i] += value
    for k in range(1 + fours, 1 + count):
        j0 = spikes[k]
        for i in range(values.shape[0]):
            rows[j0, i] += values[i]


@njit(cache=True, nogil=True)
def _used(b):
    """Whether four rows from this one on are not all 0: the others belong to neurons that nothing reaches."""
    return np.array([np.any(b[k : k + 4] != 0) for k in range(b.shape[0])])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _product(a, b, used, out):
    """Write a b into `out`; four rows of a by four of b at a time, so that the sums stay in registers."""
    out[:] = 0
    n, inner = a.shape
    for i in range(0, n - n % 4, 4):
        p0, p1, p2, p3 = out[i], out[i + 1], out[i + 2], out[i + 3]
        for k in range(0, inner - inner % 4, 4):
            if not used[k]:
                continue
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
