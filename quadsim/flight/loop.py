"""The closed loop of one instant: plant, IMU, attitude estimator, controller, rotors.

One instant k: the plant's state → IMU sample → estimate of roll and pitch → controller → rotors →
the state at k + 1. `FlightLoop` is that loop, whoever drives it.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import Engine
from ..control.cascade import (
    LEVELS,
    MEASURED,
    SET_POINT,
    Command,
    Controller,
    Level,
    control,
    controller_dtype,
)
from ..control.own import InnerLoop, MakeController, made
from ..estimator import AttitudeEstimator, Readings, accepted_sensors, receives_truth, roll_pitch_of
from ..external import ExternalSensor
from ..imu.kernel import ACCEL, GYRO, IMU, measure
from ..imu.spec import ImuSpec
from ..imu.stream import ImuStream
from ..own import named_errors
from ..plant import Plant, fly, update_truth
from ..rotation import euler_from_quat, quat_from_rotvec, quat_multiply
from ..rotors import vehicle_dtype
from ..runs.compiled import njit
from ..vehicle import Vehicle

Array = NDArray[np.float64]


FLIGHT = np.dtype(
    [
        ("min_cos_tilt", "f8"),  # limits of flight: cosine of the largest tilt,
        ("min_altitude", "f8"),  # lowest height [m]
        ("max_distance", "f8"),  # and largest distance from the set-point [m]
        ("target", SET_POINT),  # of the current sample
        ("wind", "f8", 3),
        ("crashed", "i8"),  # why it is down at this sample, and
        ("cause", "i8"),  # why it first was
    ],
    align=True,
)


@cache
def loop_dtype(rotors: int) -> np.dtype:
    """The record of one closed loop: everything about its vehicle, sensors and controller."""
    return np.dtype(
        [
            ("vehicle", vehicle_dtype(rotors)),
            ("imu", IMU),
            ("measured", MEASURED),
            ("set_point", SET_POINT),
            ("controller", controller_dtype(rotors)),
            ("flight", FLIGHT),
        ],
        align=True,
    )


class FlightLoop:
    """n closed loops, one sample at a time.

    The estimator, `corrupt` and the controller get copies: what they change in place moves no vehicle.

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
        nominal: The vehicle that the controller is tuned for, instead of the first.
        engine: What integrates the motion, see `quadsim.plant.Plant`.
        controller: Makes the attitude controller; None for the cascade's own.
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
        nominal: Vehicle | None = None,
        engine: Engine = "auto",
        controller: MakeController | None = None,
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
            self.inner = InnerLoop(made(controller, rate_hz, nominal or first), records)
        self.imu = None if imu is None else ImuStream(imu, n, rate_hz, seed, records["imu"])
        self.noise = np.empty((n, 0, 0, 3)) if self.imu is None else self.imu.noise
        self.estimator, self._last_rate = estimator, np.zeros((n, 3))
        self.external = external
        self.corrupt = corrupt
        self._observe = getattr(estimator, "observe", None) if receives_truth(estimator) else None
        self._name, self._shape = type(estimator).__name__, (n, 2)
        self._accepted = () if estimator is None else accepted_sensors(estimator.update)
        self.attitude = self.true_attitude = self.plant.roll_pitch
        self.yaw, self.measured_state = self.plant.yaw, records["measured"]
        self.k, self.rate = self.measured_state["k"], self.measured_state["gyro"]
        inertial = (self.plant.ang_vel, self.plant.specific_force)
        if self.imu is not None:
            inertial = (self.imu.gyro, self.imu.accel)
        self._sample = Readings(*map(_read_only, (*inertial, self.plant.rotor_vel)))
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
        attitude_error: Array | None = None,
    ) -> None:
        """Reset all vehicles; arguments as for `Plant.reset`.

        The estimator starts level, unless `known_attitude`: then it starts at the true roll and pitch, turned
        by `attitude_error`, rotation vectors (n, 3) in world axes [rad].
        """
        every = np.arange(self.n)
        self.restart(every, position, velocity, quat, ang_vel, known_attitude, attitude_error)
        self.sense()

    def restart(
        self,
        ids: NDArray[np.int64],
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        quat: ArrayLike | None = None,
        ang_vel: ArrayLike | None = None,
        known_attitude: bool = False,
        attitude_error: Array | None = None,
    ) -> None:
        """Reset some vehicles while the others continue; the next `sense` gives their first sample.

        Raises:
            ValueError: If the estimator cannot restart single vehicles.
        """
        self.plant.reset(position, velocity, quat, ang_vel, ids=ids)
        self.controller.reset(ids)
        if self.inner is not None:
            self.inner.reset(ids)
        self.k[ids] = 0
        if self.imu is not None:
            self.imu.reset(ids)
        if self.estimator is None:
            return
        given = None
        if known_attitude:
            given = self.true_attitude[ids]
            if attitude_error is not None:
                off = quat_multiply(quat_from_rotvec(attitude_error), self.plant.quat[ids])
                given = euler_from_quat(off)[:, :2]
        if len(ids) == self.n:
            with named_errors(f"{self._name}: reset"):
                self.estimator.reset(self.n, roll_pitch=given)
            return
        restart = getattr(self.estimator, "restart", None)
        if restart is None:
            raise ValueError("this estimator has no restart(ids, roll_pitch): it starts all or none")
        with named_errors(f"{self._name}: restart"):
            restart(ids.copy(), roll_pitch=given)

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
        self.plant.wind[:] = 0.0 if wind is None else wind
        self.move_on(self.steered(self.accept(level, command)))

    def steered(self, level: int) -> int:
        """Let an attitude controller of one's own act on the commands in the records; their level then."""
        return level if self.inner is None else self.inner.steer(level, self.readings.accel)

    def move_on(self, level: int) -> None:
        """`move` on the commands in the records, at the level of this number."""
        if self.plant.engine is None:
            move(level, self.records, self.plant.substeps)
        else:
            start_move(level, self.records)
            self.plant.finish_move(self.controller.rotor_vel_cmd)

    def sense(self) -> None:
        """The second half of `step`: IMU, external sensor and estimate."""
        sense(self.records, self.noise, self.next_noise())
        self.estimate()

    def accept(self, level: Level, command: Command) -> int:
        """Write a command to the records; returns the number of its level."""
        self.records["set_point"] = self.controller.accept(level, command)
        return LEVELS.index(level)

    def estimate(self) -> None:
        """External sensor, sensor faults and estimate, from the last sample of the IMU.

        Raises:
            ValueError: If the estimator fails, or does not return real numbers (n, 2).
        """
        measured = self.measured_state
        if self.external is not None:
            self.external.measure(measured)
        if self.corrupt is not None:
            self.readings = self._sample.map(np.copy)
            self.corrupt(self.readings, self.k.copy())
            self._last_rate = np.where(np.isfinite(self.gyro), self.gyro, self._last_rate)
            self.rate[:] = self._last_rate
        if self.estimator is not None:
            try:
                if self._observe is not None:
                    self._observe(self.plant.quat.copy())
                returned = self.readings.give_copies(self.estimator.update, self._accepted)
            except (Exception, SystemExit) as error:  # whatever a user's class does
                raise ValueError(f"{self._name}: update ends with {type(error).__name__}: {error}") from error
            self.attitude = roll_pitch_of(returned, self._shape, self._name)
            measured["roll_pitch"] = self.attitude

    def next_noise(self) -> int:
        """Place of the IMU's next sample in `noise`; it counts as taken."""
        return 0 if self.imu is None else self.imu.next_samples()


def _read_only(state: Array) -> Array:
    """A view of the plant's or the IMU's state that cannot change it."""
    view = state.view()
    view.flags.writeable = False
    return view


@njit(cache=True)
def start_one(level, loop):
    """Control of one vehicle: the count of samples increases, and its rotors get their command."""
    loop.measured.k += 1
    control(level, loop.set_point, loop.measured, loop.controller)


@njit(cache=True)
def sense_truth(loop):
    """Truth of one vehicle at this instant, to its records of vehicle and measured state."""
    p, m = loop.vehicle, loop.measured
    update_truth(p)
    for axis in range(3):
        m.position[axis], m.velocity[axis], m.gyro[axis] = p.position[axis], p.velocity[axis], p.ang_vel[axis]
    m.roll_pitch[0], m.roll_pitch[1], m.yaw = p.roll_pitch[0], p.roll_pitch[1], p.yaw


@njit(cache=True)
def sense_one(loop, noise, at, x):
    """`sense_truth`, then the sample of the IMU.

    Args:
        loop: Record of `loop_dtype`.
        noise: (NOISES, block, 3) standard normal numbers of its IMU; without an IMU, of length 0.
        at: Place of this sample in the block.
        x: (2, 3) memory.
    """
    sense_truth(loop)
    if noise.shape[0] > 0:
        p, m = loop.vehicle, loop.measured
        for axis in range(3):
            x[GYRO, axis], x[ACCEL, axis] = p.ang_vel[axis], p.specific_force[axis]
        measure(loop.imu, noise[:, at], x, p.ang_acc, p.rotor_vel)
        for axis in range(3):
            m.gyro[axis] = loop.imu.reading[GYRO, axis]


@njit(cache=True)
def start_move(level, loops):
    """What comes before MuJoCo's steps."""
    for i in range(loops.shape[0]):
        start_one(level, loops[i])


@njit(cache=True)
def move(level, loops, substeps):
    """Control and motion over a sample, (n,) records of `loop_dtype`."""
    for i in range(loops.shape[0]):
        start_one(level, loops[i])
        fly(loops[i].vehicle, loops[i].controller.rotor_vel_cmd, substeps)


@njit(cache=True)
def sense(loops, noise, at):
    """`sense_one` for all: (n,) records, noise (n, NOISES, block, 3)."""
    x = np.empty((2, 3))
    for i in range(loops.shape[0]):
        sense_one(loops[i], noise[i], at, x)
