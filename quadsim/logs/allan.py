"""Noise of an IMU from a log at rest: the Allan variance, to which the simulator's error model is fitted."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from ..dataset.stretches import blocks_of, longest_stretch
from ..runs.console import print_table, say
from ..runs.files import save_figure, write_whole
from ..vehicle import GRAVITY
from .cleaning import longest_part
from .recording import Array, Recording
from .thresholds import STILL

NOISE_S, WALK_S = 10.0, 60.0
"""Shortest durations at rest from which a white noise density and a bias random walk can be computed [s]."""
WALK_SHOWS = 4 * math.sqrt(3.0)
"""Smallest σ_b, in units of N/T, that a log of length T can show. A random walk exceeds white noise in the
Allan variance, σ_b² t/3 > N²/t, at averaging times above √3 N/σ_b, and averaging times are at most T/4."""
POINTS = 60
"""Number of averaging times of the curve."""
LONGEST = 1 / 4
"""Longest averaging time as a share of the log."""


class SensorNoise(NamedTuple):
    """Noise of one sensor, with all three axes pooled."""

    name: str
    unit: str
    """Unit of the sensor, rad/s or m/s²."""
    bias: Array
    """Mean of each axis over the log (3,); for the accelerometer, only the bias along gravity."""
    turn_on: float
    """Standard deviation of the turn-on bias, estimated from `bias`."""
    noise: float
    """White noise density N [unit/√Hz]."""
    random_walk: float
    """Bias random walk σ_b [unit/√s]; 0 if the log shows no random walk or is too short."""
    time_constant: float
    """Correlation time τ of the bias random walk [s]."""
    resolved: bool
    """Whether the log is long enough to determine τ; if not, τ is a lower bound."""
    times: Array
    """Averaging times of `deviation`, (k,) [s]."""
    deviation: Array
    """Allan deviation of the pooled axes, (k,)."""


@dataclass(frozen=True)
class Calibration:
    """Calibration of an IMU from a log at rest."""

    gyro: SensorNoise
    accel: SensorNoise
    still_s: float
    """Duration of the analysed part of the log [s]."""
    log: str
    rate_hz: float

    @property
    def lacking(self) -> Iterator[str]:
        """Coefficients for which the log is too short, with the required duration, one sentence each."""
        here = f"{self.still_s:.0f} s"
        if self.still_s < WALK_S:
            least = f"need {WALK_S:g} s at rest at a stretch at least, an hour to be sure; here are {here}"
            yield f"bias random walk and its time constant: {least}"
            return
        for each in (self.gyro, self.accel):
            if each.random_walk == 0.0:
                bound = f"it is below about {WALK_SHOWS * each.noise / self.still_s:.2g} {each.unit}/√s"
                text = f"none shows in {here}, {bound}; a smaller one needs a longer log"
                yield f"{each.name}, bias random walk: {text}"
            elif not each.resolved:
                longer = "needs a log several times as long as itself"
                yield f"{each.name}, time constant: more than {here}; {longer}"


def model_variance(times: ArrayLike, noise: float, random_walk: float, time_constant: float) -> Array:
    """Return the Allan variance of white noise plus a bias that is a first-order Gauss-Markov process.

    The variance is N²/t + (σ_b² τ²/t) [1 − (τ/2t)(3 − 4 e^{−t/τ} + e^{−2t/τ})], for the error model of
    `quadsim.imu`.
    """
    t = np.asarray(times, np.float64)
    x = t / time_constant
    # The bracket cancels for small x, where it is x²/3 − x³/4 + 7x⁴/60.
    exact = 1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * np.maximum(x, 1e-9))
    bracket = np.where(x < 1e-2, x**2 / 3 - x**3 / 4 + 7 * x**4 / 60, exact)
    return noise**2 / t + random_walk**2 * time_constant**2 / t * bracket


def allan_variance(signal: Array, rate_hz: float, sizes: NDArray[np.int64]) -> Array:
    """Return the overlapping Allan variance, (T, k) -> (len(sizes), k), for averages over `sizes` samples."""
    total = np.concatenate([np.zeros((1, signal.shape[1])), np.cumsum(signal - signal.mean(axis=0), axis=0)])
    out = np.empty((sizes.size, signal.shape[1]))
    for row, m in enumerate(sizes):
        second = total[2 * m :] - 2 * total[m:-m] + total[: -2 * m]
        out[row] = 0.5 * np.mean(second**2, axis=0) / m**2
    return out


def calibrate(log: Recording) -> Calibration:
    """Estimate noise densities, bias random walks and biases of an IMU from a log at rest.

    A noise density needs a duration of `NOISE_S` at rest, a bias random walk `WALK_S`. `Calibration.lacking`
    names the coefficients for which the log is too short.

    Args:
        log: The raw samples, from `read_recording`. The longest part at rest is used.

    Raises:
        ValueError: The log has no part at rest or no noise, or the mean specific force is not gravity's.
    """
    log = longest_part(log)[0]
    rate = 1.0 / float(np.median(np.diff(log.time)))
    gyro, accel = still_readings(log)
    down, mean = accel.mean(axis=0), gyro.mean(axis=0)
    length = float(np.linalg.norm(down))
    if not 0.9 * GRAVITY <= length <= 1.1 * GRAVITY:
        raise ValueError(
            f"{log.name}: at rest it reads a specific force of {length:.4g} m/s², and gravity is "
            f"{GRAVITY:g}: look at its unit (g, mg?)"
        )
    if not (np.ptp(gyro, axis=0).any() and np.ptp(accel, axis=0).any()):
        raise ValueError(f"{log.name}: at rest it reads the same numbers all the time: no noise to measure")
    # A level is unknown to a sensor at rest: only the length of what it reads tells of its bias.
    along = down / length * (length - GRAVITY)
    turn_on = float(np.sqrt(np.mean(mean**2))), abs(length - GRAVITY)
    return Calibration(
        gyro=SensorNoise("gyroscope", "rad/s", mean, turn_on[0], *_fitted(gyro, rate)),
        accel=SensorNoise("accelerometer", "m/s²", along, turn_on[1], *_fitted(accel, rate)),
        still_s=len(gyro) / rate,
        log=log.name,
        rate_hz=rate,
    )


def still_readings(log: Recording) -> tuple[Array, Array]:
    """Return the readings of both sensors in the longest part at rest without a missing sample, (n, 3) each.

    Raises:
        ValueError: This part is shorter than `NOISE_S`.
    """
    period = float(np.median(np.diff(log.time)))
    second = max(1, round(1.0 / period))
    lengths = np.diff(np.append(log.time, log.time[-1] + period)[::second])
    quiet = np.abs(lengths - second * period) < 0.2 * second * period
    sensors = (
        (log.gyro, STILL.still_gyro, STILL.shake_gyro),
        (log.accel, STILL.still_accel, STILL.shake_accel),
    )
    calm = np.argsort(blocks_of(log.gyro, second).std(axis=1).sum(axis=1))[: max(1, len(quiet) // 4)]
    for values, most, shake in sensors if len(quiet) else ():
        blocks = blocks_of(values, second)
        means = blocks.mean(axis=1)
        near = np.abs(means - median_filter(means, (61, 1), mode="nearest")) < most
        near &= np.abs(means - np.median(means[calm], axis=0)) < STILL.drift * most
        quiet &= (near & (blocks.std(axis=1) < shake)).all(axis=1)
    start, end = longest_stretch(quiet)
    if (found := (end - start) * second * period) < 0.99 * NOISE_S:
        raise ValueError(
            f"{log.name}: at rest for {found:.0f} s at a stretch; at least {NOISE_S:g} s are required"
        )
    return log.gyro[start * second : end * second], log.accel[start * second : end * second]


def write_imu(calibration: Calibration, out: Path) -> None:
    """Write an IMU file for `quadsim generate --set imu=FILE`."""
    lines = [
        f"Calibrated by `quadsim identify --still` from {calibration.log}:",
        f"{calibration.still_s:.0f} s at {calibration.rate_hz:.1f} Hz at rest. Scale,",
        "misalignment, low-pass and range do not show at rest: take them from the data sheet, and add",
        "scale_factor, misalignment, low_pass_hz and saturation here.",
        *calibration.lacking,
    ]
    text = "".join(f"# {line}\n" for line in lines)
    for key, found in (("gyro", calibration.gyro), ("accel", calibration.accel)):
        text += f"\n[{key}]\nnoise = {found.noise:.5g} # {found.unit}/√Hz\n"
        if found.random_walk > 0:
            sure = "" if found.resolved else ": a lower bound, the log is too short to tell"
            text += f"random_walk = {found.random_walk:.5g} # {found.unit}/√s\n"
            text += f"time_constant = {found.time_constant:.5g} # s{sure}\n"
        bias = ", ".join(f"{value:.5g}" for value in found.bias)
        text += f"turn_on = {found.turn_on:.5g} # {found.unit}, from a mean of {bias}\n"
    write_whole(out, text)


def _fitted(signal: Array, rate_hz: float) -> tuple[float, float, float, bool, Array, Array]:
    """Fit the error model to three axes (T, 3).

    Return N, σ_b, τ, whether τ is resolved, averaging times and Allan deviation.

    The fit minimises the squared error of the logarithm of the Allan variance, weighted by the degrees of
    freedom. The parameters are N, σ_b and τ, or only N if T is too short.
    """
    sizes = np.unique(np.geomspace(1, max(2, int(len(signal) * LONGEST)), POINTS).astype(np.int64))
    times = sizes / rate_hz
    variance = allan_variance(signal, rate_hz, sizes).mean(axis=1)
    # Neighbouring points are of the same samples, so that many short ones must not outweigh the rest.
    freedom = np.minimum(3 * np.maximum(len(signal) / sizes - 1, 1.0), 300.0)
    longest = float(times[-1] / LONGEST)
    curve = times, np.sqrt(variance)

    def cost(logarithms: Array) -> Array:
        return np.sqrt(freedom / 2) * np.log(model_variance(times, *np.exp(logarithms)) / variance)

    if len(signal) / rate_hz < WALK_S:
        noise = float(np.exp(0.5 * np.average(np.log(variance * times), weights=freedom / 2)))
        return noise, 0.0, longest, False, *curve
    white, walk = np.sqrt(variance[0] * times[0]), np.sqrt(variance[-1] / times[-1])
    bounds = (np.log([white / 10, walk / 1e3, 10 * times[0]]), np.log([white * 10, walk * 1e3, longest]))
    starts = (np.log([white, walk, tau]) for tau in (longest / 30, longest / 3, longest))
    best = min((least_squares(cost, start, bounds=bounds) for start in starts), key=lambda fit: fit.cost)
    noise, walk, tau = np.exp(best.x).tolist()
    with np.errstate(divide="ignore"):
        alone = np.sum(cost(np.log([noise, 0.0, 1.0])) ** 2) / 2
    if alone < best.cost + STILL.chance:
        return noise, 0.0, longest, False, *curve
    return noise, walk, tau, tau < 0.9 * longest, *curve


def draw_allan(calibration: Calibration) -> Figure:
    """Draw the measured and the fitted Allan deviation of both sensors."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for axes, found in zip(figure.subplots(1, 2), (calibration.gyro, calibration.accel), strict=True):
        axes.loglog(found.times, found.deviation, "o", ms=3.5, label="log")
        fitted = model_variance(found.times, found.noise, found.random_walk, found.time_constant)
        axes.loglog(found.times, np.sqrt(fitted), lw=1.5, label="fitted model")
        axes.set(xlabel="averaging time, s", ylabel=f"Allan deviation, {found.unit}", title=found.name)
        axes.grid(True, which="both", alpha=0.25)
        axes.legend()
    return figure


def show_calibration(found: Calibration, out: Path) -> None:
    """Print a calibration, and write the IMU file and a picture."""
    write_imu(found, out)
    save_figure(out.with_suffix(".png"), draw_allan(found), dpi=130)
    rows = []
    for each, seen in ((found.gyro, ""), (found.accel, ", along gravity")):
        walk, tau = "-", "-"
        if each.random_walk:
            walk = f"{each.random_walk:.4g}"
            tau = f"{'' if each.resolved else '> '}{each.time_constant:.0f}"
        bias = (f"{value:+.5f}" for value in each.bias)
        turn_on, noise = f"{each.turn_on:.3g}", f"{each.noise:.4g}"
        rows.append((f"{each.name}{seen}, {each.unit}", *bias, turn_on, noise, walk, tau))
    headings = ("bias x", "y", "z", "turn-on bias", "noise density", "bias random walk", "time constant, s")
    print_table(rows, ("sensor", *headings))
    for line in found.lacking:
        say(f"! {line}")
    say(f"{out}: an IMU from {found.still_s:.0f} s at rest; quadsim generate --set imu={out}")
