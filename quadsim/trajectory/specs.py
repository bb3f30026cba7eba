"""Kinds of trajectory, chosen by `kind` in TOML. Random trajectories are drawn for each flight."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..config.ranges import Between, Distance, Duration, Heading, Instant, PeakTilt, Position, Rising, Share
from ..config.toml import Strict

Manoeuvre = Annotated[float, Between(0.05, 3600.0, "s")]
ManoeuvreRange = Annotated[tuple[Manoeuvre, Manoeuvre], Rising]
Speed = Annotated[float, Between(0.01, 100.0, "m/s")]
LEAST_PEAK_DEG = 25.0
MOST_POINTS = 10_000
Multiple = Annotated[int, Between(-100, 100)]


class Placed(Strict):
    """A trajectory with a position."""

    position: Position = Field(default=(0.0, 0.0, 2.0), description="Start or centre of the trajectory [m].")


class Hover(Placed):
    """Hover at one position."""

    kind: Literal["hover"] = "hover"
    yaw_deg: Heading = Field(default=0.0, description="Heading [deg].")


class Step(Placed):
    """Hover, with a set-point that jumps to another position and back."""

    kind: Literal["step"] = "step"
    offset: Position = Field(default=(2.0, 0.0, 0.0), description="Size of the jump [m].")
    yaw_deg: Heading = Field(default=0.0, description="Jump of the heading [deg].")
    at_s: Instant = Field(default=2.0, description="Time of the first jump [s].")
    hold_s: Duration = Field(default=6.0, description="Time between jumps [s].")


class Move(Placed):
    """Minimum-snap motion from rest to rest, for take-off and landing, followed by a hover."""

    kind: Literal["move"] = "move"
    offset: Position = Field(default=(0.0, 0.0, 1.0), description="Displacement [m].")
    at_s: Instant = Field(default=2.0, description="Start time [s].")
    length_s: Manoeuvre = Field(default=4.0, description="Duration [s].")


class Lissajous(Placed):
    """Sinusoids on three axes, whose amplitudes grow during the first period.

    Frequencies 1 : 2 give a figure of eight.
    """

    kind: Literal["lissajous"] = "lissajous"
    amplitude: Position = Field(default=(3.0, 1.5, 0.0), description="Amplitudes [m].")
    ratio: tuple[Multiple, Multiple, Multiple] = Field(
        default=(1, 2, 1), description="Multiples of 1 / period."
    )
    period_s: Manoeuvre = Field(default=6.0, description="Period of the basic frequency [s].")


class Waypoints(Strict):
    """Minimum-snap trajectory through waypoints, at rest at both ends, repeated until the flight ends.

    For given times, the curve that minimises ∫ ‖d⁴x/dt⁴‖² is the interpolating spline of degree 7 (Mellinger
    & Kumar 2011). The times follow from distance and speed.
    """

    kind: Literal["waypoints"] = "waypoints"
    points: tuple[Position, ...] = Field(default=(), description="Waypoints [m]; default: random ones.")
    random_points: Annotated[int, Between(2, 100)] = Field(
        default=8, description="Number of random waypoints."
    )
    box: Position = Field(
        default=(6.0, 6.0, 2.0),
        description="Half extents of the box in which random waypoints are drawn [m].",
    )
    position: Position = Field(default=(0.0, 0.0, 4.0), description="Centre of that box [m].")
    speed: Speed = Field(default=2.5, description="Mean speed along straight legs [m/s].")

    @model_validator(mode="after")
    def _leads_somewhere(self) -> "Waypoints":
        if len(self.points) == 1 or len(self.points) > MOST_POINTS:
            raise ValueError(f"points: {len(self.points)} given; 2 to {MOST_POINTS} make a path, or none")
        return self


class Mix(Strict):
    """Random aggressive flight: dashes, circles, figures of eight, jumps, cruises and stops.

    A dash is a rest-to-rest motion that tilts once in each direction, like an attitude doublet. Its peak tilt
    is drawn up to `max_tilt_deg`. The standard deviation of roll and pitch is about 0.25 rad.
    """

    kind: Literal["mix"] = "mix"
    position: Position = Field(default=(0.0, 0.0, 20.0), description="Start and centre of the flights [m].")
    max_tilt_deg: PeakTilt = Field(default=45.0, description="Largest commanded tilt [deg].")
    min_tilt_deg: Annotated[float, Between(0.0, 55.0, "°")] = Field(
        default_factory=lambda given: min(LEAST_PEAK_DEG, given.get("max_tilt_deg", LEAST_PEAK_DEG)),
        description="Smallest peak tilt of a dash [deg]; default: 25, or `max_tilt_deg` if that is smaller.",
    )
    dash_s: ManoeuvreRange = Field(default=(1.0, 2.6), description="Range of the length of a dash [s].")
    circle_share: Share = Field(default=0.25, description="Share of circles among the manoeuvres.")
    circle_s: ManoeuvreRange = Field(default=(1.6, 3.5), description="Range of the period of a circle [s].")
    eight_share: Share = Field(default=0.0, description="Share of figures of eight.")
    eight_s: ManoeuvreRange = Field(
        default=(3.0, 8.0), description="Range of the lap time of figures of eight [s]."
    )
    jump_share: Share = Field(default=0.0, description="Share of jumps of the set-point.")
    jump_m: Annotated[tuple[Distance, Distance], Rising] = Field(
        default=(0.5, 2.5), description="Range of the size of jumps [m]."
    )
    cruise_share: Share = Field(default=0.0, description="Share of straight flights of constant velocity.")
    cruise_s: ManoeuvreRange = Field(default=(2.0, 6.0), description="Range of the duration of cruises [s].")
    cruise_speed: Annotated[tuple[Speed, Speed], Rising] = Field(
        default=(2.0, 8.0), description="Range of the cruise velocity [m/s]."
    )
    pause_share: Share = Field(default=0.1, description="Share of hovering pauses.")
    pause_s: ManoeuvreRange = Field(default=(0.2, 1.5), description="Range of the duration of pauses [s].")
    max_yaw_rate: Annotated[float, Between(0.0, 70.0, "rad/s")] = Field(
        default=1.5, description="Largest yaw rate of a turn [rad/s]."
    )
    radius: Distance = Field(default=15.0, description="Distance beyond which dashes lead to the centre [m].")

    @model_validator(mode="after")
    def _fits(self) -> "Mix":
        if self.min_tilt_deg > self.max_tilt_deg:
            raise ValueError(
                f"min_tilt_deg = {self.min_tilt_deg:g} is above max_tilt_deg = {self.max_tilt_deg:g}"
            )
        shares = ("circle_share", "eight_share", "jump_share", "cruise_share", "pause_share")
        total = sum(getattr(self, name) for name in shares)
        if total > 1.0 + 1e-9:
            raise ValueError(
                f"{' + '.join(shares)} = {total:g}; shares add up to 1 at most, the rest are dashes"
            )
        return self


class OwnFunction(Strict):
    """Set-points from a user's function of time; splines give velocity and acceleration.

    The function is called with times (T,) [s]. It returns x, y, z [m] and optionally yaw [rad], shape (T, 3)
    or (T, 4).
    """

    kind: Literal["function"] = "function"
    function: str = Field(description='Its name: "package.module:function" or "path/file.py:function".')


Trajectory = Annotated[
    Hover | Step | Move | Lissajous | Waypoints | Mix | OwnFunction,
    Field(discriminator="kind"),
]
