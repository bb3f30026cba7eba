"""The plant: n quadrotors in MuJoCo, driven by rotor-speed commands and wind, one sample at a time."""

import logging
import math
from collections.abc import Sequence
from importlib import resources
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from . import rotors
from .config.ranges import SAMPLE_RATE
from .rotation import rotate_inverse_core
from .runs.compiled import njit
from .vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

# the engine would otherwise write a file into the working directory for every vehicle that diverges
mujoco.set_mju_user_warning(logging.getLogger(__name__).info)

FLIGHT_STEP = 0.005
"""Longest RK4 step [s]: within 1e-5° of a converged solution over an aggressive manoeuvre."""
CONTACT_STEP = 0.001
"""Longest step where the ground can be touched [s]."""


class State(NamedTuple):
    """Everything about n vehicles at one instant."""

    position: Array  #: (n, 3) centre of mass, world [m]
    velocity: Array  #: (n, 3) of the centre of mass, world [m/s]
    quat: Array  #: (n, 4) quat_WB
    ang_vel: Array  #: (n, 3) body rate, body axes [rad/s]
    rotor_vel: Array  #: (n, 4) rotor speeds [rad/s]
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
def actuate(dt, rotor_vel_cmd, wind, ctrl, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc):
    """Advance the rotors by dt and write the wrench, averaged over that step, into ctrl (n, 6).

    Rotor lag is exact. Drag is taken at mid-step from the current acceleration: second order in dt.
    """
    speed = np.empty(4)
    square = np.empty(4)
    half = 0.5 * dt
    for k in range(params.shape[0]):
        p = params[k]
        for i in range(4):
            ref = min(max(rotor_vel_cmd[k, i], 0.0), p[rotors.OMEGA_MAX])
            now = rotor_vel[k, i]
            tau = p[rotors.TAU_UP] if ref > now else p[rotors.TAU_DOWN]
            rotor_vel[k, i], speed[i], square[i] = rotors.lag(now, ref, tau, dt)
        qw, qx, qy, qz = qpos[k, 3], qpos[k, 4], qpos[k, 5], qpos[k, 6]
        wx, wy, wz = qvel[k, 3], qvel[k, 4], qvel[k, 5]
        vx, vy, vz = rotate_inverse_core(
            qw, qx, qy, qz, qvel[k, 0] - wind[k, 0], qvel[k, 1] - wind[k, 1], qvel[k, 2] - wind[k, 2]
        )
        gx, gy, gz = rotate_inverse_core(qw, qx, qy, qz, 0.0, 0.0, -GRAVITY)
        ax = specific_force[k, 0] + gx - (wy * vz - wz * vy)
        ay = specific_force[k, 1] + gy - (wz * vx - wx * vz)
        az = specific_force[k, 2] + gz - (wx * vy - wy * vx)
        ctrl[k, 0], ctrl[k, 1], ctrl[k, 2], ctrl[k, 3], ctrl[k, 4], ctrl[k, 5] = rotors.wrench(
            p, hubs, speed, square,
            vx + half * ax, vy + half * ay, vz + half * az,
            wx + half * ang_acc[k, 0], wy + half * ang_acc[k, 1], wz + half * ang_acc[k, 2],
        )  # fmt: skip


@njit(cache=True, inline="always")
def sense(wind, reaction, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc):
    """Write specific force and angular acceleration of this instant, the ground reaction included.

    reaction: (n, 6) ground force in world axes and moment in body axes, or (0, 6) in free flight.
    """
    square = np.empty(4)
    for k in range(params.shape[0]):
        p = params[k]
        qw, qx, qy, qz = qpos[k, 3], qpos[k, 4], qpos[k, 5], qpos[k, 6]
        wx, wy, wz = qvel[k, 3], qvel[k, 4], qvel[k, 5]
        vx, vy, vz = rotate_inverse_core(
            qw, qx, qy, qz, qvel[k, 0] - wind[k, 0], qvel[k, 1] - wind[k, 1], qvel[k, 2] - wind[k, 2]
        )
        for i in range(4):
            square[i] = rotor_vel[k, i] * rotor_vel[k, i]
        fx, fy, fz, mx, my, mz = rotors.wrench(p, hubs, rotor_vel[k], square, vx, vy, vz, wx, wy, wz)
        if reaction.shape[0] > 0:
            cx, cy, cz = rotate_inverse_core(qw, qx, qy, qz, reaction[k, 0], reaction[k, 1], reaction[k, 2])
            fx, fy, fz = fx + cx, fy + cy, fz + cz
            mx, my, mz = mx + reaction[k, 3], my + reaction[k, 4], mz + reaction[k, 5]
        mass = p[rotors.MASS]
        specific_force[k, 0], specific_force[k, 1], specific_force[k, 2] = fx / mass, fy / mass, fz / mass
        ang_acc[k, 0], ang_acc[k, 1], ang_acc[k, 2] = rotors.angular_acceleration(p, mx, my, mz, wx, wy, wz)


class Plant:
    """n quadrotors, stepped together at the sample rate.

    The current state is held in live arrays (`position`, `velocity`, `quat`, `ang_vel`, `rotor_vel`,
    `specific_force`, `ang_acc`), all of one instant; `step` returns copies. `rotor_effect` (n, 4) scales
    the thrust of each rotor and may be written at any time; `set_mass` changes masses in flight. `arrays` are
    the last arguments of `actuate` and `sense`, for kernels that call these.

    Args:
        vehicle: One vehicle for all, or a sequence of n of them (same layout, own numbers).
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
        self.n, self.rate_hz, self.dt, self.vehicle, self.contact = (
            n,
            rate_hz,
            1.0 / rate_hz,
            vehicles[0],
            contact,
        )
        self.substeps = math.ceil(self.dt / (CONTACT_STEP if contact else FLIGHT_STEP) - 1e-9)
        self.step_dt = self.dt / self.substeps
        self.params = np.stack([rotors.parameter_row(v) for v in vehicles])
        self.rotor_effect = self.params[:, rotors.EFFECT :]
        self.hubs = self.vehicle.hubs
        self.model = mujoco.MjModel.from_xml_string(mjcf(self.vehicle, self.step_dt, integrator, contact))
        self.batch = Batch(self.model, n, nthread=1)
        qpos, qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.reaction = self.batch.bind("qfrc_constraint") if contact else np.empty((0, 6))
        self._stage = (mujoco.mjtStage.mjSTAGE_ACC if contact else mujoco.mjtStage.mjSTAGE_NONE).value
        self.position, self.quat = qpos[:, :3], qpos[:, 3:]
        self.velocity, self.ang_vel = qvel[:, :3], qvel[:, 3:]
        self.rotor_vel = np.empty((n, 4))
        self.specific_force, self.ang_acc = np.zeros((n, 3)), np.zeros((n, 3))
        self.arrays = (
            self.params, self.hubs, qpos, qvel, self.rotor_vel, self.specific_force, self.ang_acc
        )  # fmt: skip
        self._calm = np.zeros((n, 3))
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
            rotor_vel: (m, 4) [rad/s].
            ids: The m vehicles to reset; None for all.

        Raises:
            ValueError: If an array does not broadcast to its shape, or is not finite.
        """
        rows = np.arange(self.n) if ids is None else np.asarray(ids, dtype=int)
        hover = np.sqrt(self.params[rows, rotors.MASS] * GRAVITY / (4 * self.params[rows, rotors.K_F]))
        q = _rows("quat", quat, (rows.size, 4), (1.0, 0.0, 0.0, 0.0))
        norm = np.linalg.norm(q, axis=-1, keepdims=True)
        if np.any(norm == 0):
            raise ValueError("quat has length zero; give a rotation, for example (1, 0, 0, 0)")
        self.position[rows] = _rows("position", position, (rows.size, 3), (0.0, 0.0, 1.0))
        self.quat[rows] = q / norm
        self.velocity[rows] = _rows("velocity", velocity, (rows.size, 3), 0.0)
        self.ang_vel[rows] = _rows("ang_vel", ang_vel, (rows.size, 3), 0.0)
        self.rotor_vel[rows] = _rows("rotor_vel", rotor_vel, (rows.size, 4), hover[:, None])
        self.ctrl[rows] = 0.0
        if self.contact:
            self.batch.forward()
        others = np.delete(np.arange(self.n), rows)  # whose state, in whatever wind, stays as it is
        kept = self.specific_force[others], self.ang_acc[others]
        self._sense(self._calm)
        self.specific_force[others], self.ang_acc[others] = kept
        return self.state()

    def step(self, rotor_vel_cmd: ArrayLike, wind: ArrayLike | None = None) -> State:
        """Hold a command and a wind over one sample period and return the state at its end.

        Args:
            rotor_vel_cmd: (n, 4) commanded rotor speeds [rad/s]; clipped to 0…ω_max.
            wind: (n, 3) wind velocity, world [m/s]; None for still air.

        Returns:
            The state one sample later. Specific force and rates belong to that same instant.

        Raises:
            ValueError: If an array does not broadcast to its shape, or is not finite.
        """
        command = _rows("rotor_vel_cmd", rotor_vel_cmd, (self.n, 4), 0.0)
        self.advance(command, self._calm if wind is None else _rows("wind", wind, (self.n, 3), 0.0))
        return self.state()

    def advance(self, rotor_vel_cmd: Array, wind: Array) -> None:
        """`step` for inner loops: float64 arrays of full shape, no checks; live arrays hold the result."""
        self._actuate(rotor_vel_cmd, wind)
        self.integrate(rotor_vel_cmd, wind)
        self._sense(wind)

    def integrate(self, rotor_vel_cmd: Array, wind: Array) -> None:
        """`advance` without its first `actuate` and last `sense`, for loops that compile them into more."""
        self.batch.step(stage=self._stage)
        for _ in range(self.substeps - 1):
            self._sense(wind)
            self._actuate(rotor_vel_cmd, wind)
            self.batch.step(stage=self._stage)

    def state(self) -> State:
        """Copies of the live arrays."""
        return State(*(getattr(self, name).copy() for name in State._fields))

    def set_mass(self, mass: ArrayLike) -> None:
        """Change the masses, (n,) [kg], the inertia in proportion: a payload taken up or dropped."""
        new = _rows("mass", mass, (self.n,), 0.0)
        if np.any(new <= 0):
            raise ValueError(f"mass is {new.min()} kg; it must be positive")
        self.params[:, rotors.IXX : rotors.IZZ + 1] *= (new / self.params[:, rotors.MASS])[:, None]
        self.params[:, rotors.MASS] = new
        self._write_inertia()

    def _actuate(self, rotor_vel_cmd: Array, wind: Array) -> None:
        actuate(self.step_dt, rotor_vel_cmd, wind, self.ctrl, *self.arrays)

    def _sense(self, wind: Array) -> None:
        sense(wind, self.reaction, *self.arrays)

    def _write_inertia(self) -> None:
        body = self.model.body("quadrotor").id
        self.batch.expand("body_mass")[:, body] = self.params[:, rotors.MASS]
        self.batch.expand("body_inertia")[:, body] = self.params[:, rotors.IXX : rotors.IZZ + 1]
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
