"""Weights of controllers: those of a network, and what it reads beside the set-points."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

from pydantic import ValidationError
from safetensors import safe_open

from quadsim.config.toml import Strict, describe
from quadsim.runs.files import write_whole
from quadsim.runs.fingerprint import ASSETS

from ..networks.weights_file import (
    END,
    NetworkConfig,
    Tensors,
    load_network,
    save_network,
    shipped_controllers,
)

Reads = Literal["imu", "attitude"]
"""Gyroscope and accelerometer; or gyroscope and an estimate of roll and pitch."""
KEY = "controller"
"""Of `ControllerInputs` in a file's metadata."""


class ControllerInputs(Strict):
    """What a controller reads beside the set-points."""

    reads: Reads = "imu"
    """"attitude": the network has the direction of gravity that roll and pitch stand for, as a specific
    force, where others have the accelerometer's."""


class ControllerWeights(NamedTuple):
    """A controller as its file holds it."""

    config: NetworkConfig
    tensors: Tensors
    reads: Reads


def save_controller(path: str | Path, weights: ControllerWeights) -> None:
    """Write a controller: a file of `save_network` with one more entry in its metadata.

    Raises:
        ValueError: Tensors that do not fit the configuration.
    """
    if weights.reads == "imu":
        save_network(path, weights.config, weights.tensors)
        return
    with TemporaryDirectory() as folder:
        save_network(plain := Path(folder) / f"plain{END}", weights.config, weights.tensors)
        content = plain.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    header["__metadata__"][KEY] = ControllerInputs(reads=weights.reads).model_dump_json()
    text = json.dumps(header, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    text = text.ljust(-(-len(text) // 8) * 8)  # the format's alignment
    write_whole(path, len(text).to_bytes(8, "little") + text + content[8 + size :])


def load_controller(path: str | Path) -> ControllerWeights:
    """Read a controller, by its file or by the name under which it ships.

    Raises:
        FileNotFoundError: No such file.
        ValueError: One line: not such a file, or an attitude estimator's weights.
    """
    config, tensors = load_network(path)
    if not config.controls:
        ships = ", ".join(shipped_controllers()) or "none"
        raise ValueError(f"{path}: an attitude estimator, not a controller; controllers that ship: {ships}")
    ships = str(path) in shipped_controllers()
    file = ASSETS / "weights" / f"{path}{END}" if ships else Path(path)
    return ControllerWeights(config, tensors, _reads(file))


def _reads(file: Path) -> Reads:
    with safe_open(file, framework="numpy") as opened:
        text = (opened.metadata() or {}).get(KEY, "{}")
    try:
        return ControllerInputs.model_validate_json(text).reads
    except ValidationError as error:
        wrong = describe(error, ControllerInputs)
        raise ValueError(f"{file}: weights of another version of quadsim: {wrong}") from error
