"""Att-SNN and Att-RNN as trainable modules, and how their weights start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from estimators.networks import real_weights
from estimators.pruning import living
from estimators.spiking import Weights, quantise_decay, quantise_weights
from estimators.symmetry import Ties, ties
from estimators.weights_file import load_network

from .kernels import Workspace, attsnn

OUTPUTS = 2
Values = TypeVar("Values", Tensor, NDArray[np.floating])


WEIGHT_MAX = 127 / 128
"""Largest weight of either sign on the chip."""
IDLE = (1e-3, 0.999)
"""Spikes per step below and above which a hidden neuron says nothing."""


LAYERS = {
    "w_in": (0, None), "w_ff": (1, 0), "w_rec": (1, 1), "w_out": (None, 1), "syn0": (0,), "mem0": (0,),
    "syn1": (1,), "mem1": (1,), "syn2": (None,), "mem2": (None,),
}  # fmt: skip
"""For each axis of a parameter the layer whose neurons it counts: 0 encoding, 1 hidden."""


@dataclass(frozen=True)
class Ranges:
    """Time constants at the start, log-uniform between two values each [network steps]."""

    encode_syn: tuple[float, float]
    encode_mem: tuple[float, float]
    hidden_syn: tuple[float, float]
    hidden_mem: tuple[float, float]
    output_syn: float
    output_mem: float


PAPER_RANGES = Ranges((1.0, 5.0), (1.0, 5.0), (1.0, 5.0), (1.0, 5.0), 2.0, 5.0)
WIDE_RANGES = Ranges((0.5, 4.0), (60.0, 400.0), (1.0, 400.0), (20.0, 200.0), 1.5, 200.0)


class AttSNN(nn.Module):
    """The spiking network; its time constants are trained as logits of τ.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the recurrent layer.
        quantised: Run as the chip does, weights and decays on its grid.
        recurrent_delay: 1 (the chip) or 2 (the paper's equations).
        output_scale: Radians for an output potential of 1.0.
        threads: Parts of a batch that run side by side.
        symmetric: Whether weights are shared as `estimators.symmetry` says.
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
        for name in Weights._fields[:4]:  # a step of the optimiser is relative to these
            self.register_buffer(f"{name}_scale", torch.ones(getattr(self, name).shape[0], 1))
        self.ties = ties(encoding, hidden) if symmetric else {}
        for name, tied in self.ties.items():
            getattr(self, name).register_hook(partial(_mean, tied))
        for name in Weights._fields[:4]:
            kept = torch.ones(getattr(self, name).shape, dtype=torch.bool)
            if self.ties:
                kept &= torch.from_numpy(self.ties[name].sign != 0).reshape(kept.shape)
            self.register_buffer(f"{name}_kept", kept)
        self._spaces: dict[tuple[int, int], Workspace] = {}

    def set_weights(self, name: str, values: NDArray[np.floating]) -> None:
        """Set one of the four weight matrices, and its rows' scales to their root mean square."""
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
        w = [getattr(self, name) * getattr(self, f"{name}_scale") for name in Weights._fields[:4]]
        tau = [torch.sigmoid(getattr(self, name)) for name in Weights._fields[4:]]
        if not self.quantised:
            return Weights(*w, *tau)
        return Weights(*(quantise_weights(x) for x in w), *(quantise_decay(x) for x in tau))

    def forward(self, x: Tensor, fresh: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Roll and pitch [rad] of a window of scaled inputs (n, T, 6), and the layers' spike rates (2,).

        Sequences that are not `fresh` (n,) go on from the last window of this shape; None: all are fresh.
        """
        weights = self.weights()
        out, rates = attsnn(x, weights, self.space(x, weights), fresh)
        return out * self.output_scale, rates

    def space(self, x: Tensor, weights: Weights) -> Workspace:
        """The workspace for windows of this shape."""
        key = (x.shape[0], x.shape[1])
        if key not in self._spaces:
            self._spaces[key] = Workspace(
                x.shape[1], x.shape[0], weights, self.quantised, self.recurrent_delay, self.threads
            )
        return self._spaces[key]

    @torch.no_grad()
    def constrain(self) -> None:
        """Keep shared weights equal, removed ones 0, all in range; time constants where a gradient lives."""
        for name in self.ties:
            getattr(self, name).copy_(self.shared(name, getattr(self, name)))
        for weight, kept in self.kept.items():
            weight.mul_(kept)
        if self.quantised:
            for name in Weights._fields[:4]:
                limit = WEIGHT_MAX / getattr(self, f"{name}_scale")
                w = getattr(self, name)
                w.copy_(torch.minimum(torch.maximum(w, -limit), limit))
        for name in Weights._fields[4:]:
            getattr(self, name).clamp_(-6.0, math.log(4095.0))

    def part(self, name: str, values: Tensor, neurons: Sequence[NDArray[np.int64]]) -> Tensor:
        """`values`, of the shape of a parameter or of its scale, for some neurons of both layers alone."""
        for axis, layer in enumerate(LAYERS[name]):
            if layer is not None and values.shape[axis] > 1:
                values = values.index_select(axis, torch.from_numpy(neurons[layer]))
        return values

    @torch.no_grad()
    def without(self, neurons: Sequence[NDArray[np.int64]]) -> AttSNN:
        """The network of these neurons of both layers alone; its windows go on from the last ones here."""
        smaller = AttSNN(
            *(ids.size for ids in neurons), self.quantised, self.recurrent_delay, self.output_scale,
            self.threads, bool(self.ties),
        )  # fmt: skip
        smaller.load_state_dict(
            {
                name: self.part(name.removesuffix("_kept").removesuffix("_scale"), value, neurons)
                for name, value in self.state_dict().items()
            }
        )
        smaller._spaces = {key: space.without(*neurons) for key, space in self._spaces.items()}
        return smaller

    @property
    def living(self) -> list[NDArray[np.int64]]:
        """Neurons of both layers that connections join to the inputs and to the outputs."""
        kept = (getattr(self, f"{name}_kept").numpy() for name in Weights._fields[:4])
        layers = (("mem0", self.w_in.shape[0]), ("mem1", self.w_ff.shape[0]))
        groups = [self.ties[name].first if self.ties else np.arange(size) for name, size in layers]
        return living(*kept, groups)

    @torch.no_grad()
    def keep_what_is_there(self) -> None:
        """Take away every connection whose weight is 0."""
        for name in Weights._fields[:4]:
            getattr(self, f"{name}_kept").copy_(getattr(self.weights(), name) != 0)

    @property
    def kept(self) -> dict[Tensor, Tensor]:
        """By weight matrix, which of its entries are connections."""
        return {getattr(self, name): getattr(self, f"{name}_kept") for name in Weights._fields[:4]}

    @property
    def parameters_kept(self) -> int:
        """Connections that were not taken away, and time constants."""
        h0, h1 = self.w_in.shape[0], self.w_ff.shape[0]
        connections = sum(int(kept.sum()) for kept in self.kept.values())
        return connections + 2 * (h0 + h1) + 2


def thin(model: AttSNN, squared_gradients: Mapping[str, Tensor], most: int) -> None:
    """Take connections away until at most `most` parameters are left, those that matter least first.

    What a weight matters is what the loss would rise without it, to second order and with the mean square of
    its gradient in place of the curvature, w² E[g²] / 2 ("optimal brain damage", LeCun, Denker & Solla 1990,
    with the empirical Fisher information). Weights that are shared go together.

    Args:
        model: To change.
        squared_gradients: Mean square of the gradient of each entry of the four matrices.
        most: Connections and time constants.
    """
    names = Weights._fields[:4]
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
    room = most - 2 * (model.mem0.numel() + model.mem1.numel()) - 2
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


def start_like_the_paper(model: AttSNN, seed: int) -> None:
    """Weights of unit scale over the square root of their number, short time constants."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    _start_taus(model, PAPER_RANGES, rng)
    for name in Weights._fields[:4]:
        w = getattr(model, name)
        with torch.no_grad():
            w.copy_(torch.tensor(rng.normal(0, 1 / math.sqrt(w.shape[1]), w.shape)))
    model.constrain()


def start_from_data(
    model: AttSNN,
    x: NDArray[np.float64],
    roll_pitch: NDArray[np.floating],
    seed: int,
    steps_per_sample: int = 1,
    fan_in: int = 25,
) -> None:
    """A network that is solved, not trained: a leaky integrator over random features of the real input.

    Encoders point in random directions of the inputs, with gains spread over a decade; hidden neurons read a
    few encoders each over time constants from a step to seconds. Each layer is scaled so that its currents
    reach the threshold on the data, and the output weights are solved by ridge regression (the Neural
    Engineering Framework, Eliasmith & Anderson 2003).

    Args:
        model: To fill.
        x: Scaled inputs, shape (n, T, 6).
        roll_pitch: Targets, shape (n, T, 2) [rad].
        seed: Of the random directions.
        steps_per_sample: Network steps for each sample: the slow time constants are that much longer.
        fan_in: Encoders that each hidden neuron reads.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    _start_taus(model, WIDE_RANGES, rng, steps_per_sample)
    h0, h1 = model.w_in.shape[0], model.w_ff.shape[0]
    spread = x.reshape(-1, 6).std(0)
    directions = rng.normal(size=(h0, 6)) * (rng.random((h0, 6)) < 0.3)
    directions[np.arange(h0), np.arange(h0) % 5] += np.where(np.arange(h0) // 5 % 2 == 0, -2.0, 2.0)
    gain = np.exp(rng.uniform(math.log(0.05), math.log(0.5), (h0, 1)))
    tau = torch.sigmoid(model.syn0).detach().numpy()[:, None]
    w_in = directions / np.linalg.norm(directions, axis=1, keepdims=True) / spread * gain * (1 - tau)
    w_ff = np.zeros((h1, h0))
    for row in w_ff:
        chosen = rng.choice(h0, min(fan_in, h0), replace=False)
        row[chosen] = rng.normal(size=chosen.size)
    w_rec = rng.normal(size=(h1, h1)) * (rng.random((h1, h1)) < 0.1) * 0.02
    model.set_weights("w_in", w_in)
    model.constrain()
    w_ff = model.shared("w_ff", w_ff)
    model.set_weights("w_ff", w_ff * model.shared("mem1", _current_scale(model, x, w_ff, rng)))
    model.set_weights("w_rec", w_rec)
    model.constrain()
    w_out = _solve_outputs(model, x, roll_pitch)
    model.set_weights("w_out", model.ties["w_out"].mean(w_out) if model.ties else w_out)
    model.constrain()


def start_from_weights(model: AttSNN | AttRNN, path: str | Path) -> None:
    """Go on from a weights file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not weights of such a network.
    """
    config, tensors = load_network(path)
    if isinstance(model, AttRNN):
        found = config.model, config.hidden
        if found != ("att-rnn", model.out.in_features):
            raise ValueError(f"init: {path} holds {found[0]} with {found[1]} hidden units")
        model.load_state_dict({name: torch.tensor(value) for name, value in tensors.items()})
        return
    found = config.model, config.encoding, config.hidden
    if found != ("att-snn", *model.w_ff.shape[::-1]):
        raise ValueError(f"init: {path} holds {found[0]} with {found[1]} + {found[2]} neurons")
    weights, taus = real_weights(config, tensors)
    for name, w in zip(Weights._fields[:4], weights, strict=True):
        model.set_weights(name, w)
    for name, tau in zip(Weights._fields[4:], taus, strict=True):
        inside = np.clip(tau, 1 / 1024, 4095 / 4096)
        with torch.no_grad():
            getattr(model, name).copy_(torch.tensor(np.log(inside / (1 - inside))))


def revive(model: AttSNN, x: NDArray[np.float64], seed: int, fan_in: int = 20) -> int:
    """Give hidden neurons that never or always spike something new to say, and nobody that listens yet.

    The estimate stays as it is: what neurons that always spike contribute goes to those of them that stay,
    the first or, where weights are shared, the first group. A revived neuron reads a few encoders and a few
    live hidden neurons, at a rate that its drive spreads over.

    Args:
        model: To change.
        x: Scaled inputs, shape (n, T, 6).
        seed: Of the new weights.
        fan_in: Neurons that each revived one reads, half of either layer.

    Returns:
        How many neurons were revived.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    first, second = _spikes(model, x)
    group = model.ties["mem1"].first if model.ties else np.arange(second.shape[2])
    rate = (np.bincount(group, second.mean((0, 1))) / np.maximum(np.bincount(group), 1))[group]
    always = rate > IDLE[1]
    stays = always & (group == group[always.argmax()])
    idle = np.flatnonzero((rate < IDLE[0]) | (always & ~stays))
    alive = np.setdiff1d(np.arange(rate.size), idle)
    if not idle.size or not alive.size:
        return 0
    with torch.no_grad():
        w = {name: value.numpy().astype(np.float64) for name, value in model.weights()._asdict().items()}
        for name in ("w_rec", "w_out"):
            if always.any():
                w[name][:, stays] = w[name][:, always].sum(1, keepdims=True) / stays.sum()
            w[name][:, idle] = 0.0
        tau = model.shared("mem1", np.exp(-1.0 / np.exp(rng.uniform(0.0, math.log(100.0), rate.size))))
        for name in ("syn1", "mem1"):
            getattr(model, name)[idle] = torch.from_numpy(np.log(tau / (1 - tau)))[idle].float()
    for row in idle:
        for name, sources in (("w_ff", np.arange(first.shape[2])), ("w_rec", alive)):
            w[name][row] = 0.0
            chosen = rng.choice(sources, min(fan_in // 2, sources.size), replace=False)
            w[name][row, chosen] = rng.normal(size=chosen.size)
    for name in ("w_ff", "w_rec"):
        w[name] = model.shared(name, w[name])
    drive = np.concatenate([first, second], 2) @ np.hstack([w["w_ff"], w["w_rec"]])[idle].T
    current = _filtered(drive, tau[idle])
    scale = np.ones(rate.size)
    wanted = np.exp(rng.uniform(math.log(0.1), math.log(0.5), idle.size))
    towards = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)
    scale[idle] = 0.5 * wanted / np.maximum(current.std((0, 1)), 1e-6) * towards
    for name in ("w_ff", "w_rec"):
        model.set_weights(name, w[name] * model.shared("mem1", scale)[:, None])
    model.set_weights("w_out", w["w_out"])
    model.constrain()
    return int(idle.size)


def _start_taus(model: AttSNN, ranges: Ranges, rng: np.random.Generator, stretch: int = 1) -> None:
    with torch.no_grad():
        for name, limits in (
            ("syn0", ranges.encode_syn),
            ("mem0", ranges.encode_mem),
            ("syn1", ranges.hidden_syn),
            ("mem1", ranges.hidden_mem),
            ("syn2", (ranges.output_syn,) * 2),
            ("mem2", (ranges.output_mem,) * 2),
        ):
            parameter = getattr(model, name)
            low, high = (math.log(limit * (1 if name in ("syn0", "syn2") else stretch)) for limit in limits)
            steps = np.exp(rng.uniform(low, high, parameter.shape))
            tau = np.exp(-1.0 / steps)
            parameter.copy_(torch.tensor(np.log(tau / (1 - tau))))


def _spikes(model: AttSNN, x: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Spikes of both layers, (n, T, h)."""
    with torch.no_grad():
        model(torch.from_numpy(x))
    trace = model.space(torch.from_numpy(x), model.weights()).traces
    both = []
    for name in ("v0", "v1"):
        v = np.concatenate([getattr(t, name)[2:] for t in trace], 1)
        both.append((v > 0.5).transpose(1, 0, 2))
    return both[0], both[1]


def _filtered(signal: NDArray, tau: NDArray) -> NDArray:
    """First-order filter u[t] = τ u[t-1] + signal[t] along time, (n, T, k)."""
    out = np.empty(signal.shape, np.float32)
    state = np.zeros((signal.shape[0], signal.shape[2]))
    for t in range(signal.shape[1]):
        state = tau * state + signal[:, t]
        out[:, t] = state
    return out


def _current_scale(model: AttSNN, x: NDArray[np.float64], w_ff: NDArray, rng: np.random.Generator) -> NDArray:
    """Factor for each hidden neuron that makes its mean drive fill its membrane to a random part of 0.5."""
    spikes, _ = _spikes(model, x)
    tau = torch.sigmoid(model.syn1).detach().numpy()
    current = _filtered(spikes @ w_ff.T, tau)
    rate = np.exp(rng.uniform(math.log(0.2), math.log(1.0), len(w_ff)))
    sign = np.where(current.mean((0, 1)) < 0, -1.0, 1.0)  # towards spiking, not silence
    return (sign * 0.5 * rate / np.maximum(current.std((0, 1)), 1e-6))[:, None]


def _solve_outputs(model: AttSNN, x: NDArray[np.float64], roll_pitch: NDArray[np.floating]) -> NDArray:
    """Ridge regression from the hidden spikes, filtered as the outputs filter them, to roll and pitch."""
    _, spikes = _spikes(model, x)
    features = spikes.astype(np.float32)
    for name in ("syn2", "mem2"):
        features = _filtered(features, torch.sigmoid(getattr(model, name)).detach().numpy())
    skip = x.shape[1] // 4
    a = features[:, skip:].reshape(-1, features.shape[2]).astype(np.float64)
    b = roll_pitch[:, skip:].reshape(-1, 2) / model.output_scale
    gram = a.T @ a
    ridge = max(1e-3 * np.trace(gram) / len(gram), 1e-9)  # neurons may all be silent
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), a.T @ b).T


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
