"""The command `list`: shipped names, and the user's own TOML files."""

import re
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ..runs.console import output, say
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

    Your own TOML files are listed too, if they are in a folder of the working directory named after the
    kind, such as scenarios/.

    Example: quadsim list scenarios
    """
    table = Table("name", "what it is", box=None, pad_edge=False)
    for row in _rows(kind):
        table.add_row(*row)
    output.print(table)
    say(f"Use: {HOW[kind]}", "dim")


def _rows(kind: Kind) -> Iterable[tuple[str, str]]:
    """Names of a kind and what they are, shipped ones first; of the user's own, the path."""
    match kind:
        case Kind.ESTIMATORS:
            from estimators.registry import SHIPPED

            return [(name, each.description) for name, each in SHIPPED.items()]
        case Kind.CONTROLLERS:
            from estimators.networks.weights_file import shipped_controllers

            return [("cascaded", CASCADED), *_weights(shipped_controllers())]
        case Kind.WEIGHTS:
            from estimators.networks.weights_file import shipped_controllers, shipped_names

            return _weights([*shipped_names(), *shipped_controllers()])
    from ..config.toml import preset_names, shipped_folder

    root = shipped_folder(kind)
    files = {name: root / f"{name}.toml" for name in preset_names(kind)}
    own = [path for path in Path(kind).glob("*.toml") if path.resolve().parent != root.resolve()]
    files |= {path.as_posix(): path for path in sorted(own)}
    return [(name, summary(file)) for name, file in files.items()]


def _weights(names: Iterable[str]) -> list[tuple[str, str]]:
    """Weights, with the first sentence of their card after its title."""
    cards = {card.stem: card.read_text("utf-8") for card in ASSETS.glob("*/*.md")}
    return [(name, first_sentence(" ".join(cards[name].split("\n\n")[1].split()))) for name in names]


def summary(file: Path) -> str:
    """Description of a TOML file: its key `description` or `source`, or else its first comment."""
    from ..config.toml import read_toml

    try:
        text = file.read_text(encoding="utf-8")
        data = read_toml(text, file.name)
    except (OSError, ValueError) as error:
        return f"cannot be read: {error}"
    for key in ("description", "source"):
        if isinstance(data.get(key), str):
            return data[key]
    head = re.match(r"(?:#.*\n)*", text)
    return first_sentence(" ".join(line.strip("# ") for line in head[0].splitlines()) if head else "")


def first_sentence(text: str) -> str:
    """The first sentence of a text."""
    return re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0]
