"""Stages that generate flights, and the distributions of their signals."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.trajectory.specs import Trajectory

from ..stages import FLIGHTS, Numbers

DOMAINS = {"sim": "paper", "real": "paper-px4"}
"""Names of the domains, and their recipes."""


def generate_flights(
    folder: Path, *, domain: str, trajectory: dict[str, Any] | None = None, **settings: Any
) -> None:
    """Generate flights of a domain, optionally on another trajectory; `settings` are those of `generate`."""
    config: Recipe = load_recipe(DOMAINS[domain])
    if trajectory:
        flown = TypeAdapter(Trajectory).validate_json(json.dumps(trajectory))
        config = config.model_copy(update={"trajectory": flown})
    generate(config, out=folder / FLIGHTS, workers=1, **settings)


def distributions(folder: Path, *, flights: Sequence[Path]) -> Numbers:
    """Draw the inputs and outputs of every domain (Fig. 3)."""
    for path in flights:
        plot(path / FLIGHTS, folder / f"{path.name}.png")
    return {}
