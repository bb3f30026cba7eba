"""The closed loop of one instant: plant, IMU, attitude estimator, controller, rotors.

At instant k: state of the plant → IMU sample → estimate of roll and pitch → controller → rotors → state at k
+ 1.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import Engine
from ..control.attitude_controller import InnerLoop, MakeController, made_controller, start_own
from ..control.cascade import Controller
from ..control.records import LEVELS, POSITION, Command, Level
from ..estimator import AttitudeEstimator, Readings, accepted_sensors, receives_truth, roll_pitch_of
from ..external import ExternalSensor, ExternalSpec
from ..imu.stream import Imus, ImuStream
from ..motion.rotors import state_dtype
from ..plant import Plant
from ..rotation import quat_from_rotvec, quat_multiply, roll_pitch_from_quat
from ..vehicle import Vehicle
from .world import NO_NOISE, PLAN, loop_dtype, start, step

Array = NDArray[np.float64]


class FlightLoop:
    """n closed loops, one sample at a time.

    The estimator, `corrupt` and the controller receive copies, so they cannot change the state of a vehicle.

    After `reset` and after every `step`, `readings` (n, ·) and `attitude` (n, 2), the estimated roll and
    pitch, belong to the state in `plant`. `measured_state` (n,) is the input of the controller, records of
    `quadsim.control.records.MEASURED`, whose field `k` counts samples. `crashed` marks vehicles beyond the
    limits in the field `flight` of the records; by default, these limits are infinite.

    Args:
        vehicle: One vehicle, or n of them. The controller is tuned for the first.
        n: Number of vehicles.
        rate_hz: Samples per second.
        imu: The IMU, or one for each vehicle; None for a perfect one.
        estimator: Source of roll and pitch; None for the truth.
        seed: Seed of the IMU: a whole number, or one SeedSequence per vehicle.
        contact: Whether the ground can be touched. The engine then uses implicit steps of 1 ms.
        external: Source of position, velocity and yaw; None for the truth.
        corrupt: Sensor faults, called as corrupt(readings, k) on every sample, where k (n,) counts each
            vehicle's samples from 0. The function may change the readings in place. Where the body rate is
            NaN, the controller uses the last one.
        nominal: The vehicle that the controller is tuned for, instead of the first.
        engine: Integrator of the motion; see `quadsim.plant.Plant`.
        controller: Function that makes the attitude controller; None for the cascade.
        plans: Set-points and winds, (n, T) records of `PLAN`. After T samples, the last record is used. None:
            no plans.
        log: (n, t) records of `quadsim.motion.rotors.state_dtype`, to which the states at the last t samples
            of the plans are written.
    """

    def __init__(
        self,
        vehicle: Vehicle | Sequence[Vehicle],
        n: int = 1,
        *,
        rate_hz: float = 200.0,
        imu: Imus | None = None,
        estimator: AttitudeEstimator | None = None,
        seed: int | Sequence[np.random.SeedSequence] = 0,
        contact: bool = False,
        external: ExternalSensor | None = None,
        corrupt: Callable[[Readings, NDArray[np.int64]], None] | None = None,
        nominal: Vehicle | None = None,
        engine: Engine = "auto",
        controller: MakeController | None = None,
        plans: NDArray[np.void] | None = None,
        log: NDArray[np.void] | None = None,
    ) -> None:
        if estimator is not None and estimator.rate_hz != rate_hz:
            raise ValueError(f"the estimator runs at {estimator.rate_hz:g} Hz and the loop at {rate_hz:g} Hz")
        self.n, self.rate_hz = n, rate_hz
        first = vehicle if isinstance(vehicle, Vehicle) else vehicle[0]
        self.records = records = np.zeros(n, loop_dtype(len(first.rotors)))
        integrator = "implicitfast" if contact else "RK4"
        self.plant = Plant(vehicle, n, rate_hz, integrator, contact, engine, records["vehicle"])
        self.controller = Controller(nominal or first, n, rate_hz, records=records["controller"])
        self.inner = None
        if controller is not None:
            self.inner = InnerLoop(made_controller(controller, rate_hz, nominal or first), records)
        self.imu = None if imu is None else ImuStream(imu, n, rate_hz, seed, records["imu"])
        self.plans = np.zeros((n, 1), PLAN) if plans is None else plans
        self.log = np.zeros((n, 0), state_dtype(len(first.rotors))) if log is None else log
        flights = records["flight"]
        flights["min_cos_tilt"], flights["min_altitude"], flights["max_distance"] = -np.inf, -np.inf, np.inf
        self.target, self.air, self.cause = (flights[name] for name in ("target", "wind", "cause"))
        self.estimator, self.corrupt = estimator, corrupt
        self.external = external or ExternalSensor(ExternalSpec(), 0, rate_hz, 0)
        self._name = type(estimator).__name__
        self._observe = getattr(estimator, "observe", None) if receives_truth(estimator) else None
        self._accepted = () if estimator is None else accepted_sensors(estimator.update)
        self.attitude, self.measured_state = self.plant.roll_pitch, records["measured"]
        self.k, self._roll_pitch = self.measured_state["k"], self.measured_state["roll_pitch"]
        self._last_rate = np.zeros((n, 3))
        inertial = {"gyro": self.plant.ang_vel, "accel": self.plant.specific_force}
        if self.imu is not None:
            inertial = self.imu.readings
        self._sensed = Readings(**inertial, rotor_vel=self.plant.rotor_vel)

    def reset(
        self,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
        known_attitude: bool = False,
        attitude_error: Array | None = None,
        ids: NDArray[np.int64] | None = None,
    ) -> None:
        """Reset all vehicles, or those in `ids` (m,), whose first sample is taken by the next `sense`.

        The first four arguments are those of `Plant.reset`. The estimator starts level. With
        `known_attitude`, it starts at the true roll and pitch, rotated by `attitude_error`, rotation vectors
        (m, 3) in world axes [rad].

        Raises:
            ValueError: The estimator cannot restart single vehicles.
        """
        rows = np.arange(self.n) if ids is None else ids
        self.plant.reset(position, velocity, quat, ang_vel, ids=rows)
        self.plant.rotor_vel_cmd[rows] = self.controller.rotor_vel_cmd[rows]
        self.controller.reset(rows)
        if self.inner is not None:
            self.inner.reset(rows)
        self.k[rows] = 0
        if self.imu is not None:
            self.imu.reset(rows)
        if self.estimator is not None:
            given = self.plant.roll_pitch[rows] if known_attitude else None
            if known_attitude and attitude_error is not None:
                off = quat_multiply(quat_from_rotvec(attitude_error), self.plant.quat[rows])
                given = roll_pitch_from_quat(off)
            start_own(self.estimator, self._name, rows, self.n, roll_pitch=given)
        if ids is None:
            self.sense()

    def put_back(self) -> None:
        """Move crashed vehicles back above their set-points, so that their numbers do not overflow."""
        if self.crashed:
            crashed = np.flatnonzero(self.records["flight"]["crashed"])
            self.plant.reset(position=self.target["position"][crashed] + [0.0, 0.0, 1.0], ids=crashed)
            self.controller.reset(crashed)

    def step(
        self, level: Level = "position", command: Command | None = None, wind: Array | None = None
    ) -> None:
        """Advance by one sample: control with the current estimate, move, sense.

        Args:
            level: Level at which the command enters the cascade; see `quadsim.control.cascade`.
            command: (n, width of the level), or (n,) records. None uses the command in the records, by
                default the set-point of the plan.
            wind: (n, 3), world axes [m/s]; None for the wind of the plan.
        """
        if self.plant.engine is None:
            self._step(self._accept(level, command, wind), self.plant.substeps)
        else:
            self.move(level, command, wind)
            self.sense()

    def follow(self, samples: int) -> None:
        """Advance by several samples of the plans without IMU, estimator or external sensor."""
        if self.plant.engine is None:
            self._step(POSITION, self.plant.substeps, samples)
        else:
            for _ in range(samples):
                self.step()

    def move(
        self, level: Level = "position", command: Command | None = None, wind: Array | None = None
    ) -> None:
        """Run the first half of `step`: control and motion."""
        start(self._accept(level, command, wind), self.records)
        self.plant.move()

    def sense(self) -> None:
        """Run the second half of `step`: IMU, next sample of the plan, external sensor and estimate."""
        self._step(0, 0)

    def _accept(self, level: Level, command: Command | None, wind: Array | None) -> int:
        """Write command and wind of a step to the records.

        Return the number of the level of the written command.
        """
        if wind is not None:
            self.records["flight"]["wind"] = wind
        if command is not None:
            self.records["set_point"] = self.controller.accept(level, command)
        index = LEVELS.index(level)
        return index if self.inner is None else self.inner.steer(index, self.readings.accel)

    def _step(self, level: int, substeps: int, samples: int = 1) -> None:
        """Run the compiled steps, then sensor faults and the estimator."""
        noise, at = (NO_NOISE, 0) if self.imu is None else (self.imu.noise, self.imu.next_samples())
        plans, log, out = self.plans, self.log, self.external
        self.crashed, spent = step(
            level, self.records, plans, samples, substeps, noise, at, log, out.sensors, out.noise, out.queue
        )
        if spent:
            self.external.draw()
        readings = self._sensed
        if self.corrupt is not None:
            readings = readings.map(np.copy)
            self.corrupt(readings, self.k.copy())
            self._last_rate = np.where(np.isfinite(readings.gyro), readings.gyro, self._last_rate)
            self.measured_state["gyro"] = self._last_rate
        self.readings = readings
        if self.estimator is not None:
            try:
                if self._observe is not None:
                    self._observe(self.plant.quat.copy())
                others = {
                    name: each.copy() for name, each in readings.others.items() if name in self._accepted
                }
                returned = self.estimator.update(readings.gyro.copy(), readings.accel.copy(), **others)
            except (Exception, SystemExit) as error:  # whatever a user's class does
                raise ValueError(f"{self._name}: update ends with {type(error).__name__}: {error}") from error
            self.attitude = roll_pitch_of(returned, (self.n, 2), self._name)
            self._roll_pitch[:] = self.attitude
