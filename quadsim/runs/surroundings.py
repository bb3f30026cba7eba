"""What would stop an import, hide a package, or let compiled code be older than its source.

Numba keeps compiled functions in files, and compiles one again when its own source file has changed, but not
when that of a function that it calls, or of a constant, has. So the cache is in a folder whose name is a
digest of every file with compiled functions and of every file that these import constants from: another
digest, another folder.
"""

import atexit
import logging
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

from platformdirs import user_cache_dir

from .fingerprint import PACKAGES, ROOT, content_digest

log = logging.getLogger(__name__)

OPENGL = ("egl", "glfw", "osmesa", "glx", "wgl", "cgl")
"""What MUJOCO_GL may say: how pictures are made."""
SWITCHES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0")
FOLDER = "quadsim-"
"""Beginning of the name of a folder for compiled code."""
IMPORT = re.compile(rb"^from (\.*)([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
CONSTANT = re.compile(rb"\b[A-Z][A-Z0-9_]+\b")
CACHES = 3
"""Folders for compiled code that stay, the newest."""


def settle() -> None:
    """Leave only what MuJoCo and Numba can be imported with, and warn of what was changed."""
    asked = os.environ.get("MUJOCO_GL", "")
    if asked.strip().lower() not in (*OPENGL, *SWITCHES):
        log.warning("MUJOCO_GL=%s is ignored: %s are allowed", asked, ", ".join(OPENGL))
        del os.environ["MUJOCO_GL"]
    _choose_cache(FOLDER + compiled_digest(ROOT))
    if Neighbours not in sys.meta_path:
        sys.meta_path.insert(0, Neighbours)


class Neighbours:
    """Finds the packages beside this one before folders of their names in the working directory."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As `importlib.abc.MetaPathFinder.find_spec`; None for every other name."""
        return PathFinder.find_spec(name, [str(ROOT)], target) if name in (*PACKAGES, "assets") else None


def compiled_digest(root: Path) -> str:
    """Digest of every file of the product that has compiled functions, or constants that such a file imports.

    Args:
        root: The folder that the packages are in.
    """
    files = sorted(path for name in PACKAGES for path in (root / name).rglob("*.py"))
    contents = {path.relative_to(root).as_posix().encode(): path.read_bytes() for path in files}
    compiled = {name for name, each in contents.items() if b"njit" in each}
    compiled |= {source for name in compiled for source in constants_of(name, contents[name])}
    return content_digest(b"".join(name + contents.get(name, b"") for name in sorted(compiled)))[:16]


def constants_of(name: bytes, content: bytes) -> Iterator[bytes]:
    """The files, by their path from the root, that a file with relative imports takes constants from."""
    folder = name.split(b"/")[:-1]
    for dots, module, imported in IMPORT.findall(content):
        if CONSTANT.search(imported):
            above = folder[: len(folder) - len(dots) + 1]
            yield b"/".join([*above, *module.split(b".")]) + b".py"


def is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _choose_cache(name: str) -> None:
    """Have Numba keep its code in a folder of this name: where the user says, beside ours, or in a cache."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given is not None and Path(given).name.startswith(FOLDER):
        given = str(Path(given).parent)  # of the process that started this one
    beside = Path(__file__).parent / "__pycache__"
    places = [Path(given)] if given else [beside, Path(user_cache_dir("numba", appauthor=False))]
    for place in places:
        if is_writable(place / name):
            _drop_old(place)
            break
    else:
        place = Path(tempfile.mkdtemp(prefix="numba-"))
        log.warning(
            "no compiled code can be stored in %s: every run compiles it; set NUMBA_CACHE_DIR to a "
            "folder that can be written",
            " or ".join(map(str, places)),
        )
        atexit.register(shutil.rmtree, place, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(place / name)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(place / name)


def _drop_old(place: Path) -> None:
    """Remove the folders of compiled code that have not been used for longest."""
    found = [each for each in place.glob(f"{FOLDER}*") if each.is_dir()]
    for each in sorted(found, key=lambda each: each.stat().st_mtime)[:-CACHES]:
        shutil.rmtree(each, ignore_errors=True)
