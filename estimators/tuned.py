"""Tuned parameters: TOML files, one a domain (vehicle and IMU), with one table per estimator."""

import json
from pathlib import Path

from pydantic import Field, RootModel

from quadsim.config import Strict, load_toml, preset_names

DEFAULT_DOMAIN = "hummingbird-adis16448"
"""Domain whose shipped parameters an estimator has unless told otherwise."""


class Tuned(Strict):
    """Parameters of one estimator, and how they were found."""

    command: str = Field(description="What made this table.")
    rate_hz: float = Field(gt=0, description="Sample rate of the data [Hz].")
    rmse_deg: float = Field(
        ge=0, description="Root of the cost: of the mean squared error of roll and pitch [deg]."
    )
    evaluations: int = Field(ge=0, description="Parameter sets tried.")
    values: dict[str, float] = Field(description="The parameters.")


class Tuning(RootModel[dict[str, Tuned]]):
    """A whole file: estimator name to its table."""


def load_tuning(source: str | Path) -> dict[str, Tuned]:
    """Tuned parameters of every estimator in a shipped domain or a file.

    Raises:
        ValueError: One line that says what is wrong with the file.
    """
    return load_toml(source, "tuning", Tuning).root


def tuned_for(name: str, source: str | Path | None) -> Tuned | None:
    """Table of one estimator; None where there is none and no file was asked for by name.

    Args:
        name: Estimator.
        source: Domain, path of a TOML file, or None for the default domain.

    Raises:
        ValueError: A file was asked for and does not have the estimator, or cannot be read.
    """
    if source is None:
        return load_tuning(DEFAULT_DOMAIN).get(name) if DEFAULT_DOMAIN in preset_names("tuning") else None
    tables = load_tuning(source)
    if name not in tables:
        raise ValueError(f"{source}: no table [{name}]; it has {', '.join(tables) or 'none'}")
    return tables[name]


def to_toml(tables: dict[str, Tuned], comment: str) -> str:
    """Text of a tuning file, with a comment on top."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    for name, table in tables.items():
        lines += ["", f"[{name}]", f"command = {json.dumps(table.command)}"]
        lines += [f"{key} = {getattr(table, key)!r}" for key in ("rate_hz", "rmse_deg", "evaluations")]
        lines += [f"[{name}.values]", *(f"{key} = {value!r}" for key, value in table.values.items())]
    return "\n".join(lines) + "\n"
