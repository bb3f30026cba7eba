"""What training minimises, and when it stops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import huber_loss


def attitude_loss(estimate: Tensor, target: Tensor, huber_threshold: float = 0.0) -> Tensor:
    """Mean square error over roll and pitch [rad²]; both (n, T, 2).

    Where the norm of both errors exceeds `huber_threshold` [rad], the loss is linear in it (Huber, "Robust
    estimation of a location parameter", Annals of Mathematical Statistics 35, 1964); 0: nowhere.
    """
    error = estimate - target
    if huber_threshold == 0.0:
        return error.square().mean()
    size = torch.linalg.vector_norm(error, dim=-1)
    return huber_loss(size, torch.zeros_like(size), delta=huber_threshold)


def rate_cost(rates: Tensor, targets: Tensor) -> Tensor:
    """How far the layers' spike rates lie above their targets, summed; both (2,)."""
    return (rates - targets).clamp(min=0.0).sum()


def finished(losses: Sequence[float], window: int = 20, rise: float = 1.1, patience: int = 50) -> str | None:
    """Whether a run of validation losses has ended, as in the paper.

    Args:
        losses: One for each epoch so far.
        window: Epochs in the moving average.
        rise: The moving average may exceed its lowest by this factor.
        patience: Epochs that the lowest loss may be old.

    Returns:
        The reason to stop, or None.
    """
    if not losses:
        return None
    if len(losses) - 1 - int(np.argmin(losses)) >= patience:
        return f"the lowest validation loss is {patience} epochs old"
    if len(losses) > window:
        average = np.convolve(losses, np.full(window, 1 / window), mode="valid")
        if average[-1] > rise * average.min():
            return f"the {window}-epoch average is above {rise:g} times its lowest"
    return None
