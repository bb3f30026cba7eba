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

from estimators.loihi.neurons import STATE_ONE
from estimators.networks.encoder import INPUT_ONE
from estimators.networks.forward import packed
from estimators.networks.layer_parameters import Weights

from .window_kernels import Floats, Gradients, Trace, backward_window, forward_window


class Workspace:
    """The buffers of windows of `steps` samples of n sequences, and the state between two windows."""

    def __init__(self, steps: int, n: int, weights: Weights[Tensor], threads: int) -> None:
        self.dtype = weights.w_ff.detach().numpy().dtype
        edges = np.linspace(0, n, min(threads, n) + 1).astype(int)
        self.parts = [slice(lo, hi) for lo, hi in pairwise(edges)]
        self.sizes = len(weights.w_in), len(weights.w_ff), len(weights.w_out)
        sizes = (part.stop - part.start for part in self.parts)
        self.traces = [Trace.empty(steps, size, self.sizes, self.dtype) for size in sizes]
        self.places = np.array(self.sizes[:2]) * n * steps  # where spikes can be
        self.thresholds = np.zeros(sum(self.sizes))
        self.runs = 0

    def each(self, function) -> list:
        """Call `function(part, trace)` for every part of the batch, in threads where there are several."""
        if len(self.parts) == 1:  # a thread would cost more than it saves
            return [function(self.parts[0], self.traces[0])]
        with ThreadPoolExecutor(len(self.parts)) as pool:
            return list(pool.map(function, self.parts, self.traces))


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, kernels: Fused, space: Workspace, reset: NDArray[np.bool_], x: Tensor, *weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        w = Weights(*(each.detach().numpy() for each in weights))
        network = packed(w, kernels.quantised, kernels.recurrent_delay)
        one = float(STATE_ONE) if kernels.quantised else 1.0
        space.thresholds = network.table[2] / one
        number = network.weights.dtype.type if network.weights.dtype.kind == "f" else np.int32
        samples = x.detach().numpy()

        def run(part: slice, trace: Trace) -> None:
            trace.begin(reset[part])
            window = np.ascontiguousarray(samples[part].transpose(1, 0, 2) * INPUT_ONE, network.table.dtype)
            sums = np.zeros(network.weights.shape[2], number)
            forward_window(window, *network, sums, one, trace)

        space.each(run)
        space.runs += 1
        ctx.later, ctx.space, ctx.run = kernels.recurrent_delay == 2, space, space.runs
        ctx.x, ctx.weights = samples, w
        out = np.concatenate([trace.v[2:, :, sum(space.sizes[:2]) :] for trace in space.traces], 1)
        counts = [trace.spikes[2:, :, :2].sum((0, 1), dtype=np.int64) for trace in space.traces]
        spikes, encoding = np.sum(counts, 0)
        rates = np.array([encoding, spikes - encoding]) / space.places
        out = torch.from_numpy(np.ascontiguousarray(out.transpose(1, 0, 2)))
        return out, torch.from_numpy(rates.astype(space.dtype))

    @staticmethod
    def backward(ctx, *grads: Tensor):
        space: Workspace = ctx.space
        weights: Weights[Floats] = ctx.weights
        if space.runs != ctx.run:
            raise RuntimeError("the workspace has run another window since this one: its trace is gone")
        of_spikes = (grads[1].numpy() / space.places).astype(space.dtype)

        def run(part: slice, trace: Trace) -> Weights[Floats]:
            gradients = Gradients.zeros(weights, part.stop - part.start, ctx.later)
            window, of_output = (
                np.ascontiguousarray(each[part].transpose(1, 0, 2), space.dtype)
                for each in (ctx.x, grads[0].numpy())
            )
            backward_window(window, of_output, of_spikes, weights, trace, gradients)
            return gradients.of_weights()

        total, *others = space.each(run)
        for part in others:
            total = [a + b for a, b in zip(total, part, strict=True)]
        return None, None, None, None, *(torch.from_numpy(np.ascontiguousarray(each)) for each in total)


class Fused:
    """Runs windows of Att-SNN; windows of one shape continue from each other.

    Args:
        quantised: Whether to compute as the chip does, from weights on its grid.
        recurrent_delay: Of the recurrent connection, 1 or 2 steps.
        threads: Threads that share a batch.
    """

    def __init__(self, quantised: bool = True, recurrent_delay: int = 1, threads: int = 1) -> None:
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
        v = np.concatenate([trace.v[2:] for trace in self._last.traces], 1).transpose(1, 0, 2)
        h0, h1, _ = self._last.sizes
        fired = v > self._last.thresholds
        return fired[..., :h0], fired[..., h0 : h0 + h1]

    def peak_currents(self, every: int = 1) -> tuple[Floats, Floats]:
        """Largest currents of both layers in every so many steps."""
        u = np.max([np.abs(trace.u[::every]).max((0, 1)) for trace in self._last.traces], 0)
        h0, h1, _ = self._last.sizes
        return u[:h0], u[h0 : h0 + h1]
