"""The plant: n multirotors in MuJoCo, driven by rotor-speed commands and wind, one sample at a time."""

import logging
import math
from collections.abc import Sequence
from importlib import resources
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from .config.ranges import SAMPLE_RATE
from .rotation import euler_core, rotate_inverse_core
from .rotors import aerodynamic_wrench, angular_acceleration, lag, vehicle_records
from .runs.compiled import njit
from .vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

# the engine would otherwise write a file into the working directory for every vehicle that diverges
mujoco.set_mju_user_warning(logging.getLogger(__name__).info)

FLIGHT_STEP = 0.005
"""Longest RK4 step [s]: within 1e-5° of a converged solution over an aggressive manoeuvre."""
CONTACT_STEP = 0.001
"""Longest step where the ground can be touched [s]."""

POSE = np.dtype([("position", "f8", 3), ("quat", "f8", 4)])
"""A row of MuJoCo's qpos: centre of mass, world [m], and quat_WB."""
TWIST = np.dtype([("velocity", "f8", 3), ("ang_vel", "f8", 3)])
"""A row of its qvel: of the centre of mass, world [m/s], and body rate, body axes [rad/s]."""
WRENCH = np.dtype([("force", "f8", 3), ("moment", "f8", 3)])
"""A row of its ctrl, in body axes, or of its qfrc_constraint, force in world axes [N, N m]."""


class State(NamedTuple):
    """Everything about n vehicles at one instant."""

    position: Array  #: (n, 3) centre of mass, world [m]
    velocity: Array  #: (n, 3) of the centre of mass, world [m/s]
    quat: Array  #: (n, 4) quat_WB
    ang_vel: Array  #: (n, 3) body rate, body axes [rad/s]
    rotor_vel: Array  #: (n, rotors) rotor speeds [rad/s]
    specific_force: Array  #: (n, 3) what an ideal accelerometer at the centre of mass reads, body axes [m/s²]
    ang_acc: Array  #: (n, 3) angular acceleration, body axes [rad/s²]


def mjcf(vehicle: Vehicle, timestep: float, integrator: str = "RK4", contact: bool = False) -> str:
    """The MuJoCo model of one vehicle as XML."""
    return (
        (resources.files("assets") / "quadrotor.xml")
        .read_text(encoding="utf-8")
        .format(
            name=vehicle.name,
            timestep=repr(timestep),
            integrator=integrator,
            gravity=GRAVITY,
            contact="enable" if contact else "disable",
            mass=repr(vehicle.mass),
            inertia=" ".join(map(repr, vehicle.inertia)),
            size=" ".join(map(repr, vehicle.frame.size)),
        )
    )


@njit(cache=True, inline="always")
def air_velocity(p, q, velocity):
    """Velocity relative to the air, body axes, a tuple [m/s]."""
    vx, vy, vz = velocity[0] - p.wind[0], velocity[1] - p.wind[1], velocity[2] - p.wind[2]
    return rotate_inverse_core(q[0], q[1], q[2], q[3], vx, vy, vz)


@njit(cache=True, inline="always")
def actuate(rotor_vel_cmd, vehicles, pose, twist, wrench):
    """Advance the rotors by one step of the engine and write the wrench, averaged over it.

    Rotor lag is exact. Drag is taken at mid-step from the current acceleration: second order in dt.

    Args:
        rotor_vel_cmd: (n, rotors) commanded rotor speeds [rad/s].
        vehicles: (n,) records of `vehicle_dtype`.
        pose: (n,) records of `POSE`.
        twist: (n,) records of `TWIST`.
        wrench: (n,) records of `WRENCH`, written.
    """
    speed = np.empty(rotor_vel_cmd.shape[1])
    square = np.empty(rotor_vel_cmd.shape[1])
    for k in range(vehicles.shape[0]):
        p, q, w, out = vehicles[k], pose[k].quat, twist[k].ang_vel, wrench[k]
        half = 0.5 * p.dt
        for i in range(p.rotor_vel.shape[0]):
            ref = min(max(rotor_vel_cmd[k, i], 0.0), p.omega_max)
            now = p.rotor_vel[i]
            tau = p.tau_up if ref > now else p.tau_down
            p.rotor_vel[i], speed[i], square[i] = lag(now, ref, tau, p.dt)
        vx, vy, vz = air_velocity(p, q, twist[k].velocity)
        gx, gy, gz = rotate_inverse_core(q[0], q[1], q[2], q[3], 0.0, 0.0, -GRAVITY)
        ax = p.specific_force[0] + gx - (w[1] * vz - w[2] * vy)
        ay = p.specific_force[1] + gy - (w[2] * vx - w[0] * vz)
        az = p.specific_force[2] + gz - (w[0] * vy - w[1] * vx)
        midpoint_vel = (vx + half * ax, vy + half * ay, vz + half * az)
        midpoint_rate = (w[0] + half * p.ang_acc[0], w[1] + half * p.ang_acc[1], w[2] + half * p.ang_acc[2])
        out.force[0], out.force[1], out.force[2], out.moment[0], out.moment[1], out.moment[2] = (
            aerodynamic_wrench(p, speed, square, midpoint_vel, midpoint_rate)
        )


@njit(cache=True, inline="always")
def update_truth(vehicles, pose, twist, reaction):
    """Write specific force, angular acceleration and Euler angles of this instant, ground reaction included.

    reaction: (n,) records of `WRENCH`, or none in free flight; the others as for `actuate`.
    """
    square = np.empty(vehicles[0].rotor_vel.shape[0])
    for k in range(vehicles.shape[0]):
        p, q, w = vehicles[k], pose[k].quat, (twist[k].ang_vel[0], twist[k].ang_vel[1], twist[k].ang_vel[2])
        for i in range(p.rotor_vel.shape[0]):
            square[i] = p.rotor_vel[i] * p.rotor_vel[i]
        air_vel = air_velocity(p, q, twist[k].velocity)
        fx, fy, fz, mx, my, mz = aerodynamic_wrench(p, p.rotor_vel, square, air_vel, w)
        if reaction.shape[0] > 0:
            ground, moment = reaction[k].force, reaction[k].moment
            cx, cy, cz = rotate_inverse_core(q[0], q[1], q[2], q[3], ground[0], ground[1], ground[2])
            fx, fy, fz = fx + cx, fy + cy, fz + cz
            mx, my, mz = mx + moment[0], my + moment[1], mz + moment[2]
        f, a = p.specific_force, p.ang_acc
        f[0], f[1], f[2] = fx / p.mass, fy / p.mass, fz / p.mass
        a[0], a[1], a[2] = angular_acceleration(p.inertia, (mx, my, mz), w)
        p.roll_pitch[0], p.roll_pitch[1], p.yaw = euler_core(q[0], q[1], q[2], q[3])


class Plant:
    """n multirotors, stepped together at the sample rate.

    `position`, `velocity`, `quat`, `ang_vel`, `rotor_vel`, `specific_force` and `ang_acc` are views of the
    current state, all of one instant; `step` returns copies. `rotor_effect` (n, rotors) scales the thrust of
    each rotor and may be written at any time; `set_mass` changes masses in flight. `vehicles`, `pose`,
    `twist`, `wrench` and `reaction` are the records that `actuate` and `update_truth` take.

    Args:
        vehicle: One vehicle for all, or a sequence of n of them (as many rotors, own numbers).
        n: Number of vehicles.
        rate_hz: Samples per second; each is one RK4 step of at most 5 ms (1 ms with contact), or several.
        integrator: A MuJoCo integrator: "RK4", or "implicitfast", "Euler", "implicit".
        contact: Whether the ground can be touched: take-off, landing, crashes.

    Raises:
        ValueError: For a rate or a number of vehicles that is not positive, or an unknown integrator.
    """

    def __init__(
        self,
        vehicle: Vehicle | Sequence[Vehicle],
        n: int = 1,
        rate_hz: float = 200.0,
        integrator: str = "RK4",
        contact: bool = False,
    ) -> None:
        if n < 1:
            raise ValueError(f"n is {n}; a plant needs at least one vehicle")
        SAMPLE_RATE.of("rate_hz", rate_hz)
        integrators = [name.removeprefix("mjINT_") for name in mujoco.mjtIntegrator.__members__]
        if integrator.upper() not in [name.upper() for name in integrators]:
            raise ValueError(
                f"unknown integrator {integrator!r}; choose one of RK4, implicitfast, implicit, Euler"
            )
        vehicles = [vehicle] * n if isinstance(vehicle, Vehicle) else list(vehicle)
        if len(vehicles) != n:
            raise ValueError(f"{len(vehicles)} vehicles were given for n = {n}")
        if len({len(each.rotors) for each in vehicles}) > 1:
            raise ValueError("the vehicles of one plant must have the same number of rotors")
        self.n, self.rate_hz, self.dt, self.contact = n, rate_hz, 1.0 / rate_hz, contact
        self.vehicle = vehicles[0]
        self.substeps = math.ceil(self.dt / (CONTACT_STEP if contact else FLIGHT_STEP) - 1e-9)
        self.vehicles = vehicle_records(vehicles, self.dt / self.substeps)
        xml = mjcf(self.vehicle, self.dt / self.substeps, integrator, contact)
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.batch = Batch(self.model, n, nthread=1)
        self.pose, self.twist = self._bind("qpos", POSE), self._bind("qvel", TWIST)
        self.wrench = self._bind("ctrl", WRENCH)
        self.reaction = self._bind("qfrc_constraint", WRENCH) if contact else np.empty(0, WRENCH)
        self._stage = (mujoco.mjtStage.mjSTAGE_ACC if contact else mujoco.mjtStage.mjSTAGE_NONE).value
        self.position, self.quat = self.pose["position"], self.pose["quat"]
        self.velocity, self.ang_vel = self.twist["velocity"], self.twist["ang_vel"]
        self.rotor_vel, self.rotor_effect = self.vehicles["rotor_vel"], self.vehicles["effect"]
        self.specific_force, self.ang_acc = self.vehicles["specific_force"], self.vehicles["ang_acc"]
        self.roll_pitch, self.yaw = self.vehicles["roll_pitch"], self.vehicles["yaw"]
        self.wind = self.vehicles["wind"]
        if any(v is not vehicles[0] for v in vehicles):
            self._write_inertia()
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
        """Place the vehicles; what is not given is hover at rest, level, 1 m above the ground.

        Args:
            position: (m, 3) [m], world.
            velocity: (m, 3) [m/s], world.
            quat: (m, 4) quat_WB, normalised here.
            ang_vel: (m, 3) [rad/s], body axes.
            rotor_vel: (m, rotors) [rad/s].
            ids: The m vehicles to reset; None for all.

        Raises:
            ValueError: If an array does not broadcast to its shape, or is not finite.
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
        self.wrench[rows], self.wind[rows] = 0.0, 0.0
        if self.contact:
            self.batch.forward()
        others = np.delete(np.arange(self.n), rows)
        unchanged = self.vehicles[others]
        self._update_truth()
        self.vehicles[others] = unchanged
        return self.state()

    def step(self, rotor_vel_cmd: ArrayLike, wind: ArrayLike | None = None) -> State:
        """Hold a command and a wind over one sample period and return the state at its end.

        Args:
            rotor_vel_cmd: (n, rotors) commanded rotor speeds [rad/s]; clipped to 0…ω_max.
            wind: (n, 3) wind velocity, world [m/s]; None for still air.

        Returns:
            The state one sample later. Specific force and rates belong to that same instant.

        Raises:
            ValueError: If an array does not broadcast to its shape, or is not finite.
        """
        command = _rows("rotor_vel_cmd", rotor_vel_cmd, self.rotor_vel.shape, 0.0)
        self.wind[:] = _rows("wind", wind, (self.n, 3), 0.0)
        self._actuate(command)
        self.integrate(command)
        self._update_truth()
        return self.state()

    def integrate(self, rotor_vel_cmd: Array) -> None:
        """`step` without its first `actuate` and last `update_truth`, for loops that compile these two."""
        self.batch.step(stage=self._stage)
        for _ in range(self.substeps - 1):
            self._update_truth()
            self._actuate(rotor_vel_cmd)
            self.batch.step(stage=self._stage)

    def state(self) -> State:
        """Copies of the live arrays."""
        return State(*(getattr(self, name).copy() for name in State._fields))

    def set_mass(self, mass: ArrayLike) -> None:
        """Change the masses, (n,) [kg], the inertia in proportion: a payload taken up or dropped."""
        new = _rows("mass", mass, (self.n,), 0.0)
        if np.any(new <= 0):
            raise ValueError(f"mass is {new.min()} kg; it must be positive")
        self.vehicles["inertia"] *= (new / self.vehicles["mass"])[:, None]
        self.vehicles["mass"] = new
        self._write_inertia()

    def _bind(self, name: str, record: np.dtype) -> NDArray[np.void]:
        """The engine's rows of all vehicles as records, (n,)."""
        return self.batch.bind(name).view(record)[:, 0]

    def _actuate(self, rotor_vel_cmd: Array) -> None:
        actuate(rotor_vel_cmd, self.vehicles, self.pose, self.twist, self.wrench)

    def _update_truth(self) -> None:
        update_truth(self.vehicles, self.pose, self.twist, self.reaction)

    def _write_inertia(self) -> None:
        body = self.model.body("quadrotor").id
        self.batch.expand("body_mass")[:, body] = self.vehicles["mass"]
        self.batch.expand("body_inertia")[:, body] = self.vehicles["inertia"]
        self.batch.set_const()


def _rows(name: str, value: ArrayLike | None, shape: tuple[int, ...], default: ArrayLike) -> Array:
    """Broadcast an argument to its shape, or name it in the error."""
    array = np.asarray(default if value is None else value, dtype=np.float64)
    try:
        full = np.ascontiguousarray(np.broadcast_to(array, shape))
    except ValueError:
        raise ValueError(f"{name} has shape {array.shape}; it must broadcast to {shape}") from None
    if not np.all(np.isfinite(full)):
        raise ValueError(f"{name} is not finite: {array[~np.isfinite(array)].flat[0]}")
    return full
