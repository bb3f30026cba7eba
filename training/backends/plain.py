"""Att-SNN in plain PyTorch: `estimators.spiking`, the reference of the other backends, on any device."""

from __future__ import annotations

from copy import copy

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from estimators.networks.forward import STATE_ONE, NetworkState, Weights
from estimators.spiking import rest, states


class Plain:
    """One PyTorch operation after the other, in PyTorch's own threads; see `Backend` and `BACKENDS`."""

    def __init__(self, quantised: bool = True, recurrent_delay: int = 1, threads: int = 1) -> None:
        """Start from rest."""
        self.quantised, self.recurrent_delay = quantised, recurrent_delay
        self._ends: dict[tuple[int, int], NetworkState[Tensor]] = {}

    def forward(
        self, x: Tensor, weights: Weights[Tensor], reset: NDArray[np.bool_] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Run a window."""
        shape, one = (x.shape[0], x.shape[1]), STATE_ONE if self.quantised else 1.0
        state = self._ends.get(shape, rest(len(x), weights))
        going_on = torch.from_numpy(np.zeros(len(x), bool) if reset is None else ~reset).to(x.device)
        state = NetworkState(*(each * going_on[:, None] for each in state))
        self._every = states(x.to(weights.w_ff), weights, self.quantised, self.recurrent_delay, state)
        self._ends[shape] = NetworkState(*(each.detach() for each in self._every[-1]))
        output = torch.stack([each.v2 for each in self._every], 1) / one
        rates = [torch.stack([getattr(each, s).mean() for each in self._every]).mean() for s in ("s0", "s1")]
        return output, torch.stack(rates)

    def spikes(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Spikes of both layers in the last window."""
        first, second = (np.stack(self._values(name), 1) > 0 for name in ("s0", "s1"))
        return first, second

    def peak_currents(self, every: int = 1) -> tuple[NDArray[np.floating], ...]:
        """Largest currents of both layers, and after-spike ones, in the last window."""
        one = STATE_ONE if self.quantised else 1.0
        names = ("u0", "u1", "a1")
        return tuple(np.abs(self._values(name)[every - 1 :: every]).max((0, 1)) / one for name in names)

    def _values(self, name: str) -> list[NDArray]:
        return [getattr(state, name).numpy(force=True) for state in self._every]

    def connected(self, encoding: NDArray[np.int64], hidden: NDArray[np.int64]) -> Plain:
        """The backend of these neurons alone."""
        smaller = copy(self)
        smaller._ends = {
            shape: NetworkState(
                *(x[:, encoding] for x in end[:3]), *(x[:, hidden] for x in end[3:8]), u2=end.u2, v2=end.v2
            )
            for shape, end in self._ends.items()
        }
        return smaller
