"""The command `list`: shipped names, and the user's own TOML files."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ..runs.console import output, say
from ..runs.fingerprint import ASSETS

HOW = {
    "scenarios": "quadsim fly NAME; quadsim bench --scenario NAME",
    "estimators": "--estimator NAME, a file of weights, or your own file.py:Class or module:Class",
    "controllers": "--controller NAME, a file of weights, or your own file.py:make or module:make",
    "vehicles": "--set vehicle=NAME or --set vehicle=FILE.toml",
    "imus": "--set imu=NAME or --set imu=FILE.toml",
    "externals": "quadsim bench --set external=NAME or --set external=FILE.toml",
    "recipes": "quadsim generate --recipe NAME or --recipe FILE.toml",
    "presets": "quadsim train --preset NAME or --preset FILE.toml",
    "tasks": "quadsim bench --task NAME or --task FILE.toml",
    "tuning": "--set tuning=NAME or --set tuning=FILE.toml, written by quadsim tune",
    "weights": "--estimator NAME; quadsim report NAME; quadsim export NAME",
}
"""Kinds of names that can be listed, and the commands and options that accept a name."""


def list_names(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"What to list: {', '.join(HOW)}.")],
) -> None:
    """List the available scenarios, estimators, vehicles and so on, each with a description.

    If the working directory has a folder with the name of the kind, such as scenarios/, the list also
    includes the TOML files in that folder.

    Example: quadsim list scenarios
    """
    from ..config.toml import nearest

    if kind not in HOW:
        raise ValueError(f'unknown kind "{kind}"; {nearest(kind, HOW)}')
    table = Table("name", "description", box=None, pad_edge=False)
    for row in _rows(kind):
        table.add_row(*row)
    output.print(table)
    say(f"How to use a name: {HOW[kind]}", "dim")


def _rows(kind: str) -> Iterable[tuple[str, str]]:
    """Return names and descriptions of a kind: first shipped names, then paths of the user's files."""
    from estimators.networks.weights_file import shipped_controllers, shipped_names
    from estimators.registry import SHIPPED

    from ..config.toml import preset_names, shipped_folder

    if kind == "estimators":
        return [(name, each.description) for name, each in SHIPPED.items()]
    if kind == "controllers":
        from estimators.control.controller import BUILT_IN

        built_in = [(name, description) for name, (description, _) in BUILT_IN.items()]
        return [*built_in, *_weights(shipped_controllers())]
    if kind == "weights":
        return _weights([*shipped_names(), *shipped_controllers()])
    root = shipped_folder(kind)
    files = {name: root / f"{name}.toml" for name in preset_names(kind)}
    own = [path for path in Path(kind).glob("*.toml") if path.resolve().parent != root.resolve()]
    files |= {path.as_posix(): path for path in sorted(own)}
    return [(name, summary(file)) for name, file in files.items()]


def _weights(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return names of weights, each with the first sentence of its model card."""
    cards = {card.stem: card.read_text("utf-8") for card in ASSETS.glob("*/*.md")}
    return [(name, first_sentence(" ".join(cards[name].split("\n\n")[1].split()))) for name in names]


def summary(file: Path) -> str:
    """Return the description of a TOML file: its key `description` or `source`, or else its first comment."""
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
    """Return the first sentence of a text."""
    return re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0]
