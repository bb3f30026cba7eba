"""Lookahead (Zhang, Lucas, Hinton & Ba 2019): k steps forward, one step back, around any optimiser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.optim import Optimizer


class Lookahead:
    """Slow weights follow the fast: every k steps slow += α (fast - slow), and fast starts there again.

    Args:
        optimizer: Moves the fast weights, which are the parameters themselves.
        k: Steps of the fast weights for one of the slow weights.
        alpha: How far the slow weights go, in (0, 1].

    Raises:
        ValueError: k or alpha out of range.
    """

    def __init__(self, optimizer: Optimizer, k: int = 6, alpha: float = 0.5) -> None:
        """Start with the slow weights where the fast ones are."""
        if k < 1:
            raise ValueError(f"k: {k}, should be at least 1")
        if not 0.0 < alpha <= 1.0:
            raise ValueError(f"alpha: {alpha}, should be in (0, 1]")
        self.optimizer, self.k, self.alpha = optimizer, k, alpha
        self.steps = 0
        self.slow = [p.detach().clone() for p in self._fast()]

    @property
    def param_groups(self) -> list[dict[str, Any]]:
        """Those of the fast optimiser, where learning rates are set."""
        return self.optimizer.param_groups

    def _fast(self) -> list[torch.Tensor]:
        return [p for group in self.optimizer.param_groups for p in group["params"]]

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Clear the gradients."""
        self.optimizer.zero_grad(set_to_none)

    @torch.no_grad()
    def step(self) -> None:
        """One step of the fast weights and, every k, one of the slow."""
        self.optimizer.step()
        self.steps += 1
        if self.steps % self.k == 0:
            for slow, fast in zip(self.slow, self._fast(), strict=True):
                slow += self.alpha * (fast - slow)
                fast.copy_(slow)

    @torch.no_grad()
    def restart(self) -> None:
        """Let the slow weights be where the fast ones are, after these were changed by hand."""
        for slow, fast in zip(self.slow, self._fast(), strict=True):
            slow.copy_(fast)

    @contextmanager
    def evaluated(self) -> Iterator[None]:
        """Within this context the parameters are the slow weights, the ones to evaluate and to keep."""
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
        """Everything that a resumed run needs, the fast optimiser's state included."""
        return {
            "optimizer": self.optimizer.state_dict(),
            "slow": [p.clone() for p in self.slow],
            "steps": self.steps,
            "k": self.k,
            "alpha": self.alpha,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state that `state_dict` gave."""
        self.optimizer.load_state_dict(state["optimizer"])
        self.slow = [p.clone() for p in state["slow"]]
        self.steps, self.k, self.alpha = state["steps"], state["k"], state["alpha"]


def changed(state: dict[str, Any], change: Callable[[int, torch.Tensor], torch.Tensor]) -> dict[str, Any]:
    """A state of Lookahead around Adam for parameters of other shapes.

    Args:
        state: What `Lookahead.state_dict` gave.
        change: From the number of a parameter and something of its shape to the same of its new shape.
    """
    inner = state["optimizer"]
    moments = {
        k: {name: v.clone() if name == "step" else change(k, v) for name, v in of_parameter.items()}
        for k, of_parameter in inner["state"].items()
    }
    slow = [change(k, value) for k, value in enumerate(state["slow"])]
    return state | {"optimizer": inner | {"state": moments}, "slow": slow}
