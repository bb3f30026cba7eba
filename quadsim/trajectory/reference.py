"""References: a trajectory as set-points (n, steps), records of `quadsim.control.cascade.SET_POINT`."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..config.ranges import COORDINATE, Position
from ..config.toml import read_text
from ..control.cascade import SET_POINT
from ..own import load_own
from ..runs.compiled import njit
from ..vehicle import GRAVITY
from .specs import (
    Doublets,
    Hover,
    Lissajous,
    Mix,
    Move,
    OwnFunction,
    SetPointFile,
    Step,
    Trajectory,
    Waypoints,
)

Array = NDArray[np.float64]
SetPoints = NDArray[np.void]
DERIVATIVES = ("position", "velocity", "acceleration")
Seeds = Sequence[np.random.SeedSequence]


def reference(spec: Trajectory, steps: int, rate_hz: float, seeds: Seeds) -> SetPoints:
    """Set-points for one flight per seed.

    Args:
        spec: What to fly.
        steps: Number of samples.
        rate_hz: Samples per second.
        seeds: One per flight; a flight depends on its own alone.

    Returns:
        (n, steps) records of `SET_POINT`.

    Raises:
        ValueError: If a set-point file is missing or malformed, or a user's function fails.
    """
    time = np.arange(steps) / rate_hz
    if isinstance(spec, Mix | Waypoints | Doublets) and not (isinstance(spec, Waypoints) and spec.points):
        return np.stack([_random(spec, time, np.random.default_rng(seed)) for seed in seeds])
    return np.repeat(_fixed(spec, time)[None], len(seeds), axis=0)


def _random(spec: Mix | Waypoints | Doublets, time: Array, rng: np.random.Generator) -> SetPoints:
    if isinstance(spec, Waypoints):
        points = np.array(spec.position) + rng.uniform(-1, 1, (spec.random_points, 3)) * np.array(spec.box)
        return _minimum_snap(np.vstack([spec.position, points, spec.position]), spec.speed, time)
    segments = (
        _mix_segments(spec, time[-1], rng)
        if isinstance(spec, Mix)
        else _doublet_segments(spec, time[-1], rng)
    )
    turns = _turns(spec.max_yaw_rate if isinstance(spec, Mix) else 0.0, time[-1], rng)
    out = _still(spec.position, 0.0, time)
    _fly_segments(segments, turns, time, out)
    return out


def _fixed(
    spec: Hover | Step | Move | Lissajous | Waypoints | SetPointFile | OwnFunction, time: Array
) -> SetPoints:
    match spec:
        case Hover():
            out = _still(spec.position, math.radians(spec.yaw_deg), time)
        case Step():
            out = _still(spec.position, 0.0, time)
            displaced = (time >= spec.at_s) & (np.floor((time - spec.at_s) / spec.hold_s) % 2 == 0)
            out["position"][displaced] += spec.offset
            out["yaw"][displaced] += math.radians(spec.yaw_deg)
        case Move():
            out = _move(spec, time)
        case Lissajous():
            out = _lissajous(spec, time)
        case Waypoints():
            out = _minimum_snap(np.array(spec.points), spec.speed, time)
        case SetPointFile():
            out = _from_file(Path(spec.path), time)
        case OwnFunction():
            out = _from_function(spec.function, time)
    return out


def _still(position: Position, yaw: float, time: Array) -> SetPoints:
    out = np.zeros(time.size, SET_POINT)
    out["position"], out["yaw"] = position, yaw
    return out


def _move(spec: Move, time: Array) -> SetPoints:
    out = _still(spec.position, 0.0, time)
    way = np.clip((time - spec.at_s) / spec.length_s, 0, 1)[:, None]
    for order, (name, shape) in enumerate(zip(DERIVATIVES, _rest_to_rest(way), strict=True)):
        out[name] += np.array(spec.offset) * shape / spec.length_s**order
    return out


def _lissajous(spec: Lissajous, time: Array) -> SetPoints:
    rate = 2 * np.pi * np.array(spec.ratio) / spec.period_s
    phase = time[:, None] * rate
    wave = np.stack([np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)])
    s = np.clip(time / spec.period_s, 0, 1)
    grow = np.stack([s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3), 140 * s**3 * (1 - s) ** 3 / spec.period_s,
                     420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / spec.period_s**2])[..., None]  # fmt: skip
    amplitude = np.array(spec.amplitude)
    out = _still(spec.position, 0.0, time)
    out["position"] += amplitude * grow[0] * wave[0]
    out["velocity"] = amplitude * (grow[0] * wave[1] + grow[1] * wave[0])
    out["acceleration"] = amplitude * (grow[0] * wave[2] + 2 * grow[1] * wave[1] + grow[2] * wave[0])
    if spec.yaw_along:
        (vx, vy, _), (ax, ay, _) = out["velocity"].T, out["acceleration"].T
        out["yaw"] = np.unwrap(np.arctan2(vy, vx))
        out["yaw_rate"] = (vx * ay - vy * ax) / np.maximum(vx**2 + vy**2, 1e-3)
    return out


def _minimum_snap(points: Array, speed: float, time: Array) -> SetPoints:
    """Degree-7 spline through the points, derivatives 1 to 3 zero at both ends, run back, and repeated."""
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


def _from_file(path: Path, time: Array) -> SetPoints:
    try:
        rows = list(csv.DictReader(read_text(path, most_mb=100.0).splitlines()))
    except csv.Error as error:
        raise ValueError(f"{path}: cannot read the set-points: {error}") from None
    try:
        clock = np.array([float(row["t"]) for row in rows])
        points = np.array([[float(row[name]) for name in "xyz"] for row in rows])
        yaw = np.array([float(row.get("yaw") or 0.0) for row in rows])
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            f"{path}: set-points need numbers in the columns t, x, y, z (and yaw, if wanted)"
        ) from None
    finite = np.isfinite(clock).all() and np.isfinite(points).all()
    if len(rows) < 2 or not finite or np.any(np.diff(clock) <= 0):
        raise ValueError(f"{path}: set-points need two rows or more, finite, with rising t")
    for name, values in zip("xyz", points.T, strict=True):
        COORDINATE.of(f"{path}: {name}", values[np.argmax(np.abs(values))])
    return _splined(clock, points, yaw, time)


def _from_function(name: str, time: Array) -> SetPoints:
    """Set-points of a user's function."""
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
    if time.size < 2:
        out = np.zeros(time.size, SET_POINT)
        out["position"] = made[:, :3]
        return out
    return _splined(time, made[:, :3], made[:, 3] if made.shape[1] == 4 else np.zeros(time.size), time)


def _splined(clock: Array, points: Array, yaw: Array, time: Array) -> SetPoints:
    """Set-points on a cubic spline, at rest at both ends."""
    from scipy.interpolate import CubicSpline

    at = np.clip(time, clock[0], clock[-1])
    curve = CubicSpline(clock, np.column_stack([points, np.unwrap(yaw)]), bc_type="clamped")
    out = np.zeros(time.size, SET_POINT)
    for order, name in enumerate(DERIVATIVES):
        out[name] = curve(at, order)[:, :3]
    out["yaw"], out["yaw_rate"] = curve(at)[:, 3], curve(at, 1)[:, 3]
    for name in ("velocity", "acceleration", "yaw_rate"):
        out[name][time > clock[-1]] = 0.0
    return out


# --- random manoeuvres: records of segments, evaluated by one compiled function ---

SEGMENT = np.dtype(
    [
        ("start", "f8"),  # [s]
        ("length", "f8"),  # [s]
        ("kind", "i8"),
        ("first", "f8", 3),  # displacement of a dash or a jump, or the first axis of a loop [m]
        ("second", "f8", 3),  # second axis of a loop, a circle or an eight [m]
        ("omega", "f8"),  # frequency of the first axis [rad/s]
        ("ratio", "f8"),  # of the second over the first; the part of a cruise in which it speeds up
    ]
)
TURN = np.dtype([("start", "f8"), ("length", "f8"), ("angle", "f8")])
"""A turn of the heading [s, s, rad]."""
_DASH, _LOOP, _PAUSE, _JUMP, _CRUISE = range(5)
ZERO = (0.0, 0.0, 0.0)
_DASH_PEAK = 84 * math.sqrt(5) / 25  # largest |s''| of the rest-to-rest polynomial of degree 7
_RAMP_PEAK = 35 / 16  # its largest |s'|


def _mix_segments(spec: Mix, end: float, rng: np.random.Generator) -> NDArray[np.void]:
    rows: list[tuple[object, ...]] = []
    clock, where = 0.0, np.zeros(3)
    shares = (spec.pause_share, spec.circle_share, spec.jump_share, spec.eight_share, spec.cruise_share)
    low, high = math.radians(min(spec.min_tilt_deg, spec.max_tilt_deg)), math.radians(spec.max_tilt_deg)
    while clock < end:
        draw, heading = rng.random(), rng.uniform(-np.pi, np.pi)
        climb = np.clip(rng.normal(0.0, 0.1), -0.25, 0.25) * GRAVITY  # peak vertical acceleration
        lateral = (GRAVITY - abs(climb)) * math.tan(rng.uniform(low, high))
        if draw < spec.pause_share:
            length = rng.uniform(*spec.pause_s)
            row = (_PAUSE, ZERO, ZERO, 0.0, 0.0)
        elif draw < sum(shares[:2]):
            turns, period = int(rng.integers(1, 4)), rng.uniform(*spec.circle_s)
            length, omega = (turns + 2) * period, 2 * np.pi / period
            radius = 0.7 * lateral / omega**2  # the window adds to the acceleration
            axes = radius * np.array(
                [[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]]
            )
            flat, bob = rng.uniform(-1.0, 1.0), 0.5 * climb / omega**2
            row = (_LOOP, (*axes[0], bob), (*(flat * axes[1]), -bob), omega, 1.0)
        elif draw < sum(shares[:3]):
            length, reach = rng.uniform(2.0, 4.0), rng.uniform(*spec.jump_m)
            move = reach * np.array([math.cos(heading), math.sin(heading), rng.uniform(-0.3, 0.3)])
            where = where + move
            row = (_JUMP, move, ZERO, 0.0, 0.0)
        elif draw < sum(shares[:4]):
            laps, period = int(rng.integers(3, 9)), rng.uniform(*spec.eight_s)
            length, omega = (laps + 1) * period, 2 * np.pi / period
            share = rng.uniform(-1.0, 1.0)  # of the slow sweep's peak acceleration in that of the fast one
            peak = 0.92 * lateral / (1.0 + share**2 / 4)  # of the two together: lateral; the window adds
            slow = share * peak / omega**2 * np.array([math.cos(heading), math.sin(heading)])
            fast = peak / (2 * omega) ** 2 * np.array([-math.sin(heading), math.cos(heading)])
            row = (_LOOP, (*slow, 0.0), (*fast, 0.5 * climb / (2 * omega) ** 2), omega, 2.0)
        elif draw < sum(shares):
            heading = _homewards(where, spec.radius, heading, rng)
            steady, speed = rng.uniform(*spec.cruise_s), rng.uniform(*spec.cruise_speed)
            ramp = _RAMP_PEAK * speed / lateral
            length, reach = steady + 2 * ramp, speed * (steady + ramp)
            move = reach * np.array([math.cos(heading), math.sin(heading), 0.0])
            where = where + move
            row = (_CRUISE, move, ZERO, 0.0, ramp / length)
        else:
            length = rng.uniform(*spec.dash_s)
            heading = _homewards(where, spec.radius, heading, rng)
            reach = lateral * length**2 / _DASH_PEAK
            rise = climb * length**2 / _DASH_PEAK
            if abs(where[2] + rise) > 0.4 * spec.position[2]:
                rise = -math.copysign(rise, where[2])
            move = np.array([reach * math.cos(heading), reach * math.sin(heading), rise])
            where = where + move
            row = (_DASH, move, ZERO, 0.0, 0.0)
        rows.append((clock, length, *row))
        clock += length
    return np.array(rows, SEGMENT)


def _homewards(where: Array, radius: float, heading: float, rng: np.random.Generator) -> float:
    """The heading, or beyond `radius` about that to the centre [rad]."""
    if np.linalg.norm(where[:2]) > radius:
        return math.atan2(-where[1], -where[0]) + rng.uniform(-0.5, 0.5)
    return heading


def _doublet_segments(spec: Doublets, end: float, rng: np.random.Generator) -> NDArray[np.void]:
    reach = GRAVITY * math.tan(math.radians(spec.tilt_deg)) * spec.swing_s**2 / _DASH_PEAK
    rows, clock, turn = [], rng.uniform(0.2, 1.0), 0
    while clock < end:
        sign = 1.0 if turn % 4 < 2 else -1.0
        move = (sign * reach, 0.0, 0.0) if turn % 2 == 0 else (0.0, sign * reach, 0.0)
        rows.append((clock, spec.swing_s, _DASH, move, ZERO, 0.0, 0.0))
        clock += spec.swing_s + spec.pause_s
        turn += 1
    return np.array(rows, SEGMENT)


def _turns(max_rate: float, end: float, rng: np.random.Generator) -> NDArray[np.void]:
    """Turns of the heading, records of `TURN`; none at a rate of 0."""
    rows, clock = [], 0.0
    while clock < end and max_rate > 0:
        length = rng.uniform(1.0, 4.0)
        # the rest-to-rest polynomial's largest slope is 35/16
        rows.append((clock, length, rng.uniform(-1, 1) * max_rate * length * 16 / 35))
        clock += length + rng.uniform(0.0, 2.0)
    return np.array(rows, TURN)


@njit(cache=True)
def _rest_to_rest(s):
    """35 s⁴ − 84 s⁵ + 70 s⁶ − 20 s⁷ and its first two derivatives: minimum snap from rest to rest."""
    t = 1.0 - s
    value = s**4 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    return value, 140.0 * s**3 * t**3, 420.0 * s**2 * t**2 * (t - s)


@njit(cache=True)
def _ramp_way(s):
    """Integral of the first of them, 0 to 1/2."""
    return s**5 * (7.0 + s * (-14.0 + s * (10.0 - 2.5 * s)))


@njit(cache=True)
def _fly_segments(segments, turns, time, out):
    base = np.empty(3)
    for i in range(3):
        base[i] = out[0].position[i]
    seg, turn, heading = 0, 0, 0.0
    for k in range(time.size):
        while seg < segments.size and time[k] >= segments[seg].start + segments[seg].length:
            if segments[seg].kind == _DASH or segments[seg].kind == _JUMP or segments[seg].kind == _CRUISE:
                for i in range(3):
                    base[i] += segments[seg].first[i]
            seg += 1
        p, v, acc = out[k].position, out[k].velocity, out[k].acceleration
        for i in range(3):
            p[i] = base[i]
        if seg < segments.size and time[k] >= segments[seg].start:
            row = segments[seg]
            length, first, second = row.length, row.first, row.second
            s = (time[k] - row.start) / length
            if row.kind == _DASH:
                value, slope, bend = _rest_to_rest(s)
                for i in range(3):
                    p[i] += first[i] * value
                    v[i] = first[i] * slope / length
                    acc[i] = first[i] * bend / length**2
            elif row.kind == _JUMP:
                for i in range(3):
                    p[i] += first[i]
            elif row.kind == _CRUISE:
                ramp = row.ratio
                # the speed rises as the polynomial does, stays, and falls; its integral is the way
                edge, sign = min(s, 1.0 - s) / ramp, (1.0 if s < 0.5 else -1.0)
                level, slope, _ = _rest_to_rest(min(edge, 1.0))
                way = ramp * _ramp_way(min(edge, 1.0)) + max(min(s, 1.0 - s) - ramp, 0.0)
                way = (way if s < 0.5 else 1.0 - ramp - way) / (1.0 - ramp)
                speed = 1.0 / (1.0 - ramp) / length
                for i in range(3):
                    p[i] += first[i] * way
                    v[i] = first[i] * speed * level
                    acc[i] = first[i] * speed * sign * slope / (ramp * length)
            elif row.kind == _LOOP:
                # the window rises over the first quarter of the segment and falls over the last
                edge, sign = 4.0 * min(s, 1.0 - s), (1.0 if s < 0.5 else -1.0)
                w, dw, ddw = _rest_to_rest(min(edge, 1.0))
                dw, ddw = dw * 4.0 * sign / length, ddw * 16.0 / length**2
                omega, ratio = row.omega, row.ratio
                phase = omega * (time[k] - row.start)
                sin, cos = math.sin(phase), math.cos(phase)
                if ratio == 1.0:  # a quarter of a period apart, so that it is round
                    sin_2, cos_2 = cos, -sin
                else:
                    sin_2, cos_2 = math.sin(ratio * phase), math.cos(ratio * phase)
                for i in range(3):
                    a, b = first[i], second[i]
                    f = a * sin + b * sin_2
                    df = omega * (a * cos + ratio * b * cos_2)
                    ddf = -omega * omega * (a * sin + ratio * ratio * b * sin_2)
                    p[i] += w * f
                    v[i] = w * df + dw * f
                    acc[i] = w * ddf + 2.0 * dw * df + ddw * f
        while turn < turns.size and time[k] >= turns[turn].start + turns[turn].length:
            heading += turns[turn].angle
            turn += 1
        out[k].yaw = heading
        if turn < turns.size and time[k] >= turns[turn].start:
            value, slope, _ = _rest_to_rest((time[k] - turns[turn].start) / turns[turn].length)
            out[k].yaw += turns[turn].angle * value
            out[k].yaw_rate = turns[turn].angle * slope / turns[turn].length
