"""Numba's compiler, with one writer of its cache at a time.

- Numba numbers the files of a function's compiled variants. Two processes that compile different variants at
  once take the same number, and a process that loads the file later runs code for other types.
- A generalized ufunc is two files, a function and its wrapper, that know each other by a name which differs
  from process to process. A pair of two processes is a call of address 0.
"""

import os
from collections.abc import Callable
from typing import Any

import numba
from filelock import FileLock
from numba import float64, njit
from numba.core import caching

__all__ = ["float64", "guvectorize", "njit"]


class OneWriter(caching.IndexDataCacheFile):
    """The files of a compiled function, which a process writes while no other does."""

    def save(self, key: Any, data: Any) -> None:
        """Write a variant, when no other process writes one of this function."""
        with FileLock(f"{self._index_path}.lock"):
            super().save(key, data)


caching.IndexDataCacheFile = OneWriter


def guvectorize(signatures: list[Any], layout: str) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Decorator: Numba's generalized ufunc, compiled or loaded while no other process does either."""

    def decorate(function: Callable[..., None]) -> Callable[..., Any]:
        with FileLock(os.path.join(os.environ["NUMBA_CACHE_DIR"], "gufuncs.lock")):
            return numba.guvectorize(signatures, layout, cache=True)(function)

    return decorate
