"""Compiled equations of rotors and frame: lag, and force and moment by thrust, H-force and drag."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..runs.compiled import njit
from ..vehicle import AIR_DENSITY, Vehicle


@cache
def state_dtype(rotors: int) -> np.dtype:
    """Return the record type of the state of a vehicle with this many rotors.

    Fields are as in `quadsim.plant.State`.
    """
    return np.dtype(
        [
            ("position", "f8", 3),
            ("velocity", "f8", 3),
            ("quat", "f8", 4),
            ("ang_vel", "f8", 3),
            ("specific_force", "f8", 3),
            ("rotor_vel", "f8", rotors),
            ("ang_acc", "f8", 3),
            ("wind", "f8", 3),  # on the way to it, world axes [m/s]
            ("rotor_vel_cmd", "f8", rotors),
        ]
    )


@cache
def vehicle_dtype(rotors: int) -> np.dtype:
    """Return the record type of a vehicle with this many rotors: constants, state, and scratch space."""
    return np.dtype(
        [
            ("mass", "f8"),
            ("inertia", "f8", 3),
            ("k_f", "f8"),
            ("k_m", "f8"),
            ("omega_max", "f8"),
            ("tau_up", "f8"),
            ("tau_down", "f8"),
            ("rotor_drag", "f8"),
            ("rolling_moment", "f8"),
            ("frame_drag", "f8", 3),  # ½ ρ C_d A per body axis
            ("hub", "f8", (rotors, 3)),
            ("reaction", "f8", rotors),  # +1 where the yaw reaction is along +z
            ("effect", "f8", rotors),  # thrust relative to a healthy rotor
            ("dt", "f8"),  # of one step of the engine
            ("state", state_dtype(rotors)),
            ("mean_speed", "f8", rotors),  # of the rotors over the step,
            ("mean_square", "f8", rotors),  # and of their squares
            ("force", "f8", 3),  # aerodynamic, body axes, constant over the step [N],
            ("moment", "f8", 3),  # and its moment [N m]
            ("ground_force", "f8", 3),  # reaction of the ground, world axes [N],
            ("ground_moment", "f8", 3),  # and its moment, body axes [N m]
            ("roll_pitch", "f8", 2),
            ("yaw", "f8"),
        ],
        align=True,
    )


def vehicle_records(vehicles: list[Vehicle], dt: float) -> NDArray[np.void]:
    """Return records of vehicles with healthy rotors at rest, shape (n,).

    Dt is the step of the engine [s].
    """
    records = np.zeros(len(vehicles), vehicle_dtype(len(vehicles[0].rotors)))
    for record, vehicle in zip(records, vehicles, strict=True):
        record["mass"], record["inertia"] = vehicle.mass, vehicle.inertia
        for name, value in vehicle.motor.model_dump().items():
            record[name] = value
        record["frame_drag"] = [0.5 * AIR_DENSITY * area for area in vehicle.frame.drag_area]
        record["hub"], record["reaction"] = vehicle.hubs, vehicle.reactions
    records["effect"], records["dt"] = 1.0, dt
    return records


@njit(cache=True)
def lag(omega, ref, tau, dt):
    """Apply a first-order lag towards ref for dt.

    Return final speed, mean, and mean square over the interval.

    The solution ω(t) = ref + (ω − ref) e^{−t/τ} is exact at any call rate.
    """
    decay = math.exp(-dt / tau)
    gap = omega - ref
    mean_gap = gap * (1.0 - decay) * tau / dt
    mean_square = ref * ref + 2.0 * ref * mean_gap + gap * gap * (1.0 - decay * decay) * tau / (2.0 * dt)
    return ref + gap * decay, ref + mean_gap, mean_square


@njit(cache=True)
def aerodynamic_wrench(p, speed, square, air_vel, ang_vel):
    """Return aerodynamic force and moment on the vehicle, body axes, about the centre of mass.

    Each rotor has thrust k_f ω² along z, H-force −c |ω| V⊥, moment r × F, reaction torque k_m k_f ω² and
    rolling moment −c_r |ω| V⊥ (RotorS, gazebo_motor_model; Martin & Salaün 2010). V⊥ is the velocity of the
    hub relative to the air, in the rotor plane. The drag of the frame is −½ ρ C_d A |v| v per axis.

    Args:
        p: Record of the vehicle.
        speed: (rotors,) rotor speed [rad/s].
        square: (rotors,) squared rotor speed, instantaneous or averaged over a step [rad²/s²].
        air_vel: Air-relative velocity of the centre of mass, body axes, a tuple [m/s].
        ang_vel: Body rate, a tuple [rad/s].

    Returns:
        (fx, fy, fz, mx, my, mz) [N, N m].
    """
    vx, vy, vz = air_vel
    wx, wy, wz = ang_vel
    mean_speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    fx = -p.frame_drag[0] * mean_speed * vx
    fy = -p.frame_drag[1] * mean_speed * vy
    fz = -p.frame_drag[2] * mean_speed * vz
    mx = my = mz = 0.0
    for i in range(p.reaction.shape[0]):
        x, y, z = p.hub[i, 0], p.hub[i, 1], p.hub[i, 2]
        hub_vx = vx + wy * z - wz * y
        hub_vy = vy + wz * x - wx * z
        thrust = p.k_f * p.effect[i] * square[i]
        hx = -p.rotor_drag * speed[i] * hub_vx
        hy = -p.rotor_drag * speed[i] * hub_vy
        rolling = -p.rolling_moment * speed[i]
        fx += hx
        fy += hy
        fz += thrust
        mx += y * thrust - z * hy + rolling * hub_vx
        my += z * hx - x * thrust + rolling * hub_vy
        mz += x * hy - y * hx + p.reaction[i] * p.k_m * thrust
    return fx, fy, fz, mx, my, mz


@njit(cache=True)
def angular_acceleration(inertia, moment, ang_vel):
    """Return the angular acceleration, I ω̇ = M − ω × I ω, in principal body axes, a tuple [rad/s²]."""
    mx, my, mz = moment
    wx, wy, wz = ang_vel
    ax = (mx - (inertia[2] - inertia[1]) * wy * wz) / inertia[0]
    ay = (my - (inertia[0] - inertia[2]) * wz * wx) / inertia[1]
    az = (mz - (inertia[1] - inertia[0]) * wx * wy) / inertia[2]
    return ax, ay, az
