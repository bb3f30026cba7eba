"""Options that several verbs share, and how their values are read and printed."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Annotated, Literal

import typer

from ..config.ranges import Between, Engine
from ..config.toml import Strict, merged, parse

Initial = Literal["unknown", "known"]
Search = Literal["swarm", "evolution"]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]


def _unreserved(seed: int) -> int:
    from ..held_out import unreserved

    try:
        return unreserved(seed)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


LearningSeed = Annotated[
    int, typer.Option(min=0, callback=_unreserved, help="Seed of everything random; not one held out.")
]
Workers = Annotated[int | None, typer.Option(min=1, help="Worker processes; one per CPU when left out.")]
Pool = Annotated[
    str | None,
    typer.Option(
        "--workers",
        metavar="N|ADDRESS",
        help="Worker processes, one per CPU when left out; or a Dask scheduler, tcp://HOST:8786.",
    ),
]
Preset = Annotated[
    str,
    typer.Option(
        help="paper: its recipe; best: that of the shipped networks, for any IMU; hummingbird: one airframe; "
        "tune: logs; control-attitude, control-separate: controllers; or a TOML file."
    ),
]
Fields = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Any other field of the training, as name=value or table.name=value, such as init=att-snn to "
        "continue from weights; an unknown one lists them.",
    ),
]
RecipeFields = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Other than the recipe's, as name=value: vehicle or imu (a shipped name or a TOML file), engine "
        "(auto, mujoco, compiled), any key of a recipe, or rate (samples per second, 200). Again for more.",
    ),
]
ConditionFields = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Condition of the flights, as name=value: vehicle, imu or external (a shipped name or a TOML "
        "file, in place of the scenarios'), tuning (of filters: a shipped domain or a file of quadsim tune), "
        "engine (auto, mujoco, compiled), rate (samples per second). Again for more.",
    ),
]
Mount = Annotated[
    str | None,
    typer.Option(
        "--mount",
        help='Rotation from IMU to body axes: body axes as the IMU\'s ("z,-y,x"), roll, pitch and yaw of the '
        'IMU in degrees ("rpy 0 20 90"), a quaternion w x y z or a matrix by rows. A true attitude of the '
        "body is not rotated, one of the IMU itself is.",
    ),
]
Truth = Annotated[
    str | None, typer.Option(help="Topic or folder to take for the true attitude; else the best there is.")
]
Imu = Annotated[str | None, typer.Option(help="Topic of the IMU in a ROS bag.")]
OWN_CONTROLLER = (
    "cascaded, a spiking controller's weights, or your own file.py:make, called with sample rate and "
    "vehicle; in place of the cascade's levels of attitude and body rate"
)


class Sampling(Strict):
    """What `--set` says of sampling."""

    rate: Annotated[float, Between(50.0, 2000.0, "Hz")] = 200.0


class Conditions(Sampling):
    """What `--set` changes of flights in closed loop; None keeps the scenario's own."""

    vehicle: str | None = None
    imu: str | None = None
    external: str | None = None
    engine: Engine | None = None
    """Integrator: mujoco; compiled, its scheme for free flight, equal to 1e-12 and faster; or auto."""
    tuning: str | None = None
    """None takes the parameters shipped for the vehicle."""

    def changes(self, duration_s: float | None) -> dict[str, object]:
        """Fields that replace those of every scenario."""
        given = self.model_dump(exclude={"rate", "tuning"}) | {"duration_s": duration_s}
        return {name: value for name, value in given.items() if value is not None}


def conditions_of(texts: Sequence[str] | None) -> Conditions:
    """Conditions given by `--set`; an unknown name is an error that lists those there are."""
    return parse(fields_of(texts), Conditions, "--set")


def time_left(seconds: float, done: int, total: int) -> str:
    """How long the rest takes at the pace so far, at most: "12 min"."""
    left = seconds / done * (total - done)
    if left < 100:
        return f"{left:.0f} s"
    return f"{left / 60:.0f} min" if left < 6000 else f"{left / 3600:.1f} h"


def fields_of(texts: Sequence[str] | None, *options: str) -> dict[str, object]:
    """The settings given by --set; what has an option of its own, or follows from others, is refused."""
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
    """A setting given as name=value; the value is read as TOML, or as it stands."""
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
