"""Random manoeuvres: records of segments and heading turns, evaluated by one compiled function."""

import math

import numpy as np
from numpy.typing import NDArray

from ..runs.compiled import njit
from ..vehicle import GRAVITY
from .specs import Mix

Array = NDArray[np.float64]

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
"""A turn of the heading: start [s], duration [s], angle [rad]."""
_DASH, _LOOP, _PAUSE, _JUMP, _CRUISE = range(5)
UP = np.array([0.0, 0.0, 1.0])
_DASH_PEAK = 84 * math.sqrt(5) / 25  # largest |s''| of the rest-to-rest polynomial of degree 7
_RAMP_PEAK = 35 / 16  # its largest |s'|


def mix_segments(spec: Mix, end: float, rng: np.random.Generator) -> NDArray[np.void]:
    """Draw the manoeuvres of a mix until an end time [s], records of `SEGMENT`."""
    rows: list[tuple[object, ...]] = []
    clock, where = 0.0, np.zeros(3)
    shares = (spec.pause_share, spec.circle_share, spec.jump_share, spec.eight_share, spec.cruise_share)
    low, high = math.radians(min(spec.min_tilt_deg, spec.max_tilt_deg)), math.radians(spec.max_tilt_deg)
    while clock < end:
        draw, heading = rng.random(), rng.uniform(-np.pi, np.pi)
        climb = np.clip(rng.normal(0.0, 0.1), -0.25, 0.25) * GRAVITY  # peak vertical acceleration
        lateral = (GRAVITY - abs(climb)) * math.tan(rng.uniform(low, high))
        ahead, across = _axes(heading)
        first = second = np.zeros(3)
        omega = ratio = 0.0
        if draw < spec.pause_share:
            kind, length = _PAUSE, rng.uniform(*spec.pause_s)
        elif draw < sum(shares[:2]):
            rounds, period = int(rng.integers(1, 4)), rng.uniform(*spec.circle_s)
            kind, length, omega, ratio = _LOOP, (rounds + 2) * period, 2 * np.pi / period, 1.0
            radius = 0.7 * lateral / omega**2  # the window adds to the acceleration
            flat, bob = rng.uniform(-1.0, 1.0), 0.5 * climb / omega**2
            first, second = radius * ahead + bob * UP, flat * (radius * across) - bob * UP
        elif draw < sum(shares[:3]):
            kind, length, reach = _JUMP, rng.uniform(2.0, 4.0), rng.uniform(*spec.jump_m)
            first = reach * (ahead + rng.uniform(-0.3, 0.3) * UP)
        elif draw < sum(shares[:4]):
            laps, period = int(rng.integers(3, 9)), rng.uniform(*spec.eight_s)
            kind, length, omega, ratio = _LOOP, (laps + 1) * period, 2 * np.pi / period, 2.0
            share = rng.uniform(-1.0, 1.0)  # of the slow sweep's peak acceleration in that of the fast one
            peak = 0.92 * lateral / (1.0 + share**2 / 4)  # of the two together: lateral; the window adds
            first = share * peak / omega**2 * ahead
            second = peak / (2 * omega) ** 2 * across + 0.5 * climb / (2 * omega) ** 2 * UP
        elif draw < sum(shares):
            ahead, _ = _axes(_homewards(where, spec.radius, heading, rng))
            steady, speed = rng.uniform(*spec.cruise_s), rng.uniform(*spec.cruise_speed)
            ramp = _RAMP_PEAK * speed / lateral
            kind, length, ratio = _CRUISE, steady + 2 * ramp, ramp / (steady + 2 * ramp)
            first = speed * (steady + ramp) * ahead
        else:
            kind, length = _DASH, rng.uniform(*spec.dash_s)
            ahead, _ = _axes(_homewards(where, spec.radius, heading, rng))
            rise = climb * length**2 / _DASH_PEAK
            if abs(where[2] + rise) > 0.4 * spec.position[2]:
                rise = -math.copysign(rise, where[2])
            first = lateral * length**2 / _DASH_PEAK * ahead + rise * UP
        rows.append((clock, length, kind, first, second, omega, ratio))
        clock += length
        if kind != _LOOP:
            where = where + first
    return np.array(rows, SEGMENT)


def _axes(heading: float) -> tuple[Array, Array]:
    """Return the horizontal unit vectors ahead and to the left."""
    cos, sin = math.cos(heading), math.sin(heading)
    return np.array([cos, sin, 0.0]), np.array([-sin, cos, 0.0])


def _homewards(where: Array, radius: float, heading: float, rng: np.random.Generator) -> float:
    """Return the heading; beyond `radius`, a random heading roughly towards the centre [rad]."""
    if np.linalg.norm(where[:2]) > radius:
        return math.atan2(-where[1], -where[0]) + rng.uniform(-0.5, 0.5)
    return heading


def turns(max_rate: float, end: float, rng: np.random.Generator) -> NDArray[np.void]:
    """Draw turns of the heading, records of `TURN`; none at a rate of 0."""
    rows, clock = [], 0.0
    while clock < end and max_rate > 0:
        length = rng.uniform(1.0, 4.0)
        # the rest-to-rest polynomial's largest slope is 35/16
        rows.append((clock, length, rng.uniform(-1, 1) * max_rate * length * 16 / 35))
        clock += length + rng.uniform(0.0, 2.0)
    return np.array(rows, TURN)


@njit(cache=True)
def rest_to_rest(s):
    """Return 35 s⁴ − 84 s⁵ + 70 s⁶ − 20 s⁷, minimum snap from rest to rest, and its first two derivatives."""
    t = 1.0 - s
    value = s**4 * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    return value, 140.0 * s**3 * t**3, 420.0 * s**2 * t**2 * (t - s)


@njit(cache=True)
def _ramp_way(s):
    """Return the integral of the polynomial of `rest_to_rest`, from 0 to 1/2."""
    return s**5 * (7.0 + s * (-14.0 + s * (10.0 - 2.5 * s)))


@njit(cache=True)
def fly_segments(segments, turns, time, out):
    """Write set-points of segments and turns at times (T,) to out (T,), whose first has the position."""
    base = np.empty(3)
    for i in range(3):
        base[i] = out[0].position[i]
    seg, turn, heading = 0, 0, 0.0
    for k in range(time.size):
        while seg < segments.size and time[k] >= segments[seg].start + segments[seg].length:
            if segments[seg].kind != _LOOP:
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
                value, slope, bend = rest_to_rest(s)
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
                level, slope, _ = rest_to_rest(min(edge, 1.0))
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
                w, dw, ddw = rest_to_rest(min(edge, 1.0))
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
            value, slope, _ = rest_to_rest((time[k] - turns[turn].start) / turns[turn].length)
            out[k].yaw += turns[turn].angle * value
            out[k].yaw_rate = turns[turn].angle * slope / turns[turn].length
