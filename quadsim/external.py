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

Array = NDArray[np.float64]

BLOCK = 64
"""Measurements for which noise is drawn at once."""
_POSITION, _VELOCITY, _YAW, _WIDTH = 0, 3, 6, 7  # columns of a measurement


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

    After `measure`, `position` (n, 3), `velocity` (n, 3) and `yaw` (n,) hold the measurement that is at hand.

    Args:
        spec: The sensor.
        n: Number of vehicles.
        rate_hz: Samples of the loop per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """

    def __init__(self, spec: ExternalSpec, n: int, rate_hz: float, seed: Seed) -> None:
        self._ratio = min((spec.rate_hz or rate_hz) / rate_hz, 1.0)
        self._late = round(spec.delay_s * rate_hz)
        self._scale = np.array(
            3 * [spec.position_noise] + 3 * [spec.velocity_noise] + [np.radians(spec.yaw_noise_deg)]
        )
        self._random = [np.random.default_rng(each) for each in vehicle_seeds(seed, n)]
        self._noise, self._at = np.empty((n, BLOCK, _WIDTH)), np.zeros(n, dtype=np.int64)
        self._draw(np.arange(n))
        self._line = np.zeros((n, int(self._late * self._ratio) + 2, _WIDTH))
        self._held = np.zeros((n, _WIDTH))
        self.position, self.velocity = self._held[:, :_VELOCITY], self._held[:, _VELOCITY:_YAW]
        self.yaw = np.zeros(n)

    def measure(self, k: NDArray[np.int64], position: Array, velocity: Array, yaw: Array) -> None:
        """Take the next sample, each vehicle at its own count k (n,); k = 0 starts a vehicle anew.

        Args:
            k: (n,) count of samples.
            position: (n, 3) true, world [m].
            velocity: (n, 3) true, world [m/s].
            yaw: (n,) true [rad].
        """
        spent = _deliver(
            k, self._ratio, self._late, self._scale, self._noise, self._at, self._line, position, velocity,
            yaw, self._held, self.yaw,
        )  # fmt: skip
        if spent:
            self._draw(np.flatnonzero(self._at == BLOCK))

    def _draw(self, ids: NDArray[np.int64]) -> None:
        for i in ids:
            self._noise[i] = self._random[i].standard_normal((BLOCK, _WIDTH))
        self._at[ids] = 0


@njit(cache=True)
def _deliver(k, ratio, late, scale, noise, at, line, position, velocity, yaw, held, held_yaw):
    """Measure where one is due, and hand out the newest that has arrived; returns how many noises are spent.

    Measurement m is taken at the first sample k with ⌊k · ratio⌋ = m, and waits in line (n, slots, 7).
    """
    spent, slots = 0, line.shape[1]
    for i in range(k.shape[0]):
        m = int(k[i] * ratio + 1e-9)
        if k[i] == 0 or m > int((k[i] - 1) * ratio + 1e-9):
            taken, error = line[i, m % slots], noise[i, at[i]]
            for j in range(3):
                taken[_POSITION + j] = position[i, j] + scale[_POSITION + j] * error[_POSITION + j]
                taken[_VELOCITY + j] = velocity[i, j] + scale[_VELOCITY + j] * error[_VELOCITY + j]
            taken[_YAW] = yaw[i] + scale[_YAW] * error[_YAW]
            at[i] += 1
            spent += at[i] == noise.shape[1]
        here = line[i, int(max(k[i] - late, 0) * ratio + 1e-9) % slots]
        held[i] = here
        held_yaw[i] = here[_YAW]
    return spent
