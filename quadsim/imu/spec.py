"""The errors of an IMU as a typed model, read from TOML."""

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import model_validator

from ..config.ranges import Arm, Between, ForceVector, Rotation, RotorSpeed
from ..config.toml import Strict, load_toml

Noise: TypeAlias = Annotated[float, Between(0.0, 1000.0)]
Spread: TypeAlias = Annotated[float, Between(0.0, 0.5)]
RatePart: TypeAlias = Annotated[float, Between(-70.0, 70.0, "rad/s")]


class Sensor(Strict):
    """Errors of one three-axis sensor, in the unit of the sensor (rad/s or m/s²).

    By default, there are no errors.
    """

    noise: Noise = 0.0
    """White noise density N [unit/√Hz]."""
    random_walk: Noise = 0.0
    """Bias random walk σ_b [unit/√s]."""
    time_constant: Annotated[float, Between(1e-3, 1e7, "s")] | None = None
    """Correlation time τ of the bias random walk [s]."""
    turn_on: Annotated[float, Between(0.0, 50.0)] = 0.0
    """Standard deviation of the turn-on bias, which is constant during a flight [unit]."""
    scale_factor: Spread = 0.0
    """Standard deviation of the relative scale error of each axis."""
    misalignment: Spread = 0.0
    """Standard deviation of the misalignment between each two axes [rad]."""
    low_pass_hz: Annotated[float, Between(0.0, 1e5, "Hz")] = 0.0
    """Corner frequency (−3 dB) of the second-order Butterworth low-pass [Hz]; 0 for none."""
    resolution: Annotated[float, Between(0.0, 50.0)] = 0.0
    """Step of the digital output [unit]; 0 for none."""
    saturation: Annotated[float, Between(1e-3, 1e5)] | None = None
    """Largest reading [unit]; default: no limit."""

    @model_validator(mode="after")
    def _check(self) -> "Sensor":
        if self.random_walk > 0.0 and self.time_constant is None:
            raise ValueError(f"random_walk = {self.random_walk} needs a time_constant [s]")
        if self.saturation is not None and self.resolution > self.saturation:
            raise ValueError(f"resolution {self.resolution} must not exceed saturation {self.saturation}")
        return self

    @property
    def walk_sd(self) -> float:
        """Stationary standard deviation of the bias random walk, σ_b √(τ/2) [unit]."""
        return self.random_walk * math.sqrt((self.time_constant or 0.0) / 2.0)

    @property
    def limit(self) -> float:
        """Largest reading, a multiple of the resolution [unit]."""
        if self.saturation is None or self.resolution == 0.0:
            return self.saturation or math.inf
        return self.resolution * math.floor(self.saturation / self.resolution * (1.0 + 1e-12))


class RotorVibration(Strict):
    """Vibration caused by imbalance of the rotors. It is a property of the airframe, not of the sensor."""

    rotor_vel: RotorSpeed
    """Rotor speed for which the amplitudes are given [rad/s]. Amplitudes are proportional to its square."""
    gyro: tuple[RatePart, RatePart, RatePart] = (0.0, 0.0, 0.0)
    """Amplitude per rotor at the gyroscope [rad/s]."""
    accel: ForceVector = (0.0, 0.0, 0.0)
    """Amplitude per rotor at the accelerometer [m/s²]."""


READINGS = {
    "gyro": ("rad/s", "gyroscope", "body rate"),
    "accel": ("m/s^2", "accelerometer", "specific force"),
}
"""Unit, sensor and measured quantity for each of `ImuSpec.sensors`."""


class ImuSpec(Strict):
    """An IMU. The defaults describe an ideal IMU at the centre of mass."""

    gyro: Sensor = Sensor()
    """Gyroscope [rad/s]."""
    accel: Sensor = Sensor()
    """Accelerometer [m/s²]."""
    lever_arm: Arm = (0.0, 0.0, 0.0)
    """Position of the sensor relative to the centre of mass, in body axes [m]."""
    mounting_deg: Rotation = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the sensor with respect to the body [deg]. Readings are in sensor axes."""
    g_sensitivity: Annotated[float, Between(0.0, 1.0, "rad/s per m/s²")] = 0.0
    """Standard deviation of each element of the gyroscope's sensitivity to specific force [rad/s per
    m/s²]."""
    vibration: RotorVibration | None = None
    """Vibration caused by the rotors; default: none."""
    dropped: Annotated[float, Between(0.0, 0.99)] = 0.0
    """Share of samples that are lost. A lost sample repeats the previous reading."""

    @property
    def sensors(self) -> dict[str, Sensor]:
        """The sensors, by the names of their readings."""
        return {"gyro": self.gyro, "accel": self.accel}


RANDOM = "noise", "random_walk", "turn_on", "scale_factor", "misalignment", "low_pass_hz"
"""Fields of a sensor that `randomise_imu` randomises."""


def randomise_imu(imu: ImuSpec, spread: float, rng: np.random.Generator) -> ImuSpec:
    """Multiply each error of an IMU by its own random factor, 1 + U(−spread, spread).

    The errors are the fields `RANDOM` of each sensor, the sensitivity to specific force, and the vibration.
    """

    def factor() -> float:
        return 1.0 + spread * rng.uniform(-1.0, 1.0)

    parts: dict[str, object] = {
        name: sensor.model_copy(update={each: getattr(sensor, each) * factor() for each in RANDOM})
        for name, sensor in imu.sensors.items()
    }
    parts["g_sensitivity"], size = imu.g_sensitivity * factor(), factor()
    if imu.vibration is not None:
        waves = {name: tuple(size * each for each in getattr(imu.vibration, name)) for name in READINGS}
        parts["vibration"] = imu.vibration.model_copy(update=waves)
    return imu.model_copy(update=parts)


def load_imu(source: str | Path) -> ImuSpec:
    """Load a preset ("adis16448", "px4-mini", …) or a TOML file.

    Raises:
        ValueError: The file is invalid; the message names the key, its value and the allowed values.
    """
    return load_toml(source, "imus", ImuSpec)
