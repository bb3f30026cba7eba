"""Streams of readings for the training of a circuit: parts of flights and of hand-held motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from estimators.circuit.parameters import GRAVITY
from estimators.networks.encoder import HOLD
from quadsim.rotation import multiply_core, normalize_core, quat_rotate_inverse
from quadsim.runs.compiled import njit

from ..augment import measured, turned_and_mirrored
from ..config import CircuitTraining
from ..data import SIGNALS, TrainingFlights
from .imus import draw_imu

Floats = NDArray[np.float32]
BLOCK = 32
"""Number of streams that are drawn at once."""
EARLY = 0.25
"""Share of the streams that begin at the start of a flight."""
RIDGE, FALSE_RATE = 1e-3, 0.3
GAP_S, FALSE_SAMPLES, FALSEST = 0.5, 10, 60.0
"""Longest gap [s], largest number of consecutive wrong rates, and largest wrong rate [rad/s]."""
SWAY_HZ, SWAY_M, SWAY_MAX = (0.3, 2.5), 0.5, 40.0
"""Frequency of a hand's translation [Hz], its largest amplitude [m] and its largest acceleration [m/s²]. The
position of a hand is bounded, but its acceleration can be large."""


class Streams(NamedTuple):
    """Readings and targets of n streams; streams are the last axis, as in the kernels."""

    angle: Floats  #: body rate times the time of a sample (T, 3, n) [rad]
    force: Floats  #: specific force (T, 3, n) [9.81 m/s²]
    again: NDArray[np.bool_]  #: whether readings resume after a gap (T, n)
    up: Floats  #: the world's up in body axes (T, 3, n)
    bias: Floats  #: of the gyroscope, as far as `up` tells it (3, n) [rad/s]
    known: NDArray[np.bool_]  #: whether a stream begins with its attitude and bias known (n,)

    def batch(self, rows: NDArray[np.int64]) -> Streams:
        """Return some of the streams."""
        return Streams._make(np.ascontiguousarray(each[..., rows]) for each in self)


def draw_streams(
    parts: Sequence[TrainingFlights], recipe: CircuitTraining, steps: int, rng: np.random.Generator
) -> Streams:
    """Draw streams of T = `steps` samples, each with its own sensor errors.

    Datasets without a vehicle contain hand-held motion. If all datasets contain the same kind of motion, so
    do all streams.
    """
    flights, hands = ([part for part in parts if bool(part.vehicles) is flown] for flown in (True, False))
    hand_share = recipe.hand_share if flights and hands else float(not flights)
    count, blocks = recipe.streams, -(-recipe.streams // BLOCK)
    kinds = rng.random(blocks) < hand_share
    angle, force, up = (np.empty((steps, 3, count), np.float32) for _ in range(3))
    again, bias = np.zeros((steps, count), np.bool_), np.empty((3, count), np.float32)
    done = Streams(angle, force, again, up, bias, rng.random(count) < recipe.known_share)
    for k, by_hand in enumerate(kinds):
        part = slice(k * BLOCK, min((k + 1) * BLOCK, count))
        sets, swaying = (hands, recipe.sway_share) if by_hand else (flights, 0.0)
        n, rate_hz = part.stop - part.start, sets[0].rate_hz
        rate, force, up = turned_and_mirrored(*_block(sets, n, steps, swaying, rng), rng)
        imus = [draw_imu(recipe.imu, rng.random() < recipe.calibrated_share, rng) for _ in range(n)]
        readings = measured(imus, rate, force, rate_hz, rng)
        done.again[:, part] = interrupt(readings, recipe.interrupted_share, rate_hz, rng).T
        signals = readings[0] / rate_hz, readings[1] / GRAVITY, up
        for whole, drawn in zip((done.angle, done.force, done.up), signals, strict=True):
            whole[..., part] = drawn.transpose(1, 2, 0)
        done.bias[:, part] = bias_of(readings[0], up, rate_hz).T
    return done


def _block(
    sets: Sequence[TrainingFlights], n: int, steps: int, swaying: float, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return true rate, specific force and world z axis of n streams, (n, T, 3).

    All flights are equally likely.
    """
    sizes = np.array([len(each) for each in sets])
    which = rng.choice(len(sets), n, p=sizes / sizes.sum())
    streams = []
    for flights in (sets[k] for k in which):
        length = flights.gyro.shape[1]
        first = 0 if rng.random() < EARLY else rng.integers(length - steps + 1)
        row = rng.integers(len(flights))
        streams.append([getattr(flights, name)[row, first : first + steps] for name in SIGNALS])
    rate, force, _, _, up = (np.stack(each) for each in zip(*streams, strict=True))
    rate, force = hold_last(rate), hold_last(force)
    return rate, sway(rate, force, up, swaying, sets[0].rate_hz, rng) if swaying else force, up


def bias_of(gyro: Floats, up: Floats, rate_hz: float) -> Floats:
    """Estimate the gyroscope bias (n, 3) by least squares of u̇ = u × (ω - b), with the world's z axis u.

    The bias is 0 about an axis that is always vertical, because u does not determine it. Deviations are
    clipped at `FALSE_RATE`.
    """
    change = np.gradient(up, axis=1) * rate_hz
    right = gyro - up * (up * gyro).sum(2, keepdims=True) + np.cross(up, change)
    middle = np.median(right, axis=1, keepdims=True)
    right = middle + np.clip(right - middle, -FALSE_RATE, FALSE_RATE)
    square = np.eye(3) * (1 + RIDGE) - np.einsum("nti,ntj->nij", up, up) / up.shape[1]
    return np.linalg.solve(square, right.mean(1)[..., None])[..., 0]


def interrupt(
    readings: tuple[Floats, Floats], share: float, rate_hz: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Interrupt a share of the streams in place by a gap and by wrong rates about one axis.

    Returns:
        Whether a sample is the first after a gap of more than `HOLD` samples, (n, T).
    """
    n, steps, _ = readings[0].shape
    again = np.zeros((n, steps), np.bool_)
    for row in np.flatnonzero(rng.random(n) < share):
        first, length = rng.integers(1, steps), int(rng.uniform(0, GAP_S) * rate_hz)
        for each in readings:
            each[row, first : first + length] = each[row, first - 1]
        if length > HOLD:
            readings[0][row, first + HOLD : first + length] = 0
            again[row, first + length : first + length + 1] = True
        first, axis = rng.integers(steps), rng.integers(3)
        readings[0][row, first : first + rng.integers(1, FALSE_SAMPLES + 1), axis] = rng.uniform(
            -FALSEST, FALSEST
        )
    return again


def hold_last(readings: Floats) -> Floats:
    """Replace missing readings (n, T, 3) by the last valid ones, or by 0 before the first."""
    lost = ~np.isfinite(readings).all(-1)
    index = np.maximum.accumulate(np.where(lost, 0, np.arange(readings.shape[1])), axis=1)
    return np.nan_to_num(np.take_along_axis(readings, index[..., None], 1))


def sway(
    rate: Floats, force: Floats, up: Floats, share: float, rate_hz: float, rng: np.random.Generator
) -> Floats:
    """Add a bounded translation to the specific force (n, T, 3) of a share of hand-held streams."""
    n, steps, _ = rate.shape
    place = np.zeros((n, steps, 3))
    for k in np.flatnonzero(rng.random(n) < share):
        usual, t = np.exp(rng.uniform(*np.log(SWAY_HZ))), 0
        while t < steps:
            end = min(steps, t + round(rng.uniform(3, 20) * rate_hz))
            place[k, t:end] = _to_and_fro(end - t, usual, rate_hz, rng)
            t = end + round(rng.uniform(0, 5) * rate_hz)
    place = gaussian_filter1d(place, 0.04 * rate_hz, axis=1)
    acceleration = np.gradient(np.gradient(place, axis=1), axis=1) * rate_hz**2
    attitude = np.empty((n, steps, 4))
    _follow(np.ascontiguousarray(rate, np.float64) / rate_hz, _from_up(up[:, 0].astype(np.float64)), attitude)
    return force + quat_rotate_inverse(attitude, acceleration).astype(force.dtype)


def _to_and_fro(steps: int, usual_hz: float, rate_hz: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return positions (T, 3) around 0, with slowly varying direction and frequency [m]."""
    hertz = usual_hz * np.exp(0.3 * rng.standard_normal())
    wander = gaussian_filter1d(rng.standard_normal(steps + 200), 60)
    phase = 2 * np.pi * np.cumsum(hertz * np.exp(0.2 * wander[:steps] / wander.std())) / rate_hz
    amplitude = min(SWAY_M * rng.random() ** 1.5, SWAY_MAX / (2 * np.pi * hertz) ** 2)
    ramp = np.minimum(1, np.minimum(np.arange(steps), np.arange(steps)[::-1]) / (0.5 * rate_hz))
    direction = rng.standard_normal(3) * np.exp(0.7 * rng.standard_normal(3))
    lag = rng.uniform(0, 2 * np.pi, (2, 3)) * [[rng.random() < 0.5], [True]]
    waves = np.sin(phase[:, None] + lag[0]) + 0.3 * rng.random() * np.sin(2 * phase[:, None] + lag[1])
    return amplitude * ramp[:, None] * direction / np.abs(direction).max() * waves


def _from_up(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shortest rotations (n, 4), body to world, that align `up` (n, 3) with the world's z axis."""
    x, y, z = up.T
    quat = np.stack([1 + z, y, -x, np.zeros_like(z)], 1)
    quat[z < -1 + 1e-6] = 0, 1, 0, 0
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


@njit(cache=True)
def _follow(angle, quat, attitude):
    """Integrate rotations (n, T, 3) [rad] from initial attitudes (n, 4) to attitudes (n, T, 4)."""
    for k in range(angle.shape[0]):
        w, x, y, z = quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3]
        for t in range(angle.shape[1]):
            attitude[k, t, 0], attitude[k, t, 1], attitude[k, t, 2], attitude[k, t, 3] = w, x, y, z
            a, b, c = angle[k, t, 0] / 2, angle[k, t, 1] / 2, angle[k, t, 2] / 2
            w, x, y, z = normalize_core(*multiply_core(w, x, y, z, 1.0, a, b, c))
