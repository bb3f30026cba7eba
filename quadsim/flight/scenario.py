"""Scenarios: what to fly, in which wind, from which start, with which faults, and what counts as a crash.

A scenario is a TOML file that stands alone; `load_scenario` takes the name of a shipped one or a path.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import ValidationError

from ..config.ranges import Between, Distance, Engine, Position, RateDeg, Speed
from ..config.toml import Model, Strict, describe, load_toml, preset_names
from ..trajectory.specs import Hover, Trajectory
from ..vehicle import Randomisation
from ..wind import WindSpec
from .faults import Fault


class Start(Strict):
    """How a flight begins: at its first set-point, unless displaced or tilted."""

    offset: Position = (0.0, 0.0, 0.0)
    """Displacement from the first set-point, world axes [m]."""
    speed: Speed = 0.0
    """Horizontal speed on top of the set-point's, in a direction drawn for each seed [m/s]."""
    tilt_deg: Annotated[float, Between(0.0, 90.0, "°")] = 0.0
    """Initial tilt, about a horizontal axis drawn for each seed [deg]."""
    rate_deg: RateDeg = 0.0
    """Initial body rate, about a horizontal axis drawn for each seed [deg/s]."""
    known_attitude: bool = False
    """Whether the initial attitude is given to the estimator; otherwise it starts level."""
    attitude_error_deg: Annotated[float, Between(0.0, 90.0, "°")] = 0.0
    """Error of the given initial attitude, about a horizontal axis drawn for each seed [deg]."""


class Crash(Strict):
    """Limits of a flight. It crashes when one of them is exceeded, or when it hits the ground.

    It hits the ground when its centre of mass is below z = 0, world axes. Samples after a crash do not count.
    """

    tilt_deg: Annotated[float, Between(1.0, 180.0, "°")] = 75.0
    """Largest tilt [deg]; the controller commands at most 60°."""
    distance: Distance = 10.0
    """Largest distance from the set-point [m]."""


class Surroundings(Strict):
    """What recipes and scenarios have in common."""

    wind: tuple[WindSpec, ...] = ()
    """Winds, added up."""
    randomisation: Randomisation = Randomisation()
    """Ranges of the parameters of vehicle, IMU, wind and delay, which are drawn for each flight."""
    engine: Engine = "auto"
    """What integrates the motion: "mujoco", or "auto", its scheme for free flight, compiled."""


class Scenario(Surroundings):
    """A situation in flight, which can be simulated with any estimator and any number of seeds."""

    description: str
    """The difficulty for an estimator, in one sentence; shown in reports."""
    duration_s: Annotated[float, Between(1e-3, 3600.0, "s")] = 20.0
    """Length of a flight [s]."""
    vehicle: str = "hummingbird"
    """A shipped vehicle, or the path of a TOML file."""
    imu: str = "adis16448"
    """A shipped IMU, or the path of a TOML file."""
    drag_factor: Annotated[float, Between(0.0, 100.0)] = 1.0
    """True drag divided by that of the vehicle's file, which estimators receive."""
    vehicle_known: bool = True
    """Whether estimators receive the vehicle; if not, estimators that need one do not fly."""
    external: str = "ideal"
    """Source of position, velocity and yaw: a shipped external sensor, or the path of a TOML file."""
    contact: bool = False
    """Whether the ground can be touched, at five times the cost; otherwise, touching it is a crash."""
    trajectory: Trajectory = Hover()
    """The set-points."""
    start: Start = Start()
    """How a flight begins."""
    faults: tuple[Fault, ...] = ()
    """Faults, in the order in which they act on a sample."""
    crash: Crash = Crash()
    """Limits beyond which a flight has crashed."""


def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario: a shipped name ("hover") or the path of a TOML file.

    Relative paths in a file are from its folder.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    return load_toml(source, "scenarios", Scenario)


def changed(spec: Model, changes: Mapping[str, Any]) -> Model:
    """A scenario or a recipe with some of its fields changed, and checked.

    Raises:
        ValueError: A value that the field cannot have.
    """
    try:
        return type(spec).model_validate(spec.model_dump() | dict(changes))
    except ValidationError as error:
        raise ValueError(describe(error, type(spec))) from error


def scenario_names() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return preset_names("scenarios")
