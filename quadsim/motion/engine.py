"""MuJoCo as the engine of the plant, optionally with ground contact."""

import logging

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from ..runs.compiled import njit
from ..runs.fingerprint import ASSETS
from ..vehicle import GRAVITY, Vehicle

# the engine would otherwise write a file into the working directory for every vehicle that diverges
mujoco.set_mju_user_warning(logging.getLogger(__name__).info)

BODY = 1
"""Index of the vehicle among the model's bodies."""


INTEGRATORS = ("RK4", "implicitfast", "implicit", "Euler")


def vehicle_model(vehicle: Vehicle, timestep: float, integrator: str, contact: bool) -> mujoco.MjModel:
    """Make the MuJoCo model of one vehicle.

    Raises:
        ValueError: MuJoCo has no such integrator.
    """
    if integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {integrator!r}; choose one of {', '.join(INTEGRATORS)}")
    mjcf = (ASSETS / "quadrotor.xml").read_text(encoding="utf-8")
    return mujoco.MjModel.from_xml_string(
        mjcf.format(
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


class MujocoEngine:
    """Simulates n copies of a model, whose states are exchanged with the records of the plant.

    Args:
        model: The model of one vehicle, whose six actuators apply force and moment in body axes.
        vehicles: (n,) records of `quadsim.motion.rotors.vehicle_dtype`, with masses and inertias.
        contact: Whether the ground can be touched.
    """

    def __init__(self, model: mujoco.MjModel, vehicles: NDArray[np.void], contact: bool) -> None:
        self.vehicles, self.contact = vehicles, contact
        self.batch = Batch(model, len(vehicles), nthread=1)
        self.qpos, self.qvel, self.ctrl = (self.batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self.reaction = self.batch.bind("qfrc_constraint") if contact else np.zeros_like(self.qvel)
        self._stage = (mujoco.mjtStage.mjSTAGE_ACC if contact else mujoco.mjtStage.mjSTAGE_NONE).value
        if len(np.unique(vehicles["mass"])) > 1 or len(np.unique(vehicles["inertia"], axis=0)) > 1:
            self.write_inertia()

    def step(self) -> None:
        """Move all vehicles by one step under the force and moment of their records."""
        _write(self.vehicles, self.qpos, self.qvel, self.ctrl)
        self.batch.step(stage=self._stage)
        _read(self.vehicles, self.qpos, self.qvel, self.reaction)

    def forward(self) -> None:
        """Write the reaction of the ground in the current state."""
        _write(self.vehicles, self.qpos, self.qvel, self.ctrl)
        if self.contact:
            self.batch.forward()
        _read(self.vehicles, self.qpos, self.qvel, self.reaction)

    def write_inertia(self) -> None:
        """Set the masses and inertias of the models to those of the records."""
        self.batch.expand("body_mass")[:, BODY] = self.vehicles["mass"]
        self.batch.expand("body_inertia")[:, BODY] = self.vehicles["inertia"]
        self.batch.set_const()


@njit(cache=True)
def _write(vehicles, qpos, qvel, ctrl):
    for i in range(vehicles.shape[0]):
        p, s = vehicles[i], vehicles[i].state
        for j in range(3):
            qpos[i, j], qvel[i, j], qvel[i, 3 + j] = s.position[j], s.velocity[j], s.ang_vel[j]
            ctrl[i, j], ctrl[i, 3 + j] = p.force[j], p.moment[j]
        for j in range(4):
            qpos[i, 3 + j] = s.quat[j]


@njit(cache=True)
def _read(vehicles, qpos, qvel, reaction):
    for i in range(vehicles.shape[0]):
        p, s = vehicles[i], vehicles[i].state
        for j in range(3):
            s.position[j], s.velocity[j], s.ang_vel[j] = qpos[i, j], qvel[i, j], qvel[i, 3 + j]
            p.ground_force[j], p.ground_moment[j] = reaction[i, j], reaction[i, 3 + j]
        for j in range(4):
            s.quat[j] = qpos[i, 3 + j]
