"""What would stop an import, or hide a package."""

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
"""What MUJOCO_GL may say: how pictures are made."""
REGISTRY = "gymnasium.envs.registration"
"""Module of Gymnasium that holds the environments."""
SWITCHES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "off", "false", "0")


def settle() -> None:
    """Warn of what MuJoCo cannot be imported with and drop it; find the packages beside this one first.

    The environment is registered when Gymnasium is imported, which most commands never do and which takes as
    long as all else that `quadsim` imports.
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
    """Register the environment with Gymnasium, whose module for it is given."""
    registry.register(
        id="quadsim/Quadrotor-v0",
        entry_point="quadsim.env:QuadrotorEnv",
        vector_entry_point="quadsim.env:QuadrotorVectorEnv",
    )


class Registry(SourceFileLoader):
    """Loads the module that holds Gymnasium's environments, and registers ours."""

    def exec_module(self, module: ModuleType) -> None:
        """Run the module's code, then register."""
        super().exec_module(module)
        register_environment(module)


class Registering:
    """Finds the module that holds Gymnasium's environments."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As `importlib.abc.MetaPathFinder.find_spec`; None for every other name."""
        found = PathFinder.find_spec(name, path, target) if name == REGISTRY else None
        if found is None or found.origin is None:
            return None
        return spec_from_file_location(name, found.origin, loader=Registry(name, found.origin))


class Neighbours:
    """Finds the packages beside this one before folders of their names in the working directory."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As `importlib.abc.MetaPathFinder.find_spec`; None for every other name."""
        return PathFinder.find_spec(name, [str(ROOT)], target) if name in (*PACKAGES, "assets") else None
