"""Scenarios: trajectory, wind, start, faults and crash limits of flights in closed loop.

A scenario is a complete TOML file. `load_scenario` accepts the name of a shipped scenario or a path.
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
    """Start of a flight: the first set-point, with optional displacement, speed and tilt."""

    offset: Position = (0.0, 0.0, 0.0)
    """Displacement from the first set-point, world axes [m]."""
    speed: Speed = 0.0
    """Additional horizontal speed, in a direction drawn for each seed [m/s]."""
    tilt_deg: Annotated[float, Between(0.0, 90.0, "°")] = 0.0
    """Initial tilt about a horizontal axis drawn for each seed [deg]."""
    rate_deg: RateDeg = 0.0
    """Initial body rate, about a horizontal axis drawn for each seed [deg/s]."""
    known_attitude: bool = False
    """Whether the estimator is given the initial attitude; otherwise, the estimator starts level."""
    attitude_error_deg: Annotated[float, Between(0.0, 90.0, "°")] = 0.0
    """Error of the given initial attitude, about a horizontal axis drawn for each seed [deg]."""


class Crash(Strict):
    """Limits of a flight. A vehicle has crashed when it exceeds a limit or hits the ground.

    A vehicle has hit the ground when its centre of mass is below z = 0 in world axes. Samples after a crash
    are not used.
    """

    tilt_deg: Annotated[float, Between(1.0, 180.0, "°")] = 75.0
    """Largest tilt [deg]. The controller commands at most 60°."""
    distance: Distance = 10.0
    """Largest distance from the set-point [m]."""


class Surroundings(Strict):
    """Keys that recipes and scenarios have in common."""

    wind: tuple[WindSpec, ...] = ()
    """Winds; their velocities are added."""
    randomisation: Randomisation = Randomisation()
    """Ranges from which parameters of vehicle, IMU, wind and delay are drawn for each flight."""
    engine: Engine = "auto"
    """Integrator of the motion: "mujoco", or "auto", which uses a faster compiled version in free flight."""


class Scenario(Surroundings):
    """A situation in flight, which can be simulated with any estimator and any number of seeds."""

    description: str
    """The difficulty for an estimator, in one sentence. Reports show this sentence."""
    duration_s: Annotated[float, Between(1e-3, 3600.0, "s")] = 20.0
    """Length of a flight [s]."""
    vehicle: str = "hummingbird"
    """A shipped vehicle, or the path of a TOML file."""
    imu: str = "adis16448"
    """A shipped IMU, or the path of a TOML file."""
    drag_factor: Annotated[float, Between(0.0, 100.0)] = 1.0
    """True drag divided by the drag in the vehicle's file. Estimators are given the drag in the file."""
    vehicle_known: bool = True
    """Whether estimators are given the vehicle. If not, estimators that need the vehicle cannot fly the
    scenario."""
    external: str = "ideal"
    """Source of position, velocity and yaw: a shipped external sensor, or the path of a TOML file."""
    contact: bool = False
    """Whether contact with the ground is simulated, which takes five times as long. Otherwise, contact is a
    crash."""
    trajectory: Trajectory = Hover()
    """Trajectory of the set-points."""
    start: Start = Start()
    """Start of a flight."""
    faults: tuple[Fault, ...] = ()
    """Faults, in the order in which they act on a sample."""
    crash: Crash = Crash()
    """Limits beyond which a flight has crashed."""


def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario: a shipped name ("hover") or the path of a TOML file.

    Relative paths in the file start from the folder of the file.

    Raises:
        ValueError: The file is invalid; the message names the key, its value and the allowed values.
    """
    return load_toml(source, "scenarios", Scenario)


def changed(spec: Model, changes: Mapping[str, Any]) -> Model:
    """Return a scenario or a recipe with some fields changed; the new values are checked.

    Raises:
        ValueError: A value is not valid for its field.
    """
    try:
        return type(spec).model_validate(spec.model_dump() | dict(changes))
    except ValidationError as error:
        raise ValueError(describe(error, type(spec))) from error


def scenario_names() -> list[str]:
    """Return the names of the shipped scenarios, sorted."""
    return preset_names("scenarios")
