"""Faults of the vehicle: its mass, its rotors and the position of its IMU."""

from collections.abc import Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import Arm, Between, Instant, Mass, Share
from ..config.toml import Strict
from ..plant import Plant
from ..vehicle import MAX_ROTORS


class Timed(Strict):
    """A fault that begins in flight."""

    at_s: Instant
    """Start time [s]."""


class LeverArm(Strict):
    """The IMU is not at the centre of mass, and estimators are not given its position."""

    kind: Literal["lever-arm"]
    position: Arm
    """Displacement in addition to the IMU's own `lever_arm`, in body axes [m]."""


class PayloadDrop(Timed):
    """The vehicle drops a payload, whose mass is not known to the controller."""

    kind: Literal["payload-drop"]
    mass: Mass
    """Mass of the payload [kg]."""


class ThrustLoss(Timed):
    """One or all rotors produce less thrust, for example because of a chipped blade or an empty battery."""

    kind: Literal["thrust-loss"]
    rotor: Annotated[int, Between(0, MAX_ROTORS - 1)] | None = None
    """Index of the rotor, in the order of the vehicle's file; default: all rotors."""
    effect: Share
    """Share of the thrust that remains at the end."""
    fade_s: Instant = 0.0
    """Duration of the loss [s]; 0 for a sudden loss."""


class GroundEffect(Strict):
    """Near the ground, the rotors produce 1 / (1 − (R / 4z)²) times the thrust at the same speed.

    R is the radius of the rotors and z the height of the centre of mass, at least R / 2. The equation is that
    of hover in Cheeseman & Bennett, "The effect of the ground on a helicopter rotor in forward flight", ARC
    R&M 3021 (1955).
    """

    kind: Literal["ground-effect"]


VehicleFault: TypeAlias = PayloadDrop | ThrustLoss | GroundEffect | LeverArm


class VehicleFaults:
    """Applies faults of the vehicle to the plant. Call `apply` before every step."""

    def __init__(self, faults: Sequence[Strict], plant: Plant) -> None:
        """Select the faults of the vehicle among all faults; `any` is true if there are some.

        Raises:
            ValueError: A fault names a rotor that the vehicle does not have.
        """
        rotors = plant.rotor_vel.shape[1]
        for fault in faults:
            if isinstance(fault, ThrustLoss) and (fault.rotor or 0) >= rotors:
                raise ValueError(f"faults: rotor = {fault.rotor}: this vehicle has rotors 0 to {rotors - 1}")
        self._plant = plant
        self._payloads = [fault for fault in faults if isinstance(fault, PayloadDrop)]
        self._rotors = [fault for fault in faults if isinstance(fault, ThrustLoss | GroundEffect)]
        self.any = bool(self._payloads or self._rotors)
        self._empty = plant.vehicles["mass"].copy()
        self._mass = self._empty.copy()

    def restart(self, ids: NDArray[np.int64], mass: ArrayLike) -> None:
        """Set the masses (m,) [kg] and the healthy rotors of some vehicles."""
        self._empty[ids] = mass
        if self._payloads:
            self._mass[ids] = mass
            self._plant.set_mass(self._mass)
        self._plant.rotor_effect[ids] = 1.0

    def apply(self, k: NDArray[np.int64]) -> None:
        """Set masses and rotors to their values during the step that begins at sample k (n,)."""
        time = k / self._plant.rate_hz
        if self._payloads:
            mass = self._empty + sum(fault.mass * (time < fault.at_s) for fault in self._payloads)
            if not np.array_equal(mass, self._mass):
                self._plant.set_mass(mass)
                self._mass = mass
        if self._rotors:
            effect = self._plant.rotor_effect
            effect[:] = 1.0
            for fault in self._rotors:
                if isinstance(fault, GroundEffect):
                    radius = self._plant.vehicle.frame.prop_radius
                    height = np.maximum(self._plant.position[:, 2], radius / 2)
                    effect /= (1.0 - (radius / (4.0 * height)) ** 2)[:, None]
                else:
                    age = time - fault.at_s
                    faded = np.clip(age / fault.fade_s, 0.0, 1.0) if fault.fade_s else age >= 0.0
                    rotors = slice(None) if fault.rotor is None else [fault.rotor]
                    effect[:, rotors] *= 1.0 - (1.0 - fault.effect) * faded[:, None]
