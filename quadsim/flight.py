"""Flights: plant, IMU, attitude estimator and controller closed into one loop, and many recorded at once.

One instant k: the plant's state → IMU sample → estimate of roll and pitch → controller → rotors →
the state at k + 1. `FlightLoop` is that loop, whoever drives it; `simulate_flights` drives it on true
attitude and records.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.signal import lfilter

from .compiled import njit
from .config import Strict
from .controller import LEVELS, Controller, Level, control
from .estimator import AttitudeEstimator
from .external import ExternalSensor
from .imu import ImuSpec, ImuStream, simulate_imu_with_bias
from .imu_kernel import ACCEL, GYRO, measure
from .plant import Plant, actuate, sense
from .ranges import Between
from .rotation import euler_core
from .seeding import child
from .trajectory import Mix, Trajectory, reference
from .vehicle import Randomisation, Vehicle, randomise
from .wind import WindSpec, wind_series

Array = NDArray[np.float64]

MAX_SPEED = 150.0  # m/s, and
MAX_BODY_RATE = 150.0  # rad/s: a vehicle beyond either has diverged


class FlightLoop:
    """n closed loops, one sample at a time.

    After `reset` and after every `step`, `gyro`, `accel` (n, 3) and `attitude` (n, 2), the estimated roll and
    pitch, belong to the state in `plant`. `rate` (n, 3) is `gyro` with missing samples held. `seen` is the
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
        corrupt: Called as corrupt(gyro, accel, k) on every sample, k (n,) counting each vehicle's samples
            from 0; may change both in place: sensor faults. At NaN the controller holds its last body rate.
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
        corrupt: Callable[[Array, Array, NDArray[np.int64]], None] | None = None,
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
        self.true_attitude, self.yaw = np.zeros((n, 2)), np.zeros(n)
        self.seen = self.plant.position, self.plant.velocity, self.yaw
        if external is not None:
            self.seen = external.position, external.velocity, external.yaw
        self.attitude, self._calm = self.true_attitude, np.zeros((n, 3))
        self._air = self._calm  # in which the present state was reached
        self._reading = np.zeros((2, n, 1, 3))
        self._sample = self.plant.ang_vel, self.plant.specific_force
        if imu is not None:
            self._sample = self._reading[GYRO, :, 0], self._reading[ACCEL, :, 0]
        self.gyro, self.accel = self._sample
        self.rate = self.gyro if corrupt is None else np.zeros((n, 3))

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
            level: Where the command enters the cascade, see `quadsim.controller`.
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
            self.gyro, self.accel = (each.copy() for each in self._sample)
            self.corrupt(self.gyro, self.accel, self.k)
            self.rate = np.where(np.isfinite(self.gyro), self.gyro, self.rate)
        if self.estimator is not None:
            if self._observe is not None:
                self._observe(plant.quat)
            self.attitude = self.estimator.update(self.gyro, self.accel)


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


class AttitudeError(Strict):
    """Errors in the roll and pitch that a flight is flown on, as an estimator in the loop would make them.

    First-order Gauss-Markov on each angle. The vehicle then swings as it does on a real estimator.
    """

    sd_deg: Annotated[float, Between(0.0, 15.0, "°")] = Field(
        default=0.0, description="Standard deviation [deg]."
    )
    time_s: Annotated[float, Between(1e-3, 60.0, "s")] = Field(
        default=0.3, description="Correlation time [s]."
    )

    def series(self, n_steps: int, rate_hz: float, seeds: Sequence[np.random.SeedSequence]) -> Array:
        """Errors of roll and pitch of one flight per seed, (n, steps, 2) [rad], stationary from the start."""
        white = np.stack([np.random.default_rng(seed).normal(size=(n_steps, 2)) for seed in seeds])
        kept = math.exp(-1.0 / (rate_hz * self.time_s))
        white[:, 1:] *= math.sqrt(1.0 - kept**2)
        return math.radians(self.sd_deg) * np.asarray(lfilter([1.0], [1.0, -kept], white, axis=1))


class FlightConfig(Strict):
    """What a recorded flight is made of; stored whole in every dataset."""

    vehicle: Vehicle = Field(description="The nominal vehicle.")
    imu: ImuSpec = Field(description="The IMU.")
    trajectory: Trajectory = Field(default=Mix(), description="What to fly.")
    wind: tuple[WindSpec, ...] = Field(default=(), description="Winds, added up.")
    randomisation: Randomisation = Field(
        default=Randomisation(), description="Spread of the vehicle's numbers."
    )
    attitude_error: AttitudeError = Field(
        default=AttitudeError(), description="What the controller is told wrongly; nothing by default."
    )
    warmup_s: Annotated[float, Between(0.0, 60.0, "s")] = Field(
        default=4.0,
        description="Flown before recording, so that flights begin in the midst of motion [s].",
    )


class Layout(NamedTuple):
    """Columns of a recorded row."""

    position: slice = slice(0, 3)
    velocity: slice = slice(3, 6)
    quat: slice = slice(6, 10)
    ang_vel: slice = slice(10, 13)
    specific_force: slice = slice(13, 16)
    rotor_vel: slice = slice(16, 20)
    ang_acc: slice = slice(20, 23)
    wind: slice = slice(23, 26)
    rotor_vel_cmd: slice = slice(26, 30)


LAYOUT = Layout()
WIDTH = 30


@njit(cache=True)
def record(
    k, row, position, velocity, quat, ang_vel, specific_force, rotor_vel, ang_acc, wind, command, log, end
):
    """Write sample k of every vehicle into log (n, T, WIDTH); a vehicle that has diverged ends there.

    row: (WIDTH,) scratch. end: (n,) number of valid samples, T while all is well; later ones repeat the last.
    """
    for i in range(log.shape[0]):
        speed = rate = 0.0
        for j in range(3):
            row[j], row[3 + j], row[10 + j] = position[i, j], velocity[i, j], ang_vel[i, j]
            row[13 + j], row[20 + j], row[23 + j] = specific_force[i, j], ang_acc[i, j], wind[i, j]
            speed += velocity[i, j] ** 2
            rate += ang_vel[i, j] ** 2
        for j in range(4):
            row[6 + j], row[16 + j], row[26 + j] = quat[i, j], rotor_vel[i, j], command[i, j]
        nothing = 0.0  # and stays so if every number is finite
        for j in range(WIDTH):
            nothing += 0.0 * row[j]
        if nothing == 0.0 and speed < MAX_SPEED**2 and rate < MAX_BODY_RATE**2 and end[i] > k:
            log[i, k] = row
            continue
        end[i] = min(end[i], k)
        if k > 0:
            log[i, k] = log[i, k - 1]
        else:
            log[i, k] = 0.0
            log[i, k, 6] = 1.0  # level: even a flight without a valid sample holds rotations


def simulate_flights(
    config: FlightConfig, seeds: Sequence[np.random.SeedSequence], steps: int, rate_hz: float = 200.0
) -> dict[str, Array | list[str]]:
    """Fly one flight per seed on true attitude, but for the configured error, and record it.

    Args:
        config: What to fly.
        seeds: One per flight; flight i depends on seeds[i] alone.
        steps: Samples to record, after the warm-up.
        rate_hz: Samples per second.

    Returns:
        Arrays (n, T, ...) gyro accel ang_vel specific_force quat position velocity rotor_vel rotor_vel_cmd
        wind gyro_bias accel_bias, and `end_step` (n,), the number of valid samples of each flight (a vehicle
        that diverges holds its last valid sample), with `end_reason`, "" for a whole flight.
    """
    n, warmup = len(seeds), round(config.warmup_s * rate_hz)
    path, body, air, imu, sight = ([child(seed, part) for seed in seeds] for part in range(5))
    vehicles = [randomise(config.vehicle, config.randomisation, np.random.default_rng(s)) for s in body]
    target = reference(config.trajectory, warmup + steps, rate_hz, path)
    wind = wind_series(config.wind, n, warmup + steps, rate_hz, air) if config.wind else None
    wrong = (
        config.attitude_error.series(warmup + steps, rate_hz, sight) if config.attitude_error.sd_deg else None
    )
    loop = FlightLoop(vehicles, n, rate_hz=rate_hz, nominal=config.vehicle)
    loop.reset(position=target[:, 0, :3], velocity=target[:, 0, 3:6])
    log, end = np.zeros((n, steps, WIDTH)), np.full(n, steps)
    plant, row, calm = loop.plant, np.empty(WIDTH), np.zeros((n, 3))
    for k in range(warmup + steps):
        air_now = calm if wind is None else wind[:, k]
        if k:
            if wrong is not None:
                loop.attitude = loop.true_attitude + wrong[:, k - 1]
            loop.step("position", target[:, k - 1], air_now)
        if k >= warmup:
            record(
                k - warmup,
                row,
                plant.position,
                plant.velocity,
                plant.quat,
                plant.ang_vel,
                plant.specific_force,
                plant.rotor_vel,
                plant.ang_acc,
                air_now,
                loop.controller.rotor_vel_cmd,
                log,
                end,
            )
    flown = {name: log[..., columns] for name, columns in LAYOUT._asdict().items()}
    gyro, accel, gyro_bias, accel_bias = simulate_imu_with_bias(
        config.imu,
        flown["ang_vel"],
        flown["specific_force"],
        rate_hz,
        imu,
        ang_acc=flown.pop("ang_acc"),
        rotor_vel=flown["rotor_vel"],
    )
    return flown | {
        "gyro": gyro,
        "accel": accel,
        "gyro_bias": gyro_bias,
        "accel_bias": accel_bias,
        "end_step": end,
        "end_reason": ["" if e == steps else f"diverged after {e / rate_hz:.2f} s" for e in end],
    }
