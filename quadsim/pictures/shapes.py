"""Shapes that make up the picture of a vehicle."""

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..rotation import quat_from_rotvec, quat_multiply
from ..vehicle import Vehicle


def quadrotor_geoms(vehicle: Vehicle) -> list[dict[str, object]]:
    """Return the shapes of the picture of a vehicle, in body axes, from its hubs and propellers."""
    hubs = vehicle.hubs
    arm = float(np.linalg.norm(hubs[:, :2], axis=1).mean())
    scale = arm / 0.17  # everything that the vehicle does not tell is in proportion to its arms
    plane = float(hubs[:, 2].mean())
    front = hubs[:, 0] > 0.5 * arm
    geoms = _body(scale, plane)
    for hub, reaction, leads in zip(hubs, vehicle.reactions, front, strict=True):
        geoms += _arm(hub, scale, "orange" if leads else "carbon")
        pitch = -0.24 * reaction
        geoms += _rotor(hub, vehicle.frame.prop_radius, scale, 0.9 * hub[0] + 2.3 * hub[1] / arm, pitch)
    return geoms


def _shape(
    kind: str, size: ArrayLike, pos: ArrayLike, material: str, yaw: float = 0.0, castshadow: bool = True
) -> dict[str, object]:
    geom_type = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
    quat = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    size = [*np.atleast_1d(np.asarray(size, dtype=float)), 0.0, 0.0][:3]
    place = {"pos": list(np.asarray(pos, dtype=float)), "quat": quat}
    return {"type": geom_type, "size": size, **place, "material": material, "castshadow": castshadow}


def _body(s: float, plane: float) -> list[dict[str, object]]:
    """Return the shapes of the body: battery, plates, flight computer, dome and two lights."""
    z = plane - 0.024 * s
    return [
        _shape("cylinder", [0.048 * s, 0.0022 * s], [0, 0, z - 0.006 * s], "carbon"),
        _shape("cylinder", [0.044 * s, 0.0022 * s], [0, 0, z + 0.010 * s], "carbon"),
        _shape("box", [0.046 * s, 0.019 * s, 0.013 * s], [0, 0, z - 0.022 * s], "battery"),
        _shape("box", [0.006 * s, 0.0196 * s, 0.0136 * s], [0.024 * s, 0, z - 0.022 * s], "white"),
        _shape("box", [0.026 * s, 0.026 * s, 0.002 * s], [0, 0, z + 0.017 * s], "board"),
        _shape("box", [0.011 * s, 0.011 * s, 0.003 * s], [0.006 * s, 0, z + 0.021 * s], "plastic"),
        _shape("ellipsoid", [0.033 * s, 0.033 * s, 0.026 * s], [0, 0, z + 0.020 * s], "white"),
        _shape("ellipsoid", [0.0335 * s, 0.011 * s, 0.0266 * s], [0, 0, z + 0.020 * s], "orange"),
        _shape("sphere", 0.005 * s, [0.046 * s, 0, z + 0.010 * s], "red_light"),
        _shape("sphere", 0.005 * s, [-0.046 * s, 0, z + 0.010 * s], "green_light"),
        *[
            _shape(
                "cylinder", [0.0028 * s, 0.010 * s], [0.036 * s * x, 0.036 * s * y, z + 0.002 * s], "metal"
            )
            for x in (-0.025, 0.025)
            for y in (-0.025, 0.025)
        ],
    ]


def _arm(hub: ArrayLike, s: float, material: str) -> list[dict[str, object]]:
    x, y, z = np.asarray(hub, dtype=float)
    length, yaw, low = float(np.hypot(x, y)), float(np.arctan2(y, x)), z - 0.024 * s
    along = np.array([x, y]) / length
    leg, band = along * (length - 0.012 * s), along * (length - 0.052 * s)
    return [
        _shape("box", [length / 2, 0.0075 * s, 0.005 * s], [x / 2, y / 2, low], "carbon", yaw),
        _shape("box", [0.027 * s, 0.0082 * s, 0.0056 * s], [*band, low], material, yaw),
        _shape("cylinder", [0.0155 * s, 0.006 * s], [x, y, low + 0.004 * s], "plastic"),
        _shape("cylinder", [0.0135 * s, 0.006 * s], [x, y, low + 0.015 * s], "metal"),
        _shape("cylinder", [0.0032 * s, 0.0235 * s], [*leg, low - 0.025 * s], "plastic"),
        _shape("sphere", 0.0062 * s, [*leg, low - 0.048 * s], material),
    ]


def _rotor(
    hub: ArrayLike, radius: float, s: float, spin_phase: float, blade_pitch: float
) -> list[dict[str, object]]:
    """Return the shapes of a rotor: two pitched blades, a hub, and the disc of a spinning propeller."""
    x, y, z = np.asarray(hub, dtype=float)
    shapes = [
        _shape("cylinder", [radius, 0.0006 * s], [x, y, z], "blur", castshadow=False),
        _shape("cylinder", [0.0065 * s, 0.0045 * s], [x, y, z], "plastic"),
        _shape("ellipsoid", [0.005 * s, 0.005 * s, 0.006 * s], [x, y, z + 0.005 * s], "orange"),
    ]
    for angle in (spin_phase, spin_phase + np.pi):
        blade = _shape("ellipsoid", [0.5 * radius, 0.082 * radius, 0.0016 * s], [0, 0, 0], "blade", angle)
        pitch = quat_from_rotvec(np.array([blade_pitch, 0.0, 0.0]))
        blade["quat"] = list(quat_multiply(np.asarray(blade["quat"]), pitch))
        blade["pos"] = [x + 0.5 * radius * np.cos(angle), y + 0.5 * radius * np.sin(angle), z]
        shapes.append(blade)
    return shapes
