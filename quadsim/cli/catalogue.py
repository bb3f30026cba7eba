"""The verb `list`: what ships, and the user's own scenarios."""

import re
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.table import Table

from ..config.toml import preset_names, read_toml, shipped_folder
from ..runs.console import output as console
from ..runs.fingerprint import ASSETS


class Kind(StrEnum):
    """What can be listed."""

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
    Kind.VEHICLES: "--vehicle NAME, or a TOML file",
    Kind.IMUS: "--imu NAME, or a TOML file",
    Kind.EXTERNALS: "quadsim bench --set external=NAME, or a TOML file",
    Kind.RECIPES: "quadsim generate --recipe NAME, or a TOML file",
    Kind.PRESETS: "quadsim train --preset NAME, or a TOML file",
    Kind.TUNING: "--tuning NAME, or a file of quadsim tune",
    Kind.WEIGHTS: "--estimator NAME; quadsim report NAME; quadsim export NAME",
}
"""Where a name is used."""


CASCADED = "Attitude and body rate in cascade, gains from phase margins."


class Item(NamedTuple):
    """A row of the list."""

    name: str
    description: str
    path: str = ""
    """Of a file of the user's."""


def list_names(
    kind: Annotated[
        Kind, typer.Argument(metavar="KIND", help=f"What to list: {', '.join(Kind)}.", show_choices=False)
    ],
) -> None:
    """List what ships by name, with a sentence on each: scenarios, estimators, vehicles and so on.

    TOML files of your own, in a folder named as the kind, for example scenarios/, are listed too.

    Example: quadsim list scenarios
    """
    table = Table("name", "what it is", box=None, pad_edge=False)
    for item in items(kind):
        table.add_row(item.path or item.name, item.description)
    console.print(table)
    console.print(f"Use: {HOW[kind]}", style="dim", markup=False, highlight=False)


def items(kind: Kind) -> list[Item]:
    """Everything of a kind, what ships first."""
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
    root = shipped_folder(kind)
    shipped = [Item(name, summary(root / f"{name}.toml")) for name in preset_names(kind)]
    own = sorted(path for path in Path(kind).glob("*.toml") if not _ships(path, root))
    return shipped + [Item(path.stem, summary(path), path.as_posix()) for path in own]


def _weights(names: Iterable[str]) -> list[Item]:
    cards = ASSETS / "weights"
    return [Item(name, card_summary((cards / f"{name}.md").read_text("utf-8"))) for name in names]


def summary(file: Path) -> str:
    """What a TOML file says of itself: its description or source, else the comment on top."""
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
    """First sentence of a card of weights, which follows its title."""
    return first_sentence(" ".join(text.split("\n\n")[1].split()))


def first_sentence(text: str) -> str:
    """A text up to its first full stop that ends a sentence."""
    return re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0]


def _ships(path: Path, root: Path) -> bool:
    """Whether a file is one of the presets themselves, seen from the repository's root."""
    return path.resolve().parent == root.resolve()
