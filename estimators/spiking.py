"""The surrogate gradient of a spike for PyTorch, the same as in `training.window_kernels`."""

import torch
from torch import Tensor

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
    """Compute a Heaviside step with the surrogate gradient 1 / (1 + 20 |x|)² (Zenke & Ganguli 2018).

    Args:
        x: Membrane potential minus threshold, any shape.

    Returns:
        1 where x > 0, else 0.
    """
    return _SuperSpike.apply(x)  # pyright: ignore[reportReturnType]  (torch types apply as Any | None)
