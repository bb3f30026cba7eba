"""Tuned parameters: TOML files, one a domain (vehicle and IMU), with one table per estimator."""

from pathlib import Path
from typing import Annotated

import tomli_w
from pydantic import Field, RootModel

from quadsim.config.ranges import Between, SampleRate
from quadsim.config.toml import Strict, load_toml, preset_names
from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.vehicle import Vehicle

DEFAULT_DOMAIN, ANY_VEHICLE = "hummingbird-adis16448", "general"
"""Domains whose shipped parameters an estimator has for a vehicle that none is for: the first that has it."""


class Tuned(Strict):
    """Parameters of one estimator, and how they were found."""

    command: str = Field(description="Command that wrote this table.")
    vehicle: str = Field(default="", description="Name of the vehicle; empty if unknown.")
    imu: str = Field(default="", description="Name of the shipped IMU; empty if unknown or not shipped.")
    rate_hz: SampleRate = Field(description="Sample rate of the data [Hz].")
    rmse_deg: Annotated[float, Between(0.0, 360.0, "°")] = Field(
        description="Square root of the cost, which is the mean squared error of roll and pitch [deg]."
    )
    evaluations: Annotated[int, Between(0, 10**12)] = Field(description="Number of evaluated parameter sets.")
    values: dict[str, Annotated[float, Between(-1e9, 1e9)]] = Field(description="The parameters.")


class Tuning(RootModel[dict[str, Tuned]]):
    """A whole file: estimator name to its table."""


def load_tuning(source: str | Path) -> dict[str, Tuned]:
    """Tuned parameters of every estimator in a shipped domain or a file.

    Raises:
        ValueError: One line that says what is wrong with the file.
    """
    return load_toml(source, "tuning", Tuning).root


def tuned_for(
    name: str,
    source: str | Path | None,
    vehicle: Vehicle | None = None,
    imu: ImuSpec | None = None,
) -> Tuned | None:
    """Table of one estimator; None where there is none and no file was asked for by name.

    Args:
        name: Estimator.
        source: Domain, path of a TOML file, or None for the shipped domain of the vehicle and the IMU, else
            of the vehicle, else the default ones.
        vehicle: The airframe, if it is known.
        imu: Its IMU.

    Raises:
        ValueError: A file was asked for and does not have the estimator, or cannot be read.
    """
    if source is not None:
        tables = load_tuning(source)
        if name not in tables:
            raise ValueError(f"{source}: no table [{name}]; it has {', '.join(tables) or 'none'}")
        return tables[name]
    tables = {domain: table for domain in preset_names("tuning") if (table := load_tuning(domain).get(name))}
    ours = [each for each in tables.values() if vehicle is not None and each.vehicle == vehicle.name]
    fitting = [each for each in ours if imu is not None and each.imu and load_imu(each.imu) == imu]
    return next(iter([*fitting, *ours]), tables.get(DEFAULT_DOMAIN, tables.get(ANY_VEHICLE)))


def to_toml(tables: dict[str, Tuned], comment: str) -> str:
    """Text of a tuning file, with a comment on top; what may not stand in a comment is left out."""
    shown = "".join(each for each in comment if each.isprintable() or each in "\n\t")
    head = "".join(f"# {line}".rstrip() + "\n" for line in shown.split("\n"))
    text = head + "\n" + tomli_w.dumps({name: table.model_dump() for name, table in tables.items()})
    return text.encode("utf-8", "replace").decode()  # bytes of a path that are no UTF-8
