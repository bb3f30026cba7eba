"""Att-SNN and Att-RNN as trainable modules."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from estimators.networks.forward import MATRICES, TIME_CONSTANTS, Weights
from estimators.networks.symmetry import weight_sharing
from estimators.networks.weights_file import (
    EXPONENTS,
    NetworkConfig,
    NetworkOutputs,
    SetPointScaling,
    expected_shapes,
    number_of,
)
from estimators.spiking import quantise_decay, quantise_weights

from .config import TrainConfig
from .fused import Fused

WEIGHT_MAX = 127 / 128
"""Largest weight of either sign on the chip."""
CURRENT_MAX, CURRENT_EVERY = 384.0, 8
"""Largest current, three quarters of the chip's 24 bits; every eighth step is checked."""
ROWS = {"w_in": 0, "syn0": 0, "mem0": 0, "syn1": 1, "mem1": 1, "syn_after": 1}
ROWS |= {"w_ff": 1, "w_rec": 1, "w_after": 1}
"""For parameters with a row for each neuron of a layer: 0 encoding, 1 hidden."""
MEMBRANE = {"w_in": "mem0", "w_ff": "mem1", "w_rec": "mem1", "w_after": "mem1", "w_out": "mem2"}
"""Membrane time constants of the neurons that a matrix leads to."""
PAPER_SCALE, SOLVED_SCALE, CONTROL_SCALE = 1.0, 1 / 128, 32.0
"""Radians, parts of a unit vector or rad/s² for an output potential of 1.0 of a new network. The slow outputs
of a solved attitude estimator need the small one: their weights would be below a step of the chip's."""
LEAST_DECAY = 1 / 4096
"""Of a current or membrane, in a step."""


class AttSNN(nn.Module):
    """The spiking network.

    Its time constants are trained as logits of τ and its weights in units of their row's, or both as in the
    paper's published code: see `training.config.Optimisation.logits`.

    Args:
        encoding: Neurons of the encoding layer.
        hidden: Neurons of the recurrent layer.
        kernels: Compute outputs and gradients; quantised ones take weights on the chip's grid.
        output_scale: Radians, or parts of a unit vector, for an output potential of 1.0.
        symmetric: Whether weights are shared as `estimators.networks.symmetry` says.
        outputs: Roll and pitch, or up; of a controller, with 9 inputs, angular acceleration.
        finest_exponent: Of the weights into a hidden neuron on the chip, 0 or less.
        after_spike: Whether hidden neurons have after-spike currents.
        logits: What the parameters are.
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
        logits: bool = True,
    ) -> None:
        """Allocate the parameters; `training.init` fills them."""
        super().__init__()
        self.kernels, self.output_scale, self.finest_exponent = kernels, output_scale, finest_exponent
        self.outputs: NetworkOutputs = outputs
        self.logits = logits
        self.frozen: dict[str, Tensor] = {}
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
        if not self.logits:
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

    def _units(self, name: str) -> Tensor:
        """Weights for a parameter of 1, a row for each neuron that they lead to."""
        scale = getattr(self, f"{name}_scale")
        return scale if self.logits else scale * (1.0 - self.tau(MEMBRANE[name])).reshape(-1, 1)

    def set_taus(self, name: str, values: NDArray[np.floating], where: Any = slice(None)) -> None:
        """Set time constants of a kind, or of some of its neurons, before the weights that they scale."""
        tau = torch.tensor(values)
        raw = torch.log(tau / (1 - tau)) if self.logits else 1 - tau
        with torch.no_grad():
            getattr(self, name)[where] = raw.to(torch.float32)

    def tau(self, name: str) -> Tensor:
        """Time constants of a kind."""
        value = getattr(self, name)
        return torch.sigmoid(value) if self.logits else 1.0 - value

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
        """Make shared weights equal and missing ones 0, clip all to their range; frozen ones stay."""
        for name in self.sharing:
            getattr(self, name).copy_(
                torch.from_numpy(self.shared(name, getattr(self, name).detach().numpy()))
            )
        for name in self.taus:
            getattr(self, name).clamp_(*((-6.0, math.log(4095.0)) if self.logits else (LEAST_DECAY, 1.0)))
        for name in self.matrices:
            w = getattr(self, name).mul_(getattr(self, f"{name}_connected"))
            if self.kernels.quantised:
                limit = WEIGHT_MAX / self._units(name)
                w.copy_(torch.minimum(torch.maximum(w, -limit), limit))
        for name, value in self.frozen.items():
            getattr(self, name)[: len(value)] = value

    def freeze(self, encoding: int, hidden: int) -> None:
        """Keep all values of the first neurons of both layers as they are, whatever the optimiser does."""
        for name in ROWS.keys() & {*self.matrices, *self.taus}:
            if rows := (encoding, hidden)[ROWS[name]]:
                values = getattr(self, name).detach()
                self.frozen[name] = values[:rows].clone()
                mask = torch.ones_like(values)
                mask[:rows] = 0.0
                getattr(self, name).register_hook(lambda gradient, mask=mask: gradient * mask)

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

    @torch.no_grad()
    def disconnect_zeros(self) -> None:
        """Remove every connection whose weight is 0."""
        for name in self.matrices:
            getattr(self, f"{name}_connected").copy_(getattr(self.weights(), name) != 0)


def new_att_snn(config: TrainConfig, given: tuple[int, int] = (0, 0)) -> AttSNN:
    """The network of a run, all connections and no values, after `given` neurons of both layers."""
    scale = SOLVED_SCALE if config.initialisation == "solved" else PAPER_SCALE
    return AttSNN(
        given[0] + config.encoding,
        given[1] + config.hidden,
        Fused(config.quantised, config.recurrent_delay, config.threads),
        CONTROL_SCALE if config.controls else scale,
        config.symmetric,
        config.outputs,
        config.finest_exponent,
        config.after_spike,
        config.method.logits,
    )


class AttRNN(nn.Module):
    """The non-spiking twin: two GRU layers and a linear output (roll and pitch, Euler angles; or up)."""

    def __init__(self, hidden: int = 100, outputs: NetworkOutputs = "roll-pitch") -> None:
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
