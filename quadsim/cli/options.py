"""Options that several commands share, and functions that parse their values."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..config.toml import Model

Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]


def _unreserved(seed: int) -> int:
    from ..held_out import unreserved

    try:
        return unreserved(seed)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


LearningSeed = Annotated[
    int,
    typer.Option(min=0, callback=_unreserved, help="Seed of all random numbers. Held-out seeds are refused."),
]
Workers = Annotated[int | None, typer.Option(min=1, help="Number of worker processes; default: one per CPU.")]
ConditionFields = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Condition of the flights, as name=value. vehicle, imu, external (the sensor of position, "
        "velocity and yaw): a shipped name or a TOML file, in place of the scenario's. tuning: filter "
        "parameters, as a shipped name or a file from quadsim tune. engine: auto or mujoco. rate: samples "
        "per second. flight (only for fly): number of the first flight, as in flights.parquet of bench. "
        "Repeat the option to set several.",
    ),
]
Mount = Annotated[
    str | None,
    typer.Option(
        "--mount",
        help="For logs: rotation from IMU axes to body axes. Give the IMU axes along body x, y and z "
        "('z,-y,x'); roll, pitch and yaw of the IMU in degrees ('rpy 0 20 90'); a quaternion w x y z; or the "
        "nine elements of a matrix by rows. The true attitude is rotated only if it is the attitude of the "
        "IMU.",
    ),
]
Truth = Annotated[
    str | None,
    typer.Option(
        help="For logs: topic or folder of the true attitude. Default: the most accurate one in the log."
    ),
]
Imu = Annotated[
    str | None,
    typer.Option(
        help="For ROS bags and MCAP files: topic of the IMU. Default: the one with the most messages."
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="For logs: use a log even if its units or axes look wrong.")
]
Rerun = Annotated[
    Path | None,
    typer.Option(help="Write the first flight or log to this file (.rrd), for the viewer rerun."),
]
Mcap = Annotated[
    Path | None,
    typer.Option(help="Write the first flight or log to this MCAP file (.mcap), for the viewer Foxglove."),
]
Duration = Annotated[
    float | None, typer.Option(min=0.1, help="Length of each flight in seconds. Default: the scenario's.")
]
OWN_CONTROLLER = (
    "Attitude controller: cascaded, the weights of a spiking controller, or your own file.py:make. The "
    "function make is called with the sample rate and the vehicle. Any controller but cascaded replaces the "
    "attitude and body-rate loops of the cascade."
)


def settings_of(texts: Sequence[str] | None, model: type[Model]) -> Model:
    """Parse the settings given by --set into a model; the error for an unknown name lists the valid names."""
    from ..config.toml import parse

    return parse(fields_of(texts), model, "--set")


def fields_of(texts: Sequence[str] | None, *options: str) -> dict[str, object]:
    """Parse the settings given by --set; names in `options` are refused, because another option sets them."""
    from ..config.toml import merged

    fields: dict[str, object] = {}
    for name, value in map(pair_of, texts or []):
        for table in reversed(name.split(".")[1:]):
            value = {table: value}
        fields = merged(fields, {name.split(".")[0]: value})
    for name in options:
        if name in fields:
            raise ValueError(
                f"--set cannot change {name}: another option sets {name}, or its value follows from other "
                "settings"
            )
    return fields


def pair_of(text: str) -> tuple[str, object]:
    """Split a setting "name=value"; the value is parsed as TOML or, if that fails, kept as text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"--set expects name=value or table.name=value, not {text!r}")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):  # not TOML, or a whole number of thousands of digits
        if value.strip()[:1] in ("(", "[", "{"):
            raise ValueError(
                f"--set {name}: cannot parse {value}; write a list as [1, 2] and a table as {{a = 1}}"
            ) from None
        return name, value
