"""Least squares: the constants with which the model does what the readings say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from ..vehicle import Vehicle
from .model import DRAG, LAGS, UNITS, constant, lagged, predicted, with_constants
from .signals import BAND_HZ, Flight, low_passed, settled

Array = NDArray[np.float64]

BIAS_SD = 0.2
"""Standard deviation of an accelerometer's bias before the fit [m/s²]."""
SURE = 0.05
"""A constant is identified if its 95 % interval is within this share of it."""
DEGENERATE = 1e-9
"""Smallest eigenvalue of the normalised information, over the largest, of what the flights tell at all."""
ROUNDS = 3
"""Of the fit: the size of the errors of each of the six signals is known after the first alone."""
LEAST = 1e-3
"""Smallest value of a constant that cannot be 0, as a share of the start."""
TYPICAL = {"motor.rotor_drag": 1e-4, "motor.rolling_moment": 1e-6, "frame.drag_area": 1e-2}
"""Scale of a constant that is 0 at the start."""


@dataclass(frozen=True)
class Constant:
    """One constant before and after."""

    path: str
    """In the vehicle file."""
    unit: str
    start: float
    fitted: float
    half_width: float
    """Of its 95 % interval."""

    @property
    def identified(self) -> bool:
        """Whether the flights tell it well enough to be used."""
        return self.half_width <= SURE * abs(self.fitted)


@dataclass(frozen=True)
class Identified:
    """What flights say of a vehicle."""

    vehicle: Vehicle
    """With the constants that are identified; the others are as at the start."""
    constants: tuple[Constant, ...]
    missing: tuple[str, ...]
    """What could not be fitted, and why."""
    measured: tuple[Array, ...]
    """Specific force and angular acceleration of each flight below the band, (T, 6)."""
    modelled: tuple[Array, ...]
    """The same by the model with the fitted constants, (T, 6)."""
    rate_hz: float

    @property
    def explained(self) -> Array:
        """Share of the variance of each of the six that the model explains, (6,)."""
        measured, modelled = np.concatenate(self.measured), np.concatenate(self.modelled)
        return 1.0 - (measured - modelled).var(axis=0) / measured.var(axis=0)


def identify(flights: Sequence[Flight], start: Vehicle) -> Identified:
    """Fit thrust, drag and lag of the rotors, drag of the frame and inertia of a vehicle to its flights.

    Both sides of Newton's and Euler's equations are low-passed alike, at 12 Hz: the accelerometer and the
    derivative of the gyroscope on one side, `quadsim.motion.rotors` on the other. Mass and geometry are the
    start's: flights tell force per mass alone. Each flight has a bias of the accelerometer of its own.

    Args:
        flights: With rotor speeds, or commands from which the start's lag gives them.
        start: The vehicle to begin with.

    Raises:
        ValueError: No flight is long enough, has rotor speeds, or has the vehicle's rotors.
    """
    if not flights:
        raise ValueError("no flight has 5 s without a missing sample")
    if len(rates := {flight.rate_hz for flight in flights}) > 1:
        raise ValueError(
            f"flights at {' and '.join(f'{rate:g} Hz' for rate in sorted(rates))}; one rate is required"
        )
    speeds = [_speeds(flight, start) for flight in flights]
    if any(each.shape[1] != len(start.rotors) for each in speeds):
        raise ValueError(f"{start.name} has {len(start.rotors)} rotors, the flights {speeds[0].shape[1]}")
    names, missing = _wanted(flights, start)
    measured = [_measured(flight) for flight in flights]
    scale = np.array([_scale(start, name) for name in names])
    first = np.array([constant(start, name) for name in names]) / scale

    def modelled(x: Array) -> list[Array]:
        vehicle = with_constants(start, dict(zip(names, (x[: len(names)] * scale).tolist(), strict=True)))
        biases = x[len(names) :].reshape(-1, 3)
        return [
            settled(low_passed(predicted(vehicle, flight, speed), flight.rate_hz), flight.rate_hz)
            + np.concatenate([bias, np.zeros(3)])
            for flight, speed, bias in zip(flights, speeds, biases, strict=True)
        ]

    def residuals(x: Array, sigma: Array) -> Array:
        apart = [(a - b) / sigma for a, b in zip(modelled(x), measured, strict=True)]
        prior = x[len(names) :] / BIAS_SD * np.sqrt(_per_independent(flights[0]))  # against as many samples
        return np.concatenate([*(each.ravel() for each in apart), prior])

    x = np.concatenate([first, np.zeros(3 * len(flights))])
    least = [0.0 if name in DRAG else LEAST for name in names]
    low = np.concatenate([least, np.full(3 * len(flights), -np.inf)])
    sigma = np.mean([np.diff(each, axis=0).std(axis=0) for each in measured], axis=0) + 1e-9
    jacobian = found_residuals = np.empty(0)
    for _ in range(ROUNDS):
        found = least_squares(
            residuals, np.maximum(x, low), bounds=(low, np.inf), args=(sigma,), x_scale="jac"
        )
        x, jacobian, found_residuals = found.x, found.jac, found.fun
        apart = np.concatenate([a - b for a, b in zip(modelled(x), measured, strict=True)])
        sigma = np.maximum(apart.std(axis=0), 1e-9)
    half = _half_widths(jacobian, found_residuals, round(6 * flights[0].rate_hz))[: len(names)] * scale
    constants = [
        Constant(name, UNITS[name], constant(start, name), float(value), float(width))
        for name, value, width in zip(names, x[: len(names)] * scale, half, strict=True)
    ]
    constants += _lags(flights, start)
    known = {each.path: each.fitted for each in constants if each.identified}
    missing += [
        f"{each.path}: {_told(each)}, so it stays {each.start:.4g}"
        for each in constants
        if not each.identified
    ]
    return Identified(
        with_constants(start, known),
        tuple(sorted(constants, key=lambda each: list(UNITS).index(each.path))),
        tuple(missing),
        tuple(measured),
        tuple(modelled(x)),
        flights[0].rate_hz,
    )


def _speeds(flight: Flight, start: Vehicle) -> Array:
    if flight.rotor_vel is not None:
        return flight.rotor_vel
    if flight.rotor_vel_cmd is not None:
        return lagged(start, flight, flight.rotor_vel_cmd[0])
    raise ValueError("no rotor speeds: a vehicle's constants need them, measured or commanded, in rad/s")


def _wanted(flights: Sequence[Flight], start: Vehicle) -> tuple[list[str], list[str]]:
    """Constants to fit, and why not the others."""
    names, missing = [name for name in UNITS if name not in LAGS], []
    if any(flight.air_vel is None for flight in flights):
        names = [name for name in names if name not in DRAG]
        missing.append("drag: it needs attitude and position or velocity")
    if any(flight.rotor_vel is None or flight.rotor_vel_cmd is None for flight in flights):
        missing.append("lag of the rotors: it needs commanded and measured rotor speeds")
    return names, missing


def _scale(start: Vehicle, name: str) -> float:
    typical = next((value for key, value in TYPICAL.items() if name.startswith(key)), 0.0)
    return constant(start, name) or typical


def _measured(flight: Flight) -> Array:
    """Specific force and angular acceleration below the band, (T, 6)."""
    ang_acc = np.gradient(flight.gyro, 1.0 / flight.rate_hz, axis=0)
    both = np.concatenate([flight.accel, ang_acc], axis=1)
    return settled(low_passed(both, flight.rate_hz), flight.rate_hz)


def _per_independent(flight: Flight) -> float:
    """Samples for each that is independent of the others below the band."""
    return flight.rate_hz / (2.0 * BAND_HZ)


def _told(each: Constant) -> str:
    if np.isinf(each.half_width):
        return "these flights do not tell it"
    return f"{each.fitted:.3g} ± {each.half_width:.2g} {each.unit} is not told well enough"


def _half_widths(jacobian: Array, residuals: Array, rows: int) -> Array:
    """Half of the 95 % interval of each parameter; infinite where nothing tells it, alone or from others.

    Errors of neighbouring samples may be correlated: the covariance is the sandwich of sums over blocks
    (Liang & Zeger 1986).

    Args:
        jacobian: Of the residuals, (N, parameters).
        residuals: At the solution (N,).
        rows: Of a block.
    """
    length = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(length > 0.0, length, 1.0)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    told = values > DEGENERATE * values.max()
    inverse = (vectors[:, told] / values[told]) @ vectors[:, told].T
    starts = np.arange(0, len(residuals), rows)
    scores = np.add.reduceat(unit * residuals[:, None], starts, axis=0)
    variance = np.diag(inverse @ (scores.T @ scores) @ inverse)
    half = norm.ppf(0.975) * np.sqrt(variance) / np.where(length > 0.0, length, 1.0)
    blind = (length == 0.0) | (np.abs(vectors[:, ~told]) > 1e-3).any(axis=1)
    return np.where(blind, np.inf, half)


def _lags(flights: Sequence[Flight], start: Vehicle) -> list[Constant]:
    """Time constants of the rotors, from commanded and actual speeds."""
    both = [flight for flight in flights if flight.rotor_vel is not None and flight.rotor_vel_cmd is not None]
    if not both:
        return []
    begin = np.array([constant(start, name) for name in LAGS])

    def residuals(x: Array) -> Array:
        vehicle = with_constants(start, dict(zip(LAGS, (x * begin).tolist(), strict=True)))
        return np.concatenate([(lagged(vehicle, f, f.rotor_vel[0]) - f.rotor_vel).ravel() for f in both])  # pyright: ignore

    found = least_squares(residuals, np.ones(2), bounds=(1e-2, 1e2))
    second = round(both[0].rate_hz) * both[0].gyro.shape[1]
    half = _half_widths(found.jac, found.fun, second) * begin
    return [
        Constant(name, UNITS[name], float(old), float(new), float(width))
        for name, old, new, width in zip(LAGS, begin, found.x * begin, half, strict=True)
    ]
