"""What can be chosen about a training of the circuit."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import ValidationError

from estimators.circuit.file import load_circuit
from quadsim.config.ranges import Between, Share
from quadsim.config.toml import Strict, describe, load_toml, merged, preset_names, shipped_folder
from quadsim.held_out import unreserved

from ..augment import Augmentation
from ..config import TrainingRecipe

Number = Annotated[int, Between(1, 10_000_000)]


class CircuitTraining(Strict):
    """How a circuit is trained; the recipe that ships is `assets/presets/att-snn.toml`."""

    vectors: Annotated[int, Between(4, 64)] = 6
    """Vectors that turn."""
    gates: Annotated[int, Between(8, 256)] = 16
    """Gated innovations."""
    streams: Number = 1536
    """Streams that are drawn once, each with sensor errors of its own."""
    window_s: Annotated[float, Between(0.1, 600.0, "s")] = 40.0
    """Length of a stream, over which the gradient is exact [s]."""
    hand_share: Share = 0.4
    """Share of the streams that move in the hand, where there are both."""
    sway_share: Share = 0.7
    """Share of the streams in the hand to which translation is added."""
    calibrated_share: Share = 0.5
    """Share of the streams whose biases, scales and mounting are a tenth of those of the augmentation."""
    known_share: Share = 0.35
    """Share of the streams that begin with attitude and bias known, as the later parts of a flight do."""
    updates: Number = 6500
    """Updates of the weights."""
    batch_size: Annotated[int, Between(1, 1024)] = 16
    """Streams in an update."""
    learning_rate: Annotated[float, Between(1e-6, 1.0)] = 0.02
    """Of Adam, at its highest."""
    augmentation: Augmentation = Augmentation()
    """Sensor errors."""
    init: str = ""
    """Circuit to continue from, in place of the equation: a file or a shipped name; it has the vectors and
    the gates."""


class CircuitRun(CircuitTraining):
    """A training run: a recipe, its data and its seed."""

    data: tuple[str, ...]
    """Datasets to train on."""
    validation: tuple[str, ...] = ()
    """Datasets to report the error on; they choose nothing."""
    seed: Annotated[int, Between(0, 2**63 - 1)] = 0
    """Of the first weights, the streams and their order."""


def is_recipe(preset: str | Path) -> bool:
    """Whether a preset, one that ships or a TOML file, has keys that only circuits have."""
    shipped = str(preset) in preset_names("presets")
    file = shipped_folder("presets") / f"{preset}.toml" if shipped else Path(preset)
    try:
        keys = tomllib.loads(file.read_text("utf-8")).keys()
    except (OSError, ValueError):
        return False
    return not keys.isdisjoint(CircuitTraining.model_fields.keys() - TrainingRecipe.model_fields.keys())


def make_run(preset: str | Path = "att-snn", **choices: Any) -> CircuitRun:
    """A configuration from a preset and what differs from it.

    Raises:
        ValueError: One line: an unknown preset or field, or a value out of range.
    """
    loaded = load_toml(preset, "presets", CircuitTraining)
    try:
        run = CircuitRun.model_validate(merged(loaded.model_dump(), choices))
        if run.init:
            sizes = {name: getattr(load_circuit(run.init).config, name) for name in ("vectors", "gates")}
            run = run.model_copy(update=sizes)
    except ValidationError as error:
        raise ValueError(f"training: {describe(error, CircuitRun)}") from error
    unreserved(run.seed)
    if not run.data:
        raise ValueError("data: at least one dataset to train on is required, as quadsim generate makes it")
    return run
