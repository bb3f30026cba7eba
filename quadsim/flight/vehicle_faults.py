"""Faults of the vehicle: its mass, its rotors, the place of its IMU; what they do to the plant."""

from collections.abc import Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import Arm, Between, Duration, Instant, Mass, Share
from ..config.toml import Strict
from ..plant import Plant
from ..vehicle import MAX_ROTORS


class Event(Strict):
    """A fault that happens at one instant."""

    at_s: Instant = 5.0
    """Time of the event [s]."""


class LeverArm(Strict):
    """The IMU is not at the centre of mass, and no estimator knows this."""

    kind: Literal["lever-arm"]
    position: Arm
    """Displacement in addition to the IMU's own `lever_arm`, in body axes [m]."""


class PayloadDrop(Event):
    """The vehicle starts with a payload that the controller does not know, and drops it."""

    kind: Literal["payload-drop"]
    mass: Mass
    """Mass of the payload [kg]."""


class RotorLoss(Event):
    """From some time on, one rotor produces less thrust, for example because of a chipped blade."""

    kind: Literal["rotor-loss"]
    rotor: Annotated[int, Between(0, MAX_ROTORS - 1)] = 0
    """Index of the rotor, in the order of the vehicle's file."""
    effect: Share = 0.7
    """Remaining thrust, as a share of that of an intact rotor."""


class LowBattery(Strict):
    """The thrust of all rotors fades with the battery."""

    kind: Literal["low-battery"]
    effect: Share = 0.7
    """Remaining share of the thrust at the end."""
    at_s: Instant = 2.0
    """When it begins to fade [s]."""
    fade_s: Duration = 10.0
    """Duration of the fading [s]."""


class GroundEffect(Strict):
    """Near the ground, the rotors produce 1 / (1 − (R / 4z)²) times the thrust at the same speed.

    R is the rotors' radius, z the height of the centre of mass, at least R / 2. Cheeseman & Bennett, "The
    effect of the ground on a helicopter rotor in forward flight", ARC R&M 3021 (1955), in hover.
    """

    kind: Literal["ground-effect"]


VehicleFault: TypeAlias = PayloadDrop | RotorLoss | LowBattery | GroundEffect | LeverArm


class VehicleFaults:
    """What the faults do to the plant: `apply` before every step, with every vehicle's count of samples."""

    def __init__(self, faults: Sequence[Strict], plant: Plant) -> None:
        """Take the faults of the vehicle out of all; `any` tells whether there are some.

        Raises:
            ValueError: If a rotor fails that the vehicle does not have.
        """
        rotors = plant.rotor_vel.shape[1]
        for fault in faults:
            if isinstance(fault, RotorLoss) and fault.rotor >= rotors:
                raise ValueError(f"faults: rotor = {fault.rotor}: this vehicle has rotors 0 to {rotors - 1}")
        self._plant = plant
        self._payloads = [fault for fault in faults if isinstance(fault, PayloadDrop)]
        self._rotors = [fault for fault in faults if isinstance(fault, RotorLoss | LowBattery | GroundEffect)]
        self.any = bool(self._payloads or self._rotors)
        self._empty = plant.vehicles["mass"].copy()
        self._mass = self._empty.copy()

    def restart(self, ids: NDArray[np.int64], mass: ArrayLike) -> None:
        """Give some vehicles their mass, (m,) [kg], and the rotors that they have before `apply`."""
        self._empty[ids] = mass
        if self._payloads:
            self._mass[ids] = mass
            self._plant.set_mass(self._mass)
        self._plant.rotor_effect[ids] = 1.0

    def apply(self, k: NDArray[np.int64]) -> None:
        """Set masses and rotors to what they are during the step from sample k (n,) on."""
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
                if isinstance(fault, RotorLoss):
                    effect[time >= fault.at_s, fault.rotor] *= fault.effect
                elif isinstance(fault, GroundEffect):
                    radius = self._plant.vehicle.frame.prop_radius
                    height = np.maximum(self._plant.position[:, 2], radius / 2)
                    effect /= (1.0 - (radius / (4.0 * height)) ** 2)[:, None]
                else:
                    faded = np.clip((time - fault.at_s) / fault.fade_s, 0.0, 1.0)
                    effect *= 1.0 - (1.0 - fault.effect) * faded[:, None]
