"""Parts of recorded series: runs of samples at which something holds, and complete seconds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def stretches(chosen: ArrayLike) -> NDArray[np.int64]:
    """First sample and end of each run of true in (T,), shape (runs, 2)."""
    padded = np.concatenate([[False], np.asarray(chosen, bool), [False]])
    return np.flatnonzero(np.diff(padded.astype(np.int8))).reshape(-1, 2)


def longest_stretch(chosen: ArrayLike) -> Sequence[int]:
    """First sample and end of the longest run of true; (0, 0) if there is none."""
    return max(stretches(chosen).tolist(), key=lambda run: run[1] - run[0], default=(0, 0))


def blocks_of(values: Array, size: int) -> Array:
    """A series (T, ·) cut into whole blocks of `size` samples, (blocks, size, ·)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size, *values.shape[1:])
