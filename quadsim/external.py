"""The external sensor: where position, velocity and yaw come from, motion capture for instance.

Each measurement is the truth plus white noise; it is taken at the sensor's own rate, arrives after a delay,
and holds until the next one arrives. Roll and pitch are no business of it: they come from the estimator.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from .config.ranges import Between, Delay, Speed
from .config.toml import Strict, load_toml
from .runs.compiled import njit
from .seeding import Seed, vehicle_seeds

BLOCK = 64
"""Measurements for which noise is drawn at once."""
MEASUREMENT = np.dtype([("position", "f8", 3), ("velocity", "f8", 3), ("yaw", "f8")])
SENSOR = np.dtype(
    [
        ("ratio", "f8"),  # measurements per sample of the loop
        ("delay", "i8"),  # samples
        ("sd", MEASUREMENT),  # standard deviation of the noise
        ("next_noise", "i8"),
    ]
)


class ExternalSpec(Strict):
    """An external sensor; the defaults mean an ideal one: no noise, no delay, a measurement every sample."""

    rate_hz: Annotated[float, Between(0.01, 1e5, "Hz")] | None = None
    """Measurements per second; left out, or above the loop's rate, one for every sample."""
    delay_s: Delay = 0.0
    """From the measurement until it can be used [s]; rounded to whole samples of the loop."""
    position_noise: Annotated[float, Between(0.0, 100.0, "m")] = 0.0
    """Standard deviation on each axis [m]."""
    velocity_noise: Speed = 0.0
    """Standard deviation on each axis [m/s], of what the sensor's own filter makes of its positions."""
    yaw_noise_deg: Annotated[float, Between(0.0, 180.0, "°")] = 0.0
    """Standard deviation [deg]."""


def load_external(source: str | Path) -> ExternalSpec:
    """Read an external sensor: a shipped name ("ideal", "motion-capture") or the path of a TOML file.

    Raises:
        ValueError: One line with the file, the key, its value and what is allowed.
    """
    return load_toml(source, "externals", ExternalSpec)


class ExternalSensor:
    """The external sensors of n vehicles, one sample at a time.

    Args:
        spec: The sensor.
        n: Number of vehicles.
        rate_hz: Samples of the loop per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """

    def __init__(self, spec: ExternalSpec, n: int, rate_hz: float, seed: Seed) -> None:
        ratio, delay = min((spec.rate_hz or rate_hz) / rate_hz, 1.0), round(spec.delay_s * rate_hz)
        self._sensors = np.zeros(n, SENSOR)
        self._sensors["ratio"], self._sensors["delay"] = ratio, delay
        sd = self._sensors["sd"]
        sd["position"], sd["velocity"] = spec.position_noise, spec.velocity_noise
        sd["yaw"] = np.radians(spec.yaw_noise_deg)
        self._random = [np.random.default_rng(each) for each in vehicle_seeds(seed, n)]
        self._noise = np.zeros((n, BLOCK), MEASUREMENT)
        self._draw(np.arange(n))
        self._queue = np.zeros((n, int(delay * ratio) + 2), MEASUREMENT)

    def measure(self, state: NDArray[np.void]) -> None:
        """Replace the true position, velocity and yaw of the next sample by the newest available measurement.

        Args:
            state: (n,) records of `quadsim.control.records.MEASURED`; `k` = 0 resets a vehicle.
        """
        if _deliver(self._sensors, self._noise, self._queue, state):
            self._draw(np.flatnonzero(self._sensors["next_noise"] == BLOCK))

    def _draw(self, ids: NDArray[np.int64]) -> None:
        for i in ids:
            self._noise[i].view(np.float64)[:] = self._random[i].standard_normal(self._noise[i].nbytes // 8)
        self._sensors["next_noise"][ids] = 0


@njit(cache=True)
def _deliver(sensors, noise, queue, state):
    """Measure where one is due, and write the newest that has arrived; returns how many noises are spent.

    Measurement m is taken at the first sample k with ⌊k · ratio⌋ = m, and waits in queue (n, slots).
    """
    spent, slots = 0, queue.shape[1]
    for i in range(state.shape[0]):
        p, x, k = sensors[i], state[i], state[i].k
        m = int(k * p.ratio + 1e-9)
        if k == 0 or m > int((k - 1) * p.ratio + 1e-9):
            taken, error, sd = queue[i, m % slots], noise[i, p.next_noise], p.sd
            for j in range(3):
                taken.position[j] = x.position[j] + sd.position[j] * error.position[j]
                taken.velocity[j] = x.velocity[j] + sd.velocity[j] * error.velocity[j]
            taken.yaw = x.yaw + sd.yaw * error.yaw
            p.next_noise += 1
            spent += p.next_noise == noise.shape[1]
        newest = queue[i, int(max(k - p.delay, 0) * p.ratio + 1e-9) % slots]
        for j in range(3):
            x.position[j], x.velocity[j] = newest.position[j], newest.velocity[j]
        x.yaw = newest.yaw
    return spent
