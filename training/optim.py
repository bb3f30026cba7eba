"""Loss, stopping rules and optimiser: Adam in Lookahead (Zhang, Lucas, Hinton & Ba 2019)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import huber_loss
from torch.optim import Optimizer

from estimators.networks.layer_parameters import MATRICES, NEURON_CONSTANTS, PARAMETERS

from .config import TrainConfig, TrainingRecipe

LOOKAHEAD_K, LOOKAHEAD_ALPHA = 6, 0.5
"""Number k of fast steps per slow step, and size α of the slow step, as in the paper."""


class Lookahead:
    """Lookahead optimiser: after every k steps of the fast weights, slow += α (fast - slow) and fast = slow.

    Args:
        optimizer: Optimiser of the fast weights, which are the parameters of the model.
    """

    def __init__(self, optimizer: Optimizer) -> None:
        self.optimizer = optimizer
        self.steps = 0
        self.slow = [p.detach().clone() for p in self._fast()]

    @property
    def param_groups(self) -> list[dict[str, Any]]:
        """Parameter groups of the fast optimiser, which contain the learning rates."""
        return self.optimizer.param_groups

    def _fast(self) -> list[torch.Tensor]:
        return [p for group in self.optimizer.param_groups for p in group["params"]]

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Clear the gradients."""
        self.optimizer.zero_grad(set_to_none)

    @torch.no_grad()
    def step(self) -> None:
        """Run one step of the fast weights and, after every k steps, one of the slow weights."""
        self.optimizer.step()
        self.steps += 1
        if self.steps % LOOKAHEAD_K == 0:
            for slow, fast in zip(self.slow, self._fast(), strict=True):
                slow += LOOKAHEAD_ALPHA * (fast - slow)
                fast.copy_(slow)

    @contextmanager
    def evaluated(self) -> Iterator[None]:
        """Set the parameters to the slow weights within this context, for evaluation and saving."""
        fast = [p.detach().clone() for p in self._fast()]
        with torch.no_grad():
            for parameter, slow in zip(self._fast(), self.slow, strict=True):
                parameter.copy_(slow)
        try:
            yield
        finally:
            with torch.no_grad():
                for parameter, value in zip(self._fast(), fast, strict=True):
                    parameter.copy_(value)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that a resumed run needs, including the state of the fast optimiser."""
        slow = [p.clone() for p in self.slow]
        return {"optimizer": self.optimizer.state_dict(), "slow": slow, "steps": self.steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from the result of `state_dict`."""
        self.optimizer.load_state_dict(state["optimizer"])
        self.slow = [p.clone() for p in state["slow"]]
        self.steps = state["steps"]


def new_optimiser(model: nn.Module, config: TrainingRecipe) -> Lookahead:
    """Make Adam in Lookahead; each parameter has a group with the factor `step` of its learning rate.

    The factors differ between layers, because the effect of a common change of many weights adds up over
    neurons.
    """
    layers: dict[str, float] = dict(
        zip(("encoding", "hidden", "outputs"), config.method.layer_steps, strict=True)
    )
    steps = {name: layers[PARAMETERS[name].layer] for name in MATRICES}
    for name, parameter in model.named_parameters():
        parameter.requires_grad_(not (config.fixed_taus and name in NEURON_CONSTANTS))
    groups = [{"params": [p], "step": steps.get(name, 1.0)} for name, p in model.named_parameters()]
    adam = torch.optim.Adam(groups, lr=config.optimiser_lr, betas=(0.9, config.method.adam_beta2))
    return Lookahead(adam)


def learning_rate(config: TrainingRecipe, update: int) -> float:
    """Return the learning rate of an update, counted from 0 over all epochs."""
    if not config.method.cosine:
        return config.optimiser_lr
    share = update / (config.epochs * config.batches)
    return config.optimiser_lr * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))


def total_cost(estimate: Tensor, target: Tensor, rates: Tensor, config: TrainConfig) -> Tensor:
    """Return the total loss, the weighted sum of all losses in the configuration [rad²].

    Args:
        estimate: Outputs, shape (n, T, 2) [rad], or scaled angular acceleration, shape (n, T, 3).
        target: Targets of the outputs.
        rates: Spikes per neuron and step of encoding and hidden layer, shape (2,).
        config: Configuration of the run.
    """
    excess = (rates - torch.tensor(config.rate_targets)).clamp(min=0.0).sum()
    return error_loss(estimate, target, config.huber_threshold) + config.rate_cost * excess


def error_loss(estimate: Tensor, target: Tensor, huber_threshold: float = 0.0) -> Tensor:
    """Return half the mean squared norm of an error (n, T, outputs) [rad²].

    If the norm of the error exceeds `huber_threshold` [rad], the loss is linear in the norm (Huber, "Robust
    estimation of a location parameter", Annals of Mathematical Statistics 35, 1964). A threshold of 0 means a
    quadratic loss everywhere.
    """
    error = estimate - target
    if huber_threshold == 0.0:
        return error.square().mean() * (error.shape[-1] / 2)
    size = torch.linalg.vector_norm(error, dim=-1)
    return huber_loss(size, torch.zeros_like(size), delta=huber_threshold)


def finished(losses: Sequence[float]) -> str | None:
    """Return the reason to stop by the paper's rules after these validation losses, one per epoch.

    The result is None if training continues.
    """
    if losses and len(losses) - 1 - int(np.argmin(losses)) >= 50:
        return "the lowest validation loss is 50 epochs old"
    if len(losses) > 20:
        average = np.convolve(losses, np.full(20, 1 / 20), mode="valid")
        if average[-1] > 1.1 * average.min():
            return "the 20-epoch average is above 1.1 times its lowest"
    return None
