"""Conditions of flights, as set by `--set`: models, which take long to import and no `--help` needs."""

from pathlib import Path
from typing import Annotated

from ..config.ranges import Between, Engine
from ..config.toml import Strict


class Sampling(Strict):
    """Sampling rate, as set by `--set`."""

    rate: Annotated[float, Between(50.0, 2000.0, "Hz")] = 200.0


class Conditions(Sampling):
    """Changes of flights in closed loop, as set by `--set`; None keeps the scenario's value."""

    vehicle: str | None = None
    imu: str | None = None
    external: str | None = None
    engine: Engine | None = None
    """Integrator: mujoco; or auto, in free flight its scheme compiled, equal to 1e-12 and faster."""
    tuning: str | None = None
    """None selects the parameters shipped for the vehicle."""

    def changes(self, duration_s: float | None) -> dict[str, object]:
        """Fields that replace those of every scenario."""
        given = self.model_dump(exclude={"rate", "tuning", "flight"}) | {"duration_s": duration_s}
        return {name: value for name, value in given.items() if value is not None}


class FlightConditions(Conditions):
    """The same for `fly`."""

    flight: Annotated[int, Between(0, 9999)] = 0
    """First flight, by its number in flights.parquet of bench."""


class Filters(Strict):
    """Parameters of filters on recorded flights, as set by `--set`."""

    tuning: str | None = None
    """A shipped name or a file of `quadsim tune`; None selects those of the vehicle."""
    vehicle: str | None = None
    """For ekf-drag, a shipped name or a TOML file; None for the dataset's, and for logs none."""


class Recordings(Strict):
    """What `--set` may say of a task: nothing that changes it."""

    broad: Path | None = None
    """Folder of the trials of BROAD, as its authors publish them."""
