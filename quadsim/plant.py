"""The plant: n multirotors in MuJoCo, driven by rotor-speed commands and wind, one sample at a time."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .config.ranges import ENGINES, SAMPLE_RATE, Engine
from .estimator import broadcast
from .motion.engine import MujocoEngine, vehicle_model
from .motion.free_body import advance_body
from .motion.rotors import aerodynamic_wrench, angular_acceleration, lag, vehicle_records
from .rotation import euler_core, rotate_inverse_core
from .runs.compiled import njit
from .vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

FLIGHT_STEP = 0.005
"""Longest RK4 step [s]; the error is below 1e-5° over an aggressive manoeuvre."""
CONTACT_STEP = 0.001
"""Longest step with ground contact [s]."""


class State(NamedTuple):
    """State of n vehicles at one instant."""

    position: Array  #: (n, 3) centre of mass, world [m]
    velocity: Array  #: (n, 3) of the centre of mass, world [m/s]
    quat: Array  #: (n, 4) quat_WB
    ang_vel: Array  #: (n, 3) body rate, body axes [rad/s]
    rotor_vel: Array  #: (n, rotors) rotor speeds [rad/s]
    specific_force: Array  #: (n, 3) what an ideal accelerometer at the centre of mass reads, body axes [m/s²]
    ang_acc: Array  #: (n, 3) angular acceleration, body axes [rad/s²]


@njit(cache=True)
def air_velocity(p):
    """Return the velocity relative to the air, body axes, a tuple [m/s]."""
    q, v, wind = p.state.quat, p.state.velocity, p.state.wind
    return rotate_inverse_core(q[0], q[1], q[2], q[3], v[0] - wind[0], v[1] - wind[1], v[2] - wind[2])


@njit(cache=True)
def actuate(p):
    """Advance the rotors of one vehicle by a step, and write force and moment averaged over the step.

    The rotor lag is exact. Drag is computed at mid-step from the current acceleration, which is second order
    in dt.

    Args:
        p: Record of `vehicle_dtype`; the commanded rotor speeds are in its state.
    """
    s, half = p.state, 0.5 * p.dt
    q, w, speed, force, acc = s.quat, s.ang_vel, s.rotor_vel, s.specific_force, s.ang_acc
    for i in range(speed.shape[0]):
        ref = min(max(s.rotor_vel_cmd[i], 0.0), p.omega_max)
        tau = p.tau_up if ref > speed[i] else p.tau_down
        speed[i], p.mean_speed[i], p.mean_square[i] = lag(speed[i], ref, tau, p.dt)
    vx, vy, vz = air_velocity(p)
    gx, gy, gz = rotate_inverse_core(q[0], q[1], q[2], q[3], 0.0, 0.0, -GRAVITY)
    ax = force[0] + gx - (w[1] * vz - w[2] * vy)
    ay = force[1] + gy - (w[2] * vx - w[0] * vz)
    az = force[2] + gz - (w[0] * vy - w[1] * vx)
    midpoint_vel = (vx + half * ax, vy + half * ay, vz + half * az)
    midpoint_rate = (w[0] + half * acc[0], w[1] + half * acc[1], w[2] + half * acc[2])
    f, m = p.force, p.moment
    f[0], f[1], f[2], m[0], m[1], m[2] = aerodynamic_wrench(
        p, p.mean_speed, p.mean_square, midpoint_vel, midpoint_rate
    )


@njit(cache=True)
def update_truth(p):
    """Write specific force, angular acceleration and Euler angles of this instant, ground reaction included.

    Args:
        p: Record of `vehicle_dtype`.
    """
    q, rate, speed = p.state.quat, p.state.ang_vel, p.state.rotor_vel
    w = rate[0], rate[1], rate[2]
    for i in range(speed.shape[0]):
        p.mean_square[i] = speed[i] * speed[i]
    fx, fy, fz, mx, my, mz = aerodynamic_wrench(p, speed, p.mean_square, air_velocity(p), w)
    ground, moment = p.ground_force, p.ground_moment
    cx, cy, cz = rotate_inverse_core(q[0], q[1], q[2], q[3], ground[0], ground[1], ground[2])
    f, a = p.state.specific_force, p.state.ang_acc
    f[0], f[1], f[2] = (fx + cx) / p.mass, (fy + cy) / p.mass, (fz + cz) / p.mass
    moments = (mx + moment[0], my + moment[1], mz + moment[2])
    a[0], a[1], a[2] = angular_acceleration(p.inertia, moments, w)
    p.roll_pitch[0], p.roll_pitch[1], p.yaw = euler_core(q[0], q[1], q[2], q[3])


@njit(cache=True)
def move_freely(p, substeps):
    """Move one vehicle in free flight by a sample, without updating its specific force."""
    for i in range(substeps):
        if i:
            update_truth(p)
        actuate(p)
        advance_body(p)


@njit(cache=True)
def actuate_all(vehicles):
    """Run `actuate` for all vehicles (n,)."""
    for i in range(vehicles.shape[0]):
        actuate(vehicles[i])


@njit(cache=True)
def update_truth_all(vehicles):
    """Run `update_truth` for all vehicles (n,)."""
    for i in range(vehicles.shape[0]):
        update_truth(vehicles[i])


@njit(cache=True)
def fly_all(vehicles, substeps):
    """Run `move_freely` for all vehicles (n,)."""
    for i in range(vehicles.shape[0]):
        move_freely(vehicles[i], substeps)


class Plant:
    """A batch of n multirotors, stepped together at the sample rate.

    `position`, `velocity`, `quat`, `ang_vel`, `rotor_vel`, `specific_force` and `ang_acc` are views of the
    current state, all at the same instant; `step` returns copies. `rotor_effect` (n, rotors) scales the
    thrust of each rotor and can be changed at any time. `set_mass` changes masses in flight. `vehicles` are
    the records for `move_freely` and `update_truth`.

    Args:
        vehicle: One vehicle for all, or a sequence of n vehicles with the same number of rotors.
        n: Number of vehicles.
        rate_hz: Samples per second. A sample takes one or several RK4 steps of at most 5 ms (1 ms with
            contact).
        integrator: A MuJoCo integrator: "RK4", or "implicitfast", "Euler", "implicit".
        contact: Whether the ground can be touched: take-off, landing, crashes.
        engine: "mujoco", or "auto", which uses a compiled version of MuJoCo's RK4 for a free body where
            possible.
        records: (n,) records of `quadsim.motion.rotors.vehicle_dtype` to use, for loops with larger records.

    Raises:
        ValueError: The rate or the number of vehicles is not positive, or the integrator or the engine is
            unknown.
    """

    def __init__(
        self,
        vehicle: Vehicle | Sequence[Vehicle],
        n: int = 1,
        rate_hz: float = 200.0,
        integrator: str = "RK4",
        contact: bool = False,
        engine: Engine = "auto",
        records: NDArray[np.void] | None = None,
    ) -> None:
        if n < 1:
            raise ValueError(f"n is {n}; a plant needs at least one vehicle")
        SAMPLE_RATE.of("rate_hz", rate_hz)
        if engine not in ENGINES:
            raise ValueError(f"unknown engine {engine!r}; choose one of {', '.join(ENGINES)}")
        vehicles = [vehicle] * n if isinstance(vehicle, Vehicle) else list(vehicle)
        if len(vehicles) != n:
            raise ValueError(f"{len(vehicles)} vehicles were given for n = {n}")
        if len({len(each.rotors) for each in vehicles}) > 1:
            raise ValueError("the vehicles of one plant must have the same number of rotors")
        self.n, self.rate_hz, self.dt, self.contact = n, rate_hz, 1.0 / rate_hz, contact
        self.vehicle = vehicles[0]
        self.substeps = math.ceil(self.dt / (CONTACT_STEP if contact else FLIGHT_STEP) - 1e-9)
        step = self.dt / self.substeps
        made = vehicle_records(vehicles, step)
        self.vehicles = made if records is None else records
        self.vehicles[:] = made
        self.engine = None
        if engine == "mujoco" or contact or integrator != "RK4":
            model = vehicle_model(self.vehicle, step, integrator, contact)
            self.engine = MujocoEngine(model, self.vehicles, contact)
        v, s = self.vehicles, self.vehicles["state"]
        self.position, self.velocity, self.quat, self.ang_vel = (
            s[name] for name in ("position", "velocity", "quat", "ang_vel")
        )
        self.rotor_vel, self.specific_force, self.ang_acc = s["rotor_vel"], s["specific_force"], s["ang_acc"]
        self.wind, self.rotor_vel_cmd = s["wind"], s["rotor_vel_cmd"]
        self.rotor_effect, self.roll_pitch, self.yaw = v["effect"], v["roll_pitch"], v["yaw"]
        self.reset()

    def reset(
        self,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
        rotor_vel: ArrayLike | None = None,
        ids: ArrayLike | None = None,
    ) -> State:
        """Place the vehicles; the default is level hover at rest, 1 m above the ground.

        Args:
            position: Position in world axes (m, 3) [m].
            velocity: Velocity in world axes (m, 3) [m/s].
            quat: Attitude quat_WB (m, 4), which is normalised.
            ang_vel: Body rate, body axes (m, 3) [rad/s].
            rotor_vel: Rotor speeds (m, rotors) [rad/s].
            ids: The m vehicles to reset; None for all.

        Raises:
            ValueError: An array does not broadcast to its shape or is not finite.
        """
        rows = np.arange(self.n) if ids is None else np.asarray(ids, dtype=int)
        rotors, some = self.rotor_vel.shape[1], self.vehicles[rows]
        hover = np.sqrt(some["mass"] * GRAVITY / (rotors * some["k_f"]))
        q = _rows("quat", quat, (rows.size, 4), (1.0, 0.0, 0.0, 0.0))
        norm = np.linalg.norm(q, axis=-1, keepdims=True)
        if np.any(norm == 0):
            raise ValueError("quat has length zero; give a rotation, for example (1, 0, 0, 0)")
        self.position[rows] = _rows("position", position, (rows.size, 3), (0.0, 0.0, 1.0))
        self.quat[rows] = q / norm
        self.velocity[rows] = _rows("velocity", velocity, (rows.size, 3), 0.0)
        self.ang_vel[rows] = _rows("ang_vel", ang_vel, (rows.size, 3), 0.0)
        self.rotor_vel[rows] = _rows("rotor_vel", rotor_vel, (rows.size, rotors), hover[:, None])
        self.vehicles["force"][rows] = self.vehicles["moment"][rows] = self.wind[rows] = 0.0
        others = np.delete(np.arange(self.n), rows)
        unchanged = self.vehicles[others]
        if self.engine is not None:
            self.engine.forward()
        update_truth_all(self.vehicles)
        self.vehicles[others] = unchanged
        return self.state()

    def step(self, rotor_vel_cmd: ArrayLike, wind: ArrayLike | None = None) -> State:
        """Apply a command and a wind for one sample period, and return the state at its end.

        Args:
            rotor_vel_cmd: (n, rotors) commanded rotor speeds [rad/s]; clipped to 0…ω_max.
            wind: (n, 3) wind velocity, world [m/s]; None for still air.

        Returns:
            The state one sample later. Specific force and rates belong to the same instant.

        Raises:
            ValueError: An array does not broadcast to its shape or is not finite.
        """
        command = _rows("rotor_vel_cmd", rotor_vel_cmd, self.rotor_vel.shape, 0.0)
        self.wind[:] = _rows("wind", wind, (self.n, 3), 0.0)
        self.rotor_vel_cmd[:] = command
        self.move()
        update_truth_all(self.vehicles)
        return self.state()

    def move(self) -> None:
        """Move all vehicles by a sample with their commands, without updating their specific force."""
        if self.engine is None:
            fly_all(self.vehicles, self.substeps)
            return
        for i in range(self.substeps):
            if i:
                update_truth_all(self.vehicles)
            actuate_all(self.vehicles)
            self.engine.step()

    def state(self) -> State:
        """Return a copy of the current state."""
        return State(*(getattr(self, name).copy() for name in State._fields))

    def exchange(self, ids: NDArray[np.int64], vehicles: Sequence[Vehicle]) -> None:
        """Replace the vehicles `ids` (m,) by others with the same number of rotors; `reset` must follow."""
        self.vehicles[ids] = vehicle_records(list(vehicles), self.vehicles["dt"][0])
        if self.engine is not None:
            self.engine.write_inertia()

    def set_mass(self, mass: ArrayLike) -> None:
        """Change the masses, (n,) [kg], and the inertias in proportion."""
        new = _rows("mass", mass, (self.n,), 0.0)
        if np.any(new <= 0):
            raise ValueError(f"mass is {new.min()} kg; it must be positive")
        self.vehicles["inertia"] *= (new / self.vehicles["mass"])[:, None]
        self.vehicles["mass"] = new
        if self.engine is not None:
            self.engine.write_inertia()


def _rows(name: str, value: ArrayLike | None, shape: tuple[int, ...], default: ArrayLike) -> Array:
    """Return an argument or its default; see `broadcast`."""
    return broadcast(name, default if value is None else value, shape)
