"""Signals behind the estimates of a flight: readings, biases, wind, rotor commands, the estimator's own σ."""

import numpy as np
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, Readings
from quadsim.flight.faults import AccelBiasStep, BiasRamp, GyroBiasStep, sensor_faults
from quadsim.flight.mission import Mission

Array = NDArray[np.float64]

VECTORS = ("gyro", "accel", "bias", "bias_est", "wind")
"""Signals with three axes: gyroscope [deg/s], accelerometer [m/s²], gyroscope bias in the readings and as
estimated [deg/s], wind in world axes [m/s]."""
SHARED = tuple(f"{name}_{axis}" for name in ("bias", "wind") for axis in "xyz")
"""Channels that are the same with every estimator: they depend on seed and time alone."""


def signal_names(rotors: int) -> list[str]:
    """Channels of a `SignalLog`: axes of `VECTORS`, rotor commands [rad/s], σ of roll and pitch [deg]."""
    axes = [f"{name}_{axis}" for name in VECTORS for axis in "xyz"]
    return [*axes, *(f"rotor_{k}" for k in range(rotors)), "roll_sigma", "pitch_sigma"]


class SignalLog:
    """The signals of a mission's first flight, one sample of `every`; NaN where there is no value.

    Call it with the number k of each step of the mission, after the step.
    """

    def __init__(self, mission: Mission, every: int) -> None:
        self._mission, self.every = mission, every
        steps = [f for f in mission.scenario.faults if isinstance(f, GyroBiasStep | BiasRamp | AccelBiasStep)]
        self._added = sensor_faults(steps, 1, mission.rate_hz, 0)
        self.names = signal_names(len(mission.vehicle.rotors))
        self.rows = np.full((-(-mission.steps // every), len(self.names)), np.nan)

    def __call__(self, k: int) -> None:
        """Take sample k of the mission."""
        if k % self.every:
            return
        loop, mission = self._mission.loop, self._mission
        self.rows[k // self.every] = np.concatenate(
            [
                np.degrees(loop.gyro[0]),
                loop.readings.accel[0],
                np.degrees(self._true_bias()),
                np.degrees(_own(loop.estimator, "gyro_bias", mission.n, 3)),
                mission.air[0],
                loop.controller.rotor_vel_cmd[0],
                np.degrees(_own(loop.estimator, "roll_pitch_sigma", mission.n, 2)),
            ]
        )

    def _true_bias(self) -> Array:
        """Bias in the gyroscope's reading (3,) [rad/s]: of the IMU, and of the faults."""
        loop = self._mission.loop
        added = Readings(np.zeros((1, 3)), np.zeros((1, 3)))
        if self._added is not None:
            self._added(added, loop.k[:1])
        return added.gyro[0] + (0.0 if loop.imu is None else loop.imu.gyro_bias[0])


def _own(estimator: AttitudeEstimator | None, name: str, n: int, width: int) -> Array:
    """What an estimator of n vehicles knows of the first, (width,); NaN if it does not estimate that."""
    try:
        found = np.asarray(getattr(estimator, name, np.nan), dtype=np.float64)
    except (TypeError, ValueError):  # a user's attribute of that name that means something else
        found = np.empty(0)
    return found[0] if found.shape == (n, width) else np.full(width, np.nan)
