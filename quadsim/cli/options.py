"""Options that several verbs share, and how their values are read and said."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from scenarios.runner import Results

Initial = Literal["unknown", "known"]
Search = Literal["swarm", "evolution"]
Criterion = Literal["contribution", "activity", "magnitude", "random"]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per CPU when left out.")]
Preset = Annotated[
    str,
    typer.Option(help="paper: its recipe; best: the one to use; robust: rough sensors; tune: logs."),
]
Fields = Annotated[
    list[str] | None,
    typer.Option("--set", help="Any other field of the training, as name=value; an unknown one lists them."),
]
Rate = Annotated[float, typer.Option(min=50, max=2000, help="Samples per second.")]


def headline(path: Path, results: Results) -> str:
    """Where the report is, and what its verdict says."""
    from scenarios.pairs import paired_differences
    from scenarios.verdict import verdict

    found = verdict(results.rows, pairs=paired_differences(results.flights))
    return f"{path}: {found.headline}\n{found.doubt}".rstrip()


def time_left(seconds: float, done: int, total: int) -> str:
    """How long the rest takes at the pace so far, at most: "12 min"."""
    left = seconds / done * (total - done)
    if left < 100:
        return f"{left:.0f} s"
    return f"{left / 60:.0f} min" if left < 6000 else f"{left / 3600:.1f} h"


def fields_of(texts: Sequence[str] | None, *options: str) -> dict[str, object]:
    """The settings given by --set; what has an option of its own, or follows from others, is refused."""
    fields = dict(map(pair_of, texts or []))
    for name in options:
        if name in fields:
            raise ValueError(f"--set {name}: it has an option of its own, or follows from the others")
    return fields


def pair_of(text: str) -> tuple[str, object]:
    """A setting given as name=value; the value is read as TOML, or as it stands."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"--set takes name=value, not {text!r}")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        if value.strip()[:1] in ("(", "[", "{"):
            raise ValueError(
                f"--set {name}: cannot read {value}; lists are [1, 2], tables {{a = 1}}"
            ) from None
        return name, value
