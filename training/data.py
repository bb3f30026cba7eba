"""Flights in memory, their split, and batches of windows that follow one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadsim.dataset import open_dataset
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


@dataclass(frozen=True)
class Batch:
    """One window of every stream: measurements (n, T, 3) and roll, pitch (n, T, 2), float32."""

    gyro: Float32
    accel: Float32
    roll_pitch: Float32
    carry: bool
    """The window goes on where the last one ended (the network keeps its state)."""


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

    Args:
        flights: To draw from.
        augmentation: What the sensors add; drawn once per stream (noise per sample).
        batches: Windows in the epoch.
        batch_size: Streams side by side.
        steps: Samples in a window.
        windows_per_stream: Windows before new streams are drawn.
        seed: Of this epoch.
    """
    length = steps * windows_per_stream
    available = flights.gyro.shape[1]
    if length > available:
        raise ValueError(f"streams of {length} samples, but the flights have {available}")
    rng = np.random.default_rng(np.random.SeedSequence(list(seed)))
    for first in range(0, batches, windows_per_stream):
        which = rng.integers(len(flights), size=batch_size)
        start = rng.integers(available - length + 1, size=batch_size)
        index = start[:, None] + np.arange(length)
        rows = which[:, None]
        gyro, accel, up = augment(
            flights.ang_vel[rows, index],
            flights.specific_force[rows, index],
            flights.up[rows, index],
            augmentation,
            flights.rate_hz,
            rng,
        )
        roll_pitch = roll_pitch_of_up(up)
        for k in range(min(windows_per_stream, batches - first)):
            part = slice(k * steps, (k + 1) * steps)
            yield Batch(gyro[:, part], accel[:, part], roll_pitch[:, part], carry=k > 0)
