"""The IMU: readings of gyroscope and accelerometer for a given motion of the vehicle.

The model starts from the true motion of the centre of mass, in body axes. Each part is optional:

1. lever arm: the specific force at the position of the sensor, f + α × r + ω × (ω × r);
2. low-pass: a continuous Butterworth filter with its delay, at any sample rate;
3. vibration at the frequency of the rotors, attenuated by that filter and aliased by the sampling;
4. mounting, scale factor and misalignment, and the sensitivity of the gyroscope to force;
5. turn-on bias, bias random walk and white noise (RotorS): b ← e^{−dt/τ} b + σ_b √(τ/2 (1 − e^{−2dt/τ})) n,
   y = true + b + (N/√dt) n + b_on, where b starts at its stationary standard deviation σ_b √(τ/2);
6. resolution, saturation, and dropped samples, which repeat the previous reading.

Whole arrays and single samples use the same compiled functions and give the same numbers.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.ranges import SAMPLE_RATE
from ..seeding import Seed, child, vehicle_seeds
from ..vehicle import MAX_ROTORS
from .kernel import (
    ACCEL,
    GYRO,
    IMU,
    NOISES,
    SENSORS,
    constants,
    draw_flight,
    measure_series,
    motion_dtype,
    noise_streams,
)
from .spec import ImuSpec

Array = NDArray[np.float64]
Imus: TypeAlias = ImuSpec | Sequence[ImuSpec]
"""One IMU for all vehicles, or one per vehicle."""

BLOCK = 128
"""Number of samples for which noise is drawn at once."""


class ImuStream:
    """The IMUs of n vehicles, one sample at a time. The numbers equal those of `simulate_imu`.

    The random numbers of vehicle i depend only on its seed, not on n or on which errors are present.
    `readings` and the true `biases` (turn-on and random walk) are views of the last sample, an array (n, 3)
    for each of `ImuSpec.sensors`. `records` (n,) and `noise` are arguments of `quadsim.imu.kernel.measure`.
    """

    def __init__(
        self, spec: Imus, n: int, rate_hz: float, seed: Seed, records: NDArray[np.void] | None = None
    ) -> None:
        """Switch the IMUs on, with biases and scale factors drawn for this flight.

        Args:
            spec: The IMU, or one per vehicle.
            n: Number of vehicles.
            rate_hz: Samples per second.
            seed: Whole number, seed sequence, or one seed sequence per vehicle.
            records: (n,) records of `quadsim.imu.kernel.IMU` to use, for loops with larger records.

        Raises:
            ValueError: An argument is out of range.
        """
        if n < 1:
            raise ValueError(f"n = {n}: at least one vehicle is allowed")
        SAMPLE_RATE.of("rate_hz", rate_hz)
        self.specs = _one_each(spec, n)
        self.rate_hz = rate_hz
        self._seeds = vehicle_seeds(seed, n)
        self._flight = np.zeros(n, dtype=np.int64)
        self.records = np.zeros(n, IMU) if records is None else records
        constant = {id(each): constants(each, 1.0 / rate_hz) for each in self.specs}
        for vehicle, each in enumerate(self.specs):
            self.records[vehicle : vehicle + 1] = constant[id(each)]
        self.readings, self.biases = (
            dict(zip(self.specs[0].sensors, self.records[name].swapaxes(0, 1), strict=True))
            for name in ("reading", "bias")
        )
        self._noises = [noise_streams(each) for each in self.specs]
        self._random: list[list[np.random.Generator]] = [[] for _ in range(n)]
        self.noise = np.zeros((n, NOISES, BLOCK, 3))
        self._at = 0
        for vehicle in range(n):
            self._switch_on(vehicle)

    def reset(self, ids: Sequence[int] | NDArray[np.int64] | None = None) -> None:
        """Switch the IMUs of some or all vehicles off and on.

        Draw new biases and noise from the next child seed.
        """
        for vehicle in range(len(self.records)) if ids is None else ids:
            self._flight[vehicle] += 1
            self._switch_on(int(vehicle))

    def exchange(self, ids: NDArray[np.int64], specs: Sequence[ImuSpec]) -> None:
        """Replace the IMUs of some vehicles, (m,); `reset` switches the new IMUs on."""
        for vehicle, spec in zip(ids, specs, strict=True):
            self.specs[vehicle], self._noises[vehicle] = spec, noise_streams(spec)
            self.records[vehicle : vehicle + 1] = constants(spec, 1.0 / self.rate_hz)

    def sample(
        self,
        ang_vel: ArrayLike,
        specific_force: ArrayLike,
        ang_acc: ArrayLike | None = None,
        rotor_vel: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Return the next readings of all vehicles.

        Args:
            ang_vel: Body rate, body axes, shape (n, 3) [rad/s].
            specific_force: Specific force at the centre of mass, body axes, shape (n, 3) [m/s²].
            ang_acc: Angular acceleration, body axes, shape (n, 3) [rad/s²]; required for a lever arm.
            rotor_vel: Rotor speeds, shape (n, rotors) [rad/s]; needed for vibration.

        Returns:
            Readings of gyroscope [rad/s] and accelerometer [m/s²] in sensor axes, (n, 3) each.
        """
        given = (ang_vel, specific_force, ang_acc, rotor_vel)
        series = (None if each is None else np.asarray(each)[..., None, :] for each in given)
        motion = _motion(self.specs, (len(self.records), 1), *series)
        out, bias = np.empty((2, SENSORS, *motion.shape, 3))
        measure_series(self.records, self.noise, self.next_samples(), (0, 1), motion, out, bias)
        return out[GYRO, :, 0], out[ACCEL, :, 0]

    def next_samples(self, count: int = 1) -> int:
        """Reserve the next samples, all within one block, and return their index in `noise`.

        This is for loops that call `quadsim.imu.kernel.measure` themselves.
        """
        if self._at == BLOCK:
            self._at = 0
            for vehicle in range(len(self.records)):
                self._fill(vehicle, 0)
        self._at += count
        return self._at - count

    def _switch_on(self, vehicle: int) -> None:
        """Draw the constant errors of a flight, and restart the noise."""
        seed, flight = self._seeds[vehicle], int(self._flight[vehicle])
        random = np.random.default_rng(child(seed, flight, 0))
        draw_flight(self.records[vehicle], self.specs[vehicle], random)
        self._random[vehicle] = [
            np.random.default_rng(child(seed, flight, 1 + each)) for each in self._noises[vehicle]
        ]
        self._fill(vehicle, self._at)

    def _fill(self, vehicle: int, begin: int) -> None:
        """Draw the noise of a vehicle for the rest of the block."""
        for each, random in zip(self._noises[vehicle], self._random[vehicle], strict=True):
            random.standard_normal(out=self.noise[vehicle, each, begin:])


def simulate_readings(spec: Imus, motion: NDArray[np.void], rate_hz: float, seed: Seed) -> dict[str, Array]:
    """Simulate readings and true biases of whole flights.

    Args:
        spec: The IMU, or one per flight.
        motion: (n, T) records with the fields of `quadsim.imu.kernel.motion_dtype`, all finite.
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.

    Returns:
        For each of `ImuSpec.sensors`, such as "gyro", the readings, and under "gyro_bias" the true bias
        (turn-on and random walk), (n, T, 3) each, in sensor axes.
    """
    n, steps = motion.shape
    stream = ImuStream(spec, n, rate_hz, seed)
    out, bias = np.empty((2, SENSORS, n, steps, 3))
    for start in range(0, steps, BLOCK):
        end = min(start + BLOCK, steps)
        place = stream.next_samples(end - start)
        measure_series(stream.records, stream.noise, place, (start, end), motion, out, bias)
    sensors = stream.specs[0].sensors
    biases = (f"{name}_bias" for name in sensors)
    return dict(zip((*sensors, *biases), (*out, *bias), strict=True))


def simulate_imu(
    spec: Imus,
    ang_vel: ArrayLike,
    specific_force: ArrayLike,
    rate_hz: float,
    seed: Seed,
    ang_acc: ArrayLike | None = None,
    rotor_vel: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Simulate readings of the IMUs of n vehicles over whole flights.

    Args:
        spec: The IMU, or one per vehicle.
        ang_vel: Body rate, body axes, shape (n, T, 3) [rad/s].
        specific_force: Specific force at the centre of mass, body axes, shape (n, T, 3) [m/s²].
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
        ang_acc: Angular acceleration, body axes, shape (n, T, 3) [rad/s²]; needed for a lever arm.
        rotor_vel: Rotor speeds, shape (n, T, rotors) [rad/s]; needed for vibration.

    Returns:
        Readings of gyroscope [rad/s] and accelerometer [m/s²] in sensor axes, (n, T, 3) each.

    Raises:
        ValueError: An array is missing, has the wrong shape or contains a number that is not finite.
    """
    motion = motion_of(spec, ang_vel, specific_force, ang_acc, rotor_vel)
    found = simulate_readings(spec, motion, rate_hz, seed)
    return found["gyro"], found["accel"]


def motion_of(
    spec: Imus,
    ang_vel: ArrayLike,
    specific_force: ArrayLike,
    ang_acc: ArrayLike | None = None,
    rotor_vel: ArrayLike | None = None,
) -> NDArray[np.void]:
    """Return records (n, T) for `simulate_readings`; arguments and errors are those of `simulate_imu`."""
    shape = np.shape(ang_vel)[:2]
    motion = _motion(
        _one_each(spec, shape[0] if shape else 0), shape, ang_vel, specific_force, ang_acc, rotor_vel
    )
    for name in motion.dtype.names or ():
        for where in np.argwhere(~np.isfinite(motion[name]))[:1].tolist():
            value = motion[name][tuple(where)]
            raise ValueError(f"{name}{where} is {value}; all numbers must be finite")
    return motion


def _one_each(spec: Imus, n: int) -> list[ImuSpec]:
    specs = [spec] * n if isinstance(spec, ImuSpec) else list(spec)
    if len(specs) != n:
        raise ValueError(f"{len(specs)} IMUs for {n} vehicles; there must be one for each")
    return specs


def _motion(specs: Sequence[ImuSpec], shape: tuple[int, ...], *given: ArrayLike | None) -> NDArray[np.void]:
    """Return records (n, T) of the motion; fields that the IMU does not use are zero."""
    arrays = [None if each is None else np.asarray(each, np.float64) for each in given]
    displaced = any(any(spec.lever_arm) for spec in specs)
    used = (True, True, displaced, any(spec.vibration is not None for spec in specs))
    *_, rotors = (1,) if arrays[3] is None else (1, *arrays[3].shape)
    motion = np.zeros(shape, motion_dtype(min(rotors, MAX_ROTORS)))
    for name, array, is_used in zip(motion.dtype.names or (), arrays, used, strict=True):
        if is_used and (array is None or array.shape != motion[name].shape):
            width = f"at most {MAX_ROTORS} rotors" if name == "rotor_vel" else 3
            found = "nothing" if array is None else array.shape
            raise ValueError(f"this IMU needs {name} of shape (n, T, {width}), n × T = {shape}, not {found}")
        if is_used:
            motion[name] = array
    return motion
