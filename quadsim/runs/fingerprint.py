"""Fingerprints: digests of code, configuration and inputs, by which results are reused."""

import ast
import hashlib
import importlib.util
import json
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

PACKAGES = ("quadsim", "estimators", "training", "scenarios", "paper")
ROOT = Path(__file__).parents[2]
ASSETS = ROOT / "assets"
"""Folder of the presets and weights that ship; never one of that name in the working directory."""
LIBRARIES = ("mujoco", "numba", "numpy")
"""Their versions may change results in the last bits; PyTorch's where its optimisers train."""


def fingerprint(*content: Any) -> str:
    """Digest of anything that JSON can hold: two jobs with the same one make the same files."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def content_digest(content: bytes | str) -> str:
    """SHA-256 of a file's bytes or of a text."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


@cache
def code_digest(*names: str) -> str:
    """Digest of the code that a job runs, and of the versions of the libraries that it computes with.

    Args:
        names: Modules, with which all that they import of the product counts; of a package, every module.
    """
    files = closure([file for name in names for file in _sources(name)], ROOT, follow=is_of_product)
    found = {file.relative_to(ROOT).as_posix(): file_digest(file) for file in files}
    libraries = (*LIBRARIES, "torch") if any(name.startswith("training") for name in names) else LIBRARIES
    return fingerprint(found, {name: version(name) for name in libraries})


def file_digest(path: Path) -> str:
    """Digest of a file: of Python the code alone, without comments and docstrings; else the bytes."""
    if path.suffix == ".py":
        return read_source(path.read_text("utf-8")).digest
    return content_digest(path.read_bytes())


class Source(NamedTuple):
    """What fingerprints need of Python source."""

    digest: str
    imports: frozenset[tuple[int, tuple[str, ...]]]
    """For each name in an import statement how many packages up it starts, and its parts from there."""


@cache
def read_source(source: str) -> Source:
    """Parse source, once for all fingerprints that it counts in."""
    tree = ast.parse(source)
    return Source(content_digest(_shape(tree)), frozenset(_imports(tree)))


def is_of_product(path: Path) -> bool:
    """Whether a file is of one of the product's packages."""
    return any(path.is_relative_to(ROOT / package) for package in PACKAGES)


def closure(
    scripts: Iterable[Path], *roots: Path, follow: Callable[[Path], bool] = lambda path: True
) -> set[Path]:
    """The scripts and every file that their import statements load, at whatever depth and in any function.

    Modules are looked for beside the file that imports them, where its own package is, and in the roots. A
    name in more than one of these places counts with all its files.

    Args:
        scripts: Where to begin, whole paths.
        roots: Other folders that modules and packages are in.
        follow: Which of the imported files count.
    """
    found: set[Path] = set()
    waiting = list(scripts)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += filter(follow, _imported(path, roots))
    return found


def package_root(path: Path) -> Path:
    """The folder that the outermost package around a file is in; without a package the file's own folder."""
    return next(folder for folder in path.parents if not (folder / "__init__.py").is_file())


def _sources(name: str) -> list[Path]:
    place = ROOT.joinpath(*name.split("."))
    return sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]


def _imports(tree: ast.Module) -> Iterator[tuple[int, tuple[str, ...]]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((0, (alias.name,)) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = (node.module,) if node.module else ()
            yield node.level, module
            yield from ((node.level, (*module, alias.name)) for alias in node.names)


def _imported(path: Path, roots: Iterable[Path]) -> set[Path]:
    """Files that a file's import statements load; none of what is not Python, which fails when it is run."""
    try:
        imports = read_source(importlib.util.decode_source(path.read_bytes())).imports
    except (OSError, ValueError, SyntaxError, RecursionError):
        return set()
    root = package_root(path)
    files: set[Path] = set()
    for level, parts in imports:
        module = [part for name in parts for part in name.split(".")]
        if level == 0:
            files.update(*(_files_of(module, place) for place in {path.parent, root, *roots}))
        elif level <= len(path.parents):
            folder = path.parents[level - 1]
            inside = folder.relative_to(root).parts if folder.is_relative_to(root) else ()
            files.update(_files_of([*inside, *module], root if inside else folder))
    return files


def _files_of(module: list[str], place: Path) -> list[Path]:
    """The file of a module below a folder, and the `__init__.py` of each package around it."""
    packages = [place.joinpath(*module[:k], "__init__.py") for k in range(1, len(module) + 1)]
    files = [*packages, place.joinpath(*module).with_suffix(".py")] if module else []
    return [path for path in files if path.is_file()]


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
    return isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str)
