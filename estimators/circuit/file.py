"""Files of circuits: safetensors with parameters in floats, from which the chip's integers are derived."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, JsonValue
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from quadsim.config.ranges import Between
from quadsim.config.toml import Strict
from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS

from ..networks.weights_file import CIRCUIT, END, Shapes, Tensors, check_shapes, ordered, read_tensors
from .parameters import Parameters, circuit_shapes

FILE = ASSETS / "weights" / f"att-snn{END}"
SHIPPED: dict[str, Path] = dict.fromkeys(("att-snn", "att-snn-loihi", "att-rnn"), FILE)
"""Names and files of shipped circuits."""


class CircuitConfig(Strict):
    """Metadata of a circuit's file."""

    vectors: Annotated[int, Between(4, 64)]
    """Number of rotating vectors."""
    gates: Annotated[int, Between(8, 256)]
    """Number of gated innovations."""
    steps_per_sample: Literal[1, 2, 4] = 4
    """Steps of the chip for each IMU sample."""
    training: dict[str, JsonValue] = Field(default_factory=dict)
    """Training: data, seed, updates, commit, validation error."""


class CircuitFile(NamedTuple):
    """Content of a circuit's file."""

    config: CircuitConfig
    parameters: Parameters


def save_circuit(path: str | Path, config: CircuitConfig, p: Parameters) -> None:
    """Write a circuit.

    Raises:
        ValueError: The parameters do not fit the configuration or are not finite.
    """
    shapes = {name: value.shape for name, value in p._asdict().items()}
    check_shapes(path, shapes, *_shapes(config, shapes))
    _check(path, config, p._asdict())
    tensors = {name: np.ascontiguousarray(value) for name, value in p._asdict().items()}
    metadata = {"format": CIRCUIT, "config": config.model_dump_json()}
    write_whole(path, ordered(save(tensors, metadata=metadata)))


def is_circuit(path: str | Path) -> bool:
    """Return whether a file or a shipped name refers to a circuit and not to a network of layers."""
    file = _place(path)
    if not file.is_file():
        return False
    try:
        with safe_open(file, framework="numpy") as content:
            return (content.metadata() or {}).get("format") == CIRCUIT
    except SafetensorError:
        return False


def load_circuit(path: str | Path) -> CircuitFile:
    """Read a circuit written by `save_circuit`.

    Args:
        path: The file, or "att-snn" for the shipped circuit.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a circuit, or a tensor has the wrong shape or type.
    """
    file = _place(path)
    if not file.is_file():
        raise FileNotFoundError(f"{path}: no such file of a circuit; the one that ships is att-snn")
    config, tensors = read_tensors(file, CircuitConfig, CIRCUIT, _shapes)
    _check(path, config, tensors)
    return CircuitFile(config, Parameters(**tensors))


def _place(path: str | Path) -> Path:
    return SHIPPED.get(str(path), Path(path))


LARGEST = 1e4
"""Upper bound for the magnitude of a circuit's parameters."""


def _shapes(config: CircuitConfig, found: Shapes) -> tuple[Shapes, Shapes]:
    return circuit_shapes(config.vectors, config.gates, found.get("pairs", (0,))[0]), {}


def _check(path: str | Path, config: CircuitConfig, tensors: Tensors) -> None:
    for name, value in tensors.items():
        if value.dtype != (np.int64 if name == "pairs" else np.float64):
            raise ValueError(f"{path}: tensor {name} is {value.dtype}")
        if not (np.abs(value) <= LARGEST).all():
            raise ValueError(f"{path}: tensor {name} has values that are not finite, or beyond {LARGEST:g}")
    limits = np.array([config.vectors, config.gates])
    if np.any(tensors["pairs"] < 0) or np.any(tensors["pairs"] >= limits):
        raise ValueError(f"{path}: pairs name a vector or a gate that is not there")
    if np.any(tensors["tau"] <= 0) or np.any(tensors["scale"] <= 0):
        raise ValueError(f"{path}: tau and scale should be above 0")
