"""The external sensor, such as motion capture: the source of position, velocity and yaw.

Each measurement is the truth plus white noise. The sensor measures at its own rate. A measurement arrives
after a delay and is used until the next one arrives. The external sensor does not measure roll and pitch.
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
"""Number of measurements for which noise is drawn at once."""
NUMBERS = 7
"""Number of values in a measurement: position, velocity and yaw."""
SENSOR = np.dtype(
    [
        ("ratio", "f8"),  # measurements per sample of the loop
        ("delay", "i8"),  # samples
        ("sd", "f8", NUMBERS),  # standard deviation of the noise
        ("next_noise", "i8"),
    ]
)


class ExternalSpec(Strict):
    """An external sensor. By default, there is no noise and no delay, and one measurement per sample."""

    rate_hz: Annotated[float, Between(0.01, 1e5, "Hz")] | None = None
    """Measurements per second. The default, and any rate above the sample rate, gives one measurement per
    sample."""
    delay_s: Delay = 0.0
    """Delay of a measurement, rounded to whole samples [s]."""
    position_noise: Annotated[float, Between(0.0, 100.0, "m")] = 0.0
    """Standard deviation of the position on each axis [m]."""
    velocity_noise: Speed = 0.0
    """Standard deviation of the velocity on each axis [m/s], after the sensor's own filter."""
    yaw_noise_deg: Annotated[float, Between(0.0, 180.0, "°")] = 0.0
    """Standard deviation of the yaw [deg]."""


def load_external(source: str | Path) -> ExternalSpec:
    """Read an external sensor: a shipped name ("ideal", "motion-capture") or the path of a TOML file.

    Raises:
        ValueError: The file is invalid; the message names the key, its value and the allowed values.
    """
    return load_toml(source, "externals", ExternalSpec)


class ExternalSensor:
    """The external sensors of n vehicles; records, noise and queues are arguments of `deliver`.

    Args:
        spec: The sensor.
        n: Number of vehicles.
        rate_hz: Samples of the loop per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
        longest: Largest factor that `delay` accepts.
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
        """Draw new noise for sensors that have used all of theirs."""
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
        queue: (slots, NUMBERS) measurements that have not arrived yet.
        x: Record of `quadsim.control.records.MEASURED`; `k` = 0 resets the vehicle.

    Returns:
        Whether all noise has been used.
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
