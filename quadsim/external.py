"""The external sensor: where position, velocity and yaw come from, motion capture for instance.

Each measurement is the truth plus white noise; it is taken at the sensor's own rate, arrives after a delay,
and holds until the next one arrives. Roll and pitch are no business of it: they come from the estimator.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .config.ranges import Between, Delay, Speed
from .config.toml import Strict, load_toml
from .runs.compiled import njit
from .seeding import Seed, vehicle_seeds

BLOCK = 64
"""Measurements for which noise is drawn at once."""
NUMBERS = 7
"""Of a measurement: position, velocity and yaw."""
SENSOR = np.dtype(
    [
        ("ratio", "f8"),  # measurements per sample of the loop
        ("delay", "i8"),  # samples
        ("sd", "f8", NUMBERS),  # standard deviation of the noise
        ("next_noise", "i8"),
    ]
)


class ExternalSpec(Strict):
    """An external sensor; the defaults mean an ideal one: no noise, no delay, a measurement every sample."""

    rate_hz: Annotated[float, Between(0.01, 1e5, "Hz")] | None = None
    """Measurements per second; default, and if above the loop's rate: one per sample."""
    delay_s: Delay = 0.0
    """Delay of a measurement [s]; rounded to whole samples of the loop."""
    position_noise: Annotated[float, Between(0.0, 100.0, "m")] = 0.0
    """Standard deviation of the position on each axis [m]."""
    velocity_noise: Speed = 0.0
    """Standard deviation of the velocity on each axis [m/s], after the sensor's own filter."""
    yaw_noise_deg: Annotated[float, Between(0.0, 180.0, "°")] = 0.0
    """Standard deviation [deg]."""


def load_external(source: str | Path) -> ExternalSpec:
    """Read an external sensor: a shipped name ("ideal", "motion-capture") or the path of a TOML file.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    return load_toml(source, "externals", ExternalSpec)


class ExternalSensor:
    """The external sensors of n vehicles: their records, noise and queues are what `deliver` takes.

    Args:
        spec: The sensor.
        n: Number of vehicles.
        rate_hz: Samples of the loop per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
        longest: Largest factor that `delay` may be given.
    """

    def __init__(self, spec: ExternalSpec, n: int, rate_hz: float, seed: Seed, longest: float = 1.0) -> None:
        ratio, self._delay = min((spec.rate_hz or rate_hz) / rate_hz, 1.0), spec.delay_s * rate_hz
        sd = spec.position_noise, spec.velocity_noise, np.radians(spec.yaw_noise_deg)
        self.sensors = np.zeros(n, SENSOR)
        self.sensors["ratio"], self.sensors["next_noise"] = ratio, BLOCK
        self.delay(slice(None), 1.0)
        self.sensors["sd"] = np.repeat(sd, (3, 3, 1))
        self.noise = np.zeros((n, BLOCK, NUMBERS))
        self.queue = np.zeros((n, int(round(longest * self._delay) * ratio) + 2, NUMBERS))
        self._random = [np.random.default_rng(each) for each in vehicle_seeds(seed, n)]
        self.draw()

    def delay(self, ids: NDArray[np.int64] | slice, factor: ArrayLike) -> None:
        """Set the delay of some vehicles to its nominal value times a factor, (m,)."""
        self.sensors["delay"][ids] = np.rint(self._delay * np.asarray(factor))

    def draw(self) -> None:
        """Draw noise for the sensors that have spent theirs."""
        for i in np.flatnonzero(self.sensors["next_noise"] == BLOCK):
            self._random[i].standard_normal(out=self.noise[i])
            self.sensors["next_noise"][i] = 0


@njit(cache=True)
def deliver(p, noise, queue, x):
    """Replace the true position, velocity and yaw of a vehicle by the newest measurement that has arrived.

    Measurement m is taken at the first sample k with ⌊k · ratio⌋ = m.

    Args:
        p: Record of `SENSOR`.
        noise: (BLOCK, NUMBERS) standard normal numbers.
        queue: (slots, NUMBERS), where measurements wait.
        x: Record of `quadsim.control.records.MEASURED`; `k` = 0 resets the vehicle.

    Returns:
        Whether the noise is spent.
    """
    k, slots = x.k, queue.shape[0]
    m = int(k * p.ratio + 1e-9)
    if k == 0 or m > int((k - 1) * p.ratio + 1e-9):
        taken, error = queue[m % slots], noise[p.next_noise]
        for j in range(3):
            taken[j] = x.position[j] + p.sd[j] * error[j]
            taken[3 + j] = x.velocity[j] + p.sd[3 + j] * error[3 + j]
        taken[6] = x.yaw + p.sd[6] * error[6]
        p.next_noise += 1
    newest = queue[int(max(k - p.delay, 0) * p.ratio + 1e-9) % slots]
    for j in range(3):
        x.position[j], x.velocity[j] = newest[j], newest[3 + j]
    x.yaw = newest[6]
    return p.next_noise == noise.shape[0]
