"""The vehicle: its constants, read from TOML, and their randomisation for each flight."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from .config.ranges import Arm, Between, Mass, RotorSpeed, Size
from .config.toml import Strict, load_toml

GRAVITY = 9.81  # m/s², along −z of the world
AIR_DENSITY = 1.225  # kg/m³, ISA sea level

Inertia = Annotated[float, Between(1e-9, 1000.0, "kg m²")]
Area = Annotated[float, Between(0.0, 10.0, "m²")]
Lag = Annotated[float, Between(1e-4, 1.0, "s")]
Gain = Annotated[float, Between(1e-3, 1000.0, "1/s")]
IntegralGain = Annotated[float, Between(0.0, 1e4, "1/s²")]
GYRATION_M = 1e-3, 5.0
"""Range of the radius of gyration of a vehicle [m]."""
MIN_ROTORS, MAX_ROTORS = 4, 12
"""Smallest number of rotors that control thrust, roll, pitch and yaw independently; largest number of
rotors."""


class Rotor(Strict):
    """Position and direction of rotation of one rotor."""

    position: Arm = Field(description="Hub w.r.t. the centre of mass, body axes [m].")
    spin: Literal["cw", "ccw"] = Field(description="Sense of rotation seen from above.")


class Motor(Strict):
    """Constants shared by all rotors."""

    k_f: Annotated[float, Between(1e-12, 1.0, "N s²")] = Field(description="Thrust = k_f ω² [N s²].")
    k_m: Annotated[float, Between(1e-6, 10.0, "m")] = Field(description="Yaw torque per thrust [m].")
    omega_max: RotorSpeed = Field(description="Highest rotor speed [rad/s].")
    tau_up: Lag = Field(description="Time constant of the first-order lag when spinning up [s].")
    tau_down: Lag = Field(description="Time constant of the first-order lag when spinning down [s].")
    rotor_drag: Annotated[float, Between(0.0, 1.0, "N s²/m")] = Field(
        description="H-force constant c of −c |ω| V⊥ [N s²/m]."
    )
    rolling_moment: Annotated[float, Between(0.0, 1.0, "N s²")] = Field(
        description="Rolling-moment constant c_r of −c_r |ω| V⊥ [N s²]."
    )


class Frame(Strict):
    """Drag and outline of the airframe."""

    drag_area: tuple[Area, Area, Area] = Field(description="C_d A per body axis, of −½ ρ C_d A |v| v [m²].")
    size: tuple[Size, Size, Size] = Field(description="Half extents of the box that touches the ground [m].")
    prop_radius: Size = Field(description="Propeller radius, for pictures [m].")


class Gains(Strict):
    """Gains of the cascaded controller.

    By default, `quadsim.control.gains.design` computes them from phase margins.
    """

    rate: Gain = Field(description="Roll and pitch rate error to angular acceleration [1/s].")
    rate_integral: IntegralGain = Field(description="Integral action of the rate loop [1/s²].")
    yaw_rate: Gain = Field(description="Yaw rate error to angular acceleration [1/s].")
    yaw_rate_integral: IntegralGain = Field(description="Integral action of the yaw-rate loop [1/s²].")
    attitude: Gain = Field(description="Tilt error to roll and pitch rate [1/s].")
    yaw: Gain = Field(description="Yaw error to yaw rate [1/s].")
    velocity: Gain = Field(description="Velocity error to acceleration [1/s].")
    velocity_integral: IntegralGain = Field(description="Integral action of the velocity loop [1/s²].")
    position: Gain = Field(description="Position error to velocity [1/s].")


class Vehicle(Strict):
    """A multirotor. Body axes are x forward, y left and z up, with the origin at the centre of mass."""

    name: str = Field(description="Name shown in reports.")
    source: str = Field(description="Where the numbers come from.")
    mass: Mass = Field(description="Mass [kg].")
    inertia: tuple[Inertia, Inertia, Inertia] = Field(description="Principal moments of inertia [kg m²].")
    rotors: tuple[Rotor, ...] = Field(min_length=MIN_ROTORS, max_length=MAX_ROTORS, description="The rotors.")
    motor: Motor
    frame: Frame
    controller: Gains | None = Field(
        default=None, description="Gains of the controller; default: designed for phase margins."
    )

    @model_validator(mode="after")
    def _must_fly(self) -> "Vehicle":
        if self.thrust_to_weight <= 1.1:
            raise ValueError(
                f"thrust-to-weight is {self.thrust_to_weight:.2f}; a vehicle needs more than 1.1 to fly"
            )
        radii = np.sqrt(np.array(self.inertia) / self.mass)
        if radii.min() < GYRATION_M[0] or radii.max() > GYRATION_M[1]:
            raise ValueError(
                f"inertia {self.inertia} kg m² is that of {self.mass:g} kg at {radii.min():.2g} to "
                f"{radii.max():.2g} m from the axes; {GYRATION_M[0]:g} to {GYRATION_M[1]:g} m make sense"
            )
        a, b, c = sorted(self.inertia)
        if a + b < c * (1 - 1e-9):
            raise ValueError(f"inertia {self.inertia} breaks the triangle inequality; no rigid body has it")
        if np.linalg.matrix_rank(self.allocation, rtol=1e-9) < len(self.allocation):
            raise ValueError("the rotors cannot command thrust, roll, pitch and yaw independently")
        return self

    @property
    def hover_rotor_vel(self) -> float:
        """Rotor speed at which the thrust of all rotors equals the weight [rad/s]."""
        return float(np.sqrt(self.mass * GRAVITY / (len(self.rotors) * self.motor.k_f)))

    @property
    def thrust_to_weight(self) -> float:
        """Ratio of the largest total thrust to the weight."""
        return len(self.rotors) * self.motor.k_f * self.motor.omega_max**2 / (self.mass * GRAVITY)

    @property
    def drag_time_constant(self) -> float:
        """Time constant of the decay of speed by rotor drag alone at hover rotor speed, m / (c Σω) [s]."""
        return self.mass / (len(self.rotors) * self.motor.rotor_drag * self.hover_rotor_vel)

    @property
    def hubs(self) -> np.ndarray:
        """Positions of the hubs, body axes, (rotors, 3) [m]."""
        return np.array([rotor.position for rotor in self.rotors])

    @property
    def reactions(self) -> np.ndarray:
        """Sign of the yaw reaction torque of each rotor, (rotors,); +1 (along +z) for a clockwise rotor."""
        return np.array([1.0 if rotor.spin == "cw" else -1.0 for rotor in self.rotors])

    @property
    def allocation(self) -> np.ndarray:
        """Matrix (4, rotors) from squared rotor speeds [rad²/s²] to thrust [N] and torque [N m]."""
        x, y, _ = self.hubs.T
        return self.motor.k_f * np.stack([np.ones(len(x)), y, -x, self.motor.k_m * self.reactions])


def with_drag(vehicle: Vehicle, factor: float) -> Vehicle:
    """Multiply the drag of rotors and frame by a factor."""
    if factor == 1.0:
        return vehicle
    return _scaled(vehicle, factor, rotor_drag=factor, rolling_moment=factor)


def _scaled(vehicle: Vehicle, drag_area: float, **motor: float) -> Vehicle:
    """Multiply drag areas and motor constants by factors."""
    changed = {name: getattr(vehicle.motor, name) * factor for name, factor in motor.items()}
    areas = tuple(area * drag_area for area in vehicle.frame.drag_area)
    parts = {
        "motor": vehicle.motor.model_copy(update=changed),
        "frame": vehicle.frame.model_copy(update={"drag_area": areas}),
    }
    return vehicle.model_copy(update=parts)


def load_vehicle(source: str | Path) -> Vehicle:
    """Read a vehicle: a shipped name ("hummingbird", "hexarotor", …) or the path of a TOML file."""
    return load_toml(source, "vehicles", Vehicle)


class Randomisation(Strict):
    """Relative half-width r of the range of each constant. The factor 1 + U(−r, r) is drawn for each flight.

    `randomise` draws the constants of the vehicle; `quadsim.flight.domain` draws the others.
    """

    mass: float = Field(
        default=0.0, ge=0, lt=0.5, description="Relative half-width of the mass; the inertia scales with it."
    )
    inertia: float = Field(
        default=0.0, ge=0, lt=0.5, description="Additional relative half-width of the inertia."
    )
    thrust: float = Field(default=0.0, ge=0, lt=0.5, description="Relative half-width of k_f.")
    torque: float = Field(default=0.0, ge=0, lt=0.5, description="Relative half-width of k_m.")
    rotor_drag: float = Field(
        default=0.0, ge=0, lt=1, description="Relative half-width of the rotor-drag constant."
    )
    frame_drag: float = Field(default=0.0, ge=0, lt=1, description="Relative half-width of C_d A.")
    motor_lag: float = Field(
        default=0.0, ge=0, lt=0.9, description="Relative half-width of both motor time constants."
    )
    imu: float = Field(default=0.0, ge=0, lt=1, description="Relative half-width of each error of the IMU.")
    wind: float = Field(default=0.0, ge=0, le=1, description="Relative half-width of the wind's speed.")
    delay: float = Field(
        default=0.0, ge=0, le=1, description="Relative half-width of the external sensor's delay."
    )


def randomise(vehicle: Vehicle, ranges: Randomisation, rng: np.random.Generator) -> Vehicle:
    """Draw one vehicle with constants around those of `vehicle`. Ranges of zero change nothing."""

    def factor(width: float) -> float:
        return 1.0 + width * rng.uniform(-1.0, 1.0)

    mass, k_f, k_m, drag, area, lag = map(
        factor,
        (ranges.mass, ranges.thrust, ranges.torque, ranges.rotor_drag, ranges.frame_drag, ranges.motor_lag),
    )
    # the pair (x, y) shares one draw, so that no draw breaks the triangle inequality of a flat airframe
    across, along = factor(ranges.inertia), factor(ranges.inertia)
    ixx, iyy, izz = vehicle.inertia
    ixx, iyy = ixx * mass * across, iyy * mass * across
    drawn = _scaled(vehicle, area, k_f=k_f, k_m=k_m, rotor_drag=drag, tau_up=lag, tau_down=lag)
    inertia = (ixx, iyy, min(izz * mass * along, ixx + iyy))
    return drawn.model_copy(update={"mass": vehicle.mass * mass, "inertia": inertia})
