"""Loading of user code by name: "package.module:Name", "path/file.py:Name", or an entry point."""

import importlib
import importlib.util
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from .config.toml import nearest
from .runs.fingerprint import closure, content_digest, is_of_product, package_root

OWN = "quadsim_own_"
"""Prefix of the names of modules that were loaded from files."""
INSTALLED = {"site-packages", "dist-packages"}
STANDARD = Path(sysconfig.get_path("stdlib"))
_imported: dict[str, str] = {}
"""For each module of a user, the digest of its files at the time of import."""
_neighbours: set[Path] = set()
"""Files imported by modules that were loaded from a file."""


def is_own(name: str, group: str = "") -> bool:
    """Return whether a name refers to user code: it has a colon or is an entry point of the group."""
    return ":" in name or name in entry_points_of(group)


def load_own(name: str, group: str = "") -> Any:
    """Load the object with a name.

    Args:
        name: "package.module:Name"; "path/file.py:Name", relative to the working directory; or an entry
            point.
        group: Group of the entry points.

    Raises:
        ValueError: The file, module or object does not exist, or the code fails.
    """
    if name in entry_points_of(group):
        name = entry_points_of(group)[name].value
    module, _, attribute = name.rpartition(":")
    if not module or not attribute:
        raise ValueError(f"{name}: should be package.module:Name or path/file.py:Name")
    try:
        found = _from_file(Path(module)) if module.endswith(".py") else _from_path(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except FileNotFoundError as error:
        raise ValueError(f"{name}: there is no file {error.filename or module}") from error
    except AttributeError as error:
        if isinstance(error.obj, type(sys)) and error.name == attribute:
            public = [each for each in vars(error.obj) if not each.startswith("_")]
            raise ValueError(f"{name}: {module} has no {attribute}; {nearest(attribute, public)}") from error
        raise ValueError(f"{name}: {type(error).__name__}: {error}") from error
    except (Exception, SystemExit) as error:  # whatever a user's module does
        raise ValueError(f"{name}: {type(error).__name__}: {error}") from error
    return found


def _file_of(name: str, group: str) -> Path | None:
    """Return the file that defines a user's object, without running the file; None if there is no file."""
    if name in entry_points_of(group):
        name = entry_points_of(group)[name].value
    module = name.rpartition(":")[0]
    if module.endswith(".py"):
        return Path(module) if Path(module).is_file() else None
    try:
        spec = importlib.util.find_spec(module) if module else None
    except (ImportError, ValueError, AttributeError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin not in (None, "built-in", "frozen") else None


def own_files(name: str, group: str = "") -> list[Path]:
    """Return the file that defines a user's object, and the files that it imports, sorted; no file is run.

    Imports are followed to modules in the folder of the file, in its package, and in folders on Python's
    path. Installed packages, the standard library and quadsim itself are excluded.
    """
    file = _file_of(name, group)
    return _with_imports(file.absolute()) if file else []


@cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of installed packages in a group."""
    return {each.name: each for each in entry_points(group=group)} if group else {}


def _from_file(path: Path) -> Any:
    """Load a file as a module, which may import its neighbours.

    The module is loaded again only if a file has changed.
    """
    path = path.absolute()
    path.stat()  # raises where there is none
    files = _with_imports(path)
    name = f"{OWN}{content_digest(str(path) + _digest(files))[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    _neighbours.update(files)
    _forget(_neighbours)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot be imported: {path}")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        with _importable(path.parent):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _from_path(module: str) -> Any:
    """Import a module from Python's path, again if its file or a file that it imports has changed."""
    files = own_files(f"{module}:")
    digest = _digest(files)
    if _imported.setdefault(module, digest) != digest:
        _forget(files)
        _imported[module] = digest
    return importlib.import_module(module)


def _with_imports(file: Path) -> list[Path]:
    """Return a file, the packages around it, and the user's files that they import, sorted."""
    inside = file.relative_to(package_root(file)).parts
    package = package_root(file) / inside[0]
    around = [file.parents[up] / "__init__.py" for up in range(len(inside) - 1)]

    def is_users(path: Path) -> bool:
        installed = INSTALLED & set(path.parts) or path.is_relative_to(STANDARD)
        return path.is_relative_to(package) or not (installed or is_of_product(path))

    roots = filter(is_users, (Path(folder).absolute() for folder in sys.path))
    return sorted(closure([file, *around], *roots, follow=is_users))


def _digest(files: Iterable[Path]) -> str:
    return content_digest("".join(content_digest(file.read_bytes()) for file in files))


def _forget(files: Iterable[Path]) -> None:
    """Remove the modules of these files from the import cache."""
    paths = set(map(str, files))
    for name, module in list(sys.modules.items()):
        if not name.startswith(OWN) and getattr(module, "__file__", None) in paths:
            del sys.modules[name]
    importlib.invalidate_caches()


@contextmanager
def named_errors(what: str, passing: type[Exception] | tuple[()] = ValueError) -> Iterator[None]:
    """Convert any exception of user code, including `SystemExit`, to a ValueError that names what failed.

    Args:
        what: Name of the failing part, for the message.
        passing: Exceptions that are not converted; Ctrl-C never is.
    """
    try:
        yield
    except passing:
        raise
    except (Exception, SystemExit) as error:
        raise ValueError(f"{what} ends with {type(error).__name__}: {error}") from error


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Allow imports from a folder, after all other folders, and always from source.

    Python would use a stale compiled file if a source file changed within a second and kept its size.
    """
    write_none, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = write_none
