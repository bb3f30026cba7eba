"""Tuned parameters: TOML files, one per domain (vehicle and IMU), with one table per estimator."""

from pathlib import Path
from typing import Annotated

import tomli_w
from pydantic import Field, RootModel

from quadsim.config.ranges import Between, SampleRate
from quadsim.config.toml import Strict, load_toml, preset_names
from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.vehicle import Vehicle

DEFAULT_DOMAIN, ANY_VEHICLE = "hummingbird-adis16448", "general"
"""Domains whose shipped parameters are used for a vehicle without its own: the first with a table for the
estimator."""


class Tuned(Strict):
    """Parameters of one estimator, with their origin."""

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
    """A tuning file: a table per estimator."""


def load_tuning(source: str | Path) -> dict[str, Tuned]:
    """Load the tuned parameters of every estimator in a shipped domain or a file.

    Raises:
        ValueError: The file is invalid.
    """
    return load_toml(source, "tuning", Tuning).root


def tuned_for(
    name: str,
    source: str | Path | None,
    vehicle: Vehicle | None = None,
    imu: ImuSpec | None = None,
) -> Tuned | None:
    """Return the table of one estimator; None if there is none and no source was named.

    Args:
        name: Estimator.
        source: Domain, or path of a TOML file. None selects the shipped domain of vehicle and IMU or, if
            there is none, of the vehicle or the default ones.
        vehicle: The airframe, if it is known.
        imu: The IMU, if it is known.

    Raises:
        ValueError: The named source cannot be read or has no table of the estimator.
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
    """Return the text of a tuning file with a comment at the top.

    Invalid characters in the comment are dropped.
    """
    shown = "".join(each for each in comment if each.isprintable() or each in "\n\t")
    head = "".join(f"# {line}".rstrip() + "\n" for line in shown.split("\n"))
    text = head + "\n" + tomli_w.dumps({name: table.model_dump() for name, table in tables.items()})
    return text.encode("utf-8", "replace").decode()  # bytes of a path that are no UTF-8
