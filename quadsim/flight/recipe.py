"""Recipes: what a dataset's flights are made of, as a TOML file of names and numbers."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from ..config.ranges import Between, Engine
from ..config.toml import Strict, load_toml, located
from ..imu.spec import load_imu
from ..trajectory.specs import Mix, Trajectory
from ..vehicle import Randomisation, load_vehicle
from ..wind import WindSpec
from .ground import GroundStart
from .hand_held import HandHeld
from .simulate import AttitudeError, FlightConfig


class Recipe(Strict):
    """A kind of flight to generate: a domain for training and testing."""

    description: str = Field(description="What these flights are for, in a sentence.")
    vehicle: str = Field(default="hummingbird", description="A shipped vehicle, or the path of a TOML file.")
    imu: str = Field(default="adis16448", description="A shipped IMU, or the path of a TOML file.")
    trajectory: Trajectory = Field(default=Mix(), description="What to fly.")
    wind: tuple[WindSpec, ...] = Field(default=(), description="Winds, added up.")
    randomisation: Randomisation = Field(
        default=Randomisation(), description="Spread of the vehicle's numbers."
    )
    attitude_error: AttitudeError = Field(
        default=AttitudeError(), description="Error of the roll and pitch that the controller gets."
    )
    hand_held: HandHeld | None = Field(
        default=None, description="Motion by hand, in place of a flight: the IMU alone, rotors at rest."
    )
    ground: GroundStart | None = Field(
        default=None, description="A start at rest on the ground, before the flight; its end falls away."
    )
    engine: Engine = Field(
        default="auto", description='Integrator of the motion: "mujoco", "compiled", or "auto".'
    )
    warmup_s: Annotated[float, Between(0.0, 60.0, "s")] = Field(
        default=4.0, description="Simulated before recording [s]."
    )


def load_recipe(source: str | Path) -> Recipe:
    """Read a recipe: a shipped name ("hummingbird") or a TOML file, from whose folder its paths count."""
    return located(load_toml(source, "recipes", Recipe), source)


def flight_config(recipe: Recipe) -> FlightConfig:
    """The recipe with its vehicle and IMU read in: everything a flight depends on, in one model."""
    return FlightConfig(
        vehicle=load_vehicle(recipe.vehicle),
        imu=load_imu(recipe.imu),
        trajectory=recipe.trajectory,
        wind=recipe.wind,
        randomisation=recipe.randomisation,
        attitude_error=recipe.attitude_error,
        hand_held=recipe.hand_held,
        ground=recipe.ground,
        engine=recipe.engine,
        warmup_s=recipe.warmup_s,
    )
