"""The spiking network and the GRU network as trainable modules."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from estimators.networks.layer_parameters import (
    DECAY,
    EXPONENTS,
    MATRICES,
    NEURON_CONSTANTS,
    PARAMETERS,
    Kind,
    Weights,
)
from estimators.networks.weights_file import NetworkConfig, Tensors, tensor_shapes

from .config import TrainConfig
from .fused import Fused

WEIGHT_MAX = 127 / 128
"""Largest magnitude of a weight on the chip."""
CURRENT_MAX, CURRENT_EVERY = 384.0, 8
"""Largest current, three quarters of the chip's range; interval of the checks in steps."""
MEMBRANES = {each.layer: name for name, each in PARAMETERS.items() if each.role == "dv"}
"""Name of the membrane time constants of the target neurons, by weight matrix."""
CONTROL_SCALE = 32.0
"""Angular acceleration for an output potential of 1.0 of a new controller [rad/s²]."""


def weight_exponents(w: Tensor, finest: int) -> Tensor:
    """Return the smallest exponent ≥ `finest` of each row, (rows, 1), whose range includes all weights."""
    largest = w.detach().abs().amax(1, keepdim=True)
    return torch.log2(largest / WEIGHT_MAX).ceil().clamp(finest, 0)


def quantise_weights(w: Tensor, finest: int = 0) -> Tensor:
    """Round to weights of the chip, even mantissas -256...254 of 2^(e - 8), with a straight-through gradient.

    Args:
        w: Weights, shape (rows, columns).
        finest: Smallest exponent e of a row; see `weight_exponents`.
    """
    step = torch.exp2(weight_exponents(w, finest)) / 128
    return _straight(w, torch.clamp(torch.round(w / step), -128, 127) * step)


def quantise_constant(value: Tensor, kind: Kind) -> Tensor:
    """Round a neuron's constant to the nearest value on the chip, with a straight-through gradient."""
    return _straight(value, kind.real(torch.clamp(torch.round(kind.whole(value)), kind.low, kind.high)))


def _straight(value: Tensor, rounded: Tensor) -> Tensor:
    """Return `rounded` in the forward pass, with the gradient of `value` in the backward pass."""
    return value + (rounded - value).detach()


def network_of(config: TrainConfig) -> NetworkConfig:
    """Return the configuration of the network of a run."""
    return NetworkConfig(
        model=config.model,
        encoding=config.encoding,
        hidden=config.hidden,
        inputs=config.inputs,
        quantised=config.quantised and config.model == "att-snn",
        recurrent_delay=config.recurrent_delay,
        outputs=config.outputs,
        output_scale=CONTROL_SCALE if config.controls else 1.0,
        set_point=config.control.set_point if config.controls else None,
    )


class AttSNN(nn.Module):
    """The spiking network, with initial constants and weights of 0; `training.init` sets the weights.

    `training.config.Optimisation.logits` selects the trained parameters. The kernels for a quantised network
    use weights on the chip's grid.

    Args:
        config: Configuration of the run.
    """

    w_in: Tensor
    w_ff: Tensor

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.network, self.logits = network_of(config), config.method.logits
        self.finest = config.finest_exponent
        self.kernels = Fused(config.quantised, config.recurrent_delay)
        self.output_scale = self.network.output_scale
        for name, shape in tensor_shapes(self.network).items():
            self.register_parameter(name, nn.Parameter(torch.zeros(shape)))
        for name in MATRICES:  # a step of the optimiser is relative to these
            self.register_buffer(f"{name}_scale", torch.ones(getattr(self, name).shape[0], 1))
        for name in NEURON_CONSTANTS:
            self.set_constants(name, np.full(getattr(self, name).shape, PARAMETERS[name].first))

    def set_weights(self, name: str, values: NDArray[np.floating]) -> None:
        """Set a weight matrix, and the scales of its rows to their RMS values."""
        w = torch.tensor(values, dtype=torch.float32)
        if self.logits:
            used = (w != 0).sum(1, keepdim=True).clamp(min=1)
            scale = (w.square().sum(1, keepdim=True) / used).sqrt().clamp(min=1e-3)
            getattr(self, f"{name}_scale").copy_(scale)
        with torch.no_grad():
            getattr(self, name).copy_(w / self._units(name))

    def _units(self, name: str) -> Tensor:
        """Return the weights for a parameter of 1, with a row per target neuron."""
        scale, membranes = getattr(self, f"{name}_scale"), MEMBRANES[PARAMETERS[name].layer]
        return scale if self.logits else scale * (1.0 - self.constants(membranes)).reshape(-1, 1)

    def set_constants(self, name: str, values: NDArray[np.floating]) -> None:
        """Set constants of neurons; this must precede the weights that they scale."""
        value, kind = torch.tensor(values), PARAMETERS[name].kind
        raw = torch.log(value / (1 - value)) if self._is_logit(name) else kind.whole(value) * kind.step
        with torch.no_grad():
            getattr(self, name).copy_(raw)

    def constants(self, name: str) -> Tensor:
        """Return constants of neurons, such as time constants τ."""
        raw, kind = getattr(self, name), PARAMETERS[name].kind
        return torch.sigmoid(raw) if self._is_logit(name) else kind.real(raw / kind.step)

    def _is_logit(self, name: str) -> bool:
        return self.logits and PARAMETERS[name].kind is DECAY

    def weights(self) -> Weights:
        """Return weights and time constants as used by the network."""
        w = {name: getattr(self, name) * self._units(name) for name in MATRICES}
        constants = {name: self.constants(name) for name in NEURON_CONSTANTS}
        if self.kernels.quantised:
            finest = dict.fromkeys(EXPONENTS, self.finest)
            w = {name: quantise_weights(value, finest.get(name, 0)) for name, value in w.items()}
            constants = {
                name: quantise_constant(value, PARAMETERS[name].kind) for name, value in constants.items()
            }
        return Weights(**w, **constants)

    def forward(self, x: Tensor, reset: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Return outputs (n, T, outputs) for a window of scaled inputs (n, T, inputs), and spike rates (2,).

        Sequences in the mask `reset` (n,) start from a state of zero; None resets all. The others continue
        from the last window of the same shape.
        """
        out, rates = self.kernels.forward(x, self.weights(), reset)
        return out * self.output_scale, rates

    @torch.no_grad()
    def constrain(self) -> None:
        """Clip all parameters to their ranges."""
        for name in NEURON_CONSTANTS:
            kind = PARAMETERS[name].kind
            limits = (kind.low * kind.step, kind.high * kind.step)
            getattr(self, name).clamp_(*((-6.0, math.log(4095.0)) if self._is_logit(name) else limits))
        for name in MATRICES if self.kernels.quantised else ():
            w, limit = getattr(self, name), WEIGHT_MAX / self._units(name)
            w.copy_(torch.minimum(torch.maximum(w, -limit), limit))

    @torch.no_grad()
    def limit_currents(self) -> None:
        """Reduce the weights of neurons whose currents came close to the chip's limits in the last window.

        Beyond the limits, a current wraps to the other sign. A neuron whose input decreases further would
        then spike in every other step, without a gradient that corrects this.
        """
        if not self.kernels.quantised:
            return
        layers = ("w_in",), ("w_ff", "w_rec")
        for most, names in zip(self.kernels.peak_currents(CURRENT_EVERY), layers, strict=True):
            weaker = torch.from_numpy(CURRENT_MAX / np.maximum(most, CURRENT_MAX))
            for name in names if most.max() > CURRENT_MAX else ():
                getattr(self, name).mul_(weaker[:, None])

    @torch.no_grad()
    def tensors(self) -> Tensors:
        """Return the tensors for `save_network`."""
        arrays = {name: w.numpy() for name, w in self.weights()._asdict().items()}
        if not self.network.quantised:
            return {name: w.astype(np.float32) for name, w in arrays.items()}
        whole = {name: PARAMETERS[name].kind.whole(w.astype(np.float64)) for name, w in arrays.items()}
        for name, exponent in EXPONENTS.items() if self.finest else ():
            exponents = weight_exponents(torch.from_numpy(arrays[name]), self.finest).numpy()
            whole[name], whole[exponent] = whole[name] * np.exp2(-exponents), exponents[:, 0]
        return {name: np.rint(value).astype(np.int16) for name, value in whole.items()}


class AttRNN(nn.Module):
    """The GRU network: two GRU layers and a linear output, with PyTorch's initial weights."""

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.network = network_of(config)
        self.gru = nn.GRU(6, config.hidden, num_layers=2, batch_first=True)
        self.out = nn.Linear(config.hidden, 2)
        self._state: Tensor | None = None

    def forward(self, x: Tensor, reset: NDArray[np.bool_] | None = None) -> tuple[Tensor, Tensor]:
        """Return outputs (n, T, outputs) for scaled inputs (n, T, 6), and spike rates of zero (2,).

        Sequences in the mask `reset` (n,) start from a state of zero; None resets all. The others continue
        from the last window.
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
        """Do nothing, because any weight is allowed."""

    def tensors(self) -> Tensors:
        """Return the tensors for `save_network`."""
        return {name: value.numpy().copy() for name, value in self.state_dict().items()}
