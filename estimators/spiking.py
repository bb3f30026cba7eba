"""Att-SNN in plain PyTorch: the readable reference of the compiled kernels, on any device.

The equations, and what is whole in the quantised variant, are those of `estimators.networks.forward`.
Rounding passes gradients straight through; the reset does not carry a gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .networks.forward import (
    BIAS_STEP,
    MANT_MAX,
    MATRICES,
    OUTPUT_THRESHOLD,
    STATE_ONE,
    THRESHOLD,
    V_MAX,
    NetworkState,
    Weights,
)

SURROGATE_WIDTH = 20.0


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


def weight_exponents(w: Tensor, finest: int) -> Tensor:
    """Exponent of each row's weights: the finest of `finest`...0 whose mantissas reach the row's largest.

    Args:
        w: Weights, shape (rows, columns).
        finest: 0 or less.

    Returns:
        Whole numbers, shape (rows, 1).
    """
    largest = w.detach().abs().amax(1, keepdim=True)
    return torch.log2(largest / (127 / 128)).ceil().clamp(finest, 0)


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


def rest(n: int, weights: Weights[Tensor]) -> NetworkState[Tensor]:
    """State of `n` copies at rest; here spikes are 0 or 1, of shape (n, neurons)."""
    w = weights.w_ff
    h0, h1, outputs = (w.new_zeros(n, size) for size in (w.shape[1], w.shape[0], len(weights.w_out)))
    return NetworkState(h0, h0, h0, h1, h1, h1, h1, h1, outputs, outputs)


def step(
    x: Tensor,
    w: Weights[Tensor],
    state: NetworkState[Tensor],
    quantised: bool = False,
    recurrent_delay: int = 1,
) -> NetworkState[Tensor]:
    """One step of the network, one PyTorch operation after the other.

    Args:
        x: Scaled input (for the quantised network in steps of 2^-10), shape (n, inputs).
        w: Parameters, the matrices in state units (for the quantised network on the chip's grid).
        state: State after the step before.
        quantised: Round as the chip does.
        recurrent_delay: 1: the chip's time convention; 2: the paper's equations.
    """

    def decay(value: Tensor, tau: Tensor) -> Tensor:
        return _straight(value * tau, torch.trunc(value * tau)) if quantised else value * tau

    def wrapped(value: Tensor, bits: int) -> Tensor:
        return _straight(value, _wrap(value, bits)) if quantised else value

    def membrane(v: Tensor, s: Tensor, u: Tensor, tau: Tensor) -> Tensor:
        v = decay(v * (1 - s.detach()), tau) + u
        return _straight(v, v.clamp(-V_MAX, V_MAX)) if quantised else v

    u2 = wrapped(decay(state.u2, w.syn2) + wrapped(state.s1 @ w.w_out.T, 21), 23)
    v2 = decay(state.v2, w.mem2) + u2
    drive = x @ w.w_in.T
    if quantised:
        v2 = _straight(v2, torch.where(v2 > OUTPUT_THRESHOLD, 0.0, v2.clamp(min=-V_MAX)))
        drive = _straight(drive, torch.trunc(drive))
    sums = state.s0 @ w.w_ff.T + state.s1_delayed @ w.w_rec.T
    u1 = wrapped(decay(state.u1, w.syn1) + wrapped(sums, 21), 23)
    u0 = wrapped(decay(state.u0, w.syn0) + drive, 23)
    a1 = state.a1
    if w.w_after.shape[1]:
        a1 = wrapped(decay(a1, w.syn_after) + state.s1 * w.w_after[:, 0], 23)
    v1 = membrane(state.v1, state.s1, u1 + a1, w.mem1)
    v0 = membrane(state.v0, state.s0, _straight(u0, _bias(u0)) if quantised else u0, w.mem0)
    s0, s1 = (superspike((v / STATE_ONE if quantised else v) - THRESHOLD) for v in (v0, v1))
    return NetworkState(u0, v0, s0, u1, v1, s1, s1 if recurrent_delay == 1 else state.s1, a1, u2, v2)


def states(
    x: Tensor,
    weights: Weights[Tensor],
    quantised: bool = False,
    recurrent_delay: int = 1,
    state: NetworkState[Tensor] | None = None,
) -> list[NetworkState[Tensor]]:
    """State after each step of a sequence.

    Args:
        x: Scaled input, shape (n, T, inputs).
        weights: Parameters in units of 1.0 (for the quantised network on the chip's grid).
        quantised: Round as the chip does.
        recurrent_delay: 1 or 2 steps.
        state: State before the first step; None: at rest.
    """
    one = STATE_ONE if quantised else 1.0
    w = Weights(*(matrix * one for matrix in weights[: len(MATRICES)]), *weights[len(MATRICES) :])
    state, every = rest(len(x), w) if state is None else state, []
    for sample in x.unbind(1):
        state = step(sample, w, state, quantised, recurrent_delay)
        every.append(state)
    return every


def forward(
    x: Tensor, weights: Weights[Tensor], quantised: bool = False, recurrent_delay: int = 1
) -> tuple[Tensor, Tensor, Tensor]:
    """Run the network from rest; arguments as those of `states`.

    Returns:
        Output potentials (n, T, outputs), spikes of the encoding (n, T, h0) and hidden layer (n, T, h1).
    """
    every = states(x, weights, quantised, recurrent_delay)
    one = STATE_ONE if quantised else 1.0
    v2, s0, s1 = (torch.stack([getattr(each, name) for each in every], 1) for name in ("v2", "s0", "s1"))
    return v2 / one, s0, s1


def _straight(value: Tensor, rounded: Tensor) -> Tensor:
    """`rounded` forward, the gradient of `value` backward."""
    return value + (rounded - value).detach()


def _wrap(value: Tensor, bits: int) -> Tensor:
    half = 2.0**bits
    return torch.remainder(value + half, 2 * half) - half


def _bias(current: Tensor) -> Tensor:
    return torch.clamp(torch.trunc(current / BIAS_STEP), -MANT_MAX, MANT_MAX) * BIAS_STEP
