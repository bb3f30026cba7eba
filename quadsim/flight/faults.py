"""Faults: what goes wrong with sensors and vehicle in flight, each a small model chosen by `kind` in TOML.

Sensor faults act on the readings of gyroscope and accelerometer after the IMU's own errors; they do not
depend on the estimator. Vehicle faults act on the plant. Everything random is drawn from the flight's own
seed.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..config.ranges import (
    Arm,
    Between,
    Duration,
    Force,
    ForceVector,
    Frequency,
    Instant,
    Mass,
    RateDeg,
    Share,
)
from ..config.toml import Strict
from ..estimator import Readings
from ..imu.spec import ImuSpec
from ..plant import Plant
from ..seeding import Seed, child, vehicle_seeds
from ..vehicle import MAX_ROTORS

Array = NDArray[np.float64]
BiasDeg: TypeAlias = Annotated[float, Between(-4000.0, 4000.0, "°/s")]


class OnAxes(Strict):
    """A fault of the sensors' readings on some of their axes; the others stay as they are."""

    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"
    """Axes of the body that it acts on."""


class OnSensor(OnAxes):
    """A fault of one sensor of the IMU or of both."""

    sensor: Literal["both", "gyro", "accel"] = "both"
    """Sensor that it acts on."""


class GyroBiasStep(Strict):
    """The gyroscope's bias jumps."""

    kind: Literal["gyro-bias-step"]
    bias_deg: tuple[BiasDeg, BiasDeg, BiasDeg]
    """Change of the bias, body axes [deg/s]."""
    at_s: Instant = 5.0
    """When [s]."""


class AccelBiasStep(Strict):
    """The accelerometer's bias jumps."""

    kind: Literal["accel-bias-step"]
    bias: ForceVector
    """Change of the bias, body axes [m/s²]."""
    at_s: Instant = 5.0
    """When [s]."""


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


class Dropout(OnSensor):
    """Samples are lost: each with a probability, for a time of its own length. The estimator gets NaN."""

    kind: Literal["dropout"]
    probability: Share
    """Chance that a dropout begins at a sample."""
    length_s: Instant = 0.0
    """Length of a dropout [s]; 0 for single samples."""
    at_s: Instant = 0.0
    """From when on [s]."""


class Stuck(OnSensor):
    """The sensor repeats its last sample for a while."""

    kind: Literal["stuck"]
    at_s: Instant = 5.0
    """When [s]."""
    length_s: Duration = 0.2
    """For how long [s]."""
    every_s: Duration | None = None
    """Again after so long [s]; left out, once."""


class Saturation(OnAxes):
    """The measuring range is smaller than the motion."""

    kind: Literal["saturation"]
    gyro_deg: Annotated[float, Between(0.1, 4000.0, "°/s")] | None = None
    """Largest body rate that can be read [deg/s]."""
    accel: Annotated[float, Between(0.1, 1000.0, "m/s²")] | None = None
    """Largest specific force that can be read [m/s²]."""


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


class LeverArm(Strict):
    """The IMU sits off the centre of mass, and nobody says so."""

    kind: Literal["lever-arm"]
    position: Arm
    """Where, on top of the IMU's own, from the centre of mass in body axes [m]."""


class Delay(OnSensor):
    """Samples are delayed."""

    kind: Literal["delay"]
    delay_s: Annotated[float, Between(0.0, 1.0, "s")]
    """By how much; rounded to whole samples [s]."""


class PayloadDrop(Strict):
    """The vehicle starts with a payload that its controller does not know of, and drops it."""

    kind: Literal["payload-drop"]
    mass: Mass
    """Mass of the payload [kg]."""
    at_s: Instant = 5.0
    """When it falls [s]."""


class RotorLoss(Strict):
    """One rotor gives less thrust from some time on: a chipped blade, a tired motor."""

    kind: Literal["rotor-loss"]
    rotor: Annotated[int, Between(0, MAX_ROTORS - 1)] = 0
    """Which, in the order of the vehicle's file."""
    effect: Share = 0.7
    """Thrust left, as a share of a healthy rotor's."""
    at_s: Instant = 5.0
    """When [s]."""


class LowBattery(Strict):
    """All rotors fade as the battery does."""

    kind: Literal["low-battery"]
    effect: Share = 0.7
    """Thrust left at the end, as a share."""
    at_s: Instant = 2.0
    """When it begins to fade [s]."""
    fade_s: Duration = 10.0
    """How long that takes [s]."""


class GroundEffect(Strict):
    """Near the ground the rotors give more thrust for the same speed: 1 / (1 − (R / 4z)²) times as much.

    R is the rotors' radius, z the height of the centre of mass, at least R / 2. Cheeseman & Bennett, "The
    effect of the ground on a helicopter rotor in forward flight", ARC R&M 3021 (1955), in hover.
    """

    kind: Literal["ground-effect"]


SensorFault: TypeAlias = (
    GyroBiasStep | AccelBiasStep | BiasRamp | Vibration | Dropout | Stuck | Saturation | Delay
)
VehicleFault: TypeAlias = PayloadDrop | RotorLoss | LowBattery | GroundEffect | LeverArm
Fault: TypeAlias = Annotated[SensorFault | VehicleFault, Field(discriminator="kind")]

Corrupt: TypeAlias = Callable[[Readings, NDArray[np.int64]], None]
"""corrupt(readings, k): change samples (n, ·) in place, each vehicle at its own count k (n,)."""


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
            fault, _corruption(fault, rate_hz, [np.random.default_rng(child(each, index)) for each in seeds])
        )
        for index, fault in enumerate(faults)
        if isinstance(fault, SensorFault)
    ]

    def corrupt(readings: Readings, k: NDArray[np.int64]) -> None:
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


class VehicleFaults:
    """What the faults do to the plant: `apply` before every step, with every vehicle's count of samples."""

    def __init__(self, faults: Sequence[SensorFault | VehicleFault], plant: Plant) -> None:
        """Take the faults of the vehicle out of all; `any` tells whether there are some.

        Raises:
            ValueError: If a rotor fails that the vehicle does not have.
        """
        rotors = plant.rotor_vel.shape[1]
        for fault in faults:
            if isinstance(fault, RotorLoss) and fault.rotor >= rotors:
                raise ValueError(f"faults: rotor = {fault.rotor}: this vehicle has rotors 0 to {rotors - 1}")
        self._plant = plant
        self._payloads = [fault for fault in faults if isinstance(fault, PayloadDrop)]
        self._rotors = [fault for fault in faults if isinstance(fault, RotorLoss | LowBattery | GroundEffect)]
        self.any = bool(self._payloads or self._rotors)
        self._empty = plant.vehicles["mass"].copy()
        self._mass = self._empty

    def restart(self, ids: NDArray[np.int64]) -> None:
        """Give some vehicles the mass and the rotors that they have before `apply`."""
        if self._payloads:
            self._mass = self._mass.copy()
            self._mass[ids] = self._empty[ids]
            self._plant.set_mass(self._mass)
        self._plant.rotor_effect[ids] = 1.0

    def apply(self, k: NDArray[np.int64]) -> None:
        """Set masses and rotors to what they are during the step from sample k (n,) on."""
        time = k / self._plant.rate_hz
        if self._payloads:
            mass = self._empty + sum(fault.mass * (time < fault.at_s) for fault in self._payloads)
            if not np.array_equal(mass, self._mass):
                self._plant.set_mass(mass)
                self._mass = mass
        if self._rotors:
            effect = self._plant.rotor_effect
            effect[:] = 1.0
            for fault in self._rotors:
                if isinstance(fault, RotorLoss):
                    effect[time >= fault.at_s, fault.rotor] *= fault.effect
                elif isinstance(fault, GroundEffect):
                    radius = self._plant.vehicle.frame.prop_radius
                    height = np.maximum(self._plant.position[:, 2], radius / 2)
                    effect /= (1.0 - (radius / (4.0 * height)) ** 2)[:, None]
                else:
                    faded = np.clip((time - fault.at_s) / fault.fade_s, 0.0, 1.0)
                    effect *= 1.0 - (1.0 - fault.effect) * faded[:, None]


def _on_part(fault: SensorFault, corrupt: Corrupt) -> Corrupt:
    """The same on the sensor and the axes of the fault alone."""
    sensor = getattr(fault, "sensor", "both")
    others = np.array([axis not in getattr(fault, "axes", "xyz") for axis in "xyz"])
    gyro, accel = (others | (sensor not in ("both", name)) for name in ("gyro", "accel"))
    if not (gyro.any() or accel.any()):
        return corrupt

    def corrupt_part(readings: Readings, k: NDArray[np.int64]) -> None:
        before = readings.gyro[:, gyro], readings.accel[:, accel]
        corrupt(readings, k)
        readings.gyro[:, gyro], readings.accel[:, accel] = before

    return corrupt_part


def _corruption(fault: SensorFault, rate_hz: float, random: list[np.random.Generator]) -> Corrupt:
    """What one fault does to the readings of vehicles with these random numbers, one generator each."""
    n = len(random)
    start = 0 if isinstance(fault, Saturation | Delay) else round(fault.at_s * rate_hz)
    length = max(round(fault.length_s * rate_hz), 1) if isinstance(fault, Dropout | Stuck) else 0
    match fault:
        case GyroBiasStep():
            return partial(_add_bias, start, np.radians(fault.bias_deg), np.zeros(3))
        case BiasRamp():
            change = np.radians(fault.gyro_deg), np.array(fault.accel)
            return partial(_ramp_bias, start, fault.length_s * rate_hz, *change)
        case AccelBiasStep():
            return partial(_add_bias, start, np.zeros(3), np.array(fault.bias))
        case Vibration():
            phase = np.stack([rng.uniform(0, 2 * np.pi, 6) for rng in random])
            return partial(_vibrate, fault, start, 2 * np.pi * fault.frequency_hz / rate_hz, phase)
        case Dropout():
            return partial(_drop, fault.probability, start, length, np.zeros(n, dtype=np.int64), random)
        case Stuck():
            period = np.inf if fault.every_s is None else max(round(fault.every_s * rate_hz), length + 1)
            return partial(_repeat, start, length, period, Readings(np.zeros((n, 3)), np.zeros((n, 3))))
        case Saturation():
            rate = np.inf if fault.gyro_deg is None else np.radians(fault.gyro_deg)
            return partial(_saturate, rate, np.inf if fault.accel is None else fault.accel)
        case Delay():
            return partial(_delay, np.zeros((round(fault.delay_s * rate_hz) + 1, n, 6)))


def _add_bias(
    start: int, gyro_bias: Array, accel_bias: Array, readings: Readings, k: NDArray[np.int64]
) -> None:
    on = (k >= start)[:, None]
    readings.gyro[:] += on * gyro_bias
    readings.accel[:] += on * accel_bias


def _ramp_bias(
    start: int, length: float, gyro: Array, accel: Array, readings: Readings, k: NDArray[np.int64]
) -> None:
    share = np.clip((k - start) / length, 0.0, 1.0)[:, None]
    readings.gyro[:] += share * gyro
    readings.accel[:] += share * accel


def _vibrate(
    fault: Vibration, start: int, rate: float, phase: Array, readings: Readings, k: NDArray[np.int64]
) -> None:
    wave = (k >= start)[:, None] * np.sin(rate * k[:, None] + phase)
    readings.gyro[:] += np.radians(fault.gyro_deg) * wave[:, :3]
    readings.accel[:] += fault.accel * wave[:, 3:]


def _drop(
    probability: float,
    start: int,
    length: int,
    left: NDArray[np.int64],
    random: list[np.random.Generator],
    readings: Readings,
    k: NDArray[np.int64],
) -> None:
    left[k == 0] = 0
    begins = np.array([rng.random() < probability for rng in random])
    left[begins & (left == 0) & (k >= start)] = length
    readings.gyro[left > 0] = readings.accel[left > 0] = np.nan
    np.maximum(left - 1, 0, out=left)


def _repeat(
    start: int, length: int, period: float, last: Readings, readings: Readings, k: NDArray[np.int64]
) -> None:
    stuck = (k >= start) & (k > 0) & ((k - start) % period < length)
    for now, before in ((readings.gyro, last.gyro), (readings.accel, last.accel)):
        now[stuck] = before[stuck]
        before[:] = now


def _saturate(rate: float, force: float, readings: Readings, k: NDArray[np.int64]) -> None:
    np.clip(readings.gyro, -rate, rate, out=readings.gyro)
    np.clip(readings.accel, -force, force, out=readings.accel)


def _delay(line: Array, readings: Readings, k: NDArray[np.int64]) -> None:
    """Delay by the length of the line (samples + 1, n, 6), less one sample."""
    slots, rows = len(line), np.arange(len(k))
    now = np.hstack([readings.gyro, readings.accel])
    line[:, k == 0] = now[k == 0]
    line[k % slots, rows] = now
    oldest = line[(k + 1) % slots, rows]
    readings.gyro[:], readings.accel[:] = oldest[:, :3], oldest[:, 3:]
