"""Flights for a dataset: the controller receives the true attitude plus a configured error."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..control.attitude_controller import MakeController
from ..imu.stream import simulate_readings
from ..motion.rotors import state_dtype
from ..seeding import AIR, ANGLES, BODY, GROUND, SENSOR, TRAJECTORY, children
from .domain import Domain, domains
from .ground import start_on_ground
from .hand_held import move_by_hand
from .loop import FlightLoop
from .mission import planned
from .recipe import Recipe

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

MAX_SPEED = 150.0  # m/s, and
MAX_BODY_RATE = 150.0  # rad/s: a vehicle beyond either has diverged


def simulate_flights(
    config: Recipe, seeds: Seeds, steps: int, rate_hz: float = 200.0
) -> dict[str, Array | NDArray[np.int64] | list[str]]:
    """Simulate and record one flight per seed, with the true attitude plus the configured error in the loop.

    Args:
        config: What to fly.
        seeds: One per flight; flight i depends on seeds[i] alone.
        steps: Samples to record, after the warm-up.
        rate_hz: Samples per second.

    Returns:
        Arrays (n, T, ...) gyro, accel, ang_vel, specific_force, quat, position, velocity, rotor_vel,
        rotor_vel_cmd, wind, gyro_bias and accel_bias; `end_step` (n,), the number of valid samples, after
        which a flight repeats its last valid sample; and `end_reason`, "" for a complete flight.
    """
    log = np.zeros((len(seeds), steps), state_dtype(len(config.vehicle.rotors)))
    end, drawn = np.full(len(seeds), steps), _domains(config, seeds)
    if config.hand_held is not None:
        motion = move_by_hand(config.hand_held, steps, rate_hz, children(seeds, TRAJECTORY))
        for name, values in motion.items():
            log[name] = values
    else:
        total = round(config.warmup_s * rate_hz) + steps
        loop = recipe_loop(config, seeds, total, rate_hz, log, drawn=drawn)
        if total == steps:
            loop.sense()  # the first sample is recorded, in its wind
        loop.follow(total - 1)
        end = _held(log)
    if config.ground:
        before = start_on_ground(log, rate_hz, children(seeds, GROUND))
        end = np.where(end < steps, np.minimum(end + before, steps), steps)
    flights = {name: log[name] for name in log.dtype.names or () if name != "ang_acc"}
    reasons = ["" if e == steps else f"diverged after {e / rate_hz:.2f} s" for e in end]
    imus = [each.imu for each in drawn]
    readings = simulate_readings(imus, log, rate_hz, children(seeds, SENSOR))
    return {**flights, **readings, "end_step": end, "end_reason": reasons}


def _domains(config: Recipe, seeds: Seeds) -> list[Domain]:
    return domains(config.vehicle, config.imu, config.randomisation, children(seeds, BODY))


def recipe_loop(
    config: Recipe,
    seeds: Seeds,
    steps: int,
    rate_hz: float = 200.0,
    log: NDArray[np.void] | None = None,
    controller: MakeController | None = None,
    drawn: Sequence[Domain] | None = None,
) -> FlightLoop:
    """Make the loops of flights of a recipe, one per seed, at their first sample.

    Args:
        config: The recipe; hand-held motion and the start on the ground are ignored.
        seeds: One per flight; flight i depends only on seeds[i].
        steps: Number of planned samples.
        rate_hz: Samples per second.
        log: Records to which the states are written; see `FlightLoop`.
        controller: Function that makes a controller, which receives the readings of the IMU; None for the
            cascade, which receives the true body rate.
        drawn: Randomised domains, one per seed; None draws them.
    """
    path, air, angles = (children(seeds, part) for part in (TRAJECTORY, AIR, ANGLES))
    drawn = drawn or _domains(config, seeds)
    plans = planned(config.trajectory, config.wind, drawn, steps, rate_hz, path, air)
    first = plans[:, 0].copy()
    plans["wind"][:, :-1] = plans["wind"][:, 1:]  # a sample's wind is that of the way to it
    if config.attitude_error.sd_deg:
        plans["attitude_error"] = config.attitude_error.series(steps, rate_hz, angles)
    loop = FlightLoop(
        [each.vehicle for each in drawn],
        len(seeds),
        rate_hz=rate_hz,
        imu=None if controller is None else [each.imu for each in drawn],
        seed=children(seeds, SENSOR),
        nominal=config.vehicle,
        engine=config.engine,
        controller=controller,
        plans=plans,
        log=log,
    )
    loop.reset(position=first["target"]["position"], velocity=first["target"]["velocity"])
    loop.plant.wind[:] = first["wind"]
    return loop


def _held(log: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the number of valid samples of each flight (n,) of a log (n, T).

    Repeat the last valid one after them, in place.

    A flight without a valid sample is filled with a level vehicle at rest.
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
