"""Att-SNN over a window as a PyTorch function, with compiled kernels and reused buffers."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.loihi.neurons import STATE_ONE
from estimators.networks.encoder import INPUT_ONE
from estimators.networks.forward import packed
from estimators.networks.layer_parameters import Weights

from .window_kernels import Floats, ForwardTrace, backward_window, forward_window, new_gradients, of_weights


class Fused:
    """Runs windows of Att-SNN; successive windows of the same shape continue from each other.

    Args:
        quantised: Whether to compute as on the chip, with weights on its grid.
        recurrent_delay: Delay of the recurrent connection, 1 or 2 steps.
    """

    def __init__(self, quantised: bool = True, recurrent_delay: int = 1) -> None:
        self.quantised, self.recurrent_delay = quantised, recurrent_delay
        self.shape, self.runs, self.thresholds = (0, 0), 0, np.zeros(0)

    def forward(
        self, x: Tensor, weights: Weights[Tensor], reset: NDArray[np.bool_] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Run a window. The next call overwrites its trace for the gradient.

        Args:
            x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
            weights: Weights and time constants.
            reset: Sequences (n,) that start from rest; None for all. The others continue from the last
                window, if it had the same shape.

        Returns:
            Output potentials in units of 1.0, shape (n, T, outputs), and the mean spikes per neuron and step
            of the encoding and of the hidden layer, shape (2,); both have gradients.
        """
        n, steps, _ = x.shape
        if self.shape != (n, steps):
            self.shape, self.sizes = (n, steps), (len(weights.w_in), len(weights.w_ff), len(weights.w_out))
            self.trace = ForwardTrace.empty(steps, n, self.sizes, weights.w_ff.detach().numpy().dtype)
        self.trace.begin(np.ones(n, bool) if reset is None else reset)
        return _Window.apply(self, x, *weights)  # pyright: ignore[reportReturnType]

    def spikes(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return spikes of the encoding (n, T, h0) and the hidden layer (n, T, h1) in the last window."""
        h0, h1, _ = self.sizes
        fired = self.trace.v[2:].transpose(1, 0, 2) > self.thresholds
        return fired[..., :h0], fired[..., h0 : h0 + h1]

    def peak_currents(self, every: int = 1) -> tuple[Floats, Floats]:
        """Return the largest currents of both layers, sampled at regular steps."""
        h0, h1, _ = self.sizes
        u = np.abs(self.trace.u[::every]).max((0, 1))
        return u[:h0], u[h0 : h0 + h1]


class _Window(torch.autograd.Function):
    @staticmethod
    def forward(ctx, kernels: Fused, x: Tensor, *weights: Tensor) -> tuple[Tensor, Tensor]:
        w = Weights(*(each.detach().numpy() for each in weights))
        network = packed(w, kernels.quantised, kernels.recurrent_delay)
        one = float(STATE_ONE) if kernels.quantised else 1.0
        trace, samples = kernels.trace, x.detach().numpy().transpose(1, 0, 2)
        number = network.weights.dtype.type if network.weights.dtype.kind == "f" else np.int32
        sums = np.zeros(network.weights.shape[2], number)
        window = np.ascontiguousarray(samples * INPUT_ONE, network.table.dtype)
        forward_window(window, *network, sums, one, trace)
        kernels.thresholds = network.table[2] / one
        kernels.runs += 1
        h0, h1, _ = kernels.sizes
        places = np.array([h0, h1]) * x.shape[0] * x.shape[1]  # where spikes can be
        spikes, encoding = trace.spikes[2:, :, :2].sum((0, 1), dtype=np.int64)
        rates = np.array([encoding, spikes - encoding]) / places
        ctx.kernels, ctx.run, ctx.places, ctx.x, ctx.weights = kernels, kernels.runs, places, samples, w
        out = np.ascontiguousarray(trace.v[2:, :, h0 + h1 :].transpose(1, 0, 2))
        return torch.from_numpy(out), torch.from_numpy(rates.astype(out.dtype))

    @staticmethod
    def backward(ctx, *grads: Tensor):
        if ctx.kernels.runs != ctx.run:
            raise RuntimeError("another window has run since this one and has overwritten its trace")
        trace, w, dtype = ctx.kernels.trace, ctx.weights, ctx.weights.w_ff.dtype
        gradients = new_gradients(w, ctx.x.shape[1], ctx.kernels.recurrent_delay == 2)
        of_output = grads[0].numpy().transpose(1, 0, 2)
        window = (np.ascontiguousarray(each, dtype) for each in (ctx.x, of_output))
        backward_window(*window, (grads[1].numpy() / ctx.places).astype(dtype), w, trace, gradients)
        return None, None, *(torch.from_numpy(np.ascontiguousarray(each)) for each in of_weights(gradients))
