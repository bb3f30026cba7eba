"""Rotors and frame: first-order lag, thrust, H-force and drag as one body wrench. Pure equations, compiled.

Each vehicle's constants travel as one row of a (n, PARAMETERS) array, so that every vehicle of a batch can
have its own; the indices below name the columns.
"""

import math

import numpy as np
from numpy.typing import NDArray

from .runs.compiled import njit
from .vehicle import AIR_DENSITY, Vehicle

MASS, IXX, IYY, IZZ, K_F, K_M, OMEGA_MAX, TAU_UP, TAU_DOWN, ROTOR_DRAG, ROLLING, DRAG_X, DRAG_Y, DRAG_Z = (
    range(14)
)
EFFECT = 14  # four columns: thrust of each rotor relative to a healthy one
PARAMETERS = EFFECT + 4


def parameter_row(vehicle: Vehicle) -> NDArray[np.float64]:
    """The vehicle's constants as one row, shape (PARAMETERS,)."""
    m = vehicle.motor
    motor = [m.k_f, m.k_m, m.omega_max, m.tau_up, m.tau_down, m.rotor_drag, m.rolling_moment]
    quadratic = [0.5 * AIR_DENSITY * area for area in vehicle.frame.drag_area]
    return np.array([vehicle.mass, *vehicle.inertia, *motor, *quadratic, 1.0, 1.0, 1.0, 1.0])


@njit(cache=True, inline="always")
def lag(omega, ref, tau, dt):
    """First-order lag over dt towards ref: the speed at the end, its mean and mean square over the interval.

    ω(t) = ref + (ω − ref) e^{−t/τ}, so the answer is exact and the same at any call rate.
    """
    decay = math.exp(-dt / tau)
    gap = omega - ref
    mean_gap = gap * (1.0 - decay) * tau / dt
    mean_square = ref * ref + 2.0 * ref * mean_gap + gap * gap * (1.0 - decay * decay) * tau / (2.0 * dt)
    return ref + gap * decay, ref + mean_gap, mean_square


@njit(cache=True, inline="always")
def wrench(p, hubs, speed, square, vx, vy, vz, wx, wy, wz):
    """Aerodynamic force and moment on the vehicle, body axes, about the centre of mass.

    Rotor i: thrust k_f ω² along z, H-force −c |ω| V⊥, moments r × F, reaction torque k_m k_f ω² and
    −c_r |ω| V⊥ (RotorS, gazebo_motor_model; Martin & Salaün 2010), V⊥ the hub's air-relative velocity in the
    rotor plane. Frame: −½ ρ C_d A |v| v per axis.

    Args:
        p: One parameter row.
        hubs: (4, 4) hub positions [m] and reaction sense.
        speed: (4,) rotor speed [rad/s].
        square: (4,) squared rotor speed [rad²/s²]: of this instant, or its mean over a step.
        vx: Air-relative velocity of the centre of mass, body axes [m/s]; vy and vz likewise.
        vy: See vx.
        vz: See vx.
        wx: Body rate [rad/s]; wy and wz likewise.
        wy: See wx.
        wz: See wx.

    Returns:
        (fx, fy, fz) [N] and (mx, my, mz) [N m] as one tuple.
    """
    mean_speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    fx = -p[DRAG_X] * mean_speed * vx
    fy = -p[DRAG_Y] * mean_speed * vy
    fz = -p[DRAG_Z] * mean_speed * vz
    mx = my = mz = 0.0
    for i in range(4):
        x, y, z, reaction = hubs[i, 0], hubs[i, 1], hubs[i, 2], hubs[i, 3]
        hub_vx = vx + wy * z - wz * y
        hub_vy = vy + wz * x - wx * z
        thrust = p[K_F] * p[EFFECT + i] * square[i]
        hx = -p[ROTOR_DRAG] * speed[i] * hub_vx
        hy = -p[ROTOR_DRAG] * speed[i] * hub_vy
        rolling = -p[ROLLING] * speed[i]
        fx += hx
        fy += hy
        fz += thrust
        mx += y * thrust - z * hy + rolling * hub_vx
        my += z * hx - x * thrust + rolling * hub_vy
        mz += x * hy - y * hx + reaction * p[K_M] * thrust
    return fx, fy, fz, mx, my, mz


@njit(cache=True, inline="always")
def angular_acceleration(p, mx, my, mz, wx, wy, wz):
    """Euler's equation I ω̇ = M − ω × I ω, principal body axes [rad/s²]."""
    ax = (mx - (p[IZZ] - p[IYY]) * wy * wz) / p[IXX]
    ay = (my - (p[IXX] - p[IZZ]) * wz * wx) / p[IYY]
    az = (mz - (p[IYY] - p[IXX]) * wx * wy) / p[IZZ]
    return ax, ay, az
