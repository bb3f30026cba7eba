"""What can be read from a network's hidden spikes: linear decoding, cross-validated over flights.

A quantity y is decoded at a time t after a start from rest as ŷ = W φ(t) + b, ridge regression on the hidden
spikes through first-order low-passes,

    φ_τ(t) = Σ_k (1 − p) p^(t − k) s(k),   p = exp(−1 / (τ rate)),

with R² = 1 − Σ ‖y − ŷ‖² / Σ ‖y − ȳ‖², where ŷ and the mean ȳ are of other flights. The same regression on the
readings says what needs no network, that on a network of shuffled weights what needs no training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from quadsim.imu.spec import ImuSpec
from quadsim.imu.stream import simulate_imu_with_bias
from quadsim.rotation import euler_from_quat, quat_from_euler, quat_rotate, quat_rotate_inverse

from ..networks.encoder import scaled_inputs
from ..networks.network import OnLoihi
from ..networks.weights_file import InputScaling, Tensors
from .activity import record

Array = NDArray[np.float64]
SPIKES_S = (0.02, 0.1, 0.5)
"""Time constants of the low-passes behind the spikes [s]: the network has to remember what is older."""
READINGS_S = (0.02, 0.1, 0.5, 2.0, 10.0)
"""Of those behind the readings, which have no other memory [s]."""
FOLDS = 4
PENALTIES = tuple(np.geomspace(1e-6, 10.0, 8))
"""Candidates of the ridge penalty, over the mean squared norm of the features of a start."""
UP = np.array([0.0, 0.0, 1.0])
AT_ONCE = 64
"""Starts whose spikes are in memory together."""


@dataclass(frozen=True)
class Starts:
    """Pieces of flights, each with sensor errors of its own, and what there is to decode in them."""

    gyro: Array
    """(n, T, 3) [rad/s]."""
    accel: Array
    """(n, T, 3) [m/s²]."""
    flight: NDArray[np.int64]
    """The flight of each piece, (n,)."""
    quantities: dict[str, Array]
    """Name to values at `times`, (n, times, k)."""
    times: NDArray[np.int64]
    """Samples after which is decoded, counted from the first, (times,)."""
    rate_hz: float


def random_starts(
    dataset: xr.Dataset, imu: ImuSpec, per_flight: int, times_s: Sequence[float], seed: int = 0
) -> Starts:
    """Pieces that begin anywhere in simulated flights, with sensor errors drawn anew for each.

    The quantities, x and y of each: "tilt", the world's up in body axes; "turned tilt", the thrust's
    direction in axes that do not turn with the body's yaw after the start (`turned_tilt`); both biases
    [rad/s, m/s²]; and "airspeed", the air-relative velocity in body axes [m/s].

    Args:
        dataset: Of `quadsim generate`: ang_vel, specific_force, quat, velocity and wind.
        imu: What the sensor errors are drawn from; without a lever arm or vibration.
        per_flight: Pieces of each flight.
        times_s: Times after a start to decode at [s]; the last is the length of a piece.
        seed: Of the places and the sensor errors.

    Raises:
        ValueError: Flights shorter than the last time.
    """
    rate_hz = float(dataset.attrs["rate_hz"])
    steps = np.maximum(np.rint(np.asarray(times_s) * rate_hz).astype(np.int64), 1)
    length, whole = int(steps.max()), dataset.sizes["time"]
    if whole < length:
        raise ValueError(
            f"decoding: flights of {whole / rate_hz:g} s, should be {length / rate_hz:g} s or more"
        )
    rng = np.random.default_rng(seed)
    flight = np.repeat(np.arange(dataset.sizes["flight"]), per_flight)
    place = rng.integers(0, whole - length + 1, flight.size)[:, None] + np.arange(length)

    def cut(name: str, samples: NDArray[np.int64]) -> Array:
        values = dataset[name].transpose("flight", "time", ...).to_numpy()
        return values[flight[:, None], samples].astype(np.float64)

    rates, forces = cut("ang_vel", place), cut("specific_force", place)
    gyro, accel, gyro_bias, accel_bias = simulate_imu_with_bias(imu, rates, forces, rate_hz, seed)
    at = place[:, steps - 1]
    quat, air_vel = cut("quat", at), cut("velocity", at) - cut("wind", at)
    start = np.broadcast_to(cut("quat", place[:, :1]), quat.shape)
    vectors = {
        "tilt": quat_rotate_inverse(quat, np.broadcast_to(UP, air_vel.shape)),
        "turned tilt": turned_tilt(quat, start),
        "gyroscope bias": gyro_bias[:, steps - 1],
        "accelerometer bias": accel_bias[:, steps - 1],
        "airspeed": quat_rotate_inverse(quat, air_vel),
    }
    quantities = {name: vector[..., :2] for name, vector in vectors.items()}
    return Starts(gyro, accel, flight, quantities, steps, rate_hz)


def turned_tilt(quat: Array, start: Array) -> Array:
    """Direction of the thrust, body z, in world axes turned about z to the heading of a start (..., 3).

    Args:
        quat: quat_WB (..., 4).
        start: quat_WB at the start, the same shape.
    """
    heading = quat_from_euler(0.0, 0.0, euler_from_quat(start)[..., 2])
    return quat_rotate_inverse(heading, quat_rotate(quat, np.broadcast_to(UP, (*quat.shape[:-1], 3))))


def spike_features(core: OnLoihi, starts: Starts) -> Array:
    """Low-passed hidden spikes at the times, the network starting at rest; (n, times, features)."""
    kernel = low_pass_kernels(starts.times * core.steps, SPIKES_S, starts.rate_hz * core.steps)
    found = []
    for first in range(0, len(starts.gyro), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        activity = record(core, starts.gyro[part], starts.accel[part])
        found.append(_filtered(kernel, activity.of_layer(activity.spikes, 1)))
    return np.concatenate(found)


def reading_features(starts: Starts) -> Array:
    """Low-passed scaled readings at the times, (n, times, features)."""
    kernel = low_pass_kernels(starts.times, READINGS_S, starts.rate_hz)
    return _filtered(kernel, scaled_inputs(InputScaling(), starts.gyro, starts.accel))


def low_pass_kernels(times: NDArray[np.int64], constants_s: Sequence[float], rate_hz: float) -> Array:
    """Weight of each sample in each low-passed value, (constants, times, T); T is the last time."""
    age = times[:, None] - 1 - np.arange(int(times.max()))
    poles = np.exp(-1 / (np.asarray(constants_s)[:, None, None] * rate_hz))
    return np.where(age >= 0, (1 - poles) * poles ** np.maximum(age, 0), 0.0)


def _filtered(kernel: Array, signals: NDArray) -> Array:
    """Signals (n, T, k) through kernels (constants, times, T); (n, times, constants k)."""
    rows = kernel.reshape(-1, kernel.shape[2]).astype(np.float32)
    values = np.stack([rows @ each.astype(np.float32) for each in signals])
    n, constants, k = len(signals), len(kernel), signals.shape[2]
    by_time = values.reshape(n, constants, -1, k).transpose(0, 2, 1, 3)
    return by_time.reshape(n, -1, constants * k).astype(np.float64)


def shuffled(tensors: Tensors, seed: int = 0) -> Tensors:
    """The network with each array of weights and each of decays permuted, but those of the outputs."""
    rng = np.random.default_rng(seed)
    outputs = ("w_out", "syn2", "mem2")
    return {
        name: values if name in outputs else rng.permutation(values.ravel()).reshape(values.shape)
        for name, values in tensors.items()
    }


@dataclass(frozen=True)
class Decoding:
    """Squares of a decoded quantity, summed over components and the starts of each flight."""

    residual: Array
    """Σ ‖y − ŷ‖² of each flight at each time, (flights, times)."""
    total: Array
    """Σ ‖y − ȳ‖², the same; ȳ is the mean over the other folds."""
    draws: Array = field(repr=False)
    """How often each flight is in each bootstrap sample, (samples, flights)."""

    @property
    def r2(self) -> Array:
        """R² at each time, (times,); negative where the mean of other flights is nearer."""
        return 1 - self.residual.sum(axis=0) / self.total.sum(axis=0)

    def interval(self, share: float = 0.95) -> Array:
        """Ends of the bootstrap interval of R² over flights, (2, times)."""
        return _ends(self._sampled(), share)

    def gain_interval(self, other: Decoding, share: float = 0.95) -> Array:
        """The same of the difference of R² from another decoding of the same starts."""
        return _ends(self._sampled() - other._sampled(), share)

    def _sampled(self) -> Array:
        return 1 - (self.draws @ self.residual) / (self.draws @ self.total)


def _ends(values: Array, share: float) -> Array:
    return np.quantile(values, [(1 - share) / 2, (1 + share) / 2], axis=0)


def decode(
    features: ArrayLike, quantities: Mapping[str, Array], flight: NDArray[np.int64], seed: int = 0
) -> dict[str, Decoding]:
    """Decode quantities from features, at every time by a regression of its own.

    The flights are dealt into `FOLDS` folds. What decodes a fold is fitted to the others, with the penalty of
    least error when these decode one another.

    Args:
        features: (n, times, features).
        quantities: Name to values (n, times, k).
        flight: Of each start, (n,).
        seed: Of the folds and the bootstrap.

    Raises:
        ValueError: Fewer flights than folds.
    """
    features = np.asarray(features, np.float64)
    names, place = np.unique(flight, return_inverse=True)
    if names.size < FOLDS:
        raise ValueError(f"decoding: {names.size} flights, should be {FOLDS} or more")
    rng = np.random.default_rng(seed)
    fold = rng.permutation(np.arange(names.size) % FOLDS)[place]
    draws = rng.multinomial(names.size, np.full(names.size, 1 / names.size), 1000).astype(float)
    parts = np.cumsum([0, *(values.shape[2] for values in quantities.values())])
    targets = np.concatenate(list(quantities.values()), axis=2)
    squares = np.zeros((2, *targets.shape))
    for t in range(features.shape[1]):
        squares[:, :, t] = _held_out(features[:, t], targets[:, t], fold, parts)
    residual, total = np.einsum("nf,sntk->sftk", np.eye(names.size)[place], squares)
    return {
        name: Decoding(residual[..., first:end].sum(axis=-1), total[..., first:end].sum(axis=-1), draws)
        for name, first, end in zip(quantities, parts[:-1], parts[1:], strict=True)
    }


def _held_out(x: Array, y: Array, fold: NDArray[np.int64], parts: NDArray[np.int64]) -> Array:
    """Squared errors of the decoded y (n, k) and of the mean, each of a fold that was held out, (2, n, k)."""
    squares = np.empty((2, *y.shape))
    for k in range(FOLDS):
        test = fold == k
        inner = np.zeros((len(PENALTIES), y.shape[1]))
        for j in set(range(FOLDS)) - {k}:
            validation, train = fold == j, ~test & (fold != j)
            inner += ((y[validation] - _ridge(x[train], y[train], x[validation])) ** 2).sum(axis=1)
        scaled = inner / y[~test].var(axis=0).clip(1e-300)
        best = np.argmin(np.add.reduceat(scaled, parts[:-1], axis=1), axis=0)
        estimates = _ridge(x[~test], y[~test], x[test])
        chosen = np.repeat(best, np.diff(parts))
        squares[0, test] = (y[test] - estimates[chosen, :, np.arange(y.shape[1])].T) ** 2
        squares[1, test] = (y[test] - y[~test].mean(axis=0)) ** 2
    return squares


def _ridge(x: Array, y: Array, at: Array) -> Array:
    """Ridge regression of y (n, k) on x (n, p), at (m, p), for each penalty: (penalties, m, k).

    Columns are centred, but not scaled: a neuron that hardly ever spikes would weigh as much as the others.
    """
    mean = x.mean(axis=0)
    x, at = x - mean, at - mean
    few = len(x) <= x.shape[1]  # the smaller of x xᵀ and xᵀ x
    values, vectors = np.linalg.eigh(x @ x.T if few else x.T @ x)
    y_mean = y.mean(axis=0)
    centred = y - y_mean
    turned = vectors.T @ (centred if few else x.T @ centred)
    cross = (at @ x.T if few else at) @ vectors
    penalties = np.asarray(PENALTIES) * max(values.sum() / len(x), 1e-300)
    scale = 1 / (values.clip(0) + penalties[:, None])
    return (cross * scale[:, None]) @ turned + y_mean
