"""Flights for a dataset: many at once, flown with the true attitude plus a configured error, and recorded."""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.signal import lfilter

from ..config.ranges import Between
from ..config.toml import Strict
from ..imu.spec import ImuSpec
from ..imu.stream import simulate_imu_with_bias
from ..runs.compiled import njit
from ..seeding import child
from ..trajectory.reference import reference
from ..trajectory.specs import Mix, Trajectory
from ..vehicle import Randomisation, Vehicle, randomise
from ..wind import WindSpec, wind_series
from .loop import FlightLoop

Array = NDArray[np.float64]

MAX_SPEED = 150.0  # m/s, and
MAX_BODY_RATE = 150.0  # rad/s: a vehicle beyond either has diverged


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
