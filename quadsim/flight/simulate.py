"""Flights for a dataset: many at once, with the true attitude plus a configured error, recorded."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..control.records import POSITION
from ..imu.stream import simulate_imu_with_bias
from ..plant import fly
from ..runs.compiled import njit
from ..seeding import child
from ..vehicle import randomise
from .ground import start_on_ground
from .hand_held import move_by_hand
from .loop import FlightLoop
from .mission import planned
from .recipe import Recipe
from .world import sense_one, start_one

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

MAX_SPEED = 150.0  # m/s, and
MAX_BODY_RATE = 150.0  # rad/s: a vehicle beyond either has diverged


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
def record(loop, row):
    """Write the present sample of a flight into its row, a record of `sample_dtype`."""
    p, command = loop.vehicle, loop.controller.rotor_vel_cmd
    for j in range(3):
        row.position[j], row.velocity[j], row.ang_vel[j] = p.position[j], p.velocity[j], p.ang_vel[j]
        row.specific_force[j], row.ang_acc[j], row.wind[j] = p.specific_force[j], p.ang_acc[j], p.wind[j]
    for j in range(4):
        row.quat[j] = p.quat[j]
    for j in range(command.shape[0]):
        row.rotor_vel[j], row.rotor_vel_cmd[j] = p.rotor_vel[j], command[j]


@njit(cache=True)
def record_all(loops, rows):
    """`record` for all, (n,) records each."""
    for i in range(loops.shape[0]):
        record(loops[i], rows[i])


@njit(cache=True)
def fly_flights(loops, plans, substeps, log):
    """All samples of all flights but their first, recorded where there is a place in log (n, T) for them."""
    warmup, no_noise, x = plans.shape[1] - log.shape[1], np.empty((0, 0, 3)), np.empty((2, 3))
    for i in range(loops.shape[0]):
        loop = loops[i]
        for k in range(1, plans.shape[1]):
            start_one(POSITION, loop)
            fly(loop.vehicle, loop.controller.rotor_vel_cmd, substeps)
            sense_one(loop, plans[i], no_noise, 0, x)
            if k >= warmup:
                record(loop, log[i, k - warmup])


def simulate_flights(
    config: Recipe, seeds: Seeds, steps: int, rate_hz: float = 200.0
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
    log = np.zeros((len(seeds), steps), sample_dtype(len(config.vehicle.rotors)))
    end = np.full(len(seeds), steps)
    if config.hand_held is not None:
        for name, values in move_by_hand(config.hand_held, steps, rate_hz, motion).items():
            log[name] = values
    else:
        _fly(config, log, rate_hz, motion, body, air, angles)
        end = _held(log)
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


def _fly(
    config: Recipe,
    log: NDArray[np.void],
    rate_hz: float,
    motion: Seeds,
    body: Seeds,
    air: Seeds,
    angles: Seeds,
) -> None:
    """Fill the log (n, T) with flights; seeds of trajectory, vehicle, wind and error."""
    n, steps = log.shape
    warmup = round(config.warmup_s * rate_hz)
    vehicles = [randomise(config.vehicle, config.randomisation, np.random.default_rng(s)) for s in body]
    plans = planned(config.trajectory, config.wind, warmup + steps, rate_hz, motion, air)
    first = plans[:, 0].copy()
    plans["wind"][:, :-1] = plans["wind"][:, 1:]  # a sample's wind is that of the way to it
    if config.attitude_error.sd_deg:
        plans["attitude_error"] = config.attitude_error.series(warmup + steps, rate_hz, angles)
    loop = FlightLoop(vehicles, n, rate_hz=rate_hz, nominal=config.vehicle, engine=config.engine, plans=plans)
    loop.reset(position=first["target"]["position"], velocity=first["target"]["velocity"])
    loop.plant.wind[:] = first["wind"]
    if warmup == 0:
        loop.sense()
        record_all(loop.records, log[:, 0])
    if loop.plant.engine is None:
        fly_flights(loop.records, plans, loop.plant.substeps, log)
        return
    for k in range(1, warmup + steps):
        loop.step()
        if k >= warmup:
            record_all(loop.records, log[:, k - warmup])


def _held(log: NDArray[np.void]) -> NDArray[np.int64]:
    """Valid samples of each flight (n,) of a log (n, T); after them it holds the last one, changed in place.

    A flight without a valid sample is level and at rest: even that holds rotations.
    """
    numbers = log.view(np.float64).reshape(*log.shape, -1)
    with np.errstate(invalid="ignore", over="ignore"):
        speed, rate = (np.einsum("nti,nti->nt", log[name], log[name]) for name in ("velocity", "ang_vel"))
        valid = np.isfinite(numbers.sum(axis=-1)) & (speed < MAX_SPEED**2) & (rate < MAX_BODY_RATE**2)
    end = np.where(valid.all(axis=1), log.shape[1], valid.argmin(axis=1))
    for flight, last in zip(log, end - 1, strict=True):
        if last >= 0:
            flight[last + 1 :] = flight[last]
        else:
            flight[:] = np.zeros((), log.dtype)
            flight["quat"] = (1.0, 0.0, 0.0, 0.0)
    return end
