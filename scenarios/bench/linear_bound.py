"""The error of the best linear estimator of roll and pitch from an IMU."""

import numpy as np

from quadsim.config.ranges import steps_of
from quadsim.flight.scenario import Scenario
from quadsim.imu.spec import ImuSpec
from quadsim.vehicle import GRAVITY, Vehicle
from quadsim.wind import Dryden, dryden_scales

STEADY_WIND = 10.0
"""Standard deviation of a steady wind, of each axis [m/s]: unknown."""


def least_error(
    imu: ImuSpec,
    vehicle: Vehicle,
    scenario: Scenario,
    duration_s: float,
    speed_sd: float = np.inf,
    rate_hz: float = 200.0,
) -> float:
    """RMS angle between the true vertical and that of the best linear estimator, about hover.

    It reads gyroscope and accelerometer, and knows the initial attitude and speed, the drag, all noise
    densities, the standard deviations of the biases, and whether the wind is steady or Dryden turbulence of
    this size. A Kalman filter has the least variance of all linear estimators, and its covariance does not
    depend on the readings (Anderson & Moore, "Optimal Filtering", 1979, ch. 5).

    Args:
        imu: Noise, random walks and turn-on biases.
        vehicle: Its rotors' drag.
        scenario: Its turbulence.
        duration_s: Of the flight.
        speed_sd: It also knows the speed over ground, to so much in the mean over a second [m/s].
        rate_hz: Samples per second.

    Returns:
        The angle [rad].

    Raises:
        ValueError: A duration of no sample, or a speed known to less than nothing.
    """
    steps = steps_of(duration_s, rate_hz)
    if not speed_sd > 0:
        raise ValueError(f"speed_sd: {speed_sd:g} m/s, should be above 0, or inf where nothing is known")
    step, drag = 1 / rate_hz, 1 / vehicle.drag_time_constant
    turbulence = next((wind for wind in scenario.wind if isinstance(wind, Dryden)), None)
    sigma, correlation_s = 0.0, 1.0
    if turbulence is not None:
        length, _, along, _ = dryden_scales(turbulence.altitude, turbulence.wind_20ft)
        sigma, correlation_s = float(along), float(length) / turbulence.airspeed
    # One axis: speed, tilt, biases of gyroscope and accelerometer, steady wind, turbulence.
    rates = np.zeros((6, 6))
    rates[0, [0, 1, 4, 5]] = -drag, GRAVITY, drag, drag
    rates[1, 2], rates[5, 5] = -1.0, -1 / correlation_s
    transition = np.eye(6) + step * rates
    drive = sigma * np.sqrt(2 / correlation_s)
    walks = [0.0, imu.gyro.noise, imu.gyro.random_walk, imu.accel.random_walk, 0.0, drive]
    added = step * np.diag(np.square(walks))
    covariance = np.diag(np.square([0.0, 0.0, imu.gyro.turn_on, imu.accel.turn_on, STEADY_WIND, sigma]))
    readings = [(np.array([-drag, 0.0, 0.0, 1.0, drag, drag]), imu.accel.noise), (np.eye(6)[0], speed_sd)]
    total = 0.0
    for _ in range(steps):
        covariance = transition @ covariance @ transition.T + added
        for row, noise in readings:
            if np.isfinite(noise):
                column = covariance @ row
                covariance = covariance - np.outer(column, column) / (row @ column + noise**2 * rate_hz)
        total += 2 * covariance[1, 1]
    return float(np.sqrt(total / steps))
