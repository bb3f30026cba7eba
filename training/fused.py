"""Att-SNN over a window as a function of PyTorch, by compiled kernels.

Buffers are reused. The batch is split over threads; sums are added in the order of the parts.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.networks.forward import MATRICES, STATE_ONE, THRESHOLD, Weights
from estimators.spiking import SURROGATE_WIDTH

from .window_kernels import Floats, Trace, backward_window, forward_window


class Workspace:
    """The buffers of windows of `steps` samples of n sequences, and the state between two windows."""

    def __init__(self, steps: int, n: int, weights: Weights[Tensor], threads: int) -> None:
        """Allocate the buffers, of the sizes and the floating type of the weights."""
        self.steps, self.n = steps, n
        self.dtype = weights.w_ff.detach().numpy().dtype
        edges = np.linspace(0, n, min(threads, n) + 1).astype(int)
        self.parts = [slice(lo, hi) for lo, hi in pairwise(edges)]
        names = ("w_in", "w_ff", "w_out", "syn_after")
        h0, h1, outputs, after = (getattr(weights, name).shape[0] for name in names)
        self.sizes = (h0, h1, outputs, after)
        self.traces = [
            Trace.empty(steps, part.stop - part.start, self.sizes, self.dtype) for part in self.parts
        ]
        self.runs = 0

    def each(self, function) -> list:
        """Call `function(part, trace)` for every part of the batch, in threads where there are several."""
        if len(self.parts) == 1:
            return [function(self.parts[0], self.traces[0])]
        with ThreadPoolExecutor(len(self.parts)) as pool:
            return list(pool.map(function, self.parts, self.traces))

    @property
    def places(self) -> tuple[int, int]:
        """Places for a spike in a window (neurons, steps, sequences) of the encoding and hidden layer."""
        return self.sizes[0] * self.n * self.steps, self.sizes[1] * self.n * self.steps


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, kernels: Fused, space: Workspace, reset: NDArray[np.bool_], x: Tensor, *weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        w = Weights(*(each.detach().numpy() for each in weights))
        one = STATE_ONE if kernels.quantised else 1.0
        by_source = [np.ascontiguousarray(each.T) * each.dtype.type(one) for each in w[: len(MATRICES)]]
        taus = (tau.astype(np.float64) for tau in w[len(MATRICES) :])
        in_states = Weights(by_source[0].astype(np.float64), *by_source[1:], *taus)
        samples = x.detach().numpy()

        def run(part: slice, trace: Trace) -> None:
            trace.begin(reset[part])
            window = np.ascontiguousarray(samples[part].transpose(1, 0, 2), np.float64)
            forward_window(window, in_states, trace, kernels.recurrent_delay, kernels.quantised)

        space.each(run)
        space.runs += 1
        ctx.delay, ctx.space, ctx.run = kernels.recurrent_delay, space, space.runs
        ctx.x, ctx.weights = samples, w
        out = np.concatenate([trace.v2[2:] for trace in space.traces], 1)
        counts = [
            sum(int(getattr(trace, name)[2:, :, 0].sum()) for trace in space.traces) for name in ("s0", "s1")
        ]
        rates = np.array([c / places for c, places in zip(counts, space.places, strict=True)], space.dtype)
        return torch.from_numpy(np.ascontiguousarray(out.transpose(1, 0, 2))), torch.from_numpy(rates)

    @staticmethod
    def backward(ctx, *grads: Tensor):
        space: Workspace = ctx.space
        weights: Weights[Floats] = ctx.weights
        if space.runs != ctx.run:
            raise RuntimeError("the workspace has run another window since this one: its trace is gone")
        grad = grads[0].numpy()
        costs = grads[1].numpy() / space.places
        constants = tuple(np.array([THRESHOLD, SURROGATE_WIDTH, 1.0, 0.0, *costs], space.dtype))

        def run(part: slice, trace: Trace) -> Weights[Floats]:
            gradients = Weights(*(np.zeros(w.shape[::-1], space.dtype) for w in weights))
            window, of_output = (
                np.ascontiguousarray(each[part].transpose(1, 0, 2), space.dtype) for each in (ctx.x, grad)
            )
            backward_window(window, of_output, weights, trace, gradients, constants, ctx.delay)
            return gradients

        totals, *others = space.each(run)
        for part in others:
            totals = [a + b for a, b in zip(totals, part, strict=True)]
        return None, None, None, None, *(torch.from_numpy(np.ascontiguousarray(g.T)) for g in totals)


class Fused:
    """Runs windows of Att-SNN; windows of one shape continue from each other.

    Args:
        quantised: Whether to compute as the chip does, from weights on its grid.
        recurrent_delay: Of the recurrent connection, 1 or 2 steps.
        threads: Threads that share a batch.
    """

    def __init__(self, quantised: bool = True, recurrent_delay: int = 1, threads: int = 1) -> None:
        """Start without buffers; each shape of a window gets its own."""
        self.quantised, self.recurrent_delay, self.threads = quantised, recurrent_delay, threads
        self._spaces: dict[tuple[int, int], Workspace] = {}

    def forward(
        self, x: Tensor, weights: Weights[Tensor], reset: NDArray[np.bool_] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Run a window, whose trace for the gradient is lost when another one of its shape runs.

        Args:
            x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
            weights: Weights and time constants.
            reset: Sequences (n,) that start from rest, the others where the last window of this shape
                ended. None: all.

        Returns:
            Output potentials in units of 1.0, shape (n, T, outputs), and the mean spikes per neuron and step
            of the encoding and of the hidden layer, shape (2,); both have gradients.
        """
        n, steps, _ = x.shape
        if (n, steps) not in self._spaces:
            self._spaces[n, steps] = Workspace(steps, n, weights, self.threads)
        self._last = self._spaces[n, steps]
        reset = np.ones(n, bool) if reset is None else reset
        return _Fused.apply(self, self._last, reset, x, *weights)  # pyright: ignore[reportReturnType]

    def spikes(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Spikes of the encoding (n, T, h0) and of the hidden layer (n, T, h1) in the last window."""
        traces = self._last.traces
        v0, v1 = (np.concatenate([getattr(each, v)[2:] for each in traces], 1) for v in ("v0", "v1"))
        return v0.transpose(1, 0, 2) > THRESHOLD, v1.transpose(1, 0, 2) > THRESHOLD

    def peak_currents(self, every: int = 1) -> tuple[Floats, Floats, Floats]:
        """Largest currents of both layers, and after-spike ones, in every so many steps."""
        largest = [
            [np.abs(u[::every]).max((0, 1)) for u in (each.u0, each.u1, each.a1)]
            for each in self._last.traces
        ]
        first, second, after = (np.max(parts, 0) for parts in zip(*largest, strict=True))
        return first, second, after
