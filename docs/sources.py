"""Digests of what a page is made from: a script with all the code that it imports, and files."""

import ast
import hashlib
from collections.abc import Iterable
from pathlib import Path

LENGTH = 12
"""Hexadecimal digits of a digest."""


def digest_of(content: bytes | str) -> str:
    """The first digits of SHA-256."""
    data = content.encode() if isinstance(content, str) else content
    return hashlib.sha256(data).hexdigest()[:LENGTH]


def file_digest(path: Path) -> str:
    """Digest of a file: of Python the code alone, of anything else the bytes."""
    return code_digest(path.read_text()) if path.suffix == ".py" else digest_of(path.read_bytes())


def code_digest(source: str) -> str:
    """Digest of Python source that comments, docstrings and formatting do not change."""
    return digest_of(_shape(ast.parse(source)))


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


def closure(scripts: Iterable[Path], root: Path) -> set[Path]:
    """The scripts and every module of the project that they import, at whatever depth and in any function.

    Args:
        scripts: Where to begin.
        root: The repository; what is not in it is not followed.
    """
    found: set[Path] = set()
    waiting = list(scripts)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += imported(path, root)
    return found


def imported(path: Path, root: Path) -> set[Path]:
    """Files of the project that a file's import statements load."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(root).with_suffix("").parts[: -node.level] if node.level else ()
            base = ".".join([*package, *([node.module] if node.module else [])])
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return {file for name in names for place in {root, path.parent} for file in _files_of(name, place)}


def _files_of(module: str, place: Path) -> list[Path]:
    """The file of a module below a folder, and the `__init__.py` of each package around it."""
    parts = module.split(".")
    packages = [place.joinpath(*parts[:k], "__init__.py") for k in range(1, len(parts) + 1)]
    return [path for path in (*packages, place.joinpath(*parts).with_suffix(".py")) if path.is_file()]
