"""A vehicle's constants as a vector, and the motion that the model predicts from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from ..motion.rotors import aerodynamic_wrench, angular_acceleration, lag, vehicle_records
from ..runs.compiled import njit
from ..vehicle import Vehicle
from .signals import Flight

Array = NDArray[np.float64]

UNITS = {
    "motor.k_f": "N s²",
    "motor.k_m": "m",
    "motor.rotor_drag": "N s²/m",
    "motor.rolling_moment": "N s²",
    "motor.tau_up": "s",
    "motor.tau_down": "s",
    "inertia.0": "kg m²",
    "inertia.1": "kg m²",
    "inertia.2": "kg m²",
    "frame.drag_area.0": "m²",
    "frame.drag_area.1": "m²",
    "frame.drag_area.2": "m²",
}
"""Constants that can be fitted, by their path in a vehicle file, and their units."""
DRAG = ("motor.rotor_drag", "motor.rolling_moment", *(f"frame.drag_area.{k}" for k in range(3)))
"""Constants whose fit needs the velocity relative to the air."""
LAGS = ("motor.tau_up", "motor.tau_down")
"""Constants whose fit needs commanded and actual rotor speeds."""


def constant(vehicle: Vehicle, path: str) -> float:
    """Return a constant by its path."""
    name, _, index = path.rpartition(".")
    return float(attrgetter(name)(vehicle)[int(index)] if index.isdigit() else attrgetter(path)(vehicle))


def with_constants(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    """Return the vehicle with other constants, without validation."""
    every = {path: values.get(path, constant(vehicle, path)) for path in UNITS}
    motor = {path.split(".")[1]: value for path, value in every.items() if path.startswith("motor.")}
    inertia, drag_area = (
        tuple(value for path, value in every.items() if path.startswith(f"{name}."))
        for name in ("inertia", "frame.drag_area")
    )
    changed = {
        "motor": vehicle.motor.model_copy(update=motor),
        "frame": vehicle.frame.model_copy(update={"drag_area": drag_area}),
    }
    return vehicle.model_copy(update=changed | {"inertia": inertia, "controller": None})


def predicted(vehicle: Vehicle, flight: Flight, rotor_vel: Array) -> Array:
    """Predict specific force [m/s²] and angular acceleration [rad/s²] with the model, (T, 6).

    Args:
        vehicle: The vehicle.
        flight: The flight, whose body rate and velocity relative to the air are used. An unknown velocity
            counts as 0.
        rotor_vel: Rotor speeds (T, rotors) [rad/s].
    """
    air_vel = np.zeros_like(flight.gyro) if flight.air_vel is None else flight.air_vel
    record = vehicle_records([vehicle], 1.0 / flight.rate_hz)[0]
    out = np.empty((len(flight.gyro), 6))
    _predict(record, rotor_vel, air_vel, flight.gyro, out)
    return out


def lagged(vehicle: Vehicle, flight: Flight, start: Sequence[float] | Array) -> Array:
    """Return rotor speeds that follow the commands with first-order lags, (T, rotors) [rad/s]."""
    assert flight.rotor_vel_cmd is not None
    out = np.empty_like(flight.rotor_vel_cmd)
    motor = vehicle.motor
    out[0] = start
    _follow(flight.rotor_vel_cmd, motor.tau_up, motor.tau_down, motor.omega_max, 1.0 / flight.rate_hz, out)
    return out


@njit(cache=True)
def _predict(record, rotor_vel, air_vel, ang_vel, out):
    for k in range(rotor_vel.shape[0]):
        speed = rotor_vel[k]
        v = (air_vel[k, 0], air_vel[k, 1], air_vel[k, 2])
        w = (ang_vel[k, 0], ang_vel[k, 1], ang_vel[k, 2])
        fx, fy, fz, mx, my, mz = aerodynamic_wrench(record, speed, speed * speed, v, w)
        ax, ay, az = angular_acceleration(record.inertia, (mx, my, mz), w)
        out[k, 0], out[k, 1], out[k, 2] = fx / record.mass, fy / record.mass, fz / record.mass
        out[k, 3], out[k, 4], out[k, 5] = ax, ay, az


@njit(cache=True)
def _follow(commands, tau_up, tau_down, omega_max, dt, out):
    for k in range(1, commands.shape[0]):
        for i in range(commands.shape[1]):
            ref = min(max(commands[k, i], 0.0), omega_max)
            now = out[k - 1, i]
            out[k, i] = lag(now, ref, tau_up if ref > now else tau_down, dt)[0]
