"""Att-SNN, forward and surrogate-gradient backward over a window, compiled.

`attsnn` is `estimators.spiking.forward` fused into one pass over time each way (the tests hold them equal:
the same spikes, gradients to 1e-10 in float64). What makes it fast: forward and weight gradients add rows of
the neurons that spiked; the gradient of the spikes is one matrix product per step for the whole batch;
buffers are reused. The batch is split over threads; sums are added in the order of the parts.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.networks.forward import STATE_ONE, THRESHOLD, _list_spikes, advance
from estimators.spiking import MATRICES, SURROGATE_WIDTH, Weights
from quadsim.runs.compiled import njit

Floats = NDArray[np.floating]


@dataclass
class Trace:
    """What the forward pass leaves for the backward pass, time first. Rows 0 and 1 come before the window."""

    v0: Floats
    """Potentials of the encoding layer before the reset, row t + 2 is step t, shape (T + 2, n, h0)."""
    v1: Floats
    """Potentials of the hidden layer before the reset, shape (T + 2, n, h1)."""
    vo: Floats
    """Potentials of the outputs, shape (T + 2, n, outputs)."""
    u0: Floats
    """Currents of the encoding layer, row t + 1 is step t, shape (T + 1, n, h0)."""
    u1: Floats
    """Currents of the hidden layer, shape (T + 1, n, h1)."""
    uo: Floats
    """Currents of the outputs, shape (T + 1, n, outputs)."""
    s0: NDArray[np.uint16]
    """Spikes of the encoding layer: their number, then the neurons, shape (T + 2, n, h0 + 1)."""
    s1: NDArray[np.uint16]
    """Spikes of the hidden layer, shape (T + 2, n, h1 + 1)."""

    @classmethod
    def empty(cls, steps: int, n: int, h0: int, h1: int, outputs: int, dtype: np.dtype) -> Trace:
        """Buffers for one window."""
        return cls(
            v0=np.zeros((steps + 2, n, h0), dtype),
            v1=np.zeros((steps + 2, n, h1), dtype),
            vo=np.zeros((steps + 2, n, outputs), dtype),
            u0=np.zeros((steps + 1, n, h0), dtype),
            u1=np.zeros((steps + 1, n, h1), dtype),
            uo=np.zeros((steps + 1, n, outputs), dtype),
            s0=np.zeros((steps + 2, n, h0 + 1), np.uint16),
            s1=np.zeros((steps + 2, n, h1 + 1), np.uint16),
        )

    def begin(self, fresh: NDArray[np.bool_]) -> None:
        """Start where the last window ended, the sequences in `fresh` (n,) from rest."""
        for rows in (self.v0, self.v1, self.vo, self.s0, self.s1):
            rows[:2] = rows[-2:]
            rows[:2, fresh] = 0
        for rows in (self.u0, self.u1, self.uo):
            rows[0] = rows[-1]
            rows[0, fresh] = 0


@njit(cache=True, inline="always")
def _forward(x, w_in, w_ff, w_rec, w_out, taus, out_taus, quantised, delay, v0, v1, vo, u0, u1, uo, s0, s1):
    steps, n = x.shape[:2]
    h0, h1, outputs = v0.shape[2], v1.shape[2], vo.shape[2]
    one = STATE_ONE if quantised else 1.0
    unit = 1.0 / one
    threshold = THRESHOLD * one
    total, drive = np.zeros(h1, w_ff.dtype), np.zeros(h0)
    state0, state1, state2 = np.zeros((n, 2, h0)), np.zeros((n, 2, h1)), np.zeros((n, 2, outputs))
    for b in range(n):
        for i in range(h0):
            state0[b, 0, i], state0[b, 1, i] = u0[0, b, i] * one, v0[1, b, i] * one
        for i in range(h1):
            state1[b, 0, i], state1[b, 1, i] = u1[0, b, i] * one, v1[1, b, i] * one
        for o in range(outputs):
            state2[b, 0, o], state2[b, 1, o] = uo[0, b, o] * one, vo[1, b, o] * one
    for t in range(steps):
        for b in range(n):
            advance(
                x[t, b], w_in, w_ff, w_rec, w_out, taus, out_taus, quantised,
                state0[b, 0], state0[b, 1], state1[b, 0], state1[b, 1], state2[b],
                s0[t + 1, b], s1[t + 1, b], s1[t + 2 - delay, b], total, drive,
            )  # fmt: skip
            _list_spikes(state0[b, 1], threshold, s0[t + 2, b])
            _list_spikes(state1[b, 1], threshold, s1[t + 2, b])
            for i in range(h0):
                v0[t + 2, b, i] = state0[b, 1, i] * unit
                u0[t + 1, b, i] = state0[b, 0, i] * unit
            for i in range(h1):
                v1[t + 2, b, i] = state1[b, 1, i] * unit
                u1[t + 1, b, i] = state1[b, 0, i] * unit
            for o in range(outputs):
                vo[t + 2, b, o] = state2[b, 1, o] * unit
                uo[t + 1, b, o] = state2[b, 0, o] * unit


@njit(cache=True, nogil=True)
def forward_window(
    x, w_in, w_ff, w_rec, w_out, taus, out_taus, quantised, delay, v0, v1, vo, u0, u1, uo, s0, s1
):
    """Run the window x (T, n, inputs) from the rows before it; weights (in, out) in units of 1.0."""
    if quantised:
        _forward(
            x, w_in, w_ff, w_rec, w_out, taus, out_taus, True, delay,
            v0, v1, vo, u0, u1, uo, s0, s1,
        )  # fmt: skip
    else:
        _forward(
            x, w_in, w_ff, w_rec, w_out, taus, out_taus, False, delay,
            v0, v1, vo, u0, u1, uo, s0, s1,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def backward_window(
    x, grad, weights, taus, out_taus, constants, delay,
    v0, v1, vo, u0, u1, uo, s0, s1, g_in, g_ff, g_rec, g_out, g_tau0, g_tau1, g_tau_out,
):  # fmt: skip
    """Add the gradients of a window to g_*.

    Args:
        x: Input, shape (T, n, inputs).
        grad: Gradient of the outputs, shape (T, n, outputs).
        weights: w_ff and w_rec side by side, (h1, h0 + h1), and w_out (outputs, h1).
        taus: τ_syn, τ_mem of the encoding and of the hidden layer.
        out_taus: τ_syn and τ_mem of the outputs, shape (2,).
        constants: Threshold, surrogate width, 1.0, 0.0, and the gradient of every spike of the encoding
            and of the hidden layer, in the floating type of the computation.
        delay: Of the recurrent connection, 1 or 2.
        v0: Trace, as are the next seven.
        v1: Trace.
        vo: Trace.
        u0: Trace.
        u1: Trace.
        uo: Trace.
        s0: Trace.
        s1: Trace.
        g_in: Sum of the gradients of the encoding weights, shape (inputs, h0).
        g_ff: Of the feed-forward weights, shape (h0, h1).
        g_rec: Of the recurrent weights, shape (h1, h1).
        g_out: Of the output weights, shape (h1, outputs).
        g_tau0: Of τ_syn and τ_mem of the encoding layer, shape (2, h0).
        g_tau1: Of the hidden layer, shape (2, h1).
        g_tau_out: Of the outputs, shape (2,).
    """
    w_down, w_out = weights
    threshold, width, one, zero, cost0, cost1 = (
        constants[0], constants[1], constants[2], constants[3], constants[4], constants[5]
    )  # fmt: skip
    steps, n = x.shape[:2]
    h0, h1, outputs = v0.shape[2], v1.shape[2], vo.shape[2]
    syn0, mem0, syn1, mem1 = _tile(taus[0], n), _tile(taus[1], n), _tile(taus[2], n), _tile(taus[3], n)
    du0, dv0 = np.zeros_like(syn0), np.zeros_like(syn0)
    du1, dv1 = np.zeros_like(syn1), np.zeros_like(syn1)
    a_syn0, a_mem0 = np.zeros_like(syn0), np.zeros_like(syn0)
    a_syn1, a_mem1 = np.zeros_like(syn1), np.zeros_like(syn1)
    du_out, dv_out = np.zeros((n, outputs), v0.dtype), np.zeros((n, outputs), v0.dtype)
    ds0, ds1 = np.zeros_like(syn0), np.zeros_like(syn1)
    down, down_before = np.zeros((n, h0 + h1), v0.dtype), np.zeros((n, h0 + h1), v0.dtype)
    used = _used(w_down)
    for t in range(steps - 1, -1, -1):
        late = down if delay == 1 else down_before
        for b in range(n):
            first, second, into0, into1 = down[b], late[b, h0:], ds0[b * h0 :], ds1[b * h1 :]
            for i in range(h0):
                into0[i] = first[i] + cost0
            for i in range(h1):
                into1[i] = second[i] + cost1
            for o in range(outputs):
                d = du_out[b, o]
                for i in range(h1):
                    into1[i] += d * w_out[o, i]
            for o in range(outputs):
                dv_out[b, o] = grad[t, b, o] + out_taus[1] * dv_out[b, o]
                du_out[b, o] = dv_out[b, o] + out_taus[0] * du_out[b, o]
                g_tau_out[0] += du_out[b, o] * uo[t, b, o]
                g_tau_out[1] += dv_out[b, o] * vo[t + 1, b, o]

        v, before, current1 = v1[t + 2].reshape(-1), v1[t + 1].reshape(-1), u1[t].reshape(-1)
        for i in range(v.shape[0]):
            kept = before[i] if before[i] <= threshold else zero
            slope = one + width * abs(v[i] - threshold)
            d = (zero if v[i] > threshold else mem1[i] * dv1[i]) + ds1[i] / (slope * slope)
            dv1[i] = d
            du1[i] = d + syn1[i] * du1[i]
            a_mem1[i] += d * kept
            a_syn1[i] += du1[i] * current1[i]

        v, before, current0 = v0[t + 2].reshape(-1), v0[t + 1].reshape(-1), u0[t].reshape(-1)
        for i in range(v.shape[0]):
            kept = before[i] if before[i] <= threshold else zero
            slope = one + width * abs(v[i] - threshold)
            d = (zero if v[i] > threshold else mem0[i] * dv0[i]) + ds0[i] / (slope * slope)
            dv0[i] = d
            du0[i] = d + syn0[i] * du0[i]
            a_mem0[i] += d * kept
            a_syn0[i] += du0[i] * current0[i]

        for b in range(n):
            d0, d1 = du0[b * h0 : (b + 1) * h0], du1[b * h1 : (b + 1) * h1]
            for k in range(x.shape[2]):
                sample = x[t, b, k]
                row = g_in[k]
                for i in range(h0):
                    row[i] += sample * d0[i]
            _add_to_rows(g_ff, d1, s0[t + 1, b])
            _add_to_rows(g_rec, d1, s1[t + 2 - delay, b])
            spikes = s1[t + 1, b]
            for k in range(1, 1 + spikes[0]):
                for o in range(outputs):
                    g_out[spikes[k], o] += du_out[b, o]
        down, down_before = down_before, down
        _product(du1.reshape(n, h1), w_down, used, down)
    for b in range(n):
        for i in range(h0):
            g_tau0[0, i] += a_syn0[b * h0 + i]
            g_tau0[1, i] += a_mem0[b * h0 + i]
        for i in range(h1):
            g_tau1[0, i] += a_syn1[b * h1 + i]
            g_tau1[1, i] += a_mem1[b * h1 + i]


@njit(cache=True, inline="always")
def _add_to_rows(rows, values, spikes):
    """Add `values` to the rows of the neurons that spiked, four at a time."""
    count = spikes[0]
    whole = count - count % 4
    for k in range(1, 1 + whole, 4):
        j0, j1, j2, j3 = spikes[k], spikes[k + 1], spikes[k + 2], spikes[k + 3]
        for i in range(values.shape[0]):
            value = values[i]
            rows[j0, i] += value
            rows[j1, i] += value
            rows[j2, i] += value
            rows[j3, i] += value
    for k in range(1 + whole, 1 + count):
        j0 = spikes[k]
        for i in range(values.shape[0]):
            rows[j0, i] += values[i]


@njit(cache=True)
def _tile(values, n):
    tiled = np.empty(n * values.shape[0], values.dtype)
    for b in range(n):
        tiled[b * values.shape[0] : (b + 1) * values.shape[0]] = values
    return tiled


@njit(cache=True, nogil=True)
def _used(b):
    """Whether four rows from this one on are not all 0: the others belong to neurons that nothing reaches."""
    return np.array([np.any(b[k : k + 4] != 0) for k in range(b.shape[0])])


@njit(cache=True, nogil=True)
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


class Workspace:
    """The buffers of one window shape, and the state that one window hands to the next.

    Args:
        steps: Length of the window.
        n: Sequences in the batch.
        weights: Parameters of the network, for their sizes and their floating type.
        quantised: Compute as the chip does.
        recurrent_delay: 1 or 2 steps.
        threads: Parts into which the batch is split.
    """

    def __init__(
        self,
        steps: int,
        n: int,
        weights: Weights,
        quantised: bool = True,
        recurrent_delay: int = 1,
        threads: int = 1,
    ) -> None:
        """Allocate the buffers."""
        self.steps, self.n, self.quantised, self.recurrent_delay = steps, n, quantised, recurrent_delay
        self.dtype = weights.w_ff.detach().numpy().dtype
        edges = np.linspace(0, n, min(threads, n) + 1).astype(int)
        self.parts = [slice(lo, hi) for lo, hi in pairwise(edges)]
        h0, outputs, h1 = weights.w_in.shape[0], *weights.w_out.shape
        self.traces = [Trace.empty(steps, p.stop - p.start, h0, h1, outputs, self.dtype) for p in self.parts]
        self.runs = 0

    def without(self, encoding: NDArray[np.int64], hidden: NDArray[np.int64]) -> Workspace:
        """A workspace of these neurons alone, where the next window goes on from the last one here."""
        smaller = copy(self)
        smaller.traces = [
            Trace.empty(
                self.steps, trace.v0.shape[1], encoding.size, hidden.size, trace.vo.shape[2], self.dtype
            )
            for trace in self.traces
        ]
        for old, new in zip(self.traces, smaller.traces, strict=True):
            new.vo[-2:], new.uo[-1] = old.vo[-2:], old.uo[-1]
            new.u0[-1], new.u1[-1] = old.u0[-1][:, encoding], old.u1[-1][:, hidden]
            for name, neurons in (("0", encoding), ("1", hidden)):
                v, spikes = getattr(new, f"v{name}")[-2:], getattr(new, f"s{name}")[-2:]
                v[:] = getattr(old, f"v{name}")[-2:][..., neurons]
                for index in np.ndindex(v.shape[:2]):
                    found = np.flatnonzero(v[index] > THRESHOLD)
                    spikes[index][0], spikes[index][1 : 1 + found.size] = found.size, found
        return smaller

    def each(self, function) -> list:
        """Call `function(part, trace)` for every part of the batch, in threads where there are several."""
        if len(self.parts) == 1:
            return [function(self.parts[0], self.traces[0])]
        with ThreadPoolExecutor(len(self.parts)) as pool:
            return list(pool.map(function, self.parts, self.traces))

    @property
    def spikes(self) -> tuple[int, int]:
        """Places for a spike in a window (neurons, steps, sequences) of the encoding and hidden layer."""
        first = self.traces[0]
        return first.v0.shape[2] * self.n * self.steps, first.v1.shape[2] * self.n * self.steps


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, space: Workspace, fresh: NDArray[np.bool_], x: Tensor, *weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        arrays = [w.detach().numpy() for w in weights]
        one = STATE_ONE if space.quantised else 1.0
        w_in, w_ff, w_rec, w_out = (
            np.ascontiguousarray(w.T) * w.dtype.type(one) for w in arrays[: len(MATRICES)]
        )
        taus = [tau.astype(np.float64) for tau in arrays[len(MATRICES) :]]
        samples = x.detach().numpy()

        def run(part: slice, trace: Trace) -> None:
            trace.begin(fresh[part])
            forward_window(
                np.ascontiguousarray(samples[part].transpose(1, 0, 2), np.float64),
                w_in.astype(np.float64), w_ff, w_rec, w_out,
                tuple(taus[:4]), np.concatenate(taus[4:]), space.quantised, space.recurrent_delay,
                trace.v0, trace.v1, trace.vo, trace.u0, trace.u1, trace.uo, trace.s0, trace.s1,
            )  # fmt: skip

        space.each(run)
        space.runs += 1
        ctx.space, ctx.run, ctx.x, ctx.weights = space, space.runs, samples, arrays
        out = np.concatenate([trace.vo[2:] for trace in space.traces], 1)
        counts = [
            sum(int(getattr(trace, name)[2:, :, 0].sum()) for trace in space.traces) for name in ("s0", "s1")
        ]
        rates = np.array([c / places for c, places in zip(counts, space.spikes, strict=True)], space.dtype)
        return torch.from_numpy(np.ascontiguousarray(out.transpose(1, 0, 2))), torch.from_numpy(rates)

    @staticmethod
    def backward(ctx, *grads: Tensor):
        space: Workspace = ctx.space
        if space.runs != ctx.run:
            raise RuntimeError("the workspace has run another window since this one: its trace is gone")
        w_in, w_ff, w_rec, w_out, *taus = ctx.weights
        grad = grads[0].numpy()
        down = np.hstack([w_ff, w_rec])
        costs = grads[1].numpy() / space.spikes
        constants = np.array([THRESHOLD, SURROGATE_WIDTH, 1.0, 0.0, *costs], space.dtype)

        def run(part: slice, trace: Trace) -> list[Floats]:
            g_in, g_ff, g_rec, g_out = (
                np.zeros(w.shape[::-1], space.dtype) for w in (w_in, w_ff, w_rec, w_out)
            )
            g_tau0, g_tau1 = (np.zeros((2, w.shape[0]), space.dtype) for w in (w_in, w_ff))
            g_tau_out = np.zeros(2, space.dtype)
            backward_window(
                np.ascontiguousarray(ctx.x[part].transpose(1, 0, 2), space.dtype),
                np.ascontiguousarray(grad[part].transpose(1, 0, 2), space.dtype),
                (down, w_out), tuple(taus[:4]), np.concatenate(taus[4:]), constants,
                space.recurrent_delay,
                trace.v0, trace.v1, trace.vo, trace.u0, trace.u1, trace.uo, trace.s0, trace.s1,
                g_in, g_ff, g_rec, g_out, g_tau0, g_tau1, g_tau_out,
            )  # fmt: skip
            matrices = [g.T for g in (g_in, g_ff, g_rec, g_out)]
            return [*matrices, *g_tau0, *g_tau1, *(g_tau_out[k : k + 1] for k in range(2))]

        parts = space.each(run)
        totals = parts[0]
        for part in parts[1:]:
            totals = [a + b for a, b in zip(totals, part, strict=True)]
        return None, None, None, *(torch.from_numpy(np.ascontiguousarray(t)) for t in totals)


def attsnn(
    x: Tensor, weights: Weights, space: Workspace, fresh: NDArray[np.bool_] | None = None
) -> tuple[Tensor, Tensor]:
    """Run the network over a window, differentiable with respect to its weights (on the CPU).

    Args:
        x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
        weights: Parameters (for the quantised network already on the chip's grid).
        space: Buffers; its trace belongs to this window until the next call.
        fresh: Sequences (n,) that start from rest, the others where the last window ended. None: all.

    Returns:
        Output potentials in units of 1.0, shape (n, T, outputs), and the mean spikes per neuron and step of
        the encoding and of the hidden layer, shape (2,); both carry gradients.

    Raises:
        ValueError: The batch is not of the workspace's shape.
    """
    if x.shape[:2] != (space.n, space.steps):
        raise ValueError(
            f"batch: {tuple(x.shape[:2])} (n, steps), the workspace is for {(space.n, space.steps)}"
        )
    fresh = np.ones(space.n, bool) if fresh is None else fresh
    return _Fused.apply(space, fresh, x, *weights)  # pyright: ignore[reportReturnType]
