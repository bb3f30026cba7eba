"""The command `list`: shipped names, each with a description."""

import itertools
import re
import tomllib
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ..runs.console import output as console
from ..runs.fingerprint import ASSETS


class Kind(StrEnum):
    """Kinds of names that can be listed."""

    SCENARIOS = "scenarios"
    ESTIMATORS = "estimators"
    CONTROLLERS = "controllers"
    VEHICLES = "vehicles"
    IMUS = "imus"
    EXTERNALS = "externals"
    RECIPES = "recipes"
    PRESETS = "presets"
    TUNING = "tuning"
    WEIGHTS = "weights"


HOW = {
    Kind.SCENARIOS: "quadsim fly NAME; quadsim bench --scenario NAME",
    Kind.ESTIMATORS: "--estimator NAME; also weights, or your own: file.py:Class, module:Class",
    Kind.CONTROLLERS: "--controller NAME; also weights, or your own: file.py:make, module:make",
    Kind.VEHICLES: "--set vehicle=NAME, or a TOML file; quadsim evaluate --vehicle NAME",
    Kind.IMUS: "--set imu=NAME, or a TOML file",
    Kind.EXTERNALS: "quadsim bench --set external=NAME, or a TOML file",
    Kind.RECIPES: "quadsim generate --recipe NAME, or a TOML file",
    Kind.PRESETS: "quadsim train --preset NAME, or a TOML file",
    Kind.TUNING: "--set tuning=NAME, or a file written by quadsim tune; quadsim evaluate --tuning NAME",
    Kind.WEIGHTS: "--estimator NAME; quadsim report NAME; quadsim export NAME",
}
"""Commands and options that accept a name."""


CASCADED = "Attitude and body rate in cascade; gains designed for phase margins."


def list_names(
    kind: Annotated[
        Kind, typer.Argument(metavar="KIND", help=f"What to list: {', '.join(Kind)}.", show_choices=False)
    ],
) -> None:
    """List the names of scenarios, estimators, vehicles and so on, each with a description.

    Example: quadsim list scenarios
    """
    table = Table("name", "what it is", box=None, pad_edge=False)
    for name, description in descriptions(kind).items():
        table.add_row(name, description)
    console.print(table)
    console.print(f"Use: {HOW[kind]}", style="dim", markup=False, highlight=False)


def descriptions(kind: Kind) -> dict[str, str]:
    """Shipped names of a kind, and what each is."""
    from estimators.networks.weights_file import shipped_controllers, shipped_names
    from estimators.registry import SHIPPED

    from ..config.toml import preset_names, shipped_folder

    match kind:
        case Kind.ESTIMATORS:
            return {name: each.description for name, each in SHIPPED.items()}
        case Kind.CONTROLLERS:
            return {"cascaded": CASCADED} | _weights(shipped_controllers())
        case Kind.WEIGHTS:
            return _weights([*shipped_names(), *shipped_controllers()])
        case _:
            return {name: _summary(shipped_folder(kind) / f"{name}.toml") for name in preset_names(kind)}


def _weights(names: Iterable[str]) -> dict[str, str]:
    """First sentence of the model card of each, after its title."""
    cards = {card.stem: card.read_text("utf-8") for card in ASSETS.glob("*/*.md")}
    return {name: _first_sentence(cards[name].split("\n\n")[1]) for name in names}


def _summary(file: Path) -> str:
    """Description of a TOML file: its key `description` or `source`, or else its first comment."""
    text = file.read_text(encoding="utf-8")
    data = tomllib.loads(text)
    for key in ("description", "source"):
        if isinstance(data.get(key), str):
            return data[key]
    comments = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    return _first_sentence(" ".join(line.strip("# ") for line in comments))


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[.!?])\s", " ".join(text.split()), maxsplit=1)[0]
