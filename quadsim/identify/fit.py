"""Least-squares fit of a vehicle's constants to readings."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from ..vehicle import Vehicle
from .model import DRAG, LAGS, UNITS, constant, lagged, predicted, with_constants
from .signals import BAND_HZ, SHORTEST_S, Flight, below_band

Array = NDArray[np.float64]

BIAS_SD = 0.2
"""Standard deviation of an accelerometer's bias before the fit [m/s²]."""
SURE = 0.05
"""A constant is identified if half of its 95 % interval is at most this share of its value."""
DEGENERATE = 1e-9
"""Ratio of an eigenvalue of the normalised information matrix to the largest one, below which the data do not
determine its direction."""
ROUNDS = 3
"""Rounds of the fit. Only after the first round is the size of the errors of each of the six signals
known."""
LEAST = 1e-3
"""Smallest value of a constant that cannot be 0, as a share of its initial value."""
NO_FLIGHT = f"no {SHORTEST_S:g} s without a missing sample and with rotor speeds in rad/s"
TYPICAL = {"motor.rotor_drag": 1e-4, "motor.rolling_moment": 1e-6, "frame.drag_area": 1e-2}
"""Scale of a constant whose initial value is 0."""


@dataclass(frozen=True)
class Identified:
    """The result of an identification."""

    vehicle: Vehicle
    """The vehicle with the identified constants; the other constants keep their initial values."""
    constants: pd.DataFrame
    """For each constant, by its path in the vehicle file: unit, initial value, fitted value, half width of
    the 95 % interval, and whether the constant is identified."""
    missing: tuple[str, ...]
    """Constants that could not be fitted, and why."""
    measured: tuple[Array, ...]
    """Measured specific force and angular acceleration of each flight, low-passed, (T, 6)."""
    modelled: tuple[Array, ...]
    """The same quantities by the model with the fitted constants, (T, 6)."""
    rate_hz: float

    @property
    def explained(self) -> Array:
        """Share of the variance of each of the six signals that the model explains, (6,)."""
        measured, modelled = np.concatenate(self.measured), np.concatenate(self.modelled)
        return 1.0 - (measured - modelled).var(axis=0) / measured.var(axis=0)


def identify(flights: Sequence[Flight], start: Vehicle) -> Identified:
    """Fit thrust, drag and lag of the rotors, drag of the frame, and inertia of a vehicle to flights.

    Both sides of Newton's and Euler's equations are low-passed at 12 Hz: the accelerometer and the derivative
    of the gyroscope on one side, `quadsim.motion.rotors` on the other. Mass and geometry are those of the
    initial vehicle, because flights determine only force per mass. The accelerometer bias is fitted for each
    flight.

    Args:
        flights: Flights with measured rotor speeds, or with commands from which the initial rotor lag gives
            the speeds.
        start: The initial vehicle.

    Raises:
        ValueError: No flight is long enough and has the speeds of all rotors of the vehicle.
    """
    if not flights:
        raise ValueError(NO_FLIGHT)
    if len(rates := {flight.rate_hz for flight in flights}) > 1:
        raise ValueError(
            f"flights at {' and '.join(f'{rate:g} Hz' for rate in sorted(rates))}; one rate is required"
        )
    speeds = [_speeds(flight, start) for flight in flights]
    if any(each.shape[1] != len(start.rotors) for each in speeds):
        raise ValueError(f"{start.name} has {len(start.rotors)} rotors, the flights {speeds[0].shape[1]}")
    names, missing = _wanted(flights)
    measured = [_measured(flight) for flight in flights]
    scale = np.array([_scale(start, name) for name in names])

    def modelled(x: Array) -> list[Array]:
        vehicle = with_constants(start, dict(zip(names, (x[: len(names)] * scale).tolist(), strict=True)))
        biases = x[len(names) :].reshape(-1, 3)
        return [
            below_band(predicted(vehicle, flight, speed), flight.rate_hz) + np.append(bias, np.zeros(3))
            for flight, speed, bias in zip(flights, speeds, biases, strict=True)
        ]

    def errors(x: Array) -> Array:
        return np.concatenate([a - b for a, b in zip(modelled(x), measured, strict=True)])

    def residuals(x: Array, sigma: Array) -> Array:
        correlated = flights[0].rate_hz / (2.0 * BAND_HZ)  # samples for each independent one below the band
        return np.append(errors(x) / sigma, x[len(names) :] / BIAS_SD * np.sqrt(correlated))

    x = np.append([constant(start, name) for name in names] / scale, np.zeros(3 * len(flights)))
    low = np.append([0.0 if name in DRAG else LEAST for name in names], np.full(3 * len(flights), -np.inf))
    sigma = np.mean([np.diff(each, axis=0).std(axis=0) for each in measured], axis=0) + 1e-9
    found: Any = None
    for _ in range(ROUNDS):
        x = np.maximum(x, low)
        found = least_squares(residuals, x, bounds=(low, np.inf), args=(sigma,), x_scale="jac")
        x, sigma = found.x, np.maximum(errors(found.x).std(axis=0), 1e-9)
    half = _half_widths(found.jac, found.fun, round(6 * flights[0].rate_hz))[: len(names)]
    fits = [_table(start, names, x[: len(names)] * scale, half * scale), *_lags(flights, start)]
    constants = pd.concat(fits).reindex([path for path in UNITS if any(path in fit.index for fit in fits)])
    missing += [
        f"{path}: {_undetermined(row)}, so the value stays {row['start']:.4g}"
        for path, row in constants.to_dict("index").items()
        if not row["identified"]
    ]
    vehicle = with_constants(start, constants.loc[constants.identified, "fitted"].to_dict())
    return Identified(
        vehicle, constants, tuple(missing), tuple(measured), tuple(modelled(x)), flights[0].rate_hz
    )


def _speeds(flight: Flight, start: Vehicle) -> Array:
    if flight.rotor_vel is not None:
        return flight.rotor_vel
    if flight.rotor_vel_cmd is not None:
        return lagged(start, flight, flight.rotor_vel_cmd[0])
    raise ValueError(NO_FLIGHT)


def _wanted(flights: Sequence[Flight]) -> tuple[list[str], list[str]]:
    """Return the constants to fit, and why the others are not fitted."""
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
    """Return specific force and angular acceleration, low-passed, (T, 6)."""
    ang_acc = np.gradient(flight.gyro, 1.0 / flight.rate_hz, axis=0)
    return below_band(np.concatenate([flight.accel, ang_acc], axis=1), flight.rate_hz)


def _table(start: Vehicle, names: Sequence[str], fitted: Array, half_width: Array) -> pd.DataFrame:
    found = {"unit": [UNITS[name] for name in names], "start": [constant(start, name) for name in names]}
    table = pd.DataFrame(found | {"fitted": fitted, "half_width": half_width}, index=list(names))
    return table.assign(identified=table.half_width <= SURE * table.fitted.abs())


def _undetermined(row: dict[Hashable, Any]) -> str:
    if np.isinf(row["half_width"]):
        return "these flights do not determine it"
    return f"{row['fitted']:.3g} ± {row['half_width']:.2g} {row['unit']} is not determined well enough"


def _half_widths(jacobian: Array, residuals: Array, rows: int) -> Array:
    """Return half of the 95 % interval of each parameter.

    Infinite if the data do not determine the parameter.

    Errors of neighbouring samples may be correlated, so the covariance is the sandwich estimator with sums
    over blocks (Liang & Zeger 1986).

    Args:
        jacobian: Jacobian of the residuals, (N, parameters).
        residuals: Residuals at the solution, (N,).
        rows: Number of rows in a block.
    """
    length = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(length > 0.0, length, 1.0)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    observable = values > DEGENERATE * values.max()
    inverse = (vectors[:, observable] / values[observable]) @ vectors[:, observable].T
    starts = np.arange(0, len(residuals), rows)
    scores = np.add.reduceat(unit * residuals[:, None], starts, axis=0)
    variance = np.diag(inverse @ (scores.T @ scores) @ inverse)
    half = norm.ppf(0.975) * np.sqrt(variance) / np.where(length > 0.0, length, 1.0)
    blind = (length == 0.0) | (np.abs(vectors[:, ~observable]) > 1e-3).any(axis=1)
    return np.where(blind, np.inf, half)


def _lags(flights: Sequence[Flight], start: Vehicle) -> list[pd.DataFrame]:
    """Return the time constants of the rotors from commanded and actual speeds.

    There are none if no flight has both.
    """
    both = [(f, f.rotor_vel) for f in flights if f.rotor_vel is not None and f.rotor_vel_cmd is not None]
    if not both:
        return []
    begin = np.array([constant(start, name) for name in LAGS])

    def residuals(x: Array) -> Array:
        vehicle = with_constants(start, dict(zip(LAGS, (x * begin).tolist(), strict=True)))
        return np.concatenate([(lagged(vehicle, f, speeds[0]) - speeds).ravel() for f, speeds in both])

    found = least_squares(residuals, np.ones(2), bounds=(1e-2, 1e2))
    second = 3 * round(both[0][0].rate_hz)
    return [_table(start, LAGS, found.x * begin, _half_widths(found.jac, found.fun, second) * begin)]
