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


class LockedCache(caching.FunctionCache):
    """The compiled variants of a function; a process that misses one holds the lock of the function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._lock: tuple[int, FileLock] | None = None

    @property
    def lock(self) -> FileLock:
        """The lock of this process: one that was made before a fork is the parent's."""
        if self._lock is None or self._lock[0] != os.getpid():
            lock = FileLock(f"{self._cache_file._index_path}.lock", timeout=LONGEST_S)
            self._lock = os.getpid(), lock
        return self._lock[1]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a variant; None if it has to be compiled, with the lock held."""
        found = super().load_overload(sig, target_context)
        if found is None:
            with suppress(Timeout, OSError):
                self.lock.acquire()
            found = super().load_overload(sig, target_context)
        return found


def compile_locked(self: dispatcher.Dispatcher, sig: Any) -> Any:
    """Numba's `Dispatcher.compile`, which loads or compiles a variant; the lock is free at its end."""
    try:
        return COMPILE(self, sig)
    finally:
        cache = self._cache  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(cache, LockedCache):
            cache.lock.release(force=True)


COMPILE = dispatcher.Dispatcher.compile
dispatcher.Dispatcher.compile = compile_locked  # pyright: ignore[reportAttributeAccessIssue]
dispatcher.FunctionCache = LockedCache  # pyright: ignore[reportAttributeAccessIssue]


def guvectorize(signatures: list[Any], layout: str) -> Callable[[Callable[..., None]], Callable[..., Any]]:
    """Decorator: Numba's generalized ufunc, compiled or loaded while no other process does either."""

    def decorate(function: Callable[..., None]) -> Callable[..., Any]:
        lock = FileLock(os.path.join(os.environ["NUMBA_CACHE_DIR"], "gufuncs.lock"), timeout=LONGEST_S)
        with suppress(Timeout, OSError):
            lock.acquire()
        try:
            return numba.guvectorize(signatures, layout, cache=True)(function)
        finally:
            lock.release(force=True)

    return decorate
