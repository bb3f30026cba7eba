"""The closed loop of one instant: plant, IMU, attitude estimator, controller, rotors.

One instant k: the plant's state → IMU sample → estimate of roll and pitch → controller → rotors →
the state at k + 1. `FlightLoop` is that loop, whoever drives it.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..control.cascade import LEVELS, Controller, Level, control
from ..estimator import AttitudeEstimator, Readings, accepted_sensors
from ..external import ExternalSensor
from ..imu.kernel import ACCEL, GYRO, measure
from ..imu.spec import ImuSpec
from ..imu.stream import ImuStream
from ..plant import Plant, actuate, sense
from ..rotation import euler_core
from ..runs.compiled import njit
from ..vehicle import Vehicle

Array = NDArray[np.float64]


class FlightLoop:
    """n closed loops, one sample at a time.

    After `reset` and after every `step`, `readings` (n, ·), `gyro` (n, 3) among them, and `attitude` (n, 2),
    the estimated roll and pitch, belong to the state in `plant`. `rate` (n, 3) is `gyro` with missing samples
    held. `seen` is the
    position (n, 3), velocity (n, 3) and yaw (n,) that the controller sees.

    Args:
        vehicle: One vehicle, or n of them. The controller is tuned for `nominal`, or else for the first.
        n: Number of vehicles.
        rate_hz: Samples per second.
        imu: IMU to fly on; None for a perfect one.
        estimator: Source of roll and pitch; None for the truth.
        seed: Seed of the IMU, an integer or one SeedSequence per vehicle.
        contact: Whether the ground can be touched; the engine then makes 1 ms steps, implicitly.
        external: Source of position, velocity and yaw; None for the truth.
        nominal: The vehicle that the controller believes in.
        corrupt: Called as corrupt(readings, k) on every sample, k (n,) counting each vehicle's samples from
            0; may change readings in place: sensor faults. At NaN the controller holds its last body rate.
    """

    def __init__(
        self,
        vehicle: Vehicle | Sequence[Vehicle],
        n: int = 1,
        *,
        rate_hz: float = 200.0,
        imu: ImuSpec | None = None,
        estimator: AttitudeEstimator | None = None,
        seed: int | Sequence[np.random.SeedSequence] = 0,
        contact: bool = False,
        external: ExternalSensor | None = None,
        nominal: Vehicle | None = None,
        corrupt: Callable[[Readings, NDArray[np.int64]], None] | None = None,
    ) -> None:
        if estimator is not None and estimator.rate_hz != rate_hz:
            raise ValueError(f"the estimator runs at {estimator.rate_hz:g} Hz and the loop at {rate_hz:g} Hz")
        self.n, self.rate_hz, self.k = n, rate_hz, np.zeros(n, dtype=np.int64)
        self.plant = Plant(vehicle, n, rate_hz, "implicitfast" if contact else "RK4", contact)
        self.controller = Controller(nominal or self.plant.vehicle, n, rate_hz)
        self.imu = None if imu is None else ImuStream(imu, n, rate_hz, seed)
        self.estimator = estimator
        self.external = external
        self.corrupt = corrupt
        self._observe = getattr(estimator, "observe", None)
        self._accepted = () if estimator is None else accepted_sensors(estimator.update)
        self.true_attitude, self.yaw = np.zeros((n, 2)), np.zeros(n)
        self.seen = self.plant.position, self.plant.velocity, self.yaw
        if external is not None:
            self.seen = external.position, external.velocity, external.yaw
        self.attitude, self._calm = self.true_attitude, np.zeros((n, 3))
        self._air = self._calm  # in which the present state was reached
        self._reading = np.zeros((2, n, 1, 3))
        rotor_vel = self.plant.rotor_vel.view()
        rotor_vel.flags.writeable = False  # the plant's state
        self._sample = Readings(self.plant.ang_vel, self.plant.specific_force, rotor_vel)
        if imu is not None:
            self._sample = Readings(self._reading[GYRO, :, 0], self._reading[ACCEL, :, 0], rotor_vel)
        self.readings = self._sample
        self.rate = self.gyro if corrupt is None else np.zeros((n, 3))

    @property
    def gyro(self) -> Array:
        """Body rate as measured (n, 3) [rad/s]."""
        return self.readings.gyro

    def reset(
        self,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
        known_attitude: bool = False,
    ) -> None:
        """Start all vehicles anew; arguments as for `Plant.reset`.

        The estimator starts level, unless `known_attitude`: then it is told the true roll and pitch.
        """
        self.plant.reset(position, velocity, quat, ang_vel)
        self.controller.reset()
        self.k[:], self._air = 0, self._calm
        read_attitude(self.plant.quat, self.true_attitude, self.yaw)
        if self.imu is not None:
            self.imu.reset()
        if self.estimator is not None:
            self.estimator.reset(self.n, roll_pitch=self.true_attitude.copy() if known_attitude else None)
        self.sense()

    def restart(
        self,
        ids: NDArray[np.int64],
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
        known_attitude: bool = False,
    ) -> None:
        """Start some vehicles anew while the others fly on; the next `sense` gives their first sample.

        Raises:
            ValueError: If the estimator cannot restart single vehicles.
        """
        self.plant.reset(position, velocity, quat, ang_vel, ids=ids)
        self.controller.reset(ids)
        self.k[ids] = 0
        self._air = self._air.copy()
        self._air[ids] = 0.0
        read_attitude(self.plant.quat, self.true_attitude, self.yaw)
        if self.imu is not None:
            self.imu.reset(ids)
        if self.estimator is not None and len(ids) == self.n:
            self.estimator.reset(self.n, roll_pitch=self.true_attitude.copy() if known_attitude else None)
        elif self.estimator is not None:
            restart = getattr(self.estimator, "restart", None)
            if restart is None:
                raise ValueError("this estimator has no restart(ids, roll_pitch): it starts all or none")
            restart(ids, roll_pitch=self.true_attitude[ids] if known_attitude else None)

    def step(self, level: Level, command: Array, wind: Array | None = None) -> None:
        """Fly on by one sample: control from the present estimate, move, sense.

        Args:
            level: Where the command enters the cascade, see `quadsim.control.cascade`.
            command: (n, width of the level).
            wind: (n, 3) world [m/s]; None for still air.
        """
        self.move(level, command, wind)
        self.sense()

    def move(self, level: Level, command: Array, wind: Array | None = None) -> None:
        """The first half of `step`: control and motion."""
        plant, controller = self.plant, self.controller
        air = self._calm if wind is None else wind
        steer(
            LEVELS.index(level), command, *self.seen, self.attitude, self.rate, plant.step_dt, air,
            plant.ctrl, self.k, *controller.arrays, *plant.arrays,
        )  # fmt: skip
        plant.integrate(controller.rotor_vel_cmd, air)
        self._air = air

    def sense(self) -> None:
        """The second half of `step`: IMU, external sensor and estimate."""
        plant, imu = self.plant, self.imu
        if imu is None:
            arrive(self.true_attitude, self.yaw, self._air, plant.reaction, *plant.arrays)
        else:
            perceive(
                imu.next_samples(), *imu.arrays, self._reading, self.true_attitude, self.yaw, self._air,
                plant.reaction, *plant.arrays,
            )  # fmt: skip
        if self.external is not None:
            self.external.measure(self.k, plant.position, plant.velocity, self.yaw)
        if self.corrupt is not None:
            self.readings = self._sample.map(np.copy)
            self.corrupt(self.readings, self.k)
            self.rate = np.where(np.isfinite(self.gyro), self.gyro, self.rate)
        if self.estimator is not None:
            if self._observe is not None:
                self._observe(plant.quat)
            self.attitude = self.readings.give(self.estimator.update, self._accepted)


@njit(cache=True)
def steer(
    level, command, position, velocity, yaw, attitude, rate, step_dt, wind, ctrl, k,
    g, c, inverse, dt, memory, axis, rotor_vel_cmd,
    params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc,
):  # fmt: skip
    """Everything before the engine's step: `control`, then `actuate`; k (n,) counts on."""
    k += 1
    control(
        level, command, position, velocity, attitude, yaw, rate, g, c, inverse, dt, memory, axis,
        rotor_vel_cmd,
    )  # fmt: skip
    actuate(
        step_dt, rotor_vel_cmd, wind, ctrl, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc
    )  # fmt: skip


@njit(cache=True, inline="always")
def arrive(roll_pitch, yaw, wind, reaction, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc):
    """Everything after it, but for the IMU: `sense`, then `read_attitude`."""
    sense(wind, reaction, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc)
    read_attitude(qpos[:, 3:], roll_pitch, yaw)


@njit(cache=True)
def perceive(
    at, vehicles, noise, bias, reading, roll_pitch, yaw, wind, reaction,
    params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc,
):  # fmt: skip
    """Everything after it: `arrive`, then `measure` the sample at place `at` of the IMU's block of noise."""
    arrive(roll_pitch, yaw, wind, reaction, params, hubs, qpos, qvel, rotor_vel, specific_force, ang_acc)
    measure(
        vehicles, noise, at, 0, 1, np.expand_dims(qvel[:, 3:], 1), np.expand_dims(specific_force, 1),
        np.expand_dims(ang_acc, 1), np.expand_dims(rotor_vel, 1), reading, bias,
    )  # fmt: skip


@njit(cache=True, inline="always")
def read_attitude(quat, roll_pitch, yaw):
    """Write roll and pitch (n, 2) and yaw (n,) of quat (n, 4)."""
    for i in range(quat.shape[0]):
        roll_pitch[i, 0], roll_pitch[i, 1], yaw[i] = euler_core(
            quat[i, 0], quat[i, 1], quat[i, 2], quat[i, 3]
        )
