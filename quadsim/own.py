"""Objects of a user's own code, by name: "package.module:Name", "path/file.py:Name", or an entry point."""

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
"""Beginning of the name of a module that was loaded from a file."""
INSTALLED = {"site-packages", "dist-packages"}
STANDARD = Path(sysconfig.get_path("stdlib"))
_imported: dict[str, str] = {}
"""Modules of users by name: digest of all their files when they were imported."""
_neighbours: set[Path] = set()
"""Files that modules loaded from a file imported."""


def is_own(name: str, group: str = "") -> bool:
    """Whether a name is of a user's own code: it has a colon, or it is an entry point of the group."""
    return ":" in name or name in entry_points_of(group)


def load_own(name: str, group: str = "") -> Any:
    """The object of that name.

    Args:
        name: "package.module:Name"; "path/file.py:Name", from the working directory; or an entry point.
        group: Of entry points.

    Raises:
        ValueError: There is no such file, module or object, or the code fails.
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
    """The file that an object of a user's comes from, without running it; None where there is none."""
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
    """The file that an object of a user's comes from and those that it imports, without running them, sorted.

    Imports are followed to modules beside the file, in its package and in folders on Python's path, but not
    to what is installed, Python's own, or the product's.
    """
    file = _file_of(name, group)
    return _with_imports(file.absolute()) if file else []


@cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """Entry points that installed packages offer in a group."""
    return {each.name: each for each in entry_points(group=group)} if group else {}


def _from_file(path: Path) -> Any:
    """The module of a file, which may import its neighbours; loaded once for each content of them all."""
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
    """A module on Python's path; imported again where it, or a file that it imports, has changed since."""
    files = own_files(f"{module}:")
    digest = _digest(files)
    if _imported.setdefault(module, digest) != digest:
        _forget(files)
        _imported[module] = digest
    return importlib.import_module(module)


def _with_imports(file: Path) -> list[Path]:
    """A file, the packages around it, and what they import of the user's; sorted."""
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
    """Let modules of these files be imported again; what has them keeps them."""
    paths = set(map(str, files))
    for name, module in list(sys.modules.items()):
        if not name.startswith(OWN) and getattr(module, "__file__", None) in paths:
            del sys.modules[name]
    importlib.invalidate_caches()


@contextmanager
def named_errors(what: str, passing: type[Exception] | tuple[()] = ValueError) -> Iterator[None]:
    """Turn whatever a user's code raises into a ValueError that says what failed, `SystemExit` too.

    Args:
        what: What ends with the error.
        passing: What stays as it is; Ctrl-C always does.
    """
    try:
        yield
    except passing:
        raise
    except (Exception, SystemExit) as error:
        raise ValueError(f"{what} ends with {type(error).__name__}: {error}") from error


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Let modules of a folder be imported, after all others, and from their source.

    Python takes a compiled file for that of a source of the same size and second.
    """
    write_none, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = write_none
