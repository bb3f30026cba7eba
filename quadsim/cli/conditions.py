"""Models of what `--set` can change. They are not imported for `--help`, because pydantic imports slowly."""

from pathlib import Path
from typing import Annotated

from ..config.ranges import Between, Engine
from ..config.toml import Strict


class Sampling(Strict):
    """Sampling rate, as set by `--set`."""

    rate: Annotated[float, Between(50.0, 2000.0, "Hz")] = 200.0


class Conditions(Sampling):
    """Conditions of flights in closed loop, as set by `--set`; None keeps the scenario's value."""

    vehicle: str | None = None
    imu: str | None = None
    external: str | None = None
    engine: Engine | None = None
    """mujoco, or auto: in free flight a faster, compiled version of MuJoCo's integrator, equal to 1e-12."""
    tuning: str | None = None
    """Filter parameters; None selects those that ship for the vehicle."""

    def changes(self, duration_s: float | None) -> dict[str, object]:
        """Return the fields that replace those of every scenario."""
        given = self.model_dump(exclude={"rate", "tuning", "flight"}) | {"duration_s": duration_s}
        return {name: value for name, value in given.items() if value is not None}


class FlightConditions(Conditions):
    """Conditions for `quadsim fly`, as set by `--set`."""

    flight: Annotated[int, Between(0, 9999)] = 0
    """Number of the first flight, as in flights.parquet of `quadsim bench`."""


class Filters(Strict):
    """Parameters of filters on recorded flights, as set by `--set`."""

    tuning: str | None = None
    """A shipped name or a file written by `quadsim tune`; None selects the parameters for the vehicle."""
    vehicle: str | None = None
    """Airframe for ekf-drag, a shipped name or a TOML file; None selects the vehicle of the dataset."""


class Recordings(Strict):
    """Settings of `--set` for a task; they do not change the task."""

    broad: Path | None = None
    """Folder with the trials of BROAD, as published by its authors."""
