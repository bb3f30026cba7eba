"""Atomic writing: every file is written to a temporary name and then renamed."""

import csv
import errno
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from filelock import FileLock
    from matplotlib.figure import Figure
from .fingerprint import fingerprint


def replace(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Write a file atomically; create missing folders.

    Args:
        path: The file.
        write: Function that writes to the path it is given, a temporary file in the same folder with the same
            suffix.

    Returns:
        The path.

    Raises:
        OSError: The file cannot be written; an existing file is not changed.
    """
    path = Path(path)
    _make_folder(path.parent)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(part)
        part.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        part.unlink(missing_ok=True)  # still there if writing failed
    return path


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write text in UTF-8, or bytes, atomically."""
    data = content.encode() if isinstance(content, str) else content
    return replace(path, lambda part: part.write_bytes(data))


def write_csv(path: str | Path, rows: Sequence[Any]) -> Path:
    """Write dataclasses or mappings as CSV atomically, with the union of their keys as columns."""
    rows = [row if isinstance(row, Mapping) else asdict(row) for row in rows]
    columns = list(dict.fromkeys(key for row in rows for key in row))

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(rows)

    return replace(path, write)


def write_json(path: str | Path, content: Any) -> Path:
    """Write JSON data with a checksum atomically."""
    return write_whole(
        path, json.dumps({"digest": fingerprint(content), "content": content}, allow_nan=False)
    )


def read_json(path: Path) -> Any:
    """Read a file written by `write_json`.

    Raises:
        OSError: The file does not exist or cannot be read.
        ValueError: The file is damaged or has another format.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["digest"] == fingerprint(found["content"]):
            return found["content"]
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise ValueError(f"{path}: damaged, or of another version of quadsim")


def save_figure(path: str | Path, figure: "Figure", **options: Any) -> Path:
    """Write a Matplotlib figure atomically; the suffix of the path chooses the format."""
    return replace(path, lambda part: figure.savefig(part, **options))


@contextmanager
def alone(path: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Lock an output file or folder for this process, which may lock the same path more than once.

    The lock is a file in the same folder or, if that folder is not writable, inside the output folder. The
    lock is released when the process ends for any reason.

    Args:
        path: The file or folder, which need not exist.
        wait_s: Time to wait for another process [s].

    Raises:
        ValueError: Another process holds the lock.
    """
    whole = path.expanduser().resolve()
    _make_folder(whole.parent)
    lock = _acquired(path, whole, wait_s)
    try:
        yield
    finally:
        if lock.lock_counter == 1:
            Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def _acquired(path: Path, whole: Path, wait_s: float) -> "FileLock":
    from filelock import FileLock, Timeout

    beside, inside = (
        FileLock(folder / f".{whole.name}.lock", is_singleton=True) for folder in (whole.parent, whole)
    )
    for lock in (beside, inside):
        try:
            lock.acquire(timeout=wait_s)
            return lock
        except Timeout:
            if not Path(lock.lock_file).exists():
                raise OSError(errno.EACCES, "no file can be made there", str(path)) from None
            break
        except OSError:
            if lock is inside or not whole.is_dir():
                raise
    raise ValueError(f"{path} is being written by another process: wait for it, or choose another")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder)) from error
