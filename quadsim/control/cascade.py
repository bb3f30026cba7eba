"""Cascaded quadrotor control, compiled and batched: position → velocity → attitude → body rate → rotors.

Each stage takes the output of the one before it, so that a command can enter at any level:

| level    | command, one row per vehicle                                                              |
|----------|-------------------------------------------------------------------------------------------|
| position | position (3) [m], velocity (3) [m/s], acceleration (3) [m/s²], yaw [rad], yaw rate [rad/s] |
| velocity | velocity (3) [m/s], yaw [rad]                                                             |
| attitude | roll, pitch, yaw [rad], collective thrust per mass [m/s²]                                 |
| rate     | roll, pitch, yaw rate, body axes [rad/s], collective thrust per mass [m/s²]               |
| rotor    | rotor speeds (rotors) [rad/s]                                                             |

A command is an array of floats with these columns, or of records: `SET_POINT` at the first two levels; at the
others the fields `attitude_cmd`, `rate_cmd`, `thrust_cmd` and `rotor_vel_cmd` of the controller's record.

The compiled functions handle one vehicle. They take the level's number (0 position … 4 rotor), u, a record of
`SET_POINT`, m, a record of `MEASURED`, and c, a record of `controller_dtype`, which they change.

Gains come from `quadsim.control.gains`. Roll and pitch come from the attitude estimator; the rest of the
state comes from an external position sensor.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..rotation import from_euler_core, rotate_core, rotate_inverse_core
from ..runs.compiled import njit
from ..vehicle import GRAVITY, Vehicle
from .records import ATTITUDE, POSITION, RATE, ROTOR, SET_POINT, Command, Level, controller_dtype

Array = NDArray[np.float64]

MAX_TILT = math.radians(60.0)
MAX_SPEED_ERROR = 5.0  # m/s that the position error may ask for
MAX_RATE = 8.0  # rad/s that the tilt error may ask for
MAX_YAW_RATE = 2.0  # rad/s that the yaw error may ask for
MAX_WIND_ACCELERATION = 6.0  # m/s², bound of the velocity integral: holds against 12 m/s of wind
MAX_TRIM = 0.2  # bound of the rate integral over the largest angular acceleration
IDLE = 0.05  # lowest rotor speed commanded in flight, over the highest


@njit(cache=True)
def _clip_norm(x, y, z, limit):
    norm = math.sqrt(x * x + y * y + z * z)
    scale = limit / norm if norm > limit else 1.0
    return x * scale, y * scale, z * scale


@njit(cache=True)
def _velocity_stage(c, velocity, wanted, feedforward):
    """Return the commanded acceleration in world axes, PI on velocity plus feed-forward, a tuple [m/s²]."""
    g, integral = c.gains, c.wind_acc
    ex, ey, ez = wanted[0] - velocity[0], wanted[1] - velocity[1], wanted[2] - velocity[2]
    ki = g.velocity_integral * c.dt
    integral[0], integral[1], integral[2] = _clip_norm(
        integral[0] + ki * ex, integral[1] + ki * ey, integral[2] + ki * ez, MAX_WIND_ACCELERATION
    )
    return (
        feedforward[0] + g.velocity * ex + integral[0],
        feedforward[1] + g.velocity * ey + integral[1],
        feedforward[2] + g.velocity * ez + integral[2],
    )


@njit(cache=True)
def _thrust_direction(ax, ay, az):
    """Return thrust axis and magnitude of the specific force for an acceleration, with limited tilt."""
    fz = max(az + GRAVITY, 0.3 * GRAVITY)
    lateral = math.sqrt(ax * ax + ay * ay)
    scale = min(1.0, fz * math.tan(MAX_TILT) / lateral) if lateral > 0.0 else 1.0
    fx, fy = ax * scale, ay * scale
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    return fx / size, fy / size, fz / size, size


@njit(cache=True)
def _attitude_stage(g, q, axis, yaw_error):
    """Return the commanded body rate, P on tilt and yaw (Brescianini & D'Andrea 2018)."""
    bx, by, bz = rotate_inverse_core(q[0], q[1], q[2], q[3], axis[0], axis[1], axis[2])
    sine = math.sqrt(bx * bx + by * by)
    angle = math.atan2(sine, bz)
    gain = g.attitude * angle / sine if sine > 1e-9 else g.attitude
    p, r, _ = _clip_norm(-by * gain, bx * gain, 0.0, MAX_RATE)
    error = math.atan2(math.sin(yaw_error), math.cos(yaw_error))
    return p, r, min(max(g.yaw * error, -MAX_YAW_RATE), MAX_YAW_RATE)


@njit(cache=True)
def _rate_stage(c, gyro, wanted):
    """Return the commanded torque, PI on body rate, a tuple [N m]."""
    g, acc = c.gains, c.ang_acc_cmd
    for i in range(3):
        proportional, integral = (g.rate, g.rate_integral) if i < 2 else (g.yaw_rate, g.yaw_rate_integral)
        error = wanted[i] - gyro[i]
        bound = MAX_TRIM * c.max_ang_acc[i]
        c.trim[i] = min(max(c.trim[i] + integral * c.dt * error, -bound), bound)
        acc[i] = proportional * error + c.trim[i]
    return _torque(c, gyro)


@njit(cache=True)
def _torque(c, gyro):
    """Return the torque for the commanded angular acceleration, with gyroscopic term, a tuple [N m]."""
    inertia, acc = c.inertia, c.ang_acc_cmd
    return (
        inertia[0] * acc[0] + (inertia[2] - inertia[1]) * gyro[1] * gyro[2],
        inertia[1] * acc[1] + (inertia[0] - inertia[2]) * gyro[2] * gyro[0],
        inertia[2] * acc[2] + (inertia[1] - inertia[0]) * gyro[0] * gyro[1],
    )


@njit(cache=True)
def _allocate(c, thrust, torque):
    """Write rotor speeds for thrust and torque.

    At the limits, reduce first the yaw torque and then the thrust.
    """
    out = c.rotor_vel_cmd
    low, high = (IDLE * c.max_rotor_vel) ** 2, c.max_rotor_vel * c.max_rotor_vel
    most, least = -math.inf, math.inf
    for i in range(out.shape[0]):
        out[i] = c.per_thrust[i] * thrust + c.per_roll[i] * torque[0] + c.per_pitch[i] * torque[1]
        most, least = max(most, out[i]), min(least, out[i])
    shift = min(high - most, 0.0)
    shift += max(low - (least + shift), 0.0)
    room = 1.0
    for i in range(out.shape[0]):
        out[i] += shift
        yaw = c.per_yaw[i] * torque[2]
        if yaw > 0.0:
            room = min(room, max(high - out[i], 0.0) / yaw)
        elif yaw < 0.0:
            room = min(room, max(out[i] - low, 0.0) / -yaw)
    for i in range(out.shape[0]):
        out[i] = math.sqrt(min(max(out[i] + room * c.per_yaw[i] * torque[2], low), high))


@njit(cache=True)
def _tilt_rate(c, q, target):
    """Return and store the x and y body rate at which the set-point's thrust axis z turns, ω = z × ż."""
    acceleration, last = target.acceleration, c.last_axis
    x = y = 0.0
    rx, ry, rz, _ = _thrust_direction(acceleration[0], acceleration[1], acceleration[2])
    if c.has_last_axis:
        px, py, pz = last[0], last[1], last[2]
        x, y, _ = rotate_inverse_core(
            q[0], q[1], q[2], q[3],
            (py * rz - pz * ry) / c.dt, (pz * rx - px * rz) / c.dt, (px * ry - py * rx) / c.dt,
        )  # fmt: skip
        x, y, _ = _clip_norm(x, y, 0.0, MAX_RATE)
    last[0], last[1], last[2], c.has_last_axis = rx, ry, rz, 1
    return x, y


@njit(cache=True)
def _guide(level, u, m, c):
    """Run the loops above the body rate.

    Return the commanded rate, a tuple [rad/s], and thrust per mass [m/s²].

    The commanded thrust axis is written to the record.
    """
    g, q = c.gains, from_euler_core(m.roll_pitch[0], m.roll_pitch[1], m.yaw)
    thrust, tilt_rate = c.thrust_cmd, (0.0, 0.0)
    if level == ATTITUDE:
        yaw = c.attitude_cmd[2]
        w = from_euler_core(c.attitude_cmd[0], c.attitude_cmd[1], yaw)
        axis = rotate_core(w[0], w[1], w[2], w[3], 0.0, 0.0, 1.0)
    else:
        yaw, v, a = u.yaw, u.velocity, u.acceleration
        if level == POSITION:
            ex, ey, ez = _clip_norm(
                g.position * (u.position[0] - m.position[0]),
                g.position * (u.position[1] - m.position[1]),
                g.position * (u.position[2] - m.position[2]),
                MAX_SPEED_ERROR,
            )
            wanted = (v[0] + ex, v[1] + ey, v[2] + ez)
            ax, ay, az = _velocity_stage(c, m.velocity, wanted, (a[0], a[1], a[2]))
            tilt_rate = _tilt_rate(c, q, u)
        else:
            ax, ay, az = _velocity_stage(c, m.velocity, (v[0], v[1], v[2]), (0.0, 0.0, 0.0))
        zx, zy, zz, size = _thrust_direction(ax, ay, az)
        axis = (zx, zy, zz)
        bx, by, bz = rotate_core(q[0], q[1], q[2], q[3], 0.0, 0.0, 1.0)
        # only the part of the commanded force along the estimated thrust axis can be made now
        thrust = size * max(zx * bx + zy * by + zz * bz, 0.2)
    c.thrust_axis[0], c.thrust_axis[1], c.thrust_axis[2] = axis
    p, r, s = _attitude_stage(g, q, axis, yaw - m.yaw)
    forward_yaw = u.yaw_rate if level == POSITION else 0.0
    return (p + tilt_rate[0], r + tilt_rate[1], s + forward_yaw), thrust


@njit(cache=True)
def control(level, u, m, c):
    """Run one step of the cascade and write `rotor_vel_cmd` of the record.

    The set-point u is read only at the levels position and velocity.
    """
    if level == ROTOR:
        for i in range(c.rotor_vel_cmd.shape[0]):
            c.rotor_vel_cmd[i] = min(max(c.rotor_vel_cmd[i], 0.0), c.max_rotor_vel)
        return
    if level == RATE:
        rate, thrust = (c.rate_cmd[0], c.rate_cmd[1], c.rate_cmd[2]), c.thrust_cmd
    else:
        rate, thrust = _guide(level, u, m, c)
    _allocate(c, c.mass * thrust, _rate_stage(c, m.gyro, rate))


@njit(cache=True)
def attitude_set_point(level, u, m, c, out):
    """Compute the set-point of an attitude controller that replaces the inner loops.

    The set-point is written to out (4,): roll, pitch [rad], yaw rate [rad/s] and thrust per mass [m/s²]. The
    cascade's own body-rate command is written to `rate_cmd` of the record. The level must be position,
    velocity or attitude.
    """
    rate, out[3] = _guide(level, u, m, c)
    c.rate_cmd[0], c.rate_cmd[1], c.rate_cmd[2] = rate
    axis, cos, sin = c.thrust_axis, math.cos(m.yaw), math.sin(m.yaw)
    across = cos * axis[1] - sin * axis[0]
    out[0] = -math.asin(min(max(across, -1.0), 1.0))
    out[1] = math.atan2(cos * axis[0] + sin * axis[1], axis[2])
    out[2] = rate[2]


@njit(cache=True)
def apply_action(m, c, action):
    """Write the rotor speeds for an action to `rotor_vel_cmd` of the record.

    Args:
        m: Measured state.
        c: Controller.
        action: (4,) angular acceleration, body axes [rad/s²], and thrust per mass [m/s²].
    """
    for i in range(3):
        c.ang_acc_cmd[i] = min(max(action[i], -c.max_ang_acc[i]), c.max_ang_acc[i])
    _allocate(c, c.mass * max(action[3], 0.0), _torque(c, m.gyro))


class Controller:
    """The cascade for n vehicles of one type, with its integrators.

    `control` writes its command to `rotor_vel_cmd` (n, rotors). `records` (n,) are the arguments of the
    compiled functions.

    Args:
        vehicle: The nominal vehicle. If it has no `controller` gains, they are designed.
        n: Number of vehicles.
        rate_hz: Samples per second.
        records: (n,) records of `controller_dtype` to use, for loops with larger records.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        n: int = 1,
        rate_hz: float = 200.0,
        records: NDArray[np.void] | None = None,
    ) -> None:
        self.gains = vehicle.controller
        if self.gains is None:
            from .gains import design  # imports `control`, which takes a second

            self.gains = design(vehicle, rate_hz)
        self.records = np.zeros(n, controller_dtype(len(vehicle.rotors))) if records is None else records
        c, allocation = self.records, vehicle.allocation
        mixer = np.linalg.inv(allocation) if len(vehicle.rotors) == 4 else np.linalg.pinv(allocation)
        torque = np.abs(allocation[1:]).sum(axis=1) / 2 * vehicle.motor.omega_max**2
        c["dt"], c["gains"] = 1.0 / rate_hz, tuple(self.gains.model_dump().values())
        c["mass"], c["inertia"], c["max_ang_acc"] = vehicle.mass, vehicle.inertia, torque / vehicle.inertia
        c["max_rotor_vel"] = vehicle.motor.omega_max
        c["per_thrust"], c["per_roll"], c["per_pitch"], c["per_yaw"] = mixer.T
        c["rotor_vel_cmd"], c["thrust_axis"] = vehicle.hover_rotor_vel, (0.0, 0.0, 1.0)
        self.rotor_vel_cmd = c["rotor_vel_cmd"]
        self._set_points = np.zeros(n, SET_POINT)

    def reset(self, ids: NDArray[np.int_] | slice = slice(None)) -> None:
        """Clear the integrators of some vehicles."""
        for name in ("wind_acc", "trim", "has_last_axis"):
            self.records[name][ids] = 0

    def accept(self, level: Level, command: Command) -> NDArray[np.void]:
        """Write a command of floats, (n, width) as in the table of this module, to the records.

        Returns:
            The set-points (n,) for `control`; records are returned unchanged.
        """
        if command.dtype.names:
            return command
        c, out = self.records, self._set_points
        match level:
            case "position":
                return np.ascontiguousarray(command).view(SET_POINT)[:, 0]
            case "velocity":
                out["velocity"], out["yaw"] = command[:, :3], command[:, 3]
            case "attitude":
                c["attitude_cmd"], c["thrust_cmd"] = command[:, :3], command[:, 3]
            case "rate":
                c["rate_cmd"], c["thrust_cmd"] = command[:, :3], command[:, 3]
            case "rotor":
                c["rotor_vel_cmd"] = command
        return out
