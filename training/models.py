"""Att-SNN and Att-RNN as trainable modules."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from estimators.analysis.ablation import connected_neurons
from estimators.networks.forward import MATRICES, TIME_CONSTANTS, Weights
from estimators.networks.symmetry import weight_sharing
from estimators.networks.weights_file import (
    EXPONENTS,
    NetworkConfig,
    NetworkOutputs,
    Outputs,
    SetPointScaling,
    expected_shapes,
    number_of,
)
from estimators.spiking import quantise_decay, quantise_weights

from .config import Parametrisation
from .fused import Fused

WEIGHT_MAX = 127 / 128
"""Largest weight of either sign on the chip."""
CURRENT_MAX, CURRENT_EVERY = 384.0, 8
"""Largest current, three quarters of the chip's 24 bits; every eighth step is checked."""
LAYERS = {"w_in": (0, None), "w_ff": (1, 0), "w_rec": (1, 1), "w_out": (None, 1)}
LAYERS |= {"w_after": (1, None), "syn_after": (1,)}
LAYERS |= {f"{tau}{layer}": (index,) for tau in ("syn", "mem") for layer, index in enumerate((0, 1, None))}
"""For each axis of a parameter the layer whose neurons it counts: 0 encoding, 1 hidden."""
MEMBRANE = {"w_in": "mem0", "w_ff": "mem1", "w_rec": "mem1", "w_after": "mem1", "w_out": "mem2"}
"""Membrane time constants of the neurons that a matrix leads to."""
LEAST_DECAY = 1 / 4096
"""Of a current or membrane, in a step."""


class AttSNN(nn.Module):
    """The spiking network.

    Its time constants are trained as logits of τ and its weights in units of their row's, or both as in the
    paper's published code: see `training.config.TrainingRecipe.parametrisation`.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the recurrent layer.
        kernels: Compute outputs and gradients; quantised ones take weights on the chip's grid.
        output_scale: Radians, or parts of a unit vector, for an output potential of 1.0.
        symmetric: Whether weights are shared as `estimators.networks.symmetry` says.
        outputs: Roll and pitch, or up; of a controller, with 9 inputs, angular acceleration.
        finest_exponent: Of the weights into a hidden neuron on the chip, 0 or less.
        after_spike: Whether hidden neurons have after-spike currents.
        parametrisation: What the parameters are.
    """

    w_in: Tensor
    w_ff: Tensor
    syn0: Tensor
    syn1: Tensor

    def __init__(
        self,
        encoding: int,
        hidden: int,
        kernels: Fused,
        output_scale: float = 1.0,
        symmetric: bool = False,
        outputs: NetworkOutputs = "roll-pitch",
        finest_exponent: int = 0,
        after_spike: bool = False,
        parametrisation: Parametrisation = "logits",
    ) -> None:
        """Allocate the parameters; `training.init` fills them."""
        super().__init__()
        self.kernels, self.output_scale, self.finest_exponent = kernels, output_scale, finest_exponent
        self.outputs: NetworkOutputs = outputs
        self.parametrisation: Parametrisation = parametrisation
        network = NetworkConfig(
            model="att-snn",
            encoding=encoding,
            hidden=hidden,
            outputs=outputs,
            after_spike=after_spike,
            set_point=SetPointScaling() if outputs == "angular-acceleration" else None,
        )
        shapes = expected_shapes(network)
        self.matrices = [name for name in MATRICES if name in shapes]
        self.taus = [name for name in TIME_CONSTANTS if name in shapes]
        for name, shape in shapes.items():
            self.register_parameter(name, nn.Parameter(torch.zeros(shape)))
        for name in self.matrices:  # a step of the optimiser is relative to these
            self.register_buffer(f"{name}_scale", torch.ones(getattr(self, name).shape[0], 1))
        sharing = weight_sharing(encoding, hidden, network.n_outputs) if symmetric else {}
        self.sharing = {name: each for name, each in sharing.items() if name in shapes}
        for name, sharing in self.sharing.items():
            getattr(self, name).register_hook(lambda g, mean=sharing.mean: torch.from_numpy(mean(g.numpy())))
        for name in self.matrices:
            connected = torch.ones(getattr(self, name).shape, dtype=torch.bool)
            if self.sharing:
                connected &= torch.from_numpy(self.sharing[name].sign != 0).reshape(connected.shape)
            self.register_buffer(f"{name}_connected", connected)

    def set_weights(self, name: str, values: NDArray[np.floating]) -> None:
        """Set a weight matrix, and its rows' scales to their root mean square."""
        w = torch.tensor(values, dtype=torch.float32)
        if self.normalised:
            with torch.no_grad():
                getattr(self, name).copy_(w / (1.0 - self.tau(MEMBRANE[name])).reshape(-1, 1))
            return
        used = (w != 0).sum(1, keepdim=True).clamp(min=1)
        scale = (w.square().sum(1, keepdim=True) / used).sqrt().clamp(min=1e-3)
        if self.sharing:  # rows that share their weights share their scale
            layer = None if name == "w_out" else "mem0" if name == "w_in" else "mem1"
            scale = torch.from_numpy(self.shared(layer, scale.numpy())) if layer else scale.mean()
        with torch.no_grad():
            getattr(self, f"{name}_scale").copy_(scale)
            getattr(self, name).copy_(w / scale)

    @property
    def normalised(self) -> bool:
        """Whether weights are parameters times 1 − τ_mem of the neuron that they lead to."""
        return self.parametrisation == "decays"

    def _units(self, name: str) -> Tensor:
        """Weights for a parameter of 1, a row for each neuron that they lead to."""
        scale = getattr(self, f"{name}_scale")
        return scale * (1.0 - self.tau(MEMBRANE[name])).reshape(-1, 1) if self.normalised else scale

    def set_taus(self, name: str, values: NDArray[np.floating], where: Any = slice(None)) -> None:
        """Set time constants of a kind, or of some of its neurons, before the weights that they scale."""
        tau = torch.tensor(values)
        raw = torch.log(tau / (1 - tau)) if self.parametrisation == "logits" else 1 - tau
        with torch.no_grad():
            getattr(self, name)[where] = raw.to(torch.float32)

    def tau(self, name: str) -> Tensor:
        """Time constants of a kind."""
        value = getattr(self, name)
        return torch.sigmoid(value) if self.parametrisation == "logits" else 1.0 - value

    def shared(self, name: str, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """The values of a parameter in which entries that share a weight have that of the first of them."""
        return self.sharing[name].apply(values) if self.sharing else values

    def first(self, name: str) -> NDArray[np.int64]:
        """For each entry of a parameter the flat index of the first that shares its weight."""
        return self.sharing[name].first if self.sharing else np.arange(getattr(self, name).numel())

    def weights(self) -> Weights:
        """Weights and time constants as the network uses them."""
        w = {name: getattr(self, name) * self._units(name) for name in self.matrices}
        tau = {name: self.tau(name) for name in self.taus}
        if self.kernels.quantised:
            finest = dict.fromkeys(EXPONENTS, self.finest_exponent)
            w = {name: quantise_weights(value, finest.get(name, 0)) for name, value in w.items()}
            tau = {name: quantise_decay(value) for name, value in tau.items()}
        none = {"w_after": self.w_ff.new_zeros(len(self.w_ff), 0), "syn_after": self.w_ff.new_zeros(0)}
        return Weights(**(none | w | tau))

    def forward(self, x: Tensor, reset: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Outputs (n, T, outputs) of a window of scaled inputs (n, T, inputs), and spike rates (2,).

        Sequences of the mask `reset` (n,) start from a state of zero, the others continue from the last
        window of this shape; None: all are reset.
        """
        out, rates = self.kernels.forward(x, self.weights(), reset)
        return out * self.output_scale, rates

    @torch.no_grad()
    def constrain(self) -> None:
        """Make shared weights equal and pruned ones 0; clip all to the range where they can be trained."""
        for name in self.sharing:
            getattr(self, name).copy_(
                torch.from_numpy(self.shared(name, getattr(self, name).detach().numpy()))
            )
        logits = self.parametrisation == "logits"
        for name in self.taus:
            getattr(self, name).clamp_(*((-6.0, math.log(4095.0)) if logits else (LEAST_DECAY, 1.0)))
        for name in self.matrices:
            w = getattr(self, name).mul_(getattr(self, f"{name}_connected"))
            if self.kernels.quantised:
                limit = WEIGHT_MAX / self._units(name)
                w.copy_(torch.minimum(torch.maximum(w, -limit), limit))

    @torch.no_grad()
    def limit_currents(self) -> None:
        """Weaken the inputs of neurons whose currents neared the ends of the chip's range in the last window.

        Beyond them a current wraps round to the other sign: a neuron that training silences further would
        then spike in every other step, and no gradient leads back.
        """
        if not self.kernels.quantised:
            return
        layers = (("mem0", ("w_in",)), ("mem1", ("w_ff", "w_rec")), ("mem1", ("w_after",)))
        for most, (layer, names) in zip(self.kernels.peak_currents(CURRENT_EVERY), layers, strict=True):
            if most.max(initial=0.0) <= CURRENT_MAX:
                continue
            first = self.first(layer)
            of_group = np.zeros_like(most)
            np.maximum.at(of_group, first, most)
            weaker = torch.from_numpy((CURRENT_MAX / np.maximum(of_group, CURRENT_MAX))[first])
            for name in names:
                getattr(self, name).mul_(weaker[:, None])

    def select(self, name: str, values: Tensor, neurons: Sequence[NDArray[np.int64]]) -> Tensor:
        """`values`, of the shape of a parameter or of its scale, for some neurons of both layers alone."""
        for axis, layer in enumerate(LAYERS[name]):
            if layer is not None and values.shape[axis] > 1:
                values = values.index_select(axis, torch.from_numpy(neurons[layer]))
        return values

    @torch.no_grad()
    def subset(self, neurons: Sequence[NDArray[np.int64]]) -> AttSNN:
        """The network of these neurons of both layers alone; its windows continue from the last ones here."""
        encoding, hidden = neurons
        kernels = self.kernels.connected(encoding, hidden)
        sizes, symmetric = (encoding.size, hidden.size), bool(self.sharing)
        how = (self.output_scale, symmetric, self.outputs, self.finest_exponent, "w_after" in self.matrices)
        smaller = AttSNN(*sizes, kernels, *how, self.parametrisation)
        smaller.load_state_dict(
            {
                name: self.select(name.removesuffix("_connected").removesuffix("_scale"), value, neurons)
                for name, value in self.state_dict().items()
            }
        )
        return smaller

    @property
    def connected_neurons(self) -> list[NDArray[np.int64]]:
        """Neurons of both layers that an input reaches and that reach an output."""
        connected = [getattr(self, f"{name}_connected").numpy() for name in MATRICES[:4]]
        return connected_neurons(connected, [self.first("mem0"), self.first("mem1")])

    @torch.no_grad()
    def disconnect_zeros(self) -> None:
        """Remove every connection whose weight is 0."""
        for name in self.matrices:
            getattr(self, f"{name}_connected").copy_(getattr(self.weights(), name) != 0)

    @property
    def parameter_count(self) -> int:
        """Connections and time constants."""
        connections = (int(getattr(self, f"{name}_connected").sum()) for name in self.matrices)
        return sum(connections) + self.time_constants

    @property
    def time_constants(self) -> int:
        """Number of time constants."""
        return sum(getattr(self, name).numel() for name in self.taus)


def prune_connections(model: AttSNN, squared_gradients: Mapping[str, Tensor], most: int) -> None:
    """Remove the connections with the smallest effect on the loss until at most `most` parameters are left.

    The effect of a weight is the rise of the loss without it, to second order and with the mean square of its
    gradient in place of the curvature, w² E[g²] / 2 ("optimal brain damage", LeCun, Denker & Solla 1990, with
    the empirical Fisher information). Connections that share a weight go together.

    Args:
        model: To change.
        squared_gradients: Mean square of the gradient of each entry of the weight matrices.
        most: Connections and time constants.
    """
    effects, sizes, firsts = [], [], []
    for name in model.matrices:
        connected = getattr(model, f"{name}_connected").numpy().ravel()
        first = model.first(name)
        w, g2 = (
            values.detach().numpy().ravel().astype(np.float64)
            for values in (getattr(model, name), squared_gradients[name])
        )
        effects.append(np.bincount(first, w * w * g2 * connected, connected.size))
        sizes.append(np.bincount(first, connected, connected.size))
        firsts.append(first)
    effect, size = np.concatenate(effects), np.concatenate(sizes)
    order = np.argsort(-effect, kind="stable")
    stays = np.zeros(effect.size, bool)
    stays[order] = np.cumsum(size[order]) <= most - model.time_constants
    parts = np.split(stays, np.cumsum([first.size for first in firsts])[:-1])
    for name, first, part in zip(model.matrices, firsts, parts, strict=True):
        connected = getattr(model, f"{name}_connected")
        connected &= torch.from_numpy(part[first]).reshape(connected.shape)
    model.constrain()


class AttRNN(nn.Module):
    """The non-spiking twin: two GRU layers and a linear output (roll and pitch, Euler angles; or up)."""

    def __init__(self, hidden: int = 100, outputs: Outputs = "roll-pitch") -> None:
        """Build with PyTorch's own initial weights."""
        super().__init__()
        self.gru = nn.GRU(6, hidden, num_layers=2, batch_first=True)
        self.out = nn.Linear(hidden, number_of(outputs))
        self._state: Tensor | None = None

    def forward(self, x: Tensor, reset: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Outputs (n, T, outputs) of a window of scaled inputs (n, T, 6), and no spikes (2,).

        Sequences of the mask `reset` (n,) start from a state of zero, the others continue from the last
        window; None: all are reset.
        """
        before = self._state
        if reset is None or reset.all():
            before = None
        elif before is not None:
            before = before * torch.from_numpy(~reset)[:, None]
        y, state = self.gru(x, before)
        self._state = state.detach()
        return self.out(y), torch.zeros(2)

    @torch.no_grad()
    def constrain(self) -> None:
        """Do nothing: any weight is allowed."""

    @property
    def parameter_count(self) -> int:
        """Weights and biases."""
        return sum(parameter.numel() for parameter in self.parameters())
