"""Faults of sensors and vehicles in flight, each a model chosen by `kind` in TOML.

Sensor faults act on the readings of gyroscope and accelerometer, after the errors of the IMU. Faults do not
depend on the estimator. All random numbers are drawn from the seed of the flight. Faults of the vehicle are
in `vehicle_faults`.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..config.ranges import Between, Duration, Force, ForceVector, Frequency, Instant, RateDeg, Share
from ..config.toml import Strict
from ..estimator import Readings
from ..imu.spec import ImuSpec
from ..seeding import Seed, child, vehicle_seeds
from .vehicle_faults import LeverArm, PayloadDrop, Timed, VehicleFault

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Corrupt: TypeAlias = Callable[[Readings, Counts], None]
"""Called as corrupt(readings, k): changes samples (n, ·) in place; k (n,) is the sample number of each
vehicle."""
Change: TypeAlias = Callable[[Array, Counts], None]
"""The same, for readings of gyroscope and accelerometer in one array (n, 6)."""
Randoms = list[np.random.Generator]
"""One random generator per vehicle."""
BiasDeg: TypeAlias = Annotated[float, Between(-4000.0, 4000.0, "°/s")]


class OnAxes(Strict):
    """A fault of the readings on some axes; the other axes do not change."""

    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"
    """Affected body axes."""


class OnSensor(OnAxes):
    """A fault of one sensor of the IMU or of both."""

    sensor: Literal["both", "gyro", "accel"] = "both"
    """Affected sensor."""


class Bias(Timed):
    """The biases change, at once or gradually, as when a sensor warms up."""

    kind: Literal["bias"]
    gyro_deg: tuple[BiasDeg, BiasDeg, BiasDeg] = (0.0, 0.0, 0.0)
    """Change of the gyroscope's bias, body axes [deg/s]."""
    accel: ForceVector = (0.0, 0.0, 0.0)
    """Change of the accelerometer's bias, body axes [m/s²]."""
    length_s: Instant = 0.0
    """Duration of the change [s]; 0 for a step."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        change_of_all = np.concatenate([np.radians(self.gyro_deg), self.accel])
        start, length = round(self.at_s * rate_hz), self.length_s * rate_hz
        if length == 0.0:  # whole at the first sample
            start, length = start - 1, 1.0

        def change(imu: Array, k: Counts) -> None:
            imu += np.clip((k - start) / length, 0.0, 1.0)[:, None] * change_of_all

        return change


class Vibration(OnAxes, Timed):
    """A vibration of the IMU, with phases drawn for each seed.

    Frequencies above half the sample rate alias.
    """

    kind: Literal["vibration"]
    frequency_hz: Frequency
    """Frequency [Hz]."""
    accel: Force = 0.0
    """Amplitude on each axis of the accelerometer [m/s²]."""
    gyro_deg: RateDeg = 0.0
    """Amplitude on each axis of the gyroscope [deg/s]."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        start, step = round(self.at_s * rate_hz), 2 * np.pi * self.frequency_hz / rate_hz
        phase = np.stack([random.uniform(0, 2 * np.pi, 6) for random in randoms])
        amplitude = np.repeat([np.radians(self.gyro_deg), self.accel], 3)

        def change(imu: Array, k: Counts) -> None:
            imu += amplitude * ((k >= start)[:, None] * np.sin(step * k[:, None] + phase))

        return change


class Dropout(OnSensor, Timed):
    """Samples are lost at random times, each time for a fixed duration. The estimator receives NaN."""

    kind: Literal["dropout"]
    probability: Share
    """Probability that a dropout begins at a sample."""
    length_s: Instant = 0.0
    """Length of a dropout [s]; 0 for single samples."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        start, length = round(self.at_s * rate_hz), max(round(self.length_s * rate_hz), 1)
        left = np.zeros(len(randoms), dtype=np.int64)

        def change(imu: Array, k: Counts) -> None:
            left[k == 0] = 0
            begins = np.array([random.random() < self.probability for random in randoms])
            left[begins & (left == 0) & (k >= start)] = length
            imu[left > 0] = np.nan
            np.maximum(left - 1, 0, out=left)

        return change


class Stuck(OnSensor, Timed):
    """The sensor repeats its last sample for a fixed duration."""

    kind: Literal["stuck"]
    length_s: Duration = 0.2
    """Duration [s]."""
    every_s: Duration | None = None
    """Period of repetition [s]; default: only once."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        start, length = round(self.at_s * rate_hz), max(round(self.length_s * rate_hz), 1)
        period = np.inf if self.every_s is None else max(round(self.every_s * rate_hz), length + 1)
        last = np.zeros((len(randoms), 6))

        def change(imu: Array, k: Counts) -> None:
            stuck = (k >= start) & (k > 0) & ((k - start) % period < length)
            imu[stuck] = last[stuck]
            last[:] = imu

        return change


class Saturation(OnAxes):
    """The measuring range is smaller than the motion."""

    kind: Literal["saturation"]
    gyro_deg: Annotated[float, Between(0.1, 4000.0, "°/s")] | None = None
    """Largest body rate that the gyroscope can measure [deg/s]."""
    accel: Annotated[float, Between(0.1, 1000.0, "m/s²")] | None = None
    """Largest specific force that the accelerometer can measure [m/s²]."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        rate = np.inf if self.gyro_deg is None else np.radians(self.gyro_deg)
        largest = np.repeat([rate, np.inf if self.accel is None else self.accel], 3)

        def change(imu: Array, k: Counts) -> None:
            np.clip(imu, -largest, largest, out=imu)

        return change


class Delay(OnSensor):
    """The readings arrive late."""

    kind: Literal["delay"]
    delay_s: Annotated[float, Between(0.0, 1.0, "s")]
    """Delay, rounded to whole samples [s]."""

    def _change(self, rate_hz: float, randoms: Randoms) -> Change:
        line = np.zeros((round(self.delay_s * rate_hz) + 1, len(randoms), 6))

        def change(imu: Array, k: Counts) -> None:
            slots, rows = len(line), np.arange(len(k))
            line[:, k == 0] = imu[k == 0]
            line[k % slots, rows] = imu
            imu[:] = line[(k + 1) % slots, rows]

        return change


SensorFault: TypeAlias = Bias | Vibration | Dropout | Stuck | Saturation | Delay
Fault: TypeAlias = Annotated[SensorFault | VehicleFault, Field(discriminator="kind")]


def sensor_faults(
    faults: Sequence[SensorFault | VehicleFault], n: int, rate_hz: float, seed: Seed
) -> Corrupt | None:
    """Return the function that applies faults to the IMU readings of n vehicles.

    The result is None if there are no such faults.

    The samples of each vehicle must be consecutive; k = 0 resets a vehicle.

    Args:
        faults: All faults; faults of the vehicle are ignored.
        n: Number of vehicles.
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """
    chain: list[tuple[Change, NDArray[np.bool_]]] = []
    for index, fault in enumerate(faults):
        if isinstance(fault, SensorFault):
            randoms = [np.random.default_rng(child(each, index)) for each in vehicle_seeds(seed, n)]
            sensor, axes = _part(fault)
            others = [
                sensor not in ("both", name) or axis not in axes
                for name in ("gyro", "accel")
                for axis in "xyz"
            ]
            chain.append((fault._change(rate_hz, randoms), np.array(others)))

    def corrupt(readings: Readings, k: Counts) -> None:
        imu = np.hstack([readings.gyro, readings.accel])
        for change, others in chain:
            before = imu[:, others]
            change(imu, k)
            imu[:, others] = before
        readings.gyro[:], readings.accel[:] = imu[:, :3], imu[:, 3:]

    return corrupt if chain else None


def displaced(imu: ImuSpec, faults: Sequence[SensorFault | VehicleFault]) -> ImuSpec:
    """Return the IMU displaced by the lever arms among the faults."""
    arms = [fault.position for fault in faults if isinstance(fault, LeverArm)]
    if not arms:
        return imu
    x, y, z = np.sum([imu.lever_arm, *arms], axis=0).tolist()
    return imu.model_copy(update={"lever_arm": (x, y, z)})


def fault_spans(
    faults: Sequence[SensorFault | VehicleFault], duration_s: float
) -> list[tuple[str, float, float]]:
    """Return label, beginning and end [s] of each fault of a flight, in order.

    A periodic fault appears repeatedly.
    """
    spans = []
    for fault in faults:
        label, starts, length = _label(fault), [getattr(fault, "at_s", 0.0)], duration_s
        if isinstance(fault, PayloadDrop):
            label, starts, length = "payload", [0.0], fault.at_s
        elif isinstance(fault, Stuck):
            length = fault.length_s
            if fault.every_s is not None:
                starts = np.arange(fault.at_s, duration_s, fault.every_s).tolist()
        begun = [start for start in starts if start < duration_s and length > 0.0]
        spans += [(label, start, min(start + length, duration_s)) for start in begun]
    return spans


def _part(fault: SensorFault | VehicleFault) -> tuple[str, str]:
    """Return the sensors and axes that a fault acts on."""
    return getattr(fault, "sensor", "both"), getattr(fault, "axes", "xyz")


def _label(fault: SensorFault | VehicleFault) -> str:
    parts = [part for part in _part(fault) if part not in ("both", "xyz")]
    return " ".join([fault.kind.replace("-", " "), *parts])
