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
    "estimators": "--estimator NAME; also weights, or your own: file.py:Class, module:Class",
    "controllers": "--controller NAME; also weights, or your own: file.py:make, module:make",
    "vehicles": "--set vehicle=NAME, or a TOML file",
    "imus": "--set imu=NAME, or a TOML file",
    "externals": "quadsim bench --set external=NAME, or a TOML file",
    "recipes": "quadsim generate --recipe NAME, or a TOML file",
    "presets": "quadsim train --preset NAME, or a TOML file",
    "tasks": "quadsim bench --task NAME, or a TOML file",
    "tuning": "--set tuning=NAME, or a file written by quadsim tune",
    "weights": "--estimator NAME; quadsim report NAME; quadsim export NAME",
}
"""Kinds of names that can be listed, and the commands and options that accept a name."""


def list_names(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"What to list: {', '.join(HOW)}.")],
) -> None:
    """List the names of scenarios, estimators, vehicles and so on, each with a description.

    The list also includes your own TOML files in a folder of the working directory that is named after the
    kind, such as scenarios/.

    Example: quadsim list scenarios
    """
    from ..config.toml import nearest

    if kind not in HOW:
        raise ValueError(f'unknown kind "{kind}"; {nearest(kind, HOW)}')
    table = Table("name", "description", box=None, pad_edge=False)
    for row in _rows(kind):
        table.add_row(*row)
    output.print(table)
    say(f"Use: {HOW[kind]}", "dim")


def _rows(kind: str) -> Iterable[tuple[str, str]]:
    """Names of a kind and what they are, shipped ones first; of the user's own, the path."""
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
