"""Att-SNN in plain PyTorch: the readable reference of the compiled kernels, on any device.

The equations, and what is whole in the quantised variant, are those of `estimators.networks.forward`.
Rounding passes gradients straight through; the reset does not carry a gradient.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .networks.forward import BIAS_EXP

THRESHOLD = 0.5
STATE_ONE = 2.0**14
SURROGATE_WIDTH = 20.0
_V_MAX = 2.0**23 - 1
_OUTPUT_THRESHOLD = 131071.0 * 64


class _SuperSpike(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return (x > 0).to(x.dtype)

    @staticmethod
    def backward(ctx, *grads: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        return grads[0] / (1 + SURROGATE_WIDTH * x.abs()) ** 2


def superspike(x: Tensor) -> Tensor:
    """Heaviside step with the gradient 1 / (1 + 20 |x|)² (Zenke & Ganguli 2018).

    Args:
        x: Membrane potential minus threshold, any shape.

    Returns:
        1 where x > 0, else 0.
    """
    return _SuperSpike.apply(x)  # pyright: ignore[reportReturnType]  (torch types apply as Any | None)


class Weights(NamedTuple):
    """The network's parameters as tensors, in units of 1.0."""

    w_in: Tensor
    """Encoding weights, shape (h0, inputs)."""
    w_ff: Tensor
    """Encoding to hidden layer, shape (h1, h0)."""
    w_rec: Tensor
    """Recurrent weights, shape (h1, h1)."""
    w_out: Tensor
    """Hidden layer to outputs, shape (outputs, h1)."""
    syn0: Tensor
    """τ_syn of the encoding layer, shape (h0,)."""
    mem0: Tensor
    """τ_mem of the encoding layer, shape (h0,)."""
    syn1: Tensor
    """τ_syn of the hidden layer, shape (h1,)."""
    mem1: Tensor
    """τ_mem of the hidden layer, shape (h1,)."""
    syn2: Tensor
    """τ_syn of the outputs, shape (1,)."""
    mem2: Tensor
    """τ_mem of the outputs, shape (1,)."""


MATRICES, TIME_CONSTANTS = Weights._fields[:4], Weights._fields[4:]


def quantise_weights(w: Tensor) -> Tensor:
    """Nearest weight of the chip: even mantissas -256...254 of 1/256. Gradient straight through."""
    return _straight(w, torch.clamp(torch.round(w * 128), -128, 127) / 128)


def quantise_decay(tau: Tensor) -> Tensor:
    """Nearest τ of which 4096 (1 - τ) is a whole number, 1...4096. Gradient straight through."""
    return _straight(tau, 1 - torch.clamp(torch.round(4096 * (1 - tau)), 1, 4096) / 4096)


def forward(
    x: Tensor, weights: Weights, quantised: bool = False, recurrent_delay: int = 1
) -> tuple[Tensor, Tensor, Tensor]:
    """Run the network from rest, one PyTorch operation after the other.

    Args:
        x: Scaled input (for the quantised network in steps of 2^-10), shape (n, T, inputs).
        weights: Parameters (for the quantised network already on the chip's grid).
        quantised: Round as the chip does.
        recurrent_delay: 1: the chip's time convention; 2: the paper's equations.

    Returns:
        Output potentials (n, T, outputs), spikes of the encoding (n, T, h0) and hidden layer (n, T, h1).
    """
    n, steps, _ = x.shape
    one = STATE_ONE if quantised else 1.0
    w_in, w_ff, w_rec, w_out = (w * one for w in weights[:4])

    def decay(value: Tensor, tau: Tensor) -> Tensor:
        return _straight(value * tau, torch.trunc(value * tau)) if quantised else value * tau

    def wrapped(value: Tensor, bits: int) -> Tensor:
        return _straight(value, _wrap(value, bits)) if quantised else value

    def clipped(value: Tensor) -> Tensor:
        return _straight(value, value.clamp(-_V_MAX, _V_MAX)) if quantised else value

    def integrated(v: Tensor) -> Tensor:
        if not quantised:
            return v
        return _straight(v, torch.where(v > _OUTPUT_THRESHOLD, 0.0, v.clamp(min=-_V_MAX)))

    def fire(v: Tensor) -> tuple[Tensor, Tensor]:
        s = superspike(v / one - THRESHOLD)
        return s, v * (1 - s.detach())

    u0, v0, s0 = (x.new_zeros(n, w_in.shape[0]) for _ in range(3))
    u1, v1, s1 = (x.new_zeros(n, w_ff.shape[0]) for _ in range(3))
    u2, v2 = (x.new_zeros(n, w_out.shape[0]) for _ in range(2))
    late = s1
    outputs, encoding, hidden = [], [], []
    for t in range(steps):
        u2 = wrapped(decay(u2, weights.syn2) + wrapped(s1 @ w_out.T, 21), 23)
        v2 = integrated(decay(v2, weights.mem2) + u2)
        feedback = s1 if recurrent_delay == 1 else late
        u1 = wrapped(decay(u1, weights.syn1) + wrapped(s0 @ w_ff.T + feedback @ w_rec.T, 21), 23)
        drive = x[:, t] @ w_in.T
        u0 = wrapped(
            decay(u0, weights.syn0) + (_straight(drive, torch.trunc(drive)) if quantised else drive), 23
        )
        bias = _straight(u0, _bias(u0)) if quantised else u0
        late = s1
        s1, v1 = fire(clipped(decay(v1, weights.mem1) + u1))
        s0, v0 = fire(clipped(decay(v0, weights.mem0) + bias))
        outputs.append(v2 / one)
        encoding.append(s0)
        hidden.append(s1)
    return torch.stack(outputs, 1), torch.stack(encoding, 1), torch.stack(hidden, 1)


def _straight(value: Tensor, rounded: Tensor) -> Tensor:
    """`rounded` forward, the gradient of `value` backward."""
    return value + (rounded - value).detach()


def _wrap(value: Tensor, bits: int) -> Tensor:
    half = 2.0**bits
    return torch.remainder(value + half, 2 * half) - half


def _bias(current: Tensor) -> Tensor:
    return torch.clamp(torch.trunc(current / 2**BIAS_EXP), -4095, 4095) * 2**BIAS_EXP
