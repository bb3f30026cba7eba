"""Numba's compiler, with one process at a time for each function and its cache.

- Processes that start together would all compile the same functions: one does, and the others load it.
- Numba numbers the files of a function's compiled variants. Two processes that compile different variants at
  once take the same number, and a process that loads the file later runs code for other types.
- A generalized ufunc is two files, a function and its wrapper, that know each other by a name which differs
  from process to process. A pair of two processes is a call of address 0.
"""

import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba import float64, njit
from numba.core import caching, dispatcher

__all__ = ["float64", "guvectorize", "njit"]

LONGEST_S = 120.0
"""Time after which a process that waits for another's compilation compiles for itself [s]."""


class OneCompiler(caching.FunctionCache):
    """The compiled variants of a function: what is missing is compiled while no other process does."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._lock = FileLock(f"{self._cache_file._index_path}.lock", timeout=LONGEST_S)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a variant; None if it has to be compiled, and `save_overload` follows."""
        found = super().load_overload(sig, target_context)
        if found is None:
            with suppress(Timeout, OSError):
                self._lock.acquire()
            found = super().load_overload(sig, target_context)
            if found is not None:
                self._lock.release(force=True)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write a variant, and let other processes go on."""
        try:
            super().save_overload(sig, data)
        finally:
            self._lock.release(force=True)


dispatcher.FunctionCache = OneCompiler  # pyright: ignore[reportAttributeAccessIssue]


def guvectorize(signatures: list[Any], layout: str) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Decorator: Numba's generalized ufunc, compiled or loaded while no other process does either."""

    def decorate(function: Callable[..., None]) -> Callable[..., Any]:
        with FileLock(os.path.join(os.environ["NUMBA_CACHE_DIR"], "gufuncs.lock")):
            return numba.guvectorize(signatures, layout, cache=True)(function)

    return decorate
