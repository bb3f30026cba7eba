"""Flights for a dataset: many at once, with the true attitude plus a configured error, recorded."""

import math
from collections.abc import Sequence
from functools import cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..config.ranges import Between, Engine
from ..config.toml import Strict
from ..control.cascade import LEVELS, SET_POINT
from ..imu.spec import ImuSpec
from ..imu.stream import simulate_imu_with_bias
from ..plant import fly
from ..runs.compiled import njit
from ..seeding import child
from ..trajectory.reference import reference
from ..trajectory.specs import Mix, Trajectory
from ..vehicle import Randomisation, Vehicle, randomise
from ..wind import WindSpec, wind_series
from .ground import GroundStart, start_on_ground
from .hand_held import HandHeld, move_by_hand
from .loop import FlightLoop, sense_truth, start_one

Array = NDArray[np.float64]

Seeds = Sequence[np.random.SeedSequence]

MAX_SPEED = 150.0  # m/s, and
MAX_BODY_RATE = 150.0  # rad/s: a vehicle beyond either has diverged


class AttitudeError(Strict):
    """Errors in the roll and pitch that the controller gets, as an estimator in the loop would make them.

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
        from scipy.signal import lfilter  # takes half a second

        white = np.stack([np.random.default_rng(seed).normal(size=(n_steps, 2)) for seed in seeds])
        decay = math.exp(-1.0 / (rate_hz * self.time_s))
        white[:, 1:] *= math.sqrt(1.0 - decay**2)
        return math.radians(self.sd_deg) * np.asarray(lfilter([1.0], [1.0, -decay], white, axis=1))


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
        default=AttitudeError(),
        description="Error of the roll and pitch that the controller gets.",
    )
    hand_held: HandHeld | None = Field(
        default=None, description="Motion by hand, in place of a flight: the IMU alone, rotors at rest."
    )
    ground: GroundStart | None = Field(
        default=None, description="A start at rest on the ground, before the flight; its end falls away."
    )
    engine: Engine = Field(
        default="auto", description='Integrator of the motion: "mujoco", "compiled", or "auto".'
    )
    warmup_s: Annotated[float, Between(0.0, 60.0, "s")] = Field(
        default=4.0,
        description="Simulated before recording, so that flights begin in motion [s].",
    )


PATH = np.dtype([("target", SET_POINT), ("wind", "f8", 3), ("attitude_error", "f8", 2)])
"""What is planned for a sample: set-point, wind [m/s], and error of the roll and pitch for control [rad]."""
ON_POSITION = LEVELS.index("position")


@cache
def sample_dtype(rotors: int) -> np.dtype:
    """A recorded sample of a vehicle with so many rotors, fields as in `quadsim.plant.State`."""
    return np.dtype(
        [
            ("position", "f8", 3),
            ("velocity", "f8", 3),
            ("quat", "f8", 4),
            ("ang_vel", "f8", 3),
            ("specific_force", "f8", 3),
            ("rotor_vel", "f8", rotors),
            ("ang_acc", "f8", 3),
            ("wind", "f8", 3),
            ("rotor_vel_cmd", "f8", rotors),
        ]
    )


@njit(cache=True)
def record(k, loop, log, end):
    """Write sample k of a flight into its log (T,), records of `sample_dtype`.

    Returns how many of the samples so far are valid: `end` while all is well; a vehicle that has diverged
    ends there, and later samples repeat its last.
    """
    row, p, c = log[k], loop.vehicle, loop.controller
    speed = rate = not_finite = 0.0  # the last stays 0 if every number is finite
    for j in range(3):
        row.position[j], row.velocity[j], row.ang_vel[j] = p.position[j], p.velocity[j], p.ang_vel[j]
        row.specific_force[j], row.ang_acc[j], row.wind[j] = p.specific_force[j], p.ang_acc[j], p.wind[j]
        speed += p.velocity[j] ** 2
        rate += p.ang_vel[j] ** 2
        not_finite += 0.0 * (p.position[j] + p.specific_force[j] + p.ang_acc[j] + p.wind[j])
    for j in range(4):
        row.quat[j] = p.quat[j]
        not_finite += 0.0 * p.quat[j]
    for j in range(p.rotor_vel.shape[0]):
        row.rotor_vel[j], row.rotor_vel_cmd[j] = p.rotor_vel[j], c.rotor_vel_cmd[j]
        not_finite += 0.0 * row.rotor_vel[j] + 0.0 * row.rotor_vel_cmd[j]
    if not_finite == 0.0 and speed < MAX_SPEED**2 and rate < MAX_BODY_RATE**2 and end > k:
        return end
    if k > 0:
        log[k] = log[k - 1]
        return min(end, k)
    for j in range(3):
        row.position[j] = row.velocity[j] = row.ang_vel[j] = 0.0
        row.specific_force[j] = row.ang_acc[j] = row.wind[j] = 0.0
    for j in range(p.rotor_vel.shape[0]):
        row.rotor_vel[j] = row.rotor_vel_cmd[j] = 0.0
    # level: even a flight without a valid sample holds rotations
    row.quat[0], row.quat[1], row.quat[2], row.quat[3] = 1.0, 0.0, 0.0, 0.0
    return 0


@njit(cache=True)
def start_sample(k, loop, path):
    """Set-point, error of the attitude, wind and control for the step from sample k − 1 to k."""
    before, now = path[k - 1], path[k]
    loop.set_point = before.target
    for j in range(2):
        loop.measured.roll_pitch[j] += before.attitude_error[j]
    for j in range(3):
        loop.vehicle.wind[j] = now.wind[j]
    start_one(ON_POSITION, loop)


@njit(cache=True)
def start_samples(k, loops, paths):
    """`start_sample` of all flights, paths (n, T) records of `PATH`."""
    for i in range(loops.shape[0]):
        start_sample(k, loops[i], paths[i])


@njit(cache=True)
def finish_samples(k, loops, log, end):
    """Truth and record of sample k ≥ 0 of all flights, after MuJoCo has moved them."""
    for i in range(loops.shape[0]):
        sense_truth(loops[i])
        if k >= 0:
            end[i] = record(k, loops[i], log[i], end[i])


@njit(cache=True)
def fly_flights(loops, paths, substeps, log, end):
    """All samples of all flights but their first, recorded where there is a place in log for them."""
    warmup = paths.shape[1] - log.shape[1]
    for i in range(loops.shape[0]):
        loop = loops[i]
        for k in range(1, paths.shape[1]):
            start_sample(k, loop, paths[i])
            fly(loop.vehicle, loop.controller.rotor_vel_cmd, substeps)
            sense_truth(loop)
            if k >= warmup:
                end[i] = record(k - warmup, loop, log[i], end[i])


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
    motion, body, air, imu, angles = ([child(seed, part) for seed in seeds] for part in range(5))
    if config.hand_held is not None:
        log, end = _moved_by_hand(config, steps, rate_hz, motion), np.full(len(seeds), steps)
    else:
        log, end = _flown(config, steps, rate_hz, motion, body, air, angles)
    if config.ground is not None:
        before = start_on_ground(config.ground, log, rate_hz, [child(seed, 5) for seed in seeds])
        end = np.where(end < steps, np.minimum(end + before, steps), steps)
    flights = {name: log[name] for name in log.dtype.names or ()}
    rate, force, rotor_vel = flights["ang_vel"], flights["specific_force"], flights["rotor_vel"]
    ang_acc = flights.pop("ang_acc")
    gyro, accel, gyro_bias, accel_bias = simulate_imu_with_bias(
        config.imu, rate, force, rate_hz, imu, ang_acc, rotor_vel
    )
    return flights | {
        "gyro": gyro,
        "accel": accel,
        "gyro_bias": gyro_bias,
        "accel_bias": accel_bias,
        "end_step": end,
        "end_reason": ["" if e == steps else f"diverged after {e / rate_hz:.2f} s" for e in end],
    }


def _flown(
    config: FlightConfig, steps: int, rate_hz: float, motion: Seeds, body: Seeds, air: Seeds, angles: Seeds
) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Records (n, T) of flights, and the valid samples of each; seeds of trajectory, vehicle, wind, error."""
    n, warmup = len(motion), round(config.warmup_s * rate_hz)
    samples = warmup + steps
    vehicles = [randomise(config.vehicle, config.randomisation, np.random.default_rng(s)) for s in body]
    paths = np.zeros((n, samples), PATH)
    paths["target"] = target = reference(config.trajectory, samples, rate_hz, motion)
    if config.wind:
        paths["wind"] = wind_series(config.wind, n, samples, rate_hz, air)
    if config.attitude_error.sd_deg:
        paths["attitude_error"] = config.attitude_error.series(samples, rate_hz, angles)
    loop = FlightLoop(vehicles, n, rate_hz=rate_hz, nominal=config.vehicle, engine=config.engine)
    loop.reset(position=target["position"][:, 0], velocity=target["velocity"][:, 0])
    loop.plant.wind[:] = paths["wind"][:, 0]
    log, end = np.zeros((n, steps), sample_dtype(len(config.vehicle.rotors))), np.full(n, steps)
    if warmup == 0:
        finish_samples(0, loop.records, log, end)
    if loop.plant.engine is None:
        fly_flights(loop.records, paths, loop.plant.substeps, log, end)
    else:
        for k in range(1, samples):
            start_samples(k, loop.records, paths)
            loop.plant.finish_move(loop.controller.rotor_vel_cmd)
            finish_samples(k - warmup, loop.records, log, end)
    return log, end


def _moved_by_hand(config: FlightConfig, steps: int, rate_hz: float, motion: Seeds) -> NDArray[np.void]:
    """Records (n, T) of an IMU in the hand."""
    assert config.hand_held is not None
    log = np.zeros((len(motion), steps), sample_dtype(len(config.vehicle.rotors)))
    for name, values in move_by_hand(config.hand_held, steps, rate_hz, motion).items():
        log[name] = values
    return log
