"""Recipes: TOML files that define the flights of a dataset."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from ..config.ranges import Between
from ..config.toml import Model, Strict, load_toml, merged, parse
from ..imu.spec import ImuSpec, load_imu
from ..trajectory.specs import Mix, Trajectory
from ..vehicle import Vehicle, load_vehicle
from .hand_held import HandHeld
from .scenario import Surroundings


class AttitudeError(Strict):
    """Errors of the roll and pitch that the controller receives, like those of an estimator in the loop.

    The error of each angle is a first-order Gauss-Markov process, so the vehicle moves as with a real
    estimator.
    """

    sd_deg: Annotated[float, Between(0.0, 15.0, "°")] = 0.0
    """Standard deviation [deg]."""
    time_s: Annotated[float, Between(1e-3, 60.0, "s")] = 0.3
    """Correlation time [s]."""

    def series(
        self, n_steps: int, rate_hz: float, seeds: Sequence[np.random.SeedSequence]
    ) -> NDArray[np.float64]:
        """Draw stationary errors of roll and pitch, one flight per seed, (n, steps, 2) [rad]."""
        from scipy.signal import lfilter  # takes half a second

        white = np.stack([np.random.default_rng(seed).normal(size=(n_steps, 2)) for seed in seeds])
        decay = math.exp(-1.0 / (rate_hz * self.time_s))
        white[:, 1:] *= math.sqrt(1.0 - decay**2)
        return math.radians(self.sd_deg) * np.asarray(lfilter([1.0], [1.0, -decay], white, axis=1))


def _by_name(load: Callable[[str], Model], model: type[Model]) -> BeforeValidator:
    """Load a model that is given by its name."""

    def read(given: Any) -> Any:
        if isinstance(given, str):
            return load(given)
        return parse(given, model, "") if isinstance(given, dict) else given

    return BeforeValidator(read)


NamedImu: TypeAlias = Annotated[ImuSpec, _by_name(load_imu, ImuSpec)]
"""A shipped IMU, the path of a TOML file, or a table."""


class Recipe(Surroundings):
    """A kind of flight to generate, for training and testing. Every dataset stores its complete recipe."""

    description: str = Field(default="", exclude=True)
    """Purpose of these flights, in one sentence."""
    vehicle: Annotated[Vehicle, _by_name(load_vehicle, Vehicle)] = Field(
        default="hummingbird", validate_default=True
    )
    """A shipped vehicle, or the path of a TOML file."""
    imu: NamedImu = Field(default="adis16448", validate_default=True)
    """A shipped IMU, or the path of a TOML file."""
    trajectory: Trajectory = Mix()
    """Trajectory of the flights."""
    attitude_error: AttitudeError = AttitudeError()
    """Error of the roll and pitch that the controller receives."""
    hand_held: HandHeld | None = None
    """Hand-held motion of an IMU without a vehicle, instead of a flight."""
    ground: bool = False
    """Whether flights start at rest on sloping ground. The same number of samples is dropped from their
    end."""
    warmup_s: Annotated[float, Between(0.0, 60.0, "s")] = 4.0
    """Time that is simulated before the recording starts, so that flights begin in motion [s]."""

    @model_validator(mode="after")
    def _has_no_delay(self) -> "Recipe":
        if self.randomisation.delay:
            raise ValueError("randomisation.delay: a dataset has no external sensor, so omit this key")
        return self


class Variant(Strict):
    """A recipe with changes."""

    recipe: str
    """A shipped recipe, or a TOML file."""
    changes: dict[str, Any] = Field(default={})
    """Changed keys of the recipe. Other keys of a table keep their values."""


def load_recipe(source: str | Path) -> Recipe:
    """Read a recipe: a shipped name ("hummingbird") or a TOML file, whose paths start from its folder."""
    return load_toml(source, "recipes", Recipe)


def changed_recipe(source: str | Path, changes: Mapping[str, Any], label: str) -> Recipe:
    """Load a recipe and change some of its keys.

    Args:
        source: A shipped name or a TOML file.
        changes: New values by key; in a table, only the given keys change.
        label: Name of the changes in error messages.

    Raises:
        ValueError: One line with the label, the key, its value and what is allowed.
    """
    base = load_recipe(source)
    trajectory = changes.get("trajectory")
    if isinstance(trajectory, dict) and trajectory.get("kind", base.trajectory.kind) != base.trajectory.kind:
        raise ValueError(
            f"{label}: trajectory.kind = {trajectory['kind']!r}: another kind of trajectory has other keys; "
            "write a recipe file of your own, and give --recipe FILE.toml"
        )
    return parse(merged(base.model_dump(mode="json"), changes), Recipe, label)
