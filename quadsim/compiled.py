"""Numba's compiler, with one writer of its cache at a time.

Numba numbers the files of a function's compiled variants. Two processes that compile different variants at
once take the same number, and a process that loads the file later runs code for other types, and crashes.
"""

from typing import Any

from filelock import FileLock
from numba import float64, guvectorize, njit
from numba.core import caching

__all__ = ["float64", "guvectorize", "njit"]


class OneWriter(caching.IndexDataCacheFile):
    """The files of a compiled function, which a process writes while no other does."""

    def save(self, key: Any, data: Any) -> None:
        """Write a variant, when no other process writes one of this function."""
        with FileLock(f"{self._index_path}.lock"):
            super().save(key, data)


caching.IndexDataCacheFile = OneWriter
