"""Adjustment of the start of a trained circuit for flight in closed loop."""

from __future__ import annotations

import numpy as np

from estimators.circuit.floats import F
from estimators.circuit.parameters import FAST, RATE_HZ, SLOW, Parameters

from .gradient import cosine, run_streams
from .streams import Streams

QUICK = 4096 / (85 * 800)
"""Time constant of a gate that is open only at the start [s]."""
CHANGES = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)
"""Changes of the initial value of a slow gate that are tried."""
TILT_DEG, SETTLED_DEG, WAIT_S = 20.0, 1.0, 12.0
"""A constant tilt [deg], the error below which it counts as found [deg], and the duration of the test [s]."""


def as_flown(p: Parameters) -> Parameters:
    """Return the circuit with its start adjusted for flight.

    Recorded flights begin at any attitude, so a trained circuit tracks the specific force for half a second.
    In closed loop, a vehicle that begins with a dash would crash, because the force indicates level flight
    while the vehicle tilts. Therefore, fast gates that are open at the start close five times sooner. So that
    a constant tilt is still found quickly, the initial value of one slow gate, the most effective one, is
    changed.
    """
    quick = np.isclose(p.tau, FAST) & (p.onset > 0.5)
    p = p._replace(tau=np.where(quick, QUICK, p.tau))
    tried = [p]
    for q in np.flatnonzero(np.isclose(p.tau, SLOW)):
        for change in CHANGES:
            onset = p.onset.copy()
            onset[q] += change
            tried.append(p._replace(onset=onset))
    return min(tried, key=settling_s)


def settling_s(p: Parameters) -> float:
    """Return the longest time until the error of a constant tilt stays below `SETTLED_DEG` [s]."""
    steps, azimuth, tilt = round(WAIT_S * RATE_HZ), np.arange(4) * np.pi / 2, np.radians(TILT_DEG)
    up = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(4, np.cos(tilt))])
    force = np.repeat(up[None].astype(F), steps, axis=0)
    none, zero = np.zeros((steps, 4), np.bool_), np.zeros((3, 4), F)
    trace = run_streams(p, Streams(0 * force, force, none, force, zero, none[0]))
    away = np.flatnonzero((cosine(trace, up) < np.cos(np.radians(SETTLED_DEG))).any(axis=1))
    return float(away[-1] + 1) / RATE_HZ if away.size else 0.0
