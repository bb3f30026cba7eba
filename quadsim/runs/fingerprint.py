"""Fingerprints: digests of code, configuration and inputs, which decide whether results can be reused."""

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
"""Folder of shipped presets and weights; never a folder of the working directory."""
LIBRARIES = ("mujoco", "numba", "numpy")
"""Libraries whose versions may change the last bits of results; for trainings, PyTorch as well."""


def fingerprint(*content: Any) -> str:
    """Return the digest of JSON data. Two jobs with the same fingerprint write the same files."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def content_digest(content: bytes | str) -> str:
    """Return the SHA-256 of bytes or text."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


@cache
def code_digest(*names: str) -> str:
    """Return the digest of the code of a job and of the versions of numerical libraries.

    Args:
        names: Modules and packages. All modules of quadsim that they import are included.
    """
    files = closure([file for name in names for file in _sources(name)], ROOT, follow=is_of_product)
    found = {file.relative_to(ROOT).as_posix(): file_digest(file) for file in files}
    libraries = (*LIBRARIES, "torch") if any(name.startswith("training") for name in names) else LIBRARIES
    return fingerprint(found, {name: version(name) for name in libraries})


def file_digest(path: Path) -> str:
    """Return the digest of a file. For Python files, comments and docstrings are ignored."""
    if path.suffix == ".py":
        return read_source(path.read_text("utf-8")).digest
    return content_digest(path.read_bytes())


class Source(NamedTuple):
    """Digest and imports of a Python source file."""

    digest: str
    imports: frozenset[tuple[int, tuple[str, ...]]]
    """For each imported name, the level of a relative import (0 if absolute) and the parts of the name."""


@cache
def read_source(source: str) -> Source:
    """Parse source code; the result is cached."""
    tree = ast.parse(source)
    return Source(content_digest(_shape(tree)), frozenset(_imports(tree)))


def is_of_product(path: Path) -> bool:
    """Return whether a file belongs to one of quadsim's packages."""
    return any(path.is_relative_to(ROOT / package) for package in PACKAGES)


def closure(
    scripts: Iterable[Path], *roots: Path, follow: Callable[[Path], bool] = lambda path: True
) -> set[Path]:
    """Return scripts and all files that they import, directly, indirectly or inside functions.

    Modules are searched in the folder of the importing file, in the folder of its package, and in the roots.
    If a name exists in several of these folders, all its files are included.

    Args:
        scripts: Absolute paths of the first files.
        roots: Further folders with modules and packages.
        follow: Predicate that selects the imported files to include.
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
    """Return the folder that contains the outermost package of a file, or the file itself."""
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
    """Return the files that a file imports; none if the file is not valid Python."""
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
    """Return the file of a module below a folder, and the `__init__.py` of each package around it."""
    packages = [place.joinpath(*module[:k], "__init__.py") for k in range(1, len(module) + 1)]
    files = [*packages, place.joinpath(*module).with_suffix(".py")] if module else []
    return [path for path in files if path.is_file()]


def _shape(node: object) -> str:
    """Return a syntax tree as text, without empty fields, which differ between versions of Python."""
    if isinstance(node, list):
        return "[" + ",".join(_shape(each) for each in node if not _is_docstring(each)) + "]"
    if isinstance(node, ast.Constant):
        return repr(node.value)
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = ((name, value) for name, value in ast.iter_fields(node) if value not in (None, []))
    return f"{type(node).__name__}({','.join(f'{name}={_shape(value)}' for name, value in fields)})"


def _is_docstring(node: object) -> bool:
    """Return whether a statement is a string literal."""
    return isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str)
