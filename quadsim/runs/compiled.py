"""Numba's `njit`, whose compiled code is kept in files and never older than its source.

Numba compiles a stored function again when its own file has changed, but not when that of a function that it
calls, or of a constant, has. Here a digest of all of them is stored with the code. And processes that start
together would all compile the same functions: here one does, and the others load the result.
"""

import atexit
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba.core import caching
from platformdirs import user_cache_dir

from .fingerprint import PACKAGES, ROOT, content_digest

log = logging.getLogger(__name__)

LONGEST_S = 120.0
"""Time after which a process that waits for another's compilation compiles for itself [s]."""
IMPORT = re.compile(rb"^from (\.*)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
BESIDE = Path(__file__).parent / "__pycache__"
"""Compiled code of one installation, which can be copied with it."""
CONSTANT = re.compile(rb"\b[A-Z][A-Z0-9_]+\b")


def njit(*function: Callable[..., Any], cache: bool = False, **options: Any) -> Any:
    """Decorator: compile a function when it is first called; with `cache`, keep the code.

    Args:
        function: The function, where the decorator has no options.
        cache: Whether to store the code; functions that are only called by others need not be stored.
        options: Numba's.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        options.setdefault("no_cfunc_wrapper", True)
        dispatcher = numba.njit(**options)(function)
        if cache and dispatcher is not function:  # which it is with NUMBA_DISABLE_JIT
            stored = StoredCode(function)
            dispatcher._cache = stored  # pyright: ignore[reportAttributeAccessIssue]
            dispatcher.compile = stored.unlocking(dispatcher.compile)
        return dispatcher

    return decorate(*function) if function else decorate


class CacheFolder(caching.UserProvidedCacheLocator):
    """Where the code of a function is stored, and what source it is of."""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "CacheFolder":
        """The place of a function of this file."""
        return cls(py_func, py_file)

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file, self._lineno = py_file, py_func.__code__.co_firstlineno
        folder, inside = store(), Path(py_file).parent
        if folder == BESIDE and inside.is_relative_to(ROOT):
            self._cache_path = str(folder / "-".join(inside.relative_to(ROOT).parts))
        else:
            self._cache_path = str(folder / self.get_suitable_cache_subpath(py_file))
        self.ensure_cache_path()

    def get_source_stamp(self) -> bytes:
        """Digest of the source of a function and of all that it is compiled with."""
        path = Path(self._py_file)
        return source_digest(path, path.stat().st_mtime_ns).encode()


class Stored(caching.CompileResultCacheImpl):
    """Numba's format of the files."""

    _locator_classes = (CacheFolder,)


class StoredCode(caching.FunctionCache):
    """Variants of a compiled function; a process that misses one holds the lock until it has compiled it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_func, self._name = function, repr(function)
        self._locks: dict[int, FileLock] = {}
        self.enable()

    @cached_property
    def _impl(self) -> Stored:
        return Stored(self._py_func)

    @cached_property
    def _cache_path(self) -> str:
        return self._impl.locator.get_cache_path()

    @cached_property
    def _cache_file(self) -> caching.IndexDataCacheFile:
        stamp = self._impl.locator.get_source_stamp()
        file = caching.IndexDataCacheFile(self._cache_path, self._impl.filename_base, stamp)
        file._version += (
            stamp.decode()
        )  # of other source nothing is unpickled: it may name classes that are gone
        return file

    @property
    def lock(self) -> FileLock:
        """The lock of this process: one that was made before a fork is the parent's."""
        path = f"{self._cache_file._index_path}.lock"
        return self._locks.setdefault(os.getpid(), FileLock(path, timeout=LONGEST_S))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a variant; None if it has to be compiled, with the lock held."""
        found = self._load(sig, target_context)
        if found is None:
            with suppress(Timeout, OSError):
                self.lock.acquire()
            found = self._load(sig, target_context)
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (EOFError, UnpicklingError):  # a file that was cut short, by a full disk or a loss of power
            self.flush()
            return None

    def unlocking(self, compile_variant: Callable[..., Any]) -> Callable[..., Any]:
        """Numba's `Dispatcher.compile`, which loads or compiles a variant; the lock is free at its end."""

        def compiled(sig: Any) -> Any:
            try:
                return compile_variant(sig)
            finally:
                if self._locks:
                    self.lock.release(force=True)

        return compiled


@cache
def store() -> Path:
    """The folder for compiled code: where the user says, beside ours, or in the user's cache."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    for place in [Path(given)] if given else [BESIDE, Path(user_cache_dir("numba", appauthor=False))]:
        if is_writable(place):
            return place
    place = Path(tempfile.mkdtemp(prefix="numba-"))
    log.warning(
        "no compiled code can be stored in %s: every run compiles it; set NUMBA_CACHE_DIR to a "
        "folder that can be written",
        given or f"{BESIDE} or {user_cache_dir('numba', appauthor=False)}",
    )
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(place)  # for the processes that this one starts
    return place


def is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@cache
def source_digest(path: Path, changed_ns: int) -> str:
    """Digest of a file, of the files of compiled functions and of constants that it imports, and of theirs.

    Args:
        path: A file of Python source.
        changed_ns: When it was changed; another time, another call.
    """
    found: dict[Path, bytes] = {}
    waiting = [path]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path] = path.read_bytes()
            waiting += compiled_with(found[path], path)
    return content_digest(b"".join(found[each] for each in sorted(found)))


def compiled_with(source: bytes, path: Path) -> Iterator[Path]:
    """The files of the product that a file imports compiled functions or constants from."""
    for dots, module, names in IMPORT.findall(source):
        parts = module.decode().split(".")
        if dots or parts[0] in PACKAGES:
            place = (path.parents[len(dots) - 1] if dots else ROOT).joinpath(*parts)
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            if file.is_file() and (CONSTANT.search(names) or b"@njit" in file.read_bytes()):
                yield file
