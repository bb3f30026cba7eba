"""What would stop an import, or hide a package."""

import logging
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from .fingerprint import PACKAGES, ROOT

log = logging.getLogger(__name__)

OPENGL = ("egl", "glfw", "osmesa", "glx", "wgl", "cgl")
"""What MUJOCO_GL may say: how pictures are made."""
SWITCHES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0")


def settle() -> None:
    """Warn of what MuJoCo cannot be imported with and drop it; find the packages beside this one first."""
    asked = os.environ.get("MUJOCO_GL", "")
    if asked.strip().lower() not in (*OPENGL, *SWITCHES):
        log.warning("MUJOCO_GL=%s is ignored: %s are allowed", asked, ", ".join(OPENGL))
        del os.environ["MUJOCO_GL"]
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
