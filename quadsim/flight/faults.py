"""Faults: what goes wrong with sensors and vehicle in flight, each a small model chosen by `kind` in TOML.

Sensor faults act on the readings of gyroscope and accelerometer after the IMU's own errors; they do not
depend on the estimator. Those of the vehicle are in `vehicle_faults`. Everything random is drawn from the
flight's own seed.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ..config.ranges import Between, Duration, Force, ForceVector, Frequency, Instant, RateDeg, Share
from ..config.toml import Strict
from ..estimator import Readings
from ..imu.spec import ImuSpec
from ..seeding import Seed, child, vehicle_seeds
from .vehicle_faults import LeverArm, PayloadDrop, VehicleFault

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Corrupt: TypeAlias = Callable[[Readings, Counts], None]
"""corrupt(readings, k): change samples (n, ·) in place, each vehicle at its own count k (n,)."""
Randoms = list[np.random.Generator]
"""One for each vehicle."""
BiasDeg: TypeAlias = Annotated[float, Between(-4000.0, 4000.0, "°/s")]


class OnAxes(Strict):
    """A fault of the sensors' readings on some of their axes; the others stay as they are."""

    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"
    """Axes of the body that it acts on."""


class OnSensor(OnAxes):
    """A fault of one sensor of the IMU or of both."""

    sensor: Literal["both", "gyro", "accel"] = "both"
    """Sensor that it acts on."""


def _biased(gyro: ArrayLike, accel: ArrayLike, share: Callable[[Counts], Array]) -> Corrupt:
    """Add to the biases, of which so much is there at each count of samples."""

    def corrupt(readings: Readings, k: Counts) -> None:
        readings.gyro[:] += share(k)[:, None] * np.asarray(gyro)
        readings.accel[:] += share(k)[:, None] * np.asarray(accel)

    return corrupt


class GyroBiasStep(Strict):
    """The gyroscope's bias jumps."""

    kind: Literal["gyro-bias-step"]
    bias_deg: tuple[BiasDeg, BiasDeg, BiasDeg]
    """Change of the bias, body axes [deg/s]."""
    at_s: Instant = 5.0
    """When [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start = round(self.at_s * rate_hz)
        return _biased(np.radians(self.bias_deg), np.zeros(3), lambda k: (k >= start).astype(np.float64))


class AccelBiasStep(Strict):
    """The accelerometer's bias jumps."""

    kind: Literal["accel-bias-step"]
    bias: ForceVector
    """Change of the bias, body axes [m/s²]."""
    at_s: Instant = 5.0
    """When [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start = round(self.at_s * rate_hz)
        return _biased(np.zeros(3), self.bias, lambda k: (k >= start).astype(np.float64))


class Vibration(OnAxes):
    """A vibration of the whole sensor, its phases drawn for each seed; above half the rate it aliases."""

    kind: Literal["vibration"]
    frequency_hz: Frequency
    """Frequency [Hz]."""
    accel: Force = 0.0
    """Amplitude on each axis of the accelerometer [m/s²]."""
    gyro_deg: RateDeg = 0.0
    """Amplitude on each axis of the gyroscope [deg/s]."""
    at_s: Instant = 0.0
    """From when on [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start, step = round(self.at_s * rate_hz), 2 * np.pi * self.frequency_hz / rate_hz
        phase = np.stack([random.uniform(0, 2 * np.pi, 6) for random in randoms])

        def corrupt(readings: Readings, k: Counts) -> None:
            wave = (k >= start)[:, None] * np.sin(step * k[:, None] + phase)
            readings.gyro[:] += np.radians(self.gyro_deg) * wave[:, :3]
            readings.accel[:] += self.accel * wave[:, 3:]

        return corrupt


class Dropout(OnSensor):
    """Samples are lost: each with a probability, for a time of its own length. The estimator gets NaN."""

    kind: Literal["dropout"]
    probability: Share
    """Chance that a dropout begins at a sample."""
    length_s: Instant = 0.0
    """Length of a dropout [s]; 0 for single samples."""
    at_s: Instant = 0.0
    """From when on [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start, length = round(self.at_s * rate_hz), max(round(self.length_s * rate_hz), 1)
        left = np.zeros(len(randoms), dtype=np.int64)

        def corrupt(readings: Readings, k: Counts) -> None:
            left[k == 0] = 0
            begins = np.array([random.random() < self.probability for random in randoms])
            left[begins & (left == 0) & (k >= start)] = length
            readings.gyro[left > 0] = readings.accel[left > 0] = np.nan
            np.maximum(left - 1, 0, out=left)

        return corrupt


class Stuck(OnSensor):
    """The sensor repeats its last sample for a while."""

    kind: Literal["stuck"]
    at_s: Instant = 5.0
    """When [s]."""
    length_s: Duration = 0.2
    """For how long [s]."""
    every_s: Duration | None = None
    """Again after so long [s]; left out, once."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start, length = round(self.at_s * rate_hz), max(round(self.length_s * rate_hz), 1)
        period = np.inf if self.every_s is None else max(round(self.every_s * rate_hz), length + 1)
        last = Readings(np.zeros((len(randoms), 3)), np.zeros((len(randoms), 3)))

        def corrupt(readings: Readings, k: Counts) -> None:
            stuck = (k >= start) & (k > 0) & ((k - start) % period < length)
            for now, before in ((readings.gyro, last.gyro), (readings.accel, last.accel)):
                now[stuck] = before[stuck]
                before[:] = now

        return corrupt


class Saturation(OnAxes):
    """The measuring range is smaller than the motion."""

    kind: Literal["saturation"]
    gyro_deg: Annotated[float, Between(0.1, 4000.0, "°/s")] | None = None
    """Largest body rate that can be read [deg/s]."""
    accel: Annotated[float, Between(0.1, 1000.0, "m/s²")] | None = None
    """Largest specific force that can be read [m/s²]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        rate = np.inf if self.gyro_deg is None else np.radians(self.gyro_deg)
        force = np.inf if self.accel is None else self.accel

        def corrupt(readings: Readings, k: Counts) -> None:
            np.clip(readings.gyro, -rate, rate, out=readings.gyro)
            np.clip(readings.accel, -force, force, out=readings.accel)

        return corrupt


class BiasRamp(Strict):
    """The biases drift, as while a sensor warms up."""

    kind: Literal["bias-ramp"]
    gyro_deg: tuple[BiasDeg, BiasDeg, BiasDeg] = (0.0, 0.0, 0.0)
    """Change of the gyroscope's bias at the end, body axes [deg/s]."""
    accel: ForceVector = (0.0, 0.0, 0.0)
    """Change of the accelerometer's bias at the end, body axes [m/s²]."""
    at_s: Instant = 0.0
    """When it begins [s]."""
    length_s: Duration = 10.0
    """How long it takes [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        start, length = round(self.at_s * rate_hz), self.length_s * rate_hz
        rate = np.radians(self.gyro_deg)
        return _biased(rate, self.accel, lambda k: np.clip((k - start) / length, 0.0, 1.0))


class Delay(OnSensor):
    """Samples are delayed."""

    kind: Literal["delay"]
    delay_s: Annotated[float, Between(0.0, 1.0, "s")]
    """By how much; rounded to whole samples [s]."""

    def _corrupt(self, rate_hz: float, randoms: Randoms) -> Corrupt:
        line = np.zeros((round(self.delay_s * rate_hz) + 1, len(randoms), 6))

        def corrupt(readings: Readings, k: Counts) -> None:
            slots, rows = len(line), np.arange(len(k))
            now = np.hstack([readings.gyro, readings.accel])
            line[:, k == 0] = now[k == 0]
            line[k % slots, rows] = now
            oldest = line[(k + 1) % slots, rows]
            readings.gyro[:], readings.accel[:] = oldest[:, :3], oldest[:, 3:]

        return corrupt


SensorFault: TypeAlias = (
    GyroBiasStep | AccelBiasStep | BiasRamp | Vibration | Dropout | Stuck | Saturation | Delay
)
Fault: TypeAlias = Annotated[SensorFault | VehicleFault, Field(discriminator="kind")]


def sensor_faults(
    faults: Sequence[SensorFault | VehicleFault], n: int, rate_hz: float, seed: Seed
) -> Corrupt | None:
    """What the faults do to the IMU of n vehicles; None where they do nothing.

    Every vehicle's samples must come in order; k = 0 resets a vehicle.

    Args:
        faults: All faults; those of the vehicle are passed over.
        n: Number of vehicles.
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """
    seeds = vehicle_seeds(seed, n)
    chain = [
        _on_part(
            fault, fault._corrupt(rate_hz, [np.random.default_rng(child(each, index)) for each in seeds])
        )
        for index, fault in enumerate(faults)
        if isinstance(fault, SensorFault)
    ]

    def corrupt(readings: Readings, k: Counts) -> None:
        for link in chain:
            link(readings, k)

    return corrupt if chain else None


def displaced(imu: ImuSpec, faults: Sequence[SensorFault | VehicleFault]) -> ImuSpec:
    """The IMU where its lever arms put it."""
    arms = [fault.position for fault in faults if isinstance(fault, LeverArm)]
    if not arms:
        return imu
    x, y, z = np.sum([imu.lever_arm, *arms], axis=0).tolist()
    return imu.model_copy(update={"lever_arm": (x, y, z)})


class FaultSpan(NamedTuple):
    """When a fault is there, from and to [s]."""

    label: str
    start_s: float
    end_s: float


def fault_spans(faults: Sequence[SensorFault | VehicleFault], duration_s: float) -> list[FaultSpan]:
    """When the faults of a flight are there, in their order; one that comes again has as many spans."""
    spans = []
    for fault in faults:
        label, start = _label(fault), getattr(fault, "at_s", 0.0)
        match fault:
            case PayloadDrop():
                found = [FaultSpan("payload", 0.0, fault.at_s)]
            case Stuck():
                starts = [start] if fault.every_s is None else np.arange(start, duration_s, fault.every_s)
                found = [FaultSpan(label, float(each), float(each) + fault.length_s) for each in starts]
            case _:
                found = [FaultSpan(label, start, duration_s)]
        ends = [min(each.end_s, duration_s) for each in found]
        spans += [e._replace(end_s=end) for e, end in zip(found, ends, strict=True) if e.start_s < end]
    return spans


def _label(fault: SensorFault | VehicleFault) -> str:
    sensor, axes = getattr(fault, "sensor", "both"), getattr(fault, "axes", "xyz")
    parts = [part for part, whole in ((sensor, "both"), (axes, "xyz")) if part != whole]
    return " ".join([fault.kind.replace("-", " "), *parts])


def _on_part(fault: SensorFault, corrupt: Corrupt) -> Corrupt:
    """The same on the sensor and the axes of the fault alone."""
    sensor = getattr(fault, "sensor", "both")
    others = np.array([axis not in getattr(fault, "axes", "xyz") for axis in "xyz"])
    gyro, accel = (others | (sensor not in ("both", name)) for name in ("gyro", "accel"))
    if not (gyro.any() or accel.any()):
        return corrupt

    def corrupt_part(readings: Readings, k: Counts) -> None:
        before = readings.gyro[:, gyro], readings.accel[:, accel]
        corrupt(readings, k)
        readings.gyro[:, gyro], readings.accel[:, accel] = before

    return corrupt_part
