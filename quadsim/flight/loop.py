"""The closed loop of one instant: plant, IMU, attitude estimator, controller, rotors.

One instant k: the plant's state → IMU sample → estimate of roll and pitch → controller → rotors →
the state at k + 1. `FlightLoop` is that loop, whoever drives it.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..control.cascade import LEVELS, MEASURED, Command, Controller, Level, control
from ..estimator import AttitudeEstimator, Readings, accepted_sensors
from ..external import ExternalSensor
from ..imu.kernel import ACCEL, GYRO, measure
from ..imu.spec import ImuSpec
from ..imu.stream import ImuStream
from ..plant import Plant, actuate, update_truth
from ..runs.compiled import njit
from ..vehicle import Vehicle

Array = NDArray[np.float64]


class FlightLoop:
    """n closed loops, one sample at a time.

    After `reset` and after every `step`, `readings` (n, ·), `gyro` (n, 3) among them, and `attitude` (n, 2),
    the estimated roll and pitch, belong to the state in `plant`. `measured_state` (n,) holds what the
    controller gets, records of `quadsim.control.cascade.MEASURED`; `k` and `rate` are its count of samples
    and body rate.

    Args:
        vehicle: One vehicle, or n of them. The controller is tuned for the first.
        n: Number of vehicles.
        rate_hz: Samples per second.
        imu: The IMU; None for a perfect one.
        estimator: Source of roll and pitch; None for the truth.
        seed: Seed of the IMU, an integer or one SeedSequence per vehicle.
        contact: Whether the ground can be touched; the engine then makes 1 ms steps, implicitly.
        external: Source of position, velocity and yaw; None for the truth.
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
        corrupt: Callable[[Readings, NDArray[np.int64]], None] | None = None,
    ) -> None:
        if estimator is not None and estimator.rate_hz != rate_hz:
            raise ValueError(f"the estimator runs at {estimator.rate_hz:g} Hz and the loop at {rate_hz:g} Hz")
        self.n, self.rate_hz = n, rate_hz
        self.plant = Plant(vehicle, n, rate_hz, "implicitfast" if contact else "RK4", contact)
        self.controller = Controller(self.plant.vehicle, n, rate_hz)
        self.imu = None if imu is None else ImuStream(imu, n, rate_hz, seed)
        self.estimator = estimator
        self.external = external
        self.corrupt = corrupt
        self._observe = getattr(estimator, "observe", None)
        self._accepted = () if estimator is None else accepted_sensors(estimator.update)
        self.attitude = self.true_attitude = self.plant.roll_pitch
        self.yaw, self.measured_state = self.plant.yaw, np.zeros(n, MEASURED)
        self.k, self.rate = self.measured_state["k"], self.measured_state["gyro"]
        rotor_vel = self.plant.rotor_vel.view()
        rotor_vel.flags.writeable = False  # the plant's state
        self._sample = Readings(self.plant.ang_vel, self.plant.specific_force, rotor_vel)
        if self.imu is not None:
            self._sample = Readings(self.imu.gyro, self.imu.accel, rotor_vel)
        self.readings = self._sample

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
        """Reset all vehicles; arguments as for `Plant.reset`.

        The estimator starts level, unless `known_attitude`: then it starts at the true roll and pitch.
        """
        self.restart(np.arange(self.n), position, velocity, quat, ang_vel, known_attitude)
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
        """Reset some vehicles while the others continue; the next `sense` gives their first sample.

        Raises:
            ValueError: If the estimator cannot restart single vehicles.
        """
        self.plant.reset(position, velocity, quat, ang_vel, ids=ids)
        self.controller.reset(ids)
        self.k[ids] = 0
        if self.imu is not None:
            self.imu.reset(ids)
        if self.estimator is not None and len(ids) == self.n:
            self.estimator.reset(self.n, roll_pitch=self.true_attitude.copy() if known_attitude else None)
        elif self.estimator is not None:
            restart = getattr(self.estimator, "restart", None)
            if restart is None:
                raise ValueError("this estimator has no restart(ids, roll_pitch): it starts all or none")
            restart(ids, roll_pitch=self.true_attitude[ids] if known_attitude else None)

    def step(self, level: Level, command: Command, wind: Array | None = None) -> None:
        """Advance by one sample: control from the present estimate, move, sense.

        Args:
            level: Where the command enters the cascade, see `quadsim.control.cascade`.
            command: (n, width of the level), or (n,) records.
            wind: (n, 3) world [m/s]; None for still air.
        """
        self.move(level, command, wind)
        self.sense()

    def move(self, level: Level, command: Command, wind: Array | None = None) -> None:
        """The first half of `step`: control and motion."""
        plant, controller = self.plant, self.controller
        plant.wind[:] = 0.0 if wind is None else wind
        control_step(
            LEVELS.index(level), controller.accept(level, command), self.measured_state, controller.records,
            plant.vehicles, plant.pose, plant.twist, plant.wrench,
        )  # fmt: skip
        plant.integrate(controller.rotor_vel_cmd)

    def sense(self) -> None:
        """The second half of `step`: IMU, external sensor and estimate."""
        plant, imu, measured = self.plant, self.imu, self.measured_state
        last_valid = self.rate if self.corrupt is None else self.rate.copy()
        if imu is None:
            sense_truth(plant.vehicles, plant.pose, plant.twist, plant.reaction, measured)
        else:
            sense(
                imu.next_samples(), imu.noise, imu.records,
                plant.vehicles, plant.pose, plant.twist, plant.reaction, measured,
            )  # fmt: skip
        if self.external is not None:
            self.external.measure(measured)
        if self.corrupt is not None:
            self.readings = self._sample.map(np.copy)
            self.corrupt(self.readings, self.k)
            self.rate[:] = np.where(np.isfinite(self.gyro), self.gyro, last_valid)
        if self.estimator is not None:
            if self._observe is not None:
                self._observe(plant.quat)
            self.attitude = self.readings.give(self.estimator.update, self._accepted)
            measured["roll_pitch"] = self.attitude


@njit(cache=True)
def control_step(level, set_points, measured, controllers, vehicles, pose, twist, wrench):
    """Everything before the engine's step: `control`, then `actuate`; the samples' count k increases."""
    for i in range(measured.shape[0]):
        measured[i].k += 1
    control(level, set_points, measured, controllers)
    actuate(controllers.rotor_vel_cmd, vehicles, pose, twist, wrench)


@njit(cache=True)
def sense_truth(vehicles, pose, twist, reaction, measured):
    """Everything after it, but for the IMU: `update_truth`, and the true state to `measured`."""
    update_truth(vehicles, pose, twist, reaction)
    for i in range(measured.shape[0]):
        m, p = measured[i], vehicles[i]
        for axis in range(3):
            m.position[axis], m.velocity[axis] = pose[i].position[axis], twist[i].velocity[axis]
            m.gyro[axis] = twist[i].ang_vel[axis]
        m.roll_pitch[0], m.roll_pitch[1], m.yaw = p.roll_pitch[0], p.roll_pitch[1], p.yaw


@njit(cache=True)
def sense(at, noise, imus, vehicles, pose, twist, reaction, measured):
    """Everything after it: `sense_truth`, then the IMU's sample at place `at` of its block of noise."""
    sense_truth(vehicles, pose, twist, reaction, measured)
    x = np.empty((2, 3))
    for i in range(imus.shape[0]):
        p = vehicles[i]
        for axis in range(3):
            x[GYRO, axis], x[ACCEL, axis] = twist[i].ang_vel[axis], p.specific_force[axis]
        measure(imus[i], noise[i, :, at], x, p.ang_acc, p.rotor_vel)
        for axis in range(3):
            measured[i].gyro[axis] = imus[i].reading[GYRO, axis]
