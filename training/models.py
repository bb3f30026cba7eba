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
from estimators.networks.weights_file import AXES, EXPONENTS, NetworkConfig, Tensors, expected_shapes

from .config import TrainConfig
from .fused import Fused

WEIGHT_MAX = 127 / 128
"""Largest weight of either sign on the chip."""
CURRENT_MAX, CURRENT_EVERY = 384.0, 8
"""Largest current, three quarters of the chip's 24 bits; every eighth step is checked."""
ROWS = {name: axes[0] for name, axes in AXES.items() if axes[0] in ("encoding", "hidden")}
"""The layer of parameters with a row for each neuron of a layer that may be given."""
MEMBRANES = {"encoding": "mem0", "hidden": "mem1", "outputs": "mem2"}
"""Membrane time constants of the neurons that a matrix leads to."""
PAPER_SCALE, SOLVED_SCALE, CONTROL_SCALE = 1.0, 1 / 128, 32.0
"""Radians, parts of a unit vector or rad/s² for an output potential of 1.0 of a new network. The slow outputs
of a solved attitude estimator need the small one: their weights would be below a step of the chip's."""
LEAST_DECAY = 1 / 4096
"""Of a current or membrane, in a step."""


def weight_exponents(w: Tensor, finest: int) -> Tensor:
    """Exponent of each row, (rows, 1): the finest of `finest`...0 in whose range the largest weight is."""
    largest = w.detach().abs().amax(1, keepdim=True)
    return torch.log2(largest / WEIGHT_MAX).ceil().clamp(finest, 0)


def quantise_weights(w: Tensor, finest: int = 0) -> Tensor:
    """Nearest weight of the chip: even mantissas -256...254 of 2^(e - 8). Gradient straight through.

    Args:
        w: Weights, shape (rows, columns).
        finest: Least exponent e of a row, see `weight_exponents`.
    """
    step = torch.exp2(weight_exponents(w, finest)) / 128
    return _straight(w, torch.clamp(torch.round(w / step), -128, 127) * step)


def quantise_decay(tau: Tensor) -> Tensor:
    """Nearest τ of which 4096 (1 - τ) is a whole number, 1...4096. Gradient straight through."""
    return _straight(tau, 1 - torch.clamp(torch.round(4096 * (1 - tau)), 1, 4096) / 4096)


def _straight(value: Tensor, rounded: Tensor) -> Tensor:
    """`rounded` forward, the gradient of `value` backward."""
    return value + (rounded - value).detach()


def network_of(config: TrainConfig, given: tuple[int, int] = (0, 0)) -> NetworkConfig:
    """How the network of a run is run; `given` neurons come before its own in both layers."""
    spiking = config.model == "att-snn"
    scale = SOLVED_SCALE if config.initialisation == "solved" else PAPER_SCALE
    return NetworkConfig(
        model=config.model,
        encoding=given[0] + config.encoding,
        hidden=given[1] + config.hidden,
        inputs=config.inputs,
        quantised=config.quantised and spiking,
        recurrent_delay=config.recurrent_delay,
        after_spike=config.after_spike and spiking,
        steps_per_sample=config.steps_per_sample if spiking else 1,
        outputs=config.outputs,
        output_scale=(CONTROL_SCALE if config.controls else scale) if spiking else 1.0,
        set_point=config.control.set_point if config.controls else None,
        reads=config.control.reads if config.controls else "imu",
    )


class AttSNN(nn.Module):
    """The spiking network, all connections and no values, which `training.init` fills.

    Its time constants are trained as logits of τ and its weights in units of their row's, or both as in the
    paper's published code: see `training.config.Optimisation.logits`. Kernels for a quantised network take
    weights on the chip's grid.

    Args:
        config: Of the run.
        given: Neurons before its own in both layers.
    """

    w_in: Tensor
    w_ff: Tensor
    syn0: Tensor
    syn1: Tensor

    def __init__(self, config: TrainConfig, given: tuple[int, int] = (0, 0)) -> None:
        super().__init__()
        self.network, self.logits = network_of(config, given), config.method.logits
        self.finest = dict.fromkeys(EXPONENTS, config.finest_exponent)
        self.kernels = Fused(config.quantised, config.recurrent_delay, config.threads)
        self.output_scale = self.network.output_scale
        self.frozen: dict[str, Tensor] = {}
        shapes = expected_shapes(self.network)
        self.matrices = [name for name in MATRICES if name in shapes]
        self.taus = [name for name in TIME_CONSTANTS if name in shapes]
        for name, shape in shapes.items():
            self.register_parameter(name, nn.Parameter(torch.zeros(shape)))
        for name in self.matrices:  # a step of the optimiser is relative to these
            self.register_buffer(f"{name}_scale", torch.ones(getattr(self, name).shape[0], 1))
        sizes = self.network.encoding, self.network.hidden, self.network.n_outputs
        sharing = weight_sharing(*sizes) if config.symmetric else {}
        self.sharing = {name: each for name, each in sharing.items() if name in shapes}
        for name, each in self.sharing.items():
            getattr(self, name).register_hook(lambda g, mean=each.mean: torch.from_numpy(mean(g.numpy())))
        for name in self.matrices:
            connected = torch.ones(getattr(self, name).shape, dtype=torch.bool)
            if self.sharing:
                connected &= torch.from_numpy(self.sharing[name].sign != 0).reshape(connected.shape)
            self.register_buffer(f"{name}_connected", connected)

    def set_weights(self, name: str, values: NDArray[np.floating]) -> None:
        """Set a weight matrix, and its rows' scales to their root mean square."""
        w = torch.tensor(values, dtype=torch.float32)
        if self.logits:
            used = (w != 0).sum(1, keepdim=True).clamp(min=1)
            scale = (w.square().sum(1, keepdim=True) / used).sqrt().clamp(min=1e-3)
            if self.sharing:  # rows that share their weights share their scale
                layer = None if name == "w_out" else "mem0" if name == "w_in" else "mem1"
                scale = torch.from_numpy(self.shared(layer, scale.numpy())) if layer else scale.mean()
            getattr(self, f"{name}_scale").copy_(scale)
        with torch.no_grad():
            getattr(self, name).copy_(w / self._units(name))

    def _units(self, name: str) -> Tensor:
        """Weights for a parameter of 1, a row for each neuron that they lead to."""
        scale = getattr(self, f"{name}_scale")
        return scale if self.logits else scale * (1.0 - self.tau(MEMBRANES[AXES[name][0]])).reshape(-1, 1)

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

    def weights(self) -> Weights:
        """Weights and time constants as the network uses them."""
        w = {name: getattr(self, name) * self._units(name) for name in self.matrices}
        tau = {name: self.tau(name) for name in self.taus}
        if self.kernels.quantised:
            w = {name: quantise_weights(value, self.finest.get(name, 0)) for name, value in w.items()}
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
            shared = self.shared(name, getattr(self, name).detach().numpy())
            getattr(self, name).copy_(torch.from_numpy(shared))
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
            if rows := encoding if ROWS[name] == "encoding" else hidden:
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
            first = self.sharing[layer].first if self.sharing else np.arange(most.size)
            of_group = np.zeros_like(most)
            np.maximum.at(of_group, first, most)
            weaker = torch.from_numpy((CURRENT_MAX / np.maximum(of_group, CURRENT_MAX))[first])
            for name in names:
                getattr(self, name).mul_(weaker[:, None])

    @torch.no_grad()
    def tensors(self) -> Tensors:
        """Its tensors for `save_network`."""
        arrays = {name: w.numpy() for name, w in self.weights()._asdict().items() if w.numel()}
        if not self.network.quantised:
            return {name: w.astype(np.float32) for name, w in arrays.items()}
        whole = {name: 4096 * (1 - arrays[name].astype(np.float64)) for name in self.taus}
        for name in self.matrices:
            whole[name] = arrays[name] * 256
            if finest := self.finest.get(name, 0):
                exponents = weight_exponents(torch.from_numpy(arrays[name]), finest).numpy()
                whole[name] = whole[name] * np.exp2(-exponents)
                whole[EXPONENTS[name]] = exponents[:, 0]
        return {name: np.rint(value).astype(np.int16) for name, value in whole.items()}


class AttRNN(nn.Module):
    """The non-spiking twin: two GRU layers and a linear output (roll and pitch, Euler angles; or up)."""

    output_scale = 1.0

    def __init__(self, config: TrainConfig) -> None:
        """Build with PyTorch's own initial weights."""
        super().__init__()
        self.network = network_of(config)
        self.gru = nn.GRU(6, config.hidden, num_layers=2, batch_first=True)
        self.out = nn.Linear(config.hidden, self.network.n_outputs)
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

    def constrain(self) -> None:
        """Do nothing: any weight is allowed."""

    def tensors(self) -> Tensors:
        """Its tensors for `save_network`."""
        return {name: value.numpy().copy() for name, value in self.state_dict().items()}
