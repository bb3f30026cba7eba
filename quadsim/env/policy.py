"""Policies: small networks from observations to actions, stored as safetensors files."""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, JsonValue, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..config.ranges import Between, SampleRate
from ..config.toml import Strict, describe, nearest, shipped_folder
from ..control.records import Level
from ..runs.files import write_whole
from .spaces import OBSERVATION_LIMIT

Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Weights (outputs, inputs) and biases (outputs,)."""
END = ".safetensors"


class PolicySpec(Strict):
    """The environment that a policy was trained in.

    Raises:
        ValueError: A field has an invalid value.
    """

    level: Level
    """Level at which the actions enter the controller."""
    estimator: str | None = None
    """Estimator of roll and pitch; None for the true attitude."""
    rate_hz: SampleRate = 200.0
    """Samples per second."""
    repeat: Annotated[int, Between(1, 10_000)] = 1
    """Number of samples for which an action is held."""
    training: dict[str, JsonValue] = Field(default_factory=dict)
    """Description of the training."""

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise ValueError(describe(error, PolicySpec)) from error


class Policy:
    """A network with tanh layers and a linear output.

    `spec` describes the environment that it was trained in.
    """

    def __init__(self, spec: PolicySpec, layers: Sequence[Layer]) -> None:
        self.spec, self.layers = spec, tuple(layers)
        sizes = [OBSERVATION_LIMIT.size, *(len(bias) for _, bias in self.layers)]
        for (weight, bias), (inputs, outputs) in zip(self.layers, pairwise(sizes), strict=True):
            if weight.shape != (outputs, inputs) or bias.shape != (outputs,):
                raise ValueError(f"a layer has weights {weight.shape}; they must be {(outputs, inputs)}")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError("a weight is not a finite number")
        if not self.layers:
            raise ValueError("the policy has no layers")

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return actions (..., numbers) from −1 to 1 for observations (..., 17) of `QuadrotorEnv`."""
        x = np.asarray(observation, np.float32)
        if x.shape[-1:] != OBSERVATION_LIMIT.shape:
            raise ValueError(
                f"an observation has shape {x.shape}; it must be (..., {OBSERVATION_LIMIT.size})"
            )
        *hidden, (weight, bias) = self.layers
        for each, offset in hidden:
            x = np.tanh(x @ each.T + offset)
        return np.clip(x @ weight.T + bias, -1.0, 1.0)


def policy_names() -> list[str]:
    """Return the names of the policies that ship, sorted."""
    return sorted(item.stem for item in shipped_folder("policies").glob(f"*{END}"))


def load_policy(source: str | Path) -> Policy:
    """Read a policy: a shipped name ("hover", …) or the path of a file that `save_policy` wrote.

    Raises:
        ValueError: The policy does not exist, or the file does not contain a policy.
    """
    path = Path(source)
    if str(source) in policy_names():
        path = shipped_folder("policies") / f"{source}{END}"
    elif not path.is_file():
        raise ValueError(f'unknown policy "{source}"; {nearest(str(source), policy_names())}, or a path')
    try:
        with safe_open(path, framework="numpy") as file:
            if "policy" not in (about := file.metadata() or {}):
                raise ValueError("it holds other weights")
            spec = PolicySpec(**json.loads(about["policy"]))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
        numbers = range(len(tensors) // 2)
        return Policy(spec, [(tensors[f"weight_{k}"], tensors[f"bias_{k}"]) for k in numbers])
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a policy ({error})") from error


def save_policy(path: str | Path, policy: Policy) -> Path:
    """Write a policy to a file that `load_policy` can read."""
    tensors = {}
    for k, (weight, bias) in enumerate(policy.layers):
        tensors |= {f"weight_{k}": np.ascontiguousarray(weight), f"bias_{k}": np.ascontiguousarray(bias)}
    return write_whole(path, save(tensors, metadata={"policy": policy.spec.model_dump_json()}))
