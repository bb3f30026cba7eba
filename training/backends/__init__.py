"""Backends of Att-SNN: weights and a batch go in, outputs and gradients come out.

A backend for other hardware is a file here and an entry in `BACKENDS`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from estimators.spiking import Weights

from .cuda import Cuda
from .fused import Fused
from .plain import Plain


class Backend(Protocol):
    """Runs windows of Att-SNN; windows of one shape continue from each other."""

    quantised: bool
    """Compute as the chip does."""

    def forward(
        self, x: Tensor, weights: Weights[Tensor], reset: NDArray[np.bool_] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Run a window, differentiable with respect to the weights.

        Args:
            x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
            weights: Parameters (for the quantised network on the chip's grid).
            reset: Sequences (n,) that start from rest, the others where the last window of this shape
                ended. None: all.

        Returns:
            Output potentials in units of 1.0, shape (n, T, outputs), and the mean spikes per neuron and step
            of the encoding and of the hidden layer, shape (2,); both have gradients.
        """
        ...

    def spikes(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Spikes of the encoding (n, T, h0) and of the hidden layer (n, T, h1) in the last window."""
        ...

    def peak_currents(self, every: int = 1) -> tuple[NDArray[np.floating], ...]:
        """Largest currents in each `every`th step of it.

        Of the encoding (h0,) and hidden neurons (h1,), and after-spike ones (h1,); in a network without
        these they are 0, or none.
        """
        ...

    def connected(self, encoding: NDArray[np.int64], hidden: NDArray[np.int64]) -> Backend:
        """The backend of these neurons alone; its windows continue from the last ones here."""
        ...


BACKENDS = {"fused": Fused, "plain": Plain, "cuda": Cuda}
"""Constructors that take `quantised`, `recurrent_delay` (1 or 2 steps) and `threads`, which share a batch."""
