"""The start of a trained circuit: what flight asks of it, and recorded flights do not teach."""

from __future__ import annotations

import numpy as np

from estimators.circuit.floats import F
from estimators.circuit.parameters import FAST, RATE_HZ, SLOW, Parameters

from .gradient import cosine, run_batch
from .streams import Streams

QUICK = 4096 / (85 * 800)
"""Time constant of a gate that is open only at the start [s]."""
CHANGES = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)
"""Of the opening of a slow gate at the start."""
TILT_DEG, SETTLED_DEG, WAIT_S = 20.0, 1.0, 12.0
"""A constant tilt [deg], the error from which on it counts as found [deg], and how long is looked at [s]."""


def as_flown(p: Parameters) -> Parameters:
    """The circuit with the start that it flies with.

    Trained on recorded flights, which begin at any attitude, a circuit follows the force for half a second.
    In closed loop this turns a vehicle over that begins with a dash: the force says level while it tilts.
    So fast gates that are open at the start close five times sooner. To find a constant tilt soon all the
    same, one slow gate, whichever does it best, begins more or less open.
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
    """Time until the error of a constant tilt stays below `SETTLED_DEG`, the longest of four [s]."""
    steps, azimuth, tilt = round(WAIT_S * RATE_HZ), np.arange(4) * np.pi / 2, np.radians(TILT_DEG)
    up = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(4, np.cos(tilt))])
    force = np.repeat(up[None].astype(F), steps, axis=0)
    none, zero = np.zeros((steps, 4), np.bool_), np.zeros((3, 4), F)
    trace = run_batch(p, Streams(0 * force, force, none, force, zero, none[0]))
    away = np.flatnonzero((cosine(trace, up) < np.cos(np.radians(SETTLED_DEG))).any(axis=1))
    return float(away[-1] + 1) / RATE_HZ if away.size else 0.0
