"""The command `list`: shipped names, and the user's own TOML files."""

import re
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

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


class Item(NamedTuple):
    """A row of the list."""

    name: str
    description: str
    path: str = ""
    """Path of the user's own file; empty for a shipped name."""


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
    for item in items(kind):
        table.add_row(item.path or item.name, item.description)
    console.print(table)
    console.print(f"Use: {HOW[kind]}", style="dim", markup=False, highlight=False)


def items(kind: Kind) -> list[Item]:
    """All names of a kind, shipped ones first."""
    match kind:
        case Kind.ESTIMATORS:
            from estimators.registry import SHIPPED

            return [Item(name, each.description) for name, each in SHIPPED.items()]
        case Kind.CONTROLLERS:
            from estimators.networks.weights_file import shipped_controllers

            return [Item("cascaded", CASCADED), *_weights(shipped_controllers())]
        case Kind.WEIGHTS:
            from estimators.networks.weights_file import shipped_controllers, shipped_names

            return _weights([*shipped_names(), *shipped_controllers()])
    from ..config.toml import preset_names, shipped_folder

    root = shipped_folder(kind)
    shipped = [Item(name, summary(root / f"{name}.toml")) for name in preset_names(kind)]
    own = sorted(path for path in Path(kind).glob("*.toml") if not _ships(path, root))
    return shipped + [Item(path.stem, summary(path), path.as_posix()) for path in own]


def _weights(names: Iterable[str]) -> list[Item]:
    cards = {card.stem: card for card in ASSETS.glob("*/*.md")}
    return [Item(name, card_summary(cards[name].read_text("utf-8"))) for name in names]


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


def card_summary(text: str) -> str:
    """First sentence of a model card, after the title."""
    return first_sentence(" ".join(text.split("\n\n")[1].split()))


def first_sentence(text: str) -> str:
    """The first sentence of a text."""
    return re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0]


def _ships(path: Path, root: Path) -> bool:
    """Whether a file is a shipped one, found again from the repository's root."""
    return path.resolve().parent == root.resolve()
