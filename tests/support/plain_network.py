"""Att-SNN in plain PyTorch, one operation after the other: the reference of the compiled kernels.

The equations, and what is whole in the quantised variant, are those of `estimators.loihi.neurons`. Rounding
passes gradients straight through; the reset does not carry a gradient.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from estimators.networks.layer_parameters import MATRICES, THRESHOLD, Weights
from estimators.spiking import superspike

STATE_ONE, V_MAX, OUTPUT_THRESHOLD = 2.0**14, 2.0**23 - 1, (2.0**17 - 1) * 64
BIAS_STEP, MANT_MAX = 2.0**4, 4095.0


def states(x: Tensor, weights: Weights, quantised: bool = False, recurrent_delay: int = 1) -> list:
    """Currents u, potentials v before the reset and spikes s of the layers 0, 1, 2 after each step.

    Args:
        x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
        weights: Parameters in units of 1.0 (for the quantised network on the chip's grid).
        quantised: Compute as the chip does, in state units.
        recurrent_delay: 1 or 2 steps.
    """
    one = STATE_ONE if quantised else 1.0
    w = Weights(*(matrix * one for matrix in weights[: len(MATRICES)]), *weights[len(MATRICES) :])

    def rounded(value: Tensor, rounding) -> Tensor:
        return value + (rounding(value) - value).detach() if quantised else value

    def decay(value: Tensor, tau: Tensor) -> Tensor:
        return rounded(value * tau, torch.trunc)

    def wrap(value: Tensor, bits: int) -> Tensor:
        return rounded(value, lambda x: torch.remainder(x + 2.0**bits, 2.0 ** (bits + 1)) - 2.0**bits)

    def bias(current: Tensor) -> Tensor:
        return torch.clamp(torch.trunc(current / BIAS_STEP), -MANT_MAX, MANT_MAX) * BIAS_STEP

    def membrane(v: Tensor, s: Tensor, u: Tensor, tau: Tensor) -> Tensor:
        return rounded(decay(v * (1 - s.detach()), tau) + u, lambda x: x.clamp(-V_MAX, V_MAX))

    def reset(v: Tensor) -> Tensor:
        return torch.where(v > OUTPUT_THRESHOLD, 0.0, v.clamp(min=-V_MAX))

    (h1, h0), outputs = w.w_ff.shape, len(w.w_out)
    u0 = v0 = s0 = w.w_ff.new_zeros(len(x), h0)
    u1 = v1 = s1 = s1_before = w.w_ff.new_zeros(len(x), h1)
    u2 = v2 = w.w_ff.new_zeros(len(x), outputs)
    every = []
    for sample in x.to(w.w_ff).unbind(1):
        u2 = wrap(decay(u2, w.syn2) + wrap(s1 @ w.w_out.T, 21), 23)
        v2 = rounded(decay(v2, w.mem2) + u2, reset)
        sums = s0 @ w.w_ff.T + (s1 if recurrent_delay == 1 else s1_before) @ w.w_rec.T
        u1 = wrap(decay(u1, w.syn1) + wrap(sums, 21), 23)
        u0 = wrap(decay(u0, w.syn0) + rounded(sample @ w.w_in.T, torch.trunc), 23)
        v1 = membrane(v1, s1, u1, w.mem1)
        v0 = membrane(v0, s0, rounded(u0, bias), w.mem0)
        s1_before = s1
        s0, s1 = (superspike(v / one - THRESHOLD) for v in (v0, v1))
        every.append(SimpleNamespace(u0=u0, v0=v0, s0=s0, u1=u1, v1=v1, s1=s1, v2=v2))
    return every


class Plain:
    """The plain network from rest, with the methods of `training.fused.Fused`."""

    def __init__(self, quantised=True, recurrent_delay=1):
        self.quantised, self.recurrent_delay = quantised, recurrent_delay

    def forward(self, x, weights, reset=None):
        self.one = STATE_ONE if self.quantised else 1.0
        self.every = states(x, weights, self.quantised, self.recurrent_delay)
        rates = [torch.stack([getattr(each, s).mean() for each in self.every]).mean() for s in ("s0", "s1")]
        return torch.stack([each.v2 for each in self.every], 1) / self.one, torch.stack(rates)

    def spikes(self):
        return tuple(np.stack(self.values(name), 1) > 0 for name in ("s0", "s1"))

    def peak_currents(self):
        return tuple(np.abs(self.values(name)).max((0, 1)) / self.one for name in ("u0", "u1"))

    def values(self, name):
        return [getattr(state, name).detach().numpy() for state in self.every]
