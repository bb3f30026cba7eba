"""Pictures and videos of flights, rendered without a screen by EGL or OSMesa.

The scene (sky, ground, sun, paint) is `assets/scene.xml`. The quadrotor is drawn with the dimensions of its
vehicle. This module does no physics: vehicles are placed at the recorded positions.
"""

import importlib
import itertools
import logging
import os
import sys
from functools import cache
from typing import NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runs.fingerprint import ASSETS
from ..vehicle import Vehicle
from .shapes import quadrotor_geoms

log = logging.getLogger(__name__)

Image = NDArray[np.uint8]

NO_OPENGL = "no headless OpenGL on this machine, so no pictures: install Debian's libegl1 or libosmesa6"
TRAIL_COLOUR = np.array([0.93, 0.36, 0.08, 0.85], dtype=np.float32)
GHOST_COLOUR = np.array([0.10, 0.55, 0.95, 0.30], dtype=np.float32)
TARGET_COLOUR = np.array([0.10, 0.75, 0.30, 0.90], dtype=np.float32)
WIND_COLOUR = np.array([0.45, 0.25, 0.85, 0.90], dtype=np.float32)
WIND_SCALE = 0.06
"""Length of the wind arrow, in metres per m/s."""
SAMPLES = 8
"""Samples per pixel, for smooth edges."""
DRAFT = {"numslices": 12, "numstacks": 6, "shadowsize": 2048}
"""Detail of round bodies and shadows when the CPU renders, which doubles the speed."""
PROCESSORS = ("llvmpipe", "softpipe", "swrast", "swiftshader")
"""Names of OpenGL renderers that do not use a graphics card."""
CALM = 0.05
"""Wind speed below which no arrow is drawn [m/s]."""


class View(NamedTuple):
    """Position and direction of the camera."""

    target: tuple[float, float, float]  #: point looked at, world [m]
    distance: float = 1.3  #: [m]
    azimuth: float = 145.0  #: direction of view about z [deg]; 0 looks along +x
    elevation: float = -22.0  #: [deg]; negative looks down


class Scene:
    """An offscreen renderer of a quadrotor. Call `close` after use.

    Args:
        vehicle: Airframe to draw.
        width: Width of the image [px].
        height: Height of the image [px].
        ghost: Draw a second, translucent quadrotor.
        draft: Draw round bodies and shadows with less detail.

    Raises:
        RuntimeError: Neither EGL nor OSMesa works; the message says what to install.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        width: int = 960,
        height: int = 540,
        ghost: bool = False,
        draft: bool = False,
    ):
        self._context = _gl_context(width, height)
        self._context.make_current()
        self.model = scene_model(vehicle, 1 + ghost, width, height, draft)
        if ghost:
            own = self.model.geom_bodyid == self.model.body("quadrotor1").id
            self.model.geom_matid[own], self.model.geom_rgba[own] = -1, GHOST_COLOUR
        self.data = mujoco.MjData(self.model)
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)
        self._scene = mujoco.MjvScene(self.model, maxgeom=10_000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        self._drawer = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawer)

    def draw(
        self,
        position: ArrayLike,
        quat: ArrayLike,
        view: View,
        trail: ArrayLike | None = None,
        target: ArrayLike | None = None,
        wind: ArrayLike | None = None,
        text: tuple[str, str] | None = None,
    ) -> Image:
        """Draw the quadrotor and its ghost.

        Args:
            position: (3,) centre of mass, world [m].
            quat: (4,) quat_WB, or (2, 4) with a second row for the ghost.
            view: Camera.
            trail: (m, 3) points joined by a thin line [m].
            target: (3,) set-point, a small ball [m].
            wind: (3,) an arrow above the quadrotor, world axes [m/s].
            text: Labels and values, shown in a corner, one per line.

        Returns:
            Image of shape (height, width, 3).
        """
        self.data.mocap_pos[:] = position
        self.data.mocap_quat[:] = quat
        self._light(view)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        camera = mujoco.MjvCamera()
        camera.lookat[:] = view.target
        camera.distance, camera.azimuth, camera.elevation = view.distance, view.azimuth, view.elevation
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        option, perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        mujoco.mjv_updateScene(self.model, self.data, option, perturbation, camera, every, self._scene)
        if trail is not None:
            radius = 0.0025 * max(view.distance, 2.0)
            for start, end in itertools.pairwise(np.asarray(trail, dtype=np.float64)):
                self._connect("CAPSULE", radius, start, end, TRAIL_COLOUR)
        if target is not None:
            self._add_ball(np.asarray(target, dtype=np.float64), radius=0.012 * max(view.distance, 1.0))
        if wind is not None and np.linalg.norm(wind) > CALM:
            start = np.add(position, (0.0, 0.0, 0.25))
            self._connect("ARROW", 0.012, start, start + WIND_SCALE * np.asarray(wind), WIND_COLOUR)
        self._context.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._drawer)
        if text is not None:
            font, place = mujoco.mjtFont.mjFONT_NORMAL.value, mujoco.mjtGridPos.mjGRID_TOPLEFT.value
            mujoco.mjr_overlay(font, place, self._rect, *text, self._drawer)
        mujoco.mjr_readPixels(self._pixels, None, self._rect, self._drawer)
        return self._pixels[::-1].copy()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._context.make_current()
        self._drawer.free()
        self._context.free()

    def _light(self, view: View) -> None:
        """Place the sun above the centre of the view, because its shadows have a limited extent."""
        sun = self.model.light("sun").id
        reach = max(1.5, view.distance)
        self.model.light_pos[sun] = np.array(view.target) - 4.0 * reach * self.model.light_dir[sun]
        self._drawer.shadowClip = reach

    def _connect(
        self,
        kind: str,
        radius: float,
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        colour: NDArray[np.float32],
    ) -> None:
        if self._scene.ngeom < self._scene.maxgeom:
            geom, of = self._scene.geoms[self._scene.ngeom], getattr(mujoco.mjtGeom, f"mjGEOM_{kind}").value
            mujoco.mjv_initGeom(geom, of, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
            mujoco.mjv_connector(geom, of, radius, start, end)
            self._scene.ngeom += 1

    def _add_ball(self, place: NDArray[np.float64], radius: float) -> None:
        geom, ball = self._scene.geoms[self._scene.ngeom], mujoco.mjtGeom.mjGEOM_SPHERE.value
        mujoco.mjv_initGeom(geom, ball, np.full(3, radius), place, np.eye(3).ravel(), TARGET_COLOUR)
        self._scene.ngeom += 1


@cache
def drawn_by_processor() -> bool:
    """Return whether OpenGL renders without a graphics card on this computer.

    Raises:
        RuntimeError: Neither EGL nor OSMesa works.
    """
    context = _gl_context(16, 16)
    context.make_current()
    gl = importlib.import_module("OpenGL.GL")
    renderer = gl.glGetString(gl.GL_RENDERER).decode().lower()
    context.free()
    return any(name in renderer for name in PROCESSORS)


def scene_model(
    vehicle: Vehicle, copies: int, width: int, height: int, draft: bool = False
) -> mujoco.MjModel:
    """Make the model of a scene with movable quadrotors (mocap bodies).

    The arguments are those of `Scene`.
    """
    spec = mujoco.MjSpec.from_string((ASSETS / "scene.xml").read_text(encoding="utf-8"))
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.quality.offsamples = SAMPLES
    for index in range(copies):
        body = spec.worldbody.add_body(name=f"quadrotor{index}", mocap=True)
        for geom in quadrotor_geoms(vehicle):
            body.add_geom(contype=0, conaffinity=0, **geom)
    if draft:
        for name, value in DRAFT.items():
            setattr(spec.visual.quality, name, value)
    return spec.compile()


class _Context(Protocol):
    def make_current(self) -> None: ...
    def free(self) -> None: ...


def _gl_context(width: int, height: int) -> _Context:
    """Make a headless OpenGL context.

    MuJoCo chooses its backend from an environment variable on import. This function tries the backends in
    turn, so that no variable has to be set. PyOpenGL supports only one backend at a time and is loaded again
    for the next.
    """
    reasons = []
    chosen = os.environ.get("PYOPENGL_PLATFORM")
    for backend in [chosen] if chosen in ("egl", "osmesa") else ["egl", "osmesa"]:
        try:
            return importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        except (ImportError, AttributeError, RuntimeError, OSError) as error:
            reasons.append(f"{backend}: {error}")
            if chosen is None:
                _forget_opengl(backend)
    log.debug("%s", "; ".join(reasons))
    raise RuntimeError(NO_OPENGL)


def _forget_opengl(backend: str) -> None:
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in list(sys.modules):
        if name.split(".")[0] == "OpenGL" or name.startswith(f"mujoco.{backend}"):
            del sys.modules[name]
