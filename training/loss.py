"""What training minimises, and when it stops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import huber_loss

if TYPE_CHECKING:
    from .config import TrainConfig


def total_cost(estimate: Tensor, target: Tensor, rates: Tensor, config: TrainConfig) -> Tensor:
    """What an update minimises: the sum of all losses, each times its weight in the configuration [rad²].

    Args:
        estimate: Outputs, shape (n, T, 2) [rad], or up, or scaled angular acceleration, shape (n, T, 3).
        target: What they should be.
        rates: Spikes per neuron and step of the encoding and of the hidden layer, shape (2,).
        config: Of the run.
    """
    excess = (rates - torch.tensor(config.rate_targets)).clamp(min=0.0).sum()
    return error_loss(estimate, target, config.huber_threshold) + config.rate_cost * excess


def error_loss(estimate: Tensor, target: Tensor, huber_threshold: float = 0.0) -> Tensor:
    """Mean square error over roll and pitch [rad²]; both (n, T, 2), or up, (n, T, 3).

    The norm of a small error of up is that of roll and pitch together, and half its square their mean square.
    Where the norm of the error exceeds `huber_threshold` [rad], the loss is linear in it (Huber, "Robust
    estimation of a location parameter", Annals of Mathematical Statistics 35, 1964); 0: nowhere.
    """
    error = estimate - target
    if huber_threshold == 0.0:
        return error.square().mean() * (error.shape[-1] / 2)
    size = torch.linalg.vector_norm(error, dim=-1)
    return huber_loss(size, torch.zeros_like(size), delta=huber_threshold)


def finished(losses: Sequence[float]) -> str | None:
    """The paper's reason to stop after these validation losses, one for each epoch; None: there is none."""
    if losses and len(losses) - 1 - int(np.argmin(losses)) >= 50:
        return "the lowest validation loss is 50 epochs old"
    if len(losses) > 20:
        average = np.convolve(losses, np.full(20, 1 / 20), mode="valid")
        if average[-1] > 1.1 * average.min():
            return "the 20-epoch average is above 1.1 times its lowest"
    return None
