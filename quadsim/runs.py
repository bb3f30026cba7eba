"""Jobs that keep what they have made: every file is whole, and is used again for the same code alone."""

import ast
import csv
import errno
import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PACKAGES = ("quadsim", "estimators", "training", "scenarios", "paper")
ROOT = Path(__file__).parents[1]
LIBRARIES = ("mujoco", "numba", "numpy", "torch")
"""Their versions may change results in the last bits."""
PART = ".part"
CLUSTER_LOST = "the cluster was lost; what is finished is kept: give the same command again"


def replace(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Write a file, and the folders above it, so that the path holds what was there or the whole new file.

    Args:
        path: The file.
        write: Writes the path that it is given: a file beside it with the same suffix.

    Returns:
        The path.

    Raises:
        OSError: It cannot be written; nothing has changed.
    """
    path = Path(path)
    _make_folder(path.parent)
    part = path.with_name(f".{path.stem}.{os.getpid()}{PART}{path.suffix}")
    try:
        write(part)
        part.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        part.unlink(missing_ok=True)  # still there if writing failed
    return path


def drop_parts(path: str | Path) -> None:
    """Remove what processes that were killed left half written at a path, or anywhere in a folder."""
    path = Path(path)
    found = (
        path.rglob(f".*{PART}*") if path.is_dir() else path.parent.glob(f".{path.stem}.*{PART}{path.suffix}")
    )
    for part in found:
        writer = part.name.split(PART)[0].rsplit(".", 1)[-1]
        if writer.isdigit() and not _is_alive(int(writer)):
            part.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # somebody else's
        return True
    return True


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write text in UTF-8, or bytes, as `replace` does."""
    data = content.encode() if isinstance(content, str) else content
    return replace(path, lambda part: part.write_bytes(data))


def write_csv(path: str | Path, rows: Sequence[Mapping[str, object]]) -> Path:
    """Write rows under the union of their keys, as `replace` does; numbers in full."""
    columns = list(dict.fromkeys(key for row in rows for key in row))

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(rows)

    return replace(path, write)


def write_json(path: str | Path, content: Any) -> Path:
    """Write what JSON can hold, as `replace` does, beside a digest of it."""
    return write_whole(
        path, json.dumps({"digest": fingerprint(content), "content": content}, allow_nan=False)
    )


def read_json(path: Path) -> Any:
    """What `write_json` wrote.

    Raises:
        OSError: The file is not there, or cannot be read.
        ValueError: It is damaged, or not such a file.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["digest"] == fingerprint(found["content"]):
            return found["content"]
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise ValueError(f"{path}: damaged, or of another version of quadsim")


def save_figure(path: str | Path, figure: "Figure", **options: Any) -> Path:
    """Write a Matplotlib figure as `replace` does; the path's suffix chooses the format."""
    return replace(path, lambda part: figure.savefig(part, **options))


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold what grows at a path for this process; given up when the process ends, however it does.

    Raises:
        ValueError: Another process holds it.
    """
    _make_folder(path.parent)
    lock = FileLock(path.with_name(f".{path.name}.lock"), timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ValueError(
            f"{path} is being written by another process: wait for it, or choose another"
        ) from None
    try:
        yield
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that share nothing and end with this one; what has not begun when the block ends never does.

    Args:
        workers: How many. Each has one thread for linear algebra: they share the cores among themselves.
    """
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    # No threads or locks are inherited half way.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), end_with_parent)
    try:
        yield pool
    finally:
        # A future cancelled by hand, while its pool breaks at Ctrl-C, would be an error in the pool's thread.
        pool.shutdown(wait=True, cancel_futures=True)
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before


def give_up(executor: Executor, futures: Iterable[Future[Any]]) -> None:
    """Cancel what has not begun on an executor that goes on without us; a `worker_pool` does so by itself."""
    if not isinstance(executor, ProcessPoolExecutor):
        for future in futures:
            future.cancel()


def end_with_parent() -> None:
    """Let a worker die with its parent, and quietly at Ctrl-C; half a job leaves nothing behind."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def fingerprint(*content: Any) -> str:
    """Digest of anything that JSON can hold: two jobs with the same one make the same files."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def content_digest(content: bytes | str) -> str:
    """SHA-256 of a file's bytes or of a text."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder)) from error


@cache
def code_digest(*names: str) -> str:
    """Digest of the code that a job runs, and of the versions of the libraries that it computes with.

    Args:
        names: Modules, with which all that they import of the product counts; of a package, every module.
    """
    files = closure([file for name in names for file in _sources(name)], ROOT, PACKAGES)
    found = {file.relative_to(ROOT).as_posix(): file_digest(file) for file in files}
    return fingerprint(found, {name: version(name) for name in LIBRARIES})


def file_digest(path: Path) -> str:
    """Digest of a file: of Python the code alone, of anything else the bytes."""
    if path.suffix == ".py":
        return source_digest(path.read_text("utf-8"))
    return content_digest(path.read_bytes())


def source_digest(source: str) -> str:
    """Digest of Python source that comments, docstrings and formatting do not change."""
    return content_digest(_shape(ast.parse(source)))


def closure(scripts: Iterable[Path], root: Path, packages: Collection[str] | None = None) -> set[Path]:
    """The scripts and every module of the product that they import, at whatever depth and in any function.

    Args:
        scripts: Where to begin.
        root: The folder that packages are in.
        packages: Which of them are followed; all, if left out. Modules beside a script are followed too.
    """
    found: set[Path] = set()
    waiting = list(scripts)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(path, root, packages)
    return found


def _sources(name: str) -> list[Path]:
    place = ROOT.joinpath(*name.split("."))
    return sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]


def _imported(path: Path, root: Path, packages: Collection[str] | None) -> set[Path]:
    """Files of the product that a file's import statements load."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(root).with_suffix("").parts[: -node.level] if node.level else ()
            base = ".".join([*package, *([node.module] if node.module else [])])
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    ours = {name for name in names if packages is None or name.split(".")[0] in packages}
    return {file for name in ours for file in _files_of(name, root)} | {
        file for name in names for file in _files_of(name, path.parent)
    }


def _files_of(module: str, place: Path) -> list[Path]:
    """The file of a module below a folder, and the `__init__.py` of each package around it."""
    parts = module.split(".")
    packages = [place.joinpath(*parts[:k], "__init__.py") for k in range(1, len(parts) + 1)]
    return [path for path in (*packages, place.joinpath(*parts).with_suffix(".py")) if path.is_file()]


def _shape(node: object) -> str:
    """A syntax tree as text. Empty fields are left out: Python's versions differ in which there are."""
    if isinstance(node, list):
        return "[" + ",".join(_shape(each) for each in node if not _is_docstring(each)) + "]"
    if isinstance(node, ast.Constant):
        return repr(node.value)
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = ((name, value) for name, value in ast.iter_fields(node) if value not in (None, []))
    return f"{type(node).__name__}({','.join(f'{name}={_shape(value)}' for name, value in fields)})"


def _is_docstring(node: object) -> bool:
    """Whether a statement is a string alone, which does nothing."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
