"""Att-SNN and Att-RNN as trainable modules."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from estimators.analysis.ablation import living
from estimators.networks.forward import MATRICES, TIME_CONSTANTS, Weights
from estimators.networks.symmetry import Ties, ties
from estimators.spiking import quantise_decay, quantise_weights

from .backends import BACKENDS, Backend

OUTPUTS = 2
Values = TypeVar("Values", Tensor, NDArray[np.floating])


WEIGHT_MAX = 127 / 128
"""Largest weight of either sign on the chip."""
CURRENT_MAX, CURRENT_EVERY = 384.0, 8
"""Currents may grow to this, three quarters of where 24 bits end; every eighth step is looked at."""
LAYERS = {
    "w_in": (0, None), "w_ff": (1, 0), "w_rec": (1, 1), "w_out": (None, 1),
    "syn0": (0,), "mem0": (0,), "syn1": (1,), "mem1": (1,), "syn2": (None,), "mem2": (None,),
}  # fmt: skip
"""For each axis of a parameter the layer whose neurons it counts: 0 encoding, 1 hidden."""


class AttSNN(nn.Module):
    """The spiking network; its time constants are trained as logits of τ.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the recurrent layer.
        quantised: Run as the chip does, weights and decays on its grid.
        recurrent_delay: 1 (the chip) or 2 (the paper's equations).
        output_scale: Radians for an output potential of 1.0.
        threads: Parts of a batch that run side by side.
        symmetric: Whether weights are shared as `estimators.networks.symmetry` says.
    """

    def __init__(
        self,
        encoding: int = 100,
        hidden: int = 100,
        quantised: bool = True,
        recurrent_delay: int = 1,
        output_scale: float = 1.0,
        threads: int = 1,
        symmetric: bool = False,
    ) -> None:
        """Allocate the parameters; `start_like_the_paper` or `start_from_data` fills them."""
        super().__init__()
        self.quantised, self.recurrent_delay = quantised, recurrent_delay
        self.output_scale, self.threads = output_scale, threads
        self.w_in = nn.Parameter(torch.zeros(encoding, 6))
        self.w_ff = nn.Parameter(torch.zeros(hidden, encoding))
        self.w_rec = nn.Parameter(torch.zeros(hidden, hidden))
        self.w_out = nn.Parameter(torch.zeros(OUTPUTS, hidden))
        self.syn0 = nn.Parameter(torch.zeros(encoding))
        self.mem0 = nn.Parameter(torch.zeros(encoding))
        self.syn1 = nn.Parameter(torch.zeros(hidden))
        self.mem1 = nn.Parameter(torch.zeros(hidden))
        self.syn2 = nn.Parameter(torch.zeros(1))
        self.mem2 = nn.Parameter(torch.zeros(1))
        for name in MATRICES:  # a step of the optimiser is relative to these
            self.register_buffer(f"{name}_scale", torch.ones(getattr(self, name).shape[0], 1))
        self.ties = ties(encoding, hidden) if symmetric else {}
        for name, tied in self.ties.items():
            getattr(self, name).register_hook(partial(_mean, tied))
        for name in MATRICES:
            kept = torch.ones(getattr(self, name).shape, dtype=torch.bool)
            if self.ties:
                kept &= torch.from_numpy(self.ties[name].sign != 0).reshape(kept.shape)
            self.register_buffer(f"{name}_kept", kept)
        self.backend: Backend = BACKENDS["fused"](quantised, recurrent_delay, threads)

    def set_weights(self, name: str, values: NDArray[np.floating]) -> None:
        """Set a weight matrix, and its rows' scales to their root mean square."""
        w = torch.tensor(values, dtype=torch.float32)
        used = (w != 0).sum(1, keepdim=True).clamp(min=1)
        scale = (w.square().sum(1, keepdim=True) / used).sqrt().clamp(min=1e-3)
        if self.ties:  # rows that share their weights share their scale
            layer = {"w_in": "mem0", "w_ff": "mem1", "w_rec": "mem1"}.get(name)
            scale = self.shared(layer, scale) if layer else scale.mean()
        with torch.no_grad():
            getattr(self, f"{name}_scale").copy_(scale)
            getattr(self, name).copy_(w / scale)

    def shared(self, name: str, values: Values) -> Values:
        """What a parameter would be if its entries that share a weight took that of their first."""
        if not self.ties:
            return values
        if isinstance(values, Tensor):
            return torch.from_numpy(self.ties[name].copied(values.detach().numpy()))
        return self.ties[name].copied(values)

    def weights(self) -> Weights:
        """Weights and time constants as the network uses them."""
        w = [getattr(self, name) * getattr(self, f"{name}_scale") for name in MATRICES]
        tau = [torch.sigmoid(getattr(self, name)) for name in TIME_CONSTANTS]
        if self.quantised:
            w = [quantise_weights(x) for x in w]
            tau = [quantise_decay(x) for x in tau]
        return Weights(*w, *tau)

    def forward(self, x: Tensor, fresh: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Roll and pitch [rad] of a window of scaled inputs (n, T, 6), and the layers' spike rates (2,).

        Sequences that are not `fresh` (n,) go on from the last window of this shape; None: all are fresh.
        """
        out, rates = self.backend.forward(x, self.weights(), fresh)
        return out * self.output_scale, rates

    @torch.no_grad()
    def constrain(self) -> None:
        """Keep shared weights equal, removed ones 0, all in range; time constants where a gradient lives."""
        for name in self.ties:
            getattr(self, name).copy_(self.shared(name, getattr(self, name)))
        for weight, kept in self.kept.items():
            weight.mul_(kept)
        if self.quantised:
            for name in MATRICES:
                limit = WEIGHT_MAX / getattr(self, f"{name}_scale")
                w = getattr(self, name)
                w.copy_(torch.minimum(torch.maximum(w, -limit), limit))
        for name in TIME_CONSTANTS:
            getattr(self, name).clamp_(-6.0, math.log(4095.0))

    @torch.no_grad()
    def stay_in_range(self) -> None:
        """Weaken the inputs of neurons whose currents neared the ends of the chip's range in the last window.

        Beyond them a current wraps round to the other sign: a neuron that training keeps silencing would
        spike in every other step at once, and no gradient leads back.
        """
        if not self.quantised:
            return
        peaks = self.backend.peak_currents(CURRENT_EVERY)
        for layer, names in ((0, ("w_in",)), (1, ("w_ff", "w_rec"))):
            most = peaks[layer]
            if most.max() <= CURRENT_MAX:
                continue
            first = self.ties[f"mem{layer}"].first if self.ties else np.arange(most.size)
            of_group = np.zeros_like(most)
            np.maximum.at(of_group, first, most)
            weaker = torch.from_numpy((CURRENT_MAX / np.maximum(of_group, CURRENT_MAX))[first])
            for name in names:
                getattr(self, name).mul_(weaker[:, None])

    def part(self, name: str, values: Tensor, neurons: Sequence[NDArray[np.int64]]) -> Tensor:
        """`values`, of the shape of a parameter or of its scale, for some neurons of both layers alone."""
        for axis, layer in enumerate(LAYERS[name]):
            if layer is not None and values.shape[axis] > 1:
                values = values.index_select(axis, torch.from_numpy(neurons[layer]))
        return values

    @torch.no_grad()
    def without(self, neurons: Sequence[NDArray[np.int64]]) -> AttSNN:
        """The network of these neurons of both layers alone; its windows go on from the last ones here."""
        encoding, hidden = neurons
        smaller = AttSNN(
            encoding.size, hidden.size, self.quantised, self.recurrent_delay, self.output_scale, self.threads,
            bool(self.ties),
        )  # fmt: skip
        smaller.load_state_dict(
            {
                name: self.part(name.removesuffix("_kept").removesuffix("_scale"), value, neurons)
                for name, value in self.state_dict().items()
            }
        )
        smaller.backend = self.backend.connected(encoding, hidden)
        return smaller

    @property
    def living(self) -> list[NDArray[np.int64]]:
        """Neurons of both layers that connections join to the inputs and to the outputs."""
        kept = [getattr(self, f"{name}_kept").numpy() for name in MATRICES]
        layers = (("mem0", self.w_in.shape[0]), ("mem1", self.w_ff.shape[0]))
        groups = [self.ties[name].first if self.ties else np.arange(size) for name, size in layers]
        return living(kept, groups)

    @torch.no_grad()
    def keep_what_is_there(self) -> None:
        """Take away every connection whose weight is 0."""
        for name in MATRICES:
            getattr(self, f"{name}_kept").copy_(getattr(self.weights(), name) != 0)

    @property
    def kept(self) -> dict[Tensor, Tensor]:
        """By weight matrix, which of its entries are connections."""
        return {getattr(self, name): getattr(self, f"{name}_kept") for name in MATRICES}

    @property
    def parameters_kept(self) -> int:
        """Connections that were not taken away, and time constants."""
        return sum(int(kept.sum()) for kept in self.kept.values()) + self.time_constants

    @property
    def time_constants(self) -> int:
        """How many there are."""
        h0, h1 = self.w_in.shape[0], self.w_ff.shape[0]
        return 2 * (h0 + h1) + 2


def thin(model: AttSNN, squared_gradients: Mapping[str, Tensor], most: int) -> None:
    """Take connections away until at most `most` parameters are left, those that matter least first.

    What a weight matters is what the loss would rise without it, to second order and with the mean square of
    its gradient in place of the curvature, w² E[g²] / 2 ("optimal brain damage", LeCun, Denker & Solla 1990,
    with the empirical Fisher information). Weights that are shared go together.

    Args:
        model: To change.
        squared_gradients: Mean square of the gradient of each entry of the weight matrices.
        most: Connections and time constants.
    """
    names = MATRICES
    costs, sizes = [], []
    firsts = {n: model.ties[n].first if model.ties else np.arange(getattr(model, n).numel()) for n in names}
    for name, first in firsts.items():
        kept = getattr(model, f"{name}_kept").numpy().ravel()
        w, g2 = (
            t.detach().numpy().ravel().astype(np.float64)
            for t in (getattr(model, name), squared_gradients[name])
        )
        costs.append(np.bincount(first, w * w * g2 * kept, kept.size))
        sizes.append(np.bincount(first, kept, kept.size))
    cost, size = np.concatenate(costs), np.concatenate(sizes)
    order = np.argsort(-cost, kind="stable")
    room = most - model.time_constants
    stays = np.zeros(cost.size, bool)
    stays[order] = np.cumsum(size[order]) <= room
    for (name, first), part in zip(
        firsts.items(), np.split(stays, np.cumsum([c.size for c in costs])[:-1]), strict=True
    ):
        kept = getattr(model, f"{name}_kept")
        kept &= torch.from_numpy(part[first]).reshape(kept.shape)
    model.constrain()


def _mean(tied: Ties, gradient: Tensor) -> Tensor:
    return torch.from_numpy(tied.mean(gradient.numpy()))


class AttRNN(nn.Module):
    """The non-spiking twin: two GRU layers and a linear output (roll and pitch, Euler angles)."""

    def __init__(self, hidden: int = 100) -> None:
        """Build with PyTorch's own initial weights."""
        super().__init__()
        self.gru = nn.GRU(6, hidden, num_layers=2, batch_first=True)
        self.out = nn.Linear(hidden, OUTPUTS)
        self._state: Tensor | None = None

    def forward(self, x: Tensor, fresh: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Roll and pitch [rad] of a window of scaled inputs (n, T, 6), and no spikes (2,).

        Sequences that are not `fresh` (n,) go on from the last window; None: all start from rest.
        """
        before = self._state
        if fresh is None or fresh.all():
            before = None
        elif before is not None:
            before = before * torch.from_numpy(~fresh)[:, None]
        y, state = self.gru(x, before)
        self._state = state.detach()
        return self.out(y), torch.zeros(2)

    @torch.no_grad()
    def constrain(self) -> None:
        """Any weight will do."""
