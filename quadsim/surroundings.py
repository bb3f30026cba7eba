"""What of the surroundings would stop an import: a mistyped MUJOCO_GL, and no folder for compiled code."""

import atexit
import logging
import os
import shutil
import sys
import tempfile
from pathlib import Path

from platformdirs import user_cache_dir

log = logging.getLogger(__name__)

OPENGL = ("egl", "glfw", "osmesa", "glx", "wgl", "cgl")
"""What MUJOCO_GL may say: how pictures are made."""
SWITCHES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0")


def settle() -> None:
    """Leave only what MuJoCo and Numba can be imported with, and warn of what was changed."""
    asked = os.environ.get("MUJOCO_GL", "")
    if asked.strip().lower() not in (*OPENGL, *SWITCHES):
        log.warning("MUJOCO_GL=%s is ignored: %s are allowed", asked, ", ".join(OPENGL))
        del os.environ["MUJOCO_GL"]
    if "NUMBA_CACHE_DIR" not in os.environ:
        folder = Path(__file__).parent / "__pycache__"
        if not any(is_writable(each) for each in (folder, Path(user_cache_dir("numba", appauthor=False)))):
            _compile_without_cache(folder)


def is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _compile_without_cache(folder: Path) -> None:
    """Give Numba a folder that goes with this process; its workers inherit it."""
    log.warning(
        "neither %s nor a cache can be written: code is compiled anew in every run; set NUMBA_CACHE_DIR to a "
        "folder that can",
        folder,
    )
    os.environ["NUMBA_CACHE_DIR"] = found = tempfile.mkdtemp(prefix="quadsim-")
    atexit.register(shutil.rmtree, found, ignore_errors=True)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = found
