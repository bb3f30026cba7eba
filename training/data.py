"""Flights in memory, their split, and batches of windows that follow one another."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadsim.dataset.reading import open_dataset
from quadsim.rotation import quat_rotate_inverse

from .augment import Augmentation, augment, roll_pitch_of_up

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Flights:
    """Flights of equal length; float32.

    Args:
        ang_vel: True body rate, shape (n, T, 3) [rad/s].
        specific_force: True specific force, body axes, shape (n, T, 3) [m/s²].
        gyro: The measured rate.
        accel: The measured specific force.
        up: World's up in body axes, shape (n, T, 3).
        rate_hz: Samples per second.
        sources: Dataset of each flight.
    """

    ang_vel: Float32
    specific_force: Float32
    gyro: Float32
    accel: Float32
    up: Float32
    rate_hz: float
    sources: tuple[str, ...]

    def __len__(self) -> int:
        """Number of flights."""
        return len(self.gyro)

    @property
    def roll_pitch(self) -> NDArray[np.float64]:
        """True roll and pitch, shape (n, T, 2) [rad]."""
        return roll_pitch_of_up(self.up).astype(np.float64)

    def digest(self) -> str:
        """A fingerprint of all samples."""
        found = hashlib.blake2b(f"{self.rate_hz}".encode(), digest_size=16)
        for name in ("ang_vel", "specific_force", "gyro", "accel", "up"):
            found.update(np.ascontiguousarray(getattr(self, name)).data)
        return found.hexdigest()

    def select(self, ids: Sequence[int] | NDArray[np.int64]) -> Flights:
        """Some of the flights."""
        index = np.asarray(ids, dtype=np.int64)
        return Flights(
            *(getattr(self, name)[index] for name in ("ang_vel", "specific_force", "gyro", "accel", "up")),
            rate_hz=self.rate_hz,
            sources=tuple(self.sources[i] for i in index),
        )


def load_flights(paths: Sequence[str | Path]) -> Flights:
    """Read the whole flights of one or more datasets (a flight that ended early is left out).

    Raises:
        FileNotFoundError: A dataset is not there.
        ValueError: Not a dataset, different rates or lengths, or no whole flight.
    """
    if not paths:
        raise ValueError("no dataset to train on")
    parts = [_read(Path(path)) for path in paths]
    rates, lengths = {p.rate_hz for p in parts}, {p.gyro.shape[1] for p in parts}
    if len(rates) > 1:
        raise ValueError(f"datasets of different rates: {sorted(rates)} Hz")
    steps = min(lengths)
    joined = (
        np.concatenate([getattr(p, name)[:, :steps] for p in parts])
        for name in ("ang_vel", "specific_force", "gyro", "accel", "up")
    )
    return Flights(*joined, rate_hz=rates.pop(), sources=tuple(s for p in parts for s in p.sources))


def _read(path: Path) -> Flights:
    data = open_dataset(path)
    whole = np.flatnonzero(data["valid_steps"].to_numpy() == data.sizes["time"])
    if whole.size == 0:
        raise ValueError(f"{path}: no flight that lasts to the end")
    data = data.isel(flight=whole)
    quat = data["quat"].to_numpy().astype(np.float64)
    up = quat_rotate_inverse(quat, np.broadcast_to([0.0, 0.0, 1.0], (*quat.shape[:-1], 3)))
    measured = (
        data[name].to_numpy().astype(np.float32) for name in ("ang_vel", "specific_force", "gyro", "accel")
    )
    return Flights(
        *measured,
        up=up.astype(np.float32),
        rate_hz=float(data.attrs["rate_hz"]),
        sources=(str(path),) * len(up),
    )


def split(flights: int, seed: int, shares: tuple[float, float, float] = (0.7, 0.2, 0.1)) -> list[NDArray]:
    """Ids of the training, validation and test flights, drawn without replacement; at least one each.

    Raises:
        ValueError: Fewer than three flights.
    """
    if flights < 3:
        raise ValueError(f"a split needs at least 3 flights, got {flights}")
    order = np.random.default_rng(np.random.SeedSequence(seed)).permutation(flights)
    last = max(1, round(shares[2] * flights))
    middle = max(1, round(shares[1] * flights))
    return [np.sort(order[: -last - middle]), np.sort(order[-last - middle : -last]), np.sort(order[-last:])]


def fold_split(flights: int, folds: int, fold: int, seed: int) -> list[NDArray]:
    """Ids of the training, validation and test flights of one fold: the test flights are its part of all.

    Two ninths of the others choose the epoch, as in the 70/20/10 of `split`.

    Raises:
        ValueError: Fewer than two folds, no such fold, or too few flights for as many.
    """
    if folds < 2 or not 0 <= fold < folds:
        raise ValueError(f"fold {fold} of {folds}: there must be at least 2, counted from 0")
    if flights < max(folds, 3):
        raise ValueError(f"{folds} folds need at least {max(folds, 3)} flights, got {flights}")
    parts = np.array_split(np.random.default_rng(np.random.SeedSequence(seed)).permutation(flights), folds)
    others = np.concatenate(parts[:fold] + parts[fold + 1 :])
    chosen = max(1, round(len(others) * 2 / 9))
    return [np.sort(others[chosen:]), np.sort(others[:chosen]), np.sort(parts[fold])]


COHORTS = 8
"""Parts of a batch whose streams begin and end together."""


@dataclass(frozen=True)
class Batch:
    """One window of every stream: measurements (n, T, 3) and roll, pitch (n, T, 2), float32."""

    gyro: Float32
    accel: Float32
    roll_pitch: Float32
    fresh: NDArray[np.bool_]
    """Streams (n,) that begin here; the others go on where the last window ended."""


def windows(
    flights: Flights,
    augmentation: Augmentation,
    batches: int,
    batch_size: int,
    steps: int,
    windows_per_stream: int,
    seed: Sequence[int],
) -> Iterator[Batch]:
    """The windows of an epoch: streams start anywhere in any flight, and each is cut into successive windows.

    Streams differ in length, from one window to `windows_per_stream`, evenly in the logarithm: every batch
    has some that have just begun and some that have long settled.

    Args:
        flights: To draw from.
        augmentation: What the sensors add; drawn once per stream (noise per sample).
        batches: Windows in the epoch.
        batch_size: Streams side by side.
        steps: Samples in a window.
        windows_per_stream: Most windows in a stream; fewer where the flights end before.
        seed: Of this epoch.
    """
    available = flights.gyro.shape[1]
    if steps < 1:
        raise ValueError("windows of no sample: give a larger window_s")
    if steps > available:
        raise ValueError(
            f"windows of {steps} samples, but the flights have {available}: give a smaller window_s"
        )
    most = min(windows_per_stream, available // steps)
    sizes = [len(part) for part in np.array_split(np.arange(batch_size), COHORTS) if len(part)]
    seeds = np.random.SeedSequence(list(seed)).spawn(len(sizes))
    cohorts = [
        _streams(flights, augmentation, n, steps, most, np.random.default_rng(each))
        for n, each in zip(sizes, seeds, strict=True)
    ]
    for _ in range(batches):
        parts = [next(cohort) for cohort in cohorts]
        yield Batch(*(np.concatenate([getattr(part, name) for part in parts]) for name in BATCH))


BATCH = tuple(each.name for each in fields(Batch))


def _streams(
    flights: Flights,
    augmentation: Augmentation,
    n: int,
    steps: int,
    most: int,
    rng: np.random.Generator,
) -> Iterator[Batch]:
    """Windows of `n` streams of one length, then of `n` others, without end."""
    while True:
        length = int(np.exp(rng.uniform(0, np.log(most + 1)))) * steps
        rows = rng.integers(len(flights), size=n)[:, None]
        first = rng.integers(flights.gyro.shape[1] - length + 1, size=n)
        index = first[:, None] + np.arange(length)
        gyro, accel, up = augment(
            flights.ang_vel[rows, index],
            flights.specific_force[rows, index],
            flights.up[rows, index],
            augmentation,
            flights.rate_hz,
            rng,
        )
        roll_pitch = roll_pitch_of_up(up)
        for k in range(0, length, steps):
            part = slice(k, k + steps)
            yield Batch(gyro[:, part], accel[:, part], roll_pitch[:, part], np.full(n, k == 0))
