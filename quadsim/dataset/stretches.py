"""Parts of recorded series: runs of samples that meet a condition, and blocks of equal length."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def stretches(chosen: ArrayLike) -> NDArray[np.int64]:
    """Return first sample and end of each run of true values in (T,), shape (runs, 2)."""
    padded = np.concatenate([[False], np.asarray(chosen, bool), [False]])
    return np.flatnonzero(np.diff(padded.astype(np.int8))).reshape(-1, 2)


def longest_stretch(chosen: ArrayLike) -> Sequence[int]:
    """Return first sample and end of the longest run of true values; (0, 0) if there is none."""
    return max(stretches(chosen).tolist(), key=lambda run: run[1] - run[0], default=(0, 0))


def blocks_of(values: Array, size: int) -> Array:
    """Cut a series (T, ·) into complete blocks of `size` samples, (blocks, size, ·)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size, *values.shape[1:])
