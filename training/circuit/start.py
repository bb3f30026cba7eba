"""The start of a trained circuit: what flight asks of it, and recorded flights do not teach."""

from __future__ import annotations

import numpy as np

from estimators.circuit.floats import F, new_trace, run_floats, stepped
from estimators.circuit.parameters import FAST, OUTPUT, RATE_HZ, SLOW, Parameters

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
    rest, force = np.zeros((steps, 3, 4), F), np.repeat(up[None].astype(F), steps, axis=0)
    trace, senses = new_trace(p, steps, 4)
    run_floats(rest, force, np.zeros((steps, 4), np.bool_), stepped(p), trace, senses)
    estimate = trace.x[1:, OUTPUT]
    cosine = (estimate * up).sum(1) / np.linalg.norm(estimate, axis=1)
    away = np.flatnonzero((cosine < np.cos(np.radians(SETTLED_DEG))).any(axis=1))
    return float(away[-1] + 1) / RATE_HZ if away.size else 0.0
