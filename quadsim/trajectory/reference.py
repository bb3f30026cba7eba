"""Trajectories as set-points (n, steps), records of `quadsim.control.records.SET_POINT`."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import COORDINATE
from ..control.records import SET_POINT
from ..own import load_own
from .manoeuvres import fly_segments, mix_segments, rest_to_rest, turns
from .specs import (
    Hover,
    Lissajous,
    Mix,
    Move,
    OwnFunction,
    Step,
    Trajectory,
    Waypoints,
)

Array = NDArray[np.float64]
SetPoints = NDArray[np.void]
DERIVATIVES = ("position", "velocity", "acceleration")
Seeds = Sequence[np.random.SeedSequence]


def reference(spec: Trajectory, steps: int, rate_hz: float, seeds: Seeds) -> SetPoints:
    """Compute the set-points of one flight per seed.

    Args:
        spec: The trajectory.
        steps: Number of samples.
        rate_hz: Samples per second.
        seeds: One per flight; a flight depends only on its own seed.

    Returns:
        (n, steps) records of `SET_POINT`, read-only.

    Raises:
        ValueError: A user's function fails.
    """
    time = np.arange(steps) / rate_hz
    drawn = isinstance(spec, Mix) or (isinstance(spec, Waypoints) and not spec.points)
    paths = [_path(spec, time, np.random.default_rng(seed)) for seed in (seeds if drawn else seeds[:1])]
    return np.broadcast_to(np.stack(paths), (len(seeds), steps))


def _path(spec: Trajectory, time: Array, rng: np.random.Generator) -> SetPoints:
    out = np.zeros(time.size, SET_POINT)
    if not isinstance(spec, OwnFunction):
        out["position"] = spec.position
    match spec:
        case Hover():
            out["yaw"] = math.radians(spec.yaw_deg)
        case Step():
            displaced = (time >= spec.at_s) & (np.floor((time - spec.at_s) / spec.hold_s) % 2 == 0)
            out["position"][displaced] += spec.offset
            out["yaw"][displaced] += math.radians(spec.yaw_deg)
        case Move():
            way = np.clip((time - spec.at_s) / spec.length_s, 0, 1)[:, None]
            for order, (name, shape) in enumerate(zip(DERIVATIVES, rest_to_rest(way), strict=True)):
                out[name] += np.array(spec.offset) * shape / spec.length_s**order
        case Lissajous():
            _add_lissajous(spec, time, out)
        case Waypoints(points=()):
            points = np.array(spec.position) + rng.uniform(-1, 1, (spec.random_points, 3)) * spec.box
            out = _minimum_snap(np.vstack([spec.position, points, spec.position]), spec.speed, time)
        case Waypoints():
            out = _minimum_snap(np.array(spec.points), spec.speed, time)
        case Mix():
            segments = mix_segments(spec, time[-1], rng)
            fly_segments(segments, turns(spec.max_yaw_rate, time[-1], rng), time, out)
        case OwnFunction():
            out = _from_function(spec.function, time)
    return out


def _add_lissajous(spec: Lissajous, time: Array, out: SetPoints) -> None:
    rate = 2 * np.pi * np.array(spec.ratio) / spec.period_s
    phase = time[:, None] * rate
    wave = np.stack([np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)])
    s = np.clip(time / spec.period_s, 0, 1)
    grow = np.stack([s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3), 140 * s**3 * (1 - s) ** 3 / spec.period_s,
                     420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / spec.period_s**2])[..., None]  # fmt: skip
    amplitude = np.array(spec.amplitude)
    out["position"] += amplitude * grow[0] * wave[0]
    out["velocity"] = amplitude * (grow[0] * wave[1] + grow[1] * wave[0])
    out["acceleration"] = amplitude * (grow[0] * wave[2] + 2 * grow[1] * wave[1] + grow[2] * wave[0])


def _minimum_snap(points: Array, speed: float, time: Array) -> SetPoints:
    """Interpolate the points by a spline of degree 7, at rest at both ends; fly back, and repeat."""
    from scipy.interpolate import make_interp_spline  # scipy.interpolate takes a tenth of a second

    loop = points if np.allclose(points[0], points[-1]) else np.vstack([points, points[-2::-1]])
    legs = np.linalg.norm(np.diff(loop, axis=0), axis=1)
    if np.any(legs < 1e-6):
        raise ValueError("two waypoints in a row are the same point; leave one out")
    # a leg from or to rest takes longer: a speed that rises from zero halves the mean
    slow = np.ones(legs.size)
    slow[0] = slow[-1] = 2.0
    knots = np.concatenate([[0.0], np.cumsum(slow * legs / speed)])
    rest: list[tuple[int, Array]] = [(order, np.zeros(3)) for order in (1, 2, 3)]
    curve = make_interp_spline(knots, loop, k=7, bc_type=(rest, rest))
    at = np.mod(time, knots[-1])
    out = np.zeros(time.size, SET_POINT)
    for order, name in enumerate(DERIVATIVES):
        out[name] = curve(at, nu=order)
    return out


def _from_function(name: str, time: Array) -> SetPoints:
    """Return the set-points of a user's function, on a cubic spline that is at rest at both ends."""
    from scipy.interpolate import CubicSpline

    fly = load_own(name)
    try:
        made = np.asarray(fly(time.copy()), np.float64)
    except Exception as error:  # whatever a user's function does
        raise ValueError(f"trajectory {name} ends with {type(error).__name__}: {error}") from error
    if made.shape not in ((time.size, 3), (time.size, 4)):
        raise ValueError(
            f"trajectory {name} returns an array of shape {made.shape} for {time.size} times; x, y, z [m] "
            "and, if wanted, yaw [rad] are required, a row for each"
        )
    if not np.isfinite(made).all():
        raise ValueError(f"trajectory {name} returns numbers that are not finite")
    for axis, values in zip("xyz", made.T, strict=False):
        COORDINATE.of(f"trajectory {name}: {axis}", values[np.argmax(np.abs(values))])
    yaw = made[:, 3] if made.shape[1] == 4 else np.zeros(time.size)
    out = np.zeros(time.size, SET_POINT)
    out["position"] = made[:, :3]
    if time.size > 1:
        curve = CubicSpline(time, np.column_stack([made[:, :3], np.unwrap(yaw)]), bc_type="clamped")
        for order, derivative in enumerate(DERIVATIVES):
            out[derivative] = curve(time, order)[:, :3]
        out["yaw"], out["yaw_rate"] = curve(time)[:, 3], curve(time, 1)[:, 3]
    return out
