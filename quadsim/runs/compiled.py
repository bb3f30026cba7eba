"""Numba's `njit`, with a cache on disk that is never older than the source.

Numba compiles a cached function again if its own file has changed, but not if a called function or a constant
in another file has changed. This module stores a digest of all these files with the compiled code. In
addition, if several processes start together, only one compiles a function, and the others load the result.
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
"""Longest time that a process waits for the compilation by another process before compiling itself [s]."""
IMPORT = re.compile(rb"^from (\.*)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
BESIDE = Path(__file__).parent / "__pycache__"
"""Folder of compiled code inside an installation, which can be copied with it."""
CONSTANT = re.compile(rb"\b[A-Z][A-Z0-9_]+\b")


def njit(*function: Callable[..., Any], cache: bool = False, **options: Any) -> Any:
    """Decorate a function to be compiled on its first call.

    Args:
        function: The function, if the decorator is used without options.
        cache: Whether to store the compiled code on disk. Functions that only compiled code calls need no
            cache.
        options: Options of Numba's `njit`.
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
    """Locates the cached code of a function and the digest of its source."""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "CacheFolder":
        """Return the location for a function in this file."""
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
        """Return the digest of the source of a function and of everything that is compiled with it."""
        path = Path(self._py_file)
        return source_digest(path, path.stat().st_mtime_ns).encode()


class Stored(caching.CompileResultCacheImpl):
    """Cache of a function in Numba's file format."""

    _locator_classes = (CacheFolder,)


class StoredCode(caching.FunctionCache):
    """Compiled variants of a function; a process that compiles a variant holds the lock."""

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
        """Return the lock of this process; a lock made before a fork belongs to the parent."""
        path = f"{self._cache_file._index_path}.lock"
        return self._locks.setdefault(os.getpid(), FileLock(path, timeout=LONGEST_S))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a variant; return None and hold the lock if it has to be compiled."""
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
        """Run Numba's `Dispatcher.compile`, which loads or compiles a variant, and release the lock."""

        def compiled(sig: Any) -> Any:
            try:
                return compile_variant(sig)
            finally:
                if self._locks:
                    self.lock.release(force=True)

        return compiled


@cache
def store() -> Path:
    """Return the folder for compiled code: the user's setting, the installation, or the user's cache."""
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
    """Return whether files can be created in a folder; create the folder if necessary."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@cache
def source_digest(path: Path, changed_ns: int) -> str:
    """Return the digest of a file and of all files from which it imports compiled functions or constants.

    Args:
        path: A file of Python source.
        changed_ns: Time of the last change, so that a change is not answered from memory.
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
    """Return the files of quadsim from which a file imports compiled functions or constants."""
    for dots, module, names in IMPORT.findall(source):
        parts = module.decode().split(".")
        if dots or parts[0] in PACKAGES:
            place = (path.parents[len(dots) - 1] if dots else ROOT).joinpath(*parts)
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            if file.is_file() and (CONSTANT.search(names) or b"@njit" in file.read_bytes()):
                yield file
