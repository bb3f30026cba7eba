"""Cascaded quadrotor control, compiled and batched: position → velocity → attitude → body rate → rotors.

Each stage takes the output of the one before it, so that a command can enter at any level:

| level    | command, one row per vehicle                                                              |
|----------|-------------------------------------------------------------------------------------------|
| position | position (3) [m], velocity (3) [m/s], acceleration (3) [m/s²], yaw [rad], yaw rate [rad/s] |
| velocity | velocity (3) [m/s], yaw [rad]                                                             |
| attitude | roll, pitch, yaw [rad], collective thrust per mass [m/s²]                                 |
| rate     | roll, pitch, yaw rate, body axes [rad/s], collective thrust per mass [m/s²]               |
| rotor    | four rotor speeds [rad/s]                                                                 |

Gains come from `quadsim.control.gains`. Roll and pitch come from the attitude estimator; the rest of the
state comes from an external position sensor.
"""

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..rotation import from_euler_core, rotate_core, rotate_inverse_core
from ..runs.compiled import njit
from ..vehicle import GRAVITY, Gains, Vehicle

Array = NDArray[np.float64]
Level = Literal["position", "velocity", "attitude", "rate", "rotor"]
LEVELS: tuple[Level, ...] = get_args(Level)
WIDTH = {"position": 11, "velocity": 4, "attitude": 4, "rate": 4, "rotor": 4}
"""Numbers in a command of each level."""

MAX_TILT = math.radians(60.0)
MAX_SPEED_ERROR = 5.0  # m/s that the position error may ask for
MAX_RATE = 8.0  # rad/s that the tilt error may ask for
MAX_YAW_RATE = 2.0  # rad/s that the yaw error may ask for
MAX_WIND_ACCELERATION = 6.0  # m/s², bound of the velocity integral: holds against 12 m/s of wind
MAX_TRIM = 0.2  # bound of the rate integral over the largest angular acceleration
IDLE = 0.05  # lowest rotor speed commanded in flight, over the highest

POSITION, VELOCITY, ATTITUDE, RATE, ROTOR = range(5)
# columns of the controller's memory
_SPEED, _TRIM, _AXIS, _SEEN = 0, 3, 6, 9
_MEMORY = 10


@njit(cache=True)
def _clip_norm(x, y, z, limit):
    norm = math.sqrt(x * x + y * y + z * z)
    scale = limit / norm if norm > limit else 1.0
    return x * scale, y * scale, z * scale


@njit(cache=True, inline="always")
def _velocity_stage(g, dt, memory, velocity, want_x, want_y, want_z, ax, ay, az):
    """PI on velocity plus feed-forward: the acceleration to ask for, world [m/s²]."""
    ex, ey, ez = want_x - velocity[0], want_y - velocity[1], want_z - velocity[2]
    ki = g[7] * dt
    memory[_SPEED], memory[_SPEED + 1], memory[_SPEED + 2] = _clip_norm(
        memory[_SPEED] + ki * ex,
        memory[_SPEED + 1] + ki * ey,
        memory[_SPEED + 2] + ki * ez,
        MAX_WIND_ACCELERATION,
    )
    return (
        ax + g[6] * ex + memory[_SPEED],
        ay + g[6] * ey + memory[_SPEED + 1],
        az + g[6] * ez + memory[_SPEED + 2],
    )


@njit(cache=True)
def _thrust_direction(ax, ay, az):
    """Unit thrust axis and size of the specific force for an acceleration, the tilt limited to MAX_TILT."""
    fz = max(az + GRAVITY, 0.3 * GRAVITY)
    lateral = math.sqrt(ax * ax + ay * ay)
    scale = min(1.0, fz * math.tan(MAX_TILT) / lateral) if lateral > 0.0 else 1.0
    fx, fy = ax * scale, ay * scale
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    return fx / size, fy / size, fz / size, size


@njit(cache=True, inline="always")
def _attitude_stage(g, q, zx, zy, zz, yaw_error):
    """P on tilt and yaw: the body rate to ask for; z: wanted thrust axis (Brescianini & D'Andrea 2018)."""
    bx, by, bz = rotate_inverse_core(q[0], q[1], q[2], q[3], zx, zy, zz)
    sine = math.sqrt(bx * bx + by * by)
    angle = math.atan2(sine, bz)
    gain = g[4] * angle / sine if sine > 1e-9 else g[4]
    p, r, _ = _clip_norm(-by * gain, bx * gain, 0.0, MAX_RATE)
    error = math.atan2(math.sin(yaw_error), math.cos(yaw_error))
    return p, r, min(max(g[5] * error, -MAX_YAW_RATE), MAX_YAW_RATE)


@njit(cache=True, inline="always")
def _rate_stage(g, c, dt, memory, gyro, p, q, r, out):
    """PI on body rate: the torque to ask for, gyroscopic term included [N m]."""
    want = (p, q, r)
    for i in range(3):
        proportional, integral = (g[0], g[1]) if i < 2 else (g[2], g[3])
        error = want[i] - gyro[i]
        bound = MAX_TRIM * c[4 + i]
        memory[_TRIM + i] = min(max(memory[_TRIM + i] + integral * dt * error, -bound), bound)
        out[i] = c[1 + i] * (proportional * error + memory[_TRIM + i])
    out[0] += (c[3] - c[2]) * gyro[1] * gyro[2]
    out[1] += (c[1] - c[3]) * gyro[2] * gyro[0]
    out[2] += (c[2] - c[1]) * gyro[0] * gyro[1]


@njit(cache=True, inline="always")
def _allocate(c, inverse, thrust, torque, out):
    """Rotor speeds for thrust and torque; what does not fit gives way: yaw first, then thrust."""
    low, high = (IDLE * c[7]) ** 2, c[7] * c[7]
    most, least = -math.inf, math.inf
    for i in range(4):
        out[i] = inverse[i, 0] * thrust + inverse[i, 1] * torque[0] + inverse[i, 2] * torque[1]
        most, least = max(most, out[i]), min(least, out[i])
    shift = min(high - most, 0.0)
    shift += max(low - (least + shift), 0.0)
    room = 1.0
    for i in range(4):
        out[i] += shift
        yaw = inverse[i, 3] * torque[2]
        if yaw > 0.0:
            room = min(room, max(high - out[i], 0.0) / yaw)
        elif yaw < 0.0:
            room = min(room, max(out[i] - low, 0.0) / -yaw)
    for i in range(4):
        out[i] = math.sqrt(min(max(out[i] + room * inverse[i, 3] * torque[2], low), high))


@njit(cache=True, inline="always")
def control(level, command, position, velocity, attitude, yaw, gyro, g, c, inverse, dt, memory, axis, out):
    """One step of the cascade for n vehicles.

    Args:
        level: 0 position … 4 rotor.
        command: (n, width of the level).
        position: (n, 3) world [m].
        velocity: (n, 3) world [m/s].
        attitude: (n, 2) estimated roll and pitch [rad].
        yaw: (n,) [rad].
        gyro: (n, 3) measured body rate [rad/s].
        g: Gains, in the order of `quadsim.vehicle.Gains`.
        c: (8,) mass, inertia (3), largest angular acceleration (3), largest rotor speed.
        inverse: (4, 4) from thrust and torque to squared rotor speed.
        dt: Sample period [s].
        memory: (n, 10), changed in place.
        axis: (n, 3), written: the thrust axis asked for, world; as it was where the command is a lower one.
        out: (n, 4) commanded rotor speeds [rad/s].
    """
    torque = np.empty(3)
    for k in range(command.shape[0]):
        u, m = command[k], memory[k]
        if level == ROTOR:
            for i in range(4):
                out[k, i] = min(max(u[i], 0.0), c[7])
            continue
        q = from_euler_core(attitude[k, 0], attitude[k, 1], yaw[k])
        if level == RATE:
            p, r, s, specific = u[0], u[1], u[2], u[3]
        else:
            forward_x = forward_y = forward_yaw = 0.0
            if level == ATTITUDE:
                w = from_euler_core(u[0], u[1], u[2])
                zx, zy, zz = rotate_core(w[0], w[1], w[2], w[3], 0.0, 0.0, 1.0)
                want_yaw, specific = u[2], u[3]
            else:
                if level == POSITION:
                    ex, ey, ez = _clip_norm(
                        g[8] * (u[0] - position[k, 0]),
                        g[8] * (u[1] - position[k, 1]),
                        g[8] * (u[2] - position[k, 2]),
                        MAX_SPEED_ERROR,
                    )
                    ax, ay, az = _velocity_stage(
                        g, dt, m, velocity[k], u[3] + ex, u[4] + ey, u[5] + ez, u[6], u[7], u[8]
                    )
                    want_yaw, forward_yaw = u[9], u[10]
                    # the reference's own tilt rate, fed forward: ω = z × ż of its thrust axis
                    rx, ry, rz, _ = _thrust_direction(u[6], u[7], u[8])
                    if m[_SEEN] > 0.0:
                        px, py, pz = m[_AXIS], m[_AXIS + 1], m[_AXIS + 2]
                        forward_x, forward_y, _ = rotate_inverse_core(
                            q[0], q[1], q[2], q[3],
                            (py * rz - pz * ry) / dt, (pz * rx - px * rz) / dt, (px * ry - py * rx) / dt,
                        )  # fmt: skip
                        forward_x, forward_y, _ = _clip_norm(forward_x, forward_y, 0.0, MAX_RATE)
                    m[_AXIS], m[_AXIS + 1], m[_AXIS + 2], m[_SEEN] = rx, ry, rz, 1.0
                else:
                    ax, ay, az = _velocity_stage(g, dt, m, velocity[k], u[0], u[1], u[2], 0.0, 0.0, 0.0)
                    want_yaw = u[3]
                zx, zy, zz, size = _thrust_direction(ax, ay, az)
                bx, by, bz = rotate_core(q[0], q[1], q[2], q[3], 0.0, 0.0, 1.0)
                # only the part of the wanted force along the estimated thrust axis can be made now
                specific = size * max(zx * bx + zy * by + zz * bz, 0.2)
            axis[k, 0], axis[k, 1], axis[k, 2] = zx, zy, zz
            p, r, s = _attitude_stage(g, q, zx, zy, zz, want_yaw - yaw[k])
            p, r, s = p + forward_x, r + forward_y, s + forward_yaw
        _rate_stage(g, c, dt, m, gyro[k], p, r, s, torque)
        _allocate(c, inverse, c[0] * specific, torque, out[k])


class Controller:
    """The cascade for n vehicles of one type, with its integrators.

    After a step, `rotor_vel_cmd` (n, 4) holds its command and `thrust_axis` (n, 3) where it wants the thrust
    to point, world axes. `arrays` are the last arguments of `control`, for kernels that call it.

    Args:
        vehicle: The nominal vehicle; its `controller` gains are used, or designed when it has none.
        n: Number of vehicles.
        rate_hz: Samples per second.
        gains: Other gains than the vehicle's.
    """

    def __init__(
        self, vehicle: Vehicle, n: int = 1, rate_hz: float = 200.0, gains: Gains | None = None
    ) -> None:
        self.n, self.dt = n, 1.0 / rate_hz
        self.gains = gains or vehicle.controller or _designed(vehicle, rate_hz)
        g = np.array(list(self.gains.model_dump().values()))
        arms = np.abs(vehicle.allocation[1:]).sum(axis=1) / 2 * vehicle.motor.omega_max**2
        c = np.array([vehicle.mass, *vehicle.inertia, *(arms / vehicle.inertia), vehicle.motor.omega_max])
        inverse = np.linalg.inv(vehicle.allocation)
        self._memory = np.zeros((n, _MEMORY))
        self.rotor_vel_cmd = np.full((n, 4), vehicle.hover_rotor_vel)
        self.thrust_axis = np.tile([0.0, 0.0, 1.0], (n, 1))
        self.arrays = (g, c, inverse, self.dt, self._memory, self.thrust_axis, self.rotor_vel_cmd)

    def reset(self, ids: NDArray[np.int_] | slice = slice(None)) -> None:
        """Clear the integrators of some vehicles."""
        self._memory[ids] = 0.0

    def step(
        self,
        level: Level,
        command: Array,
        position: Array,
        velocity: Array,
        attitude: Array,
        yaw: Array,
        gyro: Array,
    ) -> Array:
        """Rotor speeds (n, 4) [rad/s] for a command at a level; the array is reused by the next call.

        Args:
            level: Where in the cascade the command enters.
            command: (n, width) as in the table of this module.
            position: (n, 3) world [m].
            velocity: (n, 3) world [m/s].
            attitude: (n, 2) estimated roll and pitch [rad].
            yaw: (n,) [rad].
            gyro: (n, 3) measured body rate [rad/s].
        """
        control(LEVELS.index(level), command, position, velocity, attitude, yaw, gyro, *self.arrays)
        return self.rotor_vel_cmd


def _designed(vehicle: Vehicle, rate_hz: float) -> Gains:
    from .gains import design  # imports `control`, which takes a second

    return design(vehicle, rate_hz)
