"""Options that several commands share, and functions that read and print their values."""

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
    typer.Option(min=0, callback=_unreserved, help="Seed of all random numbers; held-out seeds are refused."),
]
Workers = Annotated[int | None, typer.Option(min=1, help="Number of worker processes; default: one per CPU.")]
ConditionFields = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Condition of the flights, as name=value: vehicle, imu or external (a shipped name or a "
        "TOML file, in place of the scenarios'), tuning (filter parameters: a shipped name or a "
        "file from quadsim tune), engine (auto, mujoco), rate (samples per second). Only fly: flight "
        "(number of the first flight, as in flights.parquet of bench). "
        "Repeat for more.",
    ),
]
Mount = Annotated[
    str | None,
    typer.Option(
        "--mount",
        help='Rotation from IMU to body axes: body x, y and z as axes of the IMU ("z,-y,x"); roll, '
        'pitch and yaw of the IMU in degrees ("rpy 0 20 90"); a quaternion w x y z; or a matrix '
        "by rows. The true attitude is rotated only if it is that of the IMU itself.",
    ),
]
Truth = Annotated[
    str | None, typer.Option(help="Topic or folder of the true attitude; default: the best one in the log.")
]
Imu = Annotated[str | None, typer.Option(help="Topic of the IMU in a ROS bag or MCAP.")]
Force = Annotated[bool, typer.Option("--force", help="Use logs even if their units or axes look wrong.")]
Rerun = Annotated[
    Path | None,
    typer.Option(help="Write the first flight or the log to a recording for the viewer rerun (.rrd)."),
]
Mcap = Annotated[
    Path | None, typer.Option(help="Write the first flight or the log to an MCAP file, for Foxglove.")
]
Duration = Annotated[float | None, typer.Option(min=0.1, help="Length in seconds; default: the scenario's.")]
OWN_CONTROLLER = (
    "Attitude controller: cascaded, a spiking controller's weights, or your own file.py:make, a function of "
    "sample rate and vehicle. Other controllers than cascaded replace its attitude and body-rate loops."
)


def settings_of(texts: Sequence[str] | None, model: type[Model]) -> Model:
    """Settings given by --set, as a model; the error for an unknown name lists the valid ones."""
    from ..config.toml import parse

    return parse(fields_of(texts), model, "--set")


def fields_of(texts: Sequence[str] | None, *options: str) -> dict[str, object]:
    """Settings given by --set; those named in `options` are refused, because another option sets them."""
    from ..config.toml import merged

    fields: dict[str, object] = {}
    for name, value in map(pair_of, texts or []):
        for table in reversed(name.split(".")[1:]):
            value = {table: value}
        fields = merged(fields, {name.split(".")[0]: value})
    for name in options:
        if name in fields:
            raise ValueError(f"--set {name}: it has an option of its own, or follows from the others")
    return fields


def pair_of(text: str) -> tuple[str, object]:
    """Name and value of a setting "name=value"; the value is read as TOML, or else as text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"--set takes name=value or table.name=value, not {text!r}")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):  # not TOML, or a whole number of thousands of digits
        if value.strip()[:1] in ("(", "[", "{"):
            raise ValueError(
                f"--set {name}: cannot read {value}; lists are [1, 2], tables {{a = 1}}"
            ) from None
        return name, value
