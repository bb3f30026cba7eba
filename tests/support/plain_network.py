"""Att-SNN in plain PyTorch, the reference of the compiled kernels."""

import numpy as np
import torch

from estimators.networks.forward import STATE_ONE
from estimators.spiking import rest, states


class Plain:
    """One PyTorch operation after the other, from rest, with the methods of `training.fused.Fused`."""

    def __init__(self, quantised=True, recurrent_delay=1):
        self.quantised, self.recurrent_delay = quantised, recurrent_delay

    def forward(self, x, weights, reset=None):
        self.one = STATE_ONE if self.quantised else 1.0
        begin = rest(len(x), weights)
        self.every = states(x.to(weights.w_ff), weights, self.quantised, self.recurrent_delay, begin)
        rates = [torch.stack([getattr(each, s).mean() for each in self.every]).mean() for s in ("s0", "s1")]
        return torch.stack([each.v2 for each in self.every], 1) / self.one, torch.stack(rates)

    def spikes(self):
        return tuple(np.stack(self.values(name), 1) > 0 for name in ("s0", "s1"))

    def peak_currents(self):
        return tuple(np.abs(self.values(name)).max((0, 1)) / self.one for name in ("u0", "u1", "a1"))

    def values(self, name):
        return [getattr(state, name).detach().numpy() for state in self.every]
