"""The gradient of a run of the circuit in floats, for n copies at once.

The gradient is the exact derivative of `estimators.circuit.floats.run_floats`, with two exceptions: inputs of
gates are treated as constants, and a closed or fully open gate passes the share `LEAK` of a gradient that
would move it back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.circuit.floats import (
    BIAS_MAX,
    DT,
    SMOOTH,
    F,
    Senses,
    Signals,
    Steps,
    new_trace,
    run_floats,
    stepped,
    unbiased,
)
from estimators.circuit.parameters import FELT, LEARNT, OUTPUT, RATE_HZ, Parameters
from quadsim.runs.compiled import njit

from .streams import Streams

Floats = NDArray[np.float32]
LEAK = F(0.3)
ROUNDING = 0.02
"""Error below which the loss is approximately quadratic, and above which it is linear."""
LENGTH_COST = 0.02
"""Weight of the squared difference between the length of the estimate and 1."""


def new_run(p: Parameters, batch: Streams) -> tuple[Signals, Senses]:
    """Return arrays for a run over a batch, with the initial state; attitude and bias can be known."""
    trace, senses = new_trace(p, len(batch.angle), len(batch.known))
    known = np.flatnonzero(batch.known)
    trace.x[0][:, :, known] = p.start[:, None, None] * batch.up[0][:, known]
    trace.bias[0][:, known] = batch.bias[:, known]
    senses.u[:, known] = 0
    return trace, senses


def loss_and_gradient(p: Parameters, batch: Streams, weights: Floats) -> tuple[float, Parameters, Signals]:
    """Compute the loss of a batch of streams and its gradient.

    Args:
        p: Parameters of the circuit.
        batch: Readings, and the world's z axis as the target.
        weights: Weights of the streams (n,).

    Returns:
        The loss, which is the mean of √(|error|² + ROUNDING²) - ROUNDING of the normalised estimate plus the
        cost of its length; the gradient of the parameters `LEARNT`; and the trace.
    """
    w, (trace, senses) = stepped(p), new_run(p, batch)
    run_floats(batch.angle, batch.force, batch.again, w, trace, senses)
    loss, outer = _loss(trace.x[1:, OUTPUT], batch.up, weights / (weights.sum() * len(batch.angle)))
    slopes = Steps._make(map(np.zeros_like, w))
    opened, onset = np.zeros_like(trace.opened), np.zeros_like(w.level)
    _backward(batch.angle, batch.force, w, trace, outer, slopes, opened)
    _gates(opened, trace, w.share, batch.again, batch.known, slopes, onset)
    dt = 1 / RATE_HZ
    body = {"mix": (0, dt), "pull": (0, dt), "give": (1, dt), "take": (1, 1.0), "read": (1, 1.0)}
    found = {name: _planes(getattr(slopes, name), axis) * unit for name, (axis, unit) in body.items()}
    found |= {name: getattr(slopes, name) for name in ("gate", "level", "resume")}
    found |= {"learn": slopes.learn * dt, "onset": onset}
    rest = {name: np.zeros_like(value) for name, value in p._asdict().items() if name not in LEARNT}
    return loss, p._replace(**rest, **{name: each.astype(np.float64) for name, each in found.items()}), trace


def run_streams(p: Parameters, batch: Streams) -> Signals:
    """Run the circuit on streams."""
    trace, senses = new_run(p, batch)
    run_floats(batch.angle, batch.force, batch.again, stepped(p), trace, senses)
    return trace


def cosine(trace: Signals, up: Floats) -> Floats:
    """Return the cosine of the angle between estimates and targets (T, 3, n), shape (T, n)."""
    estimate = trace.x[1:, OUTPUT]
    return (estimate * up).sum(1) / np.linalg.norm(estimate, axis=1)


def _planes(values: Floats, axis: int) -> Floats:
    """Return sums over the horizontal axes, and the vertical axis."""
    x, y, z = np.moveaxis(values, axis, 0)
    return np.stack([x + y, z], axis)


def _loss(estimate: Floats, up: Floats, weights: Floats) -> tuple[float, Floats]:
    """Return the loss of estimates (T, 3, n) and its gradient."""
    length = np.sqrt((estimate * estimate).sum(1, keepdims=True)) + F(1e-3)
    direction = estimate / length
    error = direction - up
    size = np.sqrt((error * error).sum(1, keepdims=True) + F(ROUNDING**2))
    excess = length - 1
    loss = float(((size - F(ROUNDING) + F(LENGTH_COST) * excess * excess) * weights).sum())
    slope = error / size * weights
    outer = (slope - direction * (direction * slope).sum(1, keepdims=True)) / length
    return loss, (outer + F(2 * LENGTH_COST) * excess * direction * weights).astype(F)


@njit(cache=True, error_model="numpy", fastmath=True)
def _backward(angle, force, w, trace, outer, slopes, of_opened):
    """Backpropagate the gradient of the estimates (T, 3, n), and add to the last two arguments."""
    n, (gates, vectors) = angle.shape[2], (w.give.shape[0], w.pull.shape[1])
    x_bar, earlier = np.zeros((vectors, 3, n), F), np.zeros((vectors, 3, n), F)
    b_bar, e_bar = np.zeros((3, n), F), np.zeros((gates, 3, n), F)
    d_bar, d = np.zeros((gates, 3, n), F), np.zeros((gates, 3, n), F)
    for t in range(angle.shape[0] - 1, -1, -1):
        for i in range(3):
            for c in range(n):
                x_bar[OUTPUT, i, c] += outer[t, i, c]
        x, e, opened = trace.x[t], trace.e[t + 1], trace.opened[t]
        for q in range(gates):
            for i in range(3):
                for c in range(n):
                    share = min(max(opened[q, c], F(0)), F(1))
                    d[q, i, c] = min(max(share * min(max(e[q, i, c], F(-2)), F(2)), F(-1)), F(1))
                    d_bar[q, i, c] = 0
        b_bar *= np.abs(trace.bias[t + 1]) < 2 * BIAS_MAX
        turn, free = unbiased(angle[t], trace.bias[t]), np.abs(trace.bias[t]) < BIAS_MAX
        b_next = b_bar + free * _turned_back(turn, x, x_bar, earlier)
        _mixed_back(force[t], x, x_bar, earlier, w, slopes)
        _learnt_back(x, d, b_bar, earlier, d_bar, w, slopes)
        _passed_back(force[t], x, x_bar, e, opened, d, d_bar, e_bar, earlier, w, slopes, of_opened[t])
        x_bar, earlier = earlier, x_bar
        b_bar = b_next


@njit(fastmath=True)
def _turned_back(turn, x, x_bar, earlier):
    """Backpropagate through the rotation of the vectors; return the gradient of the bias."""
    n = turn.shape[1]
    cross, by_bias = np.empty((3, n), F), np.zeros((3, n), F)
    for m in range(x.shape[0]):
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                cross[i, c] = turn[j, c] * x_bar[m, k, c] - turn[k, c] * x_bar[m, j, c]
                by_bias[i, c] += DT * (x[m, j, c] * x_bar[m, k, c] - x[m, k, c] * x_bar[m, j, c])
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                second = turn[j, c] * cross[k, c] - turn[k, c] * cross[j, c]
                earlier[m, i, c] = x_bar[m, i, c] + cross[i, c] + F(0.5) * second
    return by_bias


@njit(fastmath=True)
def _mixed_back(force, x, x_bar, earlier, w, slopes):
    """Backpropagate through the linear mixing and the correction by the specific force."""
    n, vectors = force.shape[1], x.shape[0]
    for i in range(3):
        for m in range(vectors):
            total = F(0)
            for c in range(n):
                total += x_bar[m, i, c] * force[i, c]
            slopes.pull[i, m] += total
            for other in range(vectors):
                total = F(0)
                for c in range(n):
                    total += x_bar[m, i, c] * x[other, i, c]
                    earlier[other, i, c] += w.mix[i, m, other] * x_bar[m, i, c]
                slopes.mix[i, m, other] += total


@njit(fastmath=True)
def _learnt_back(x, d, b_bar, earlier, d_bar, w, slopes):
    """Backpropagate through the products that update the bias."""
    n = b_bar.shape[1]
    for p in range(w.learn.size):
        m, q, kappa, total = w.pairs[p, 0], w.pairs[p, 1], w.learn[p], F(0)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                earlier[m, i, c] += kappa * (d[q, j, c] * b_bar[k, c] - d[q, k, c] * b_bar[j, c])
                d_bar[q, i, c] += kappa * (b_bar[j, c] * x[m, k, c] - b_bar[k, c] * x[m, j, c])
                total += b_bar[i, c] * (x[m, j, c] * d[q, k, c] - x[m, k, c] * d[q, j, c])
        slopes.learn[p] += total


@njit(fastmath=True)
def _passed_back(force, x, x_bar, e, opened, d, d_bar, e_bar, earlier, w, slopes, of_opened):
    """Backpropagate through innovations and gates."""
    n, vectors = force.shape[1], x.shape[0]
    for q in range(e.shape[0]):
        for i in range(3):
            for m in range(vectors):
                total = F(0)
                for c in range(n):
                    d_bar[q, i, c] += w.give[q, i, m] * x_bar[m, i, c]
                    total += x_bar[m, i, c] * d[q, i, c]
                slopes.give[q, i, m] += total
            total = F(0)
            for c in range(n):
                share = min(max(opened[q, c], F(0)), F(1))
                kept = min(max(e[q, i, c], F(-2)), F(2))
                inside = F(abs(share * kept) < 1)
                of_opened[q, c] += inside * d_bar[q, i, c] * kept
                of_e = e_bar[q, i, c] + d_bar[q, i, c] * inside * F(abs(e[q, i, c]) < 2) * share
                e_bar[q, i, c] = (F(1) - SMOOTH) * of_e
                d_bar[q, i, c] = SMOOTH * of_e
                total += d_bar[q, i, c] * force[i, c]
            slopes.read[q, i] += total
            for m in range(vectors):
                total = F(0)
                for c in range(n):
                    earlier[m, i, c] += w.take[q, i, m] * d_bar[q, i, c]
                    total += d_bar[q, i, c] * x[m, i, c]
                slopes.take[q, i, m] += total


@njit(cache=True, error_model="numpy", fastmath=True)
def _gates(slope, trace, share, again, known, slopes, onset):
    """Backpropagate from the gates to their weights, biases, starts and gains after gaps."""
    steps, gates, n = slope.shape
    u_bar = np.zeros((gates, n), F)
    for t in range(steps - 1, -1, -1):
        for q in range(gates):
            for c in range(n):
                opened, down = trace.opened[t, q, c], slope[t, q, c]
                if opened >= 1:
                    down *= LEAK * (down > 0)
                elif opened <= 0:
                    down *= LEAK * (down < 0)
                slopes.level[q] += down
                u_bar[q, c] += down
                for k in range(FELT):
                    slopes.gate[q, k] += u_bar[q, c] * share[q] * trace.felt[t, k, c]
                u_bar[q, c] *= F(1) - share[q]
                if again[t, c]:
                    slopes.resume[q] += u_bar[q, c]
    for q in range(gates):
        for c in range(n):
            if not known[c]:
                onset[q] += u_bar[q, c]
