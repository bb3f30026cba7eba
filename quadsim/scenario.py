"""Scenarios: what to fly, in which wind, from which start, with which faults, and what counts as a crash.

A scenario is a TOML file that stands alone; `load_scenario` takes the name of a shipped one or a path.
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from .config import Strict, load_toml, preset_names
from .faults import Fault
from .trajectory import Hover, Trajectory
from .wind import WindSpec

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Start(Strict):
    """How a flight begins: at its first set-point, unless displaced or tilted."""

    offset: Vector = (0.0, 0.0, 0.0)
    """Displacement from the first set-point, world axes [m]."""
    speed: NonNegative = 0.0
    """Horizontal speed on top of the set-point's, in a direction drawn for each seed [m/s]."""
    tilt_deg: Annotated[float, Field(ge=0, le=90)] = 0.0
    """Tilt, about a horizontal axis drawn for each seed [deg]."""
    rate_deg: NonNegative = 0.0
    """Size of the body rate, about a horizontal axis drawn for each seed [deg/s]."""
    known_attitude: bool = False
    """Whether the estimator is told its attitude; otherwise it starts level."""


class Crash(Strict):
    """A flight has crashed at the first instant at which any of these holds; what follows is not counted."""

    tilt_deg: Annotated[float, Field(gt=0, le=180)] = 75.0
    """Tilt beyond which a flight counts as lost: the controller asks for 60° at most [deg]."""
    altitude: float = 0.0
    """Height of the centre of mass below which the ground is hit, world z [m]."""
    distance: Positive = 10.0
    """Distance from the set-point beyond which the vehicle has flown away [m]."""


class Scenario(Strict):
    """One flight situation, to be flown on any estimator and any number of seeds."""

    description: str
    """What it asks of an estimator, in a sentence; shown in reports."""
    duration_s: Annotated[float, Field(gt=0, le=3600)] = 20.0
    """Length of a flight [s]."""
    vehicle: str = "hummingbird"
    """A shipped vehicle, or the path of a TOML file."""
    imu: str = "adis16448"
    """A shipped IMU, or the path of a TOML file."""
    external: str = "ideal"
    """Where position, velocity and yaw come from: a shipped external sensor, or the path of a TOML file."""
    contact: bool = False
    """Whether the ground can be touched, at five times the cost; otherwise to reach it is to crash."""
    trajectory: Trajectory = Hover()
    """The set-points."""
    wind: tuple[WindSpec, ...] = ()
    """Winds, added up."""
    start: Start = Start()
    """How a flight begins."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong, in the order in which it acts on a sample."""
    crash: Crash = Crash()
    """What counts as a crash."""


def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario: a shipped name ("hover") or the path of a TOML file.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    return load_toml(source, "scenarios", Scenario)


def scenario_names() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return preset_names("scenarios")
