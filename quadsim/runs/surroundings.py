"""Corrections of the environment that would break an import or hide a package."""

import logging
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from types import ModuleType

from .fingerprint import PACKAGES, ROOT

log = logging.getLogger(__name__)

OPENGL = ("egl", "glfw", "osmesa", "glx", "wgl", "cgl")
"""Allowed values of MUJOCO_GL, which selects the renderer."""
REGISTRY = "gymnasium.envs.registration"
"""Module of Gymnasium with the registry of environments."""
SWITCHES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0")


def settle() -> None:
    """Remove a setting that would break MuJoCo's import, with a warning, and find quadsim's packages first.

    The environment is registered when Gymnasium is imported. Most commands never import Gymnasium, and its
    import is slow.
    """
    asked = os.environ.get("MUJOCO_GL", "")
    if asked.strip().lower() not in (*OPENGL, *SWITCHES):
        log.warning("MUJOCO_GL=%s is ignored: %s are allowed", asked, ", ".join(OPENGL))
        del os.environ["MUJOCO_GL"]
    if Neighbours not in sys.meta_path:
        sys.meta_path.insert(0, Neighbours)
    if REGISTRY in sys.modules:
        register_environment(sys.modules[REGISTRY])
    elif Registering not in sys.meta_path:
        sys.meta_path.insert(0, Registering)


def register_environment(registry: ModuleType) -> None:
    """Register the environment in a module of Gymnasium."""
    registry.register(
        id="quadsim/Quadrotor-v0",
        entry_point="quadsim.env:QuadrotorEnv",
        vector_entry_point="quadsim.env:QuadrotorVectorEnv",
    )


class Registry(SourceFileLoader):
    """Loads the registry module of Gymnasium, and registers the environment of quadsim."""

    def exec_module(self, module: ModuleType) -> None:
        """Run the code of the module, then register the environment."""
        super().exec_module(module)
        register_environment(module)


class Registering:
    """Finds the registry module of Gymnasium."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module, as `importlib.abc.MetaPathFinder.find_spec` does; return None for other names."""
        found = PathFinder.find_spec(name, path, target) if name == REGISTRY else None
        if found is None or found.origin is None:
            return None
        return spec_from_file_location(name, found.origin, loader=Registry(name, found.origin))


class Neighbours:
    """Finds the packages of quadsim before folders with the same names in the working directory."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module, as `importlib.abc.MetaPathFinder.find_spec` does; return None for other names."""
        return PathFinder.find_spec(name, [str(ROOT)], target) if name in (*PACKAGES, "assets") else None
