"""Att-RNN: the circuit in floats, for n copies at once. The training also uses it.

The equations are those of `estimators.circuit.parameters`, with one Euler step per sample; the turn is
x - θ × x + θ × (θ × x) / 2 for an angle θ = (ω - b) dt. Arrays have the copies last: (time, axis, copy).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..networks.encoder import ENCODED, INPUT_ONE, Scaling, encode_sample, encoder_fields, resumed
from .circuit_records import BIAS_RATE
from .parameters import FELT, FELT_RATE, FELT_S, OUTPUT, RATE_HZ, SMOOTH_S, Parameters

F = np.float32
Floats = NDArray[np.float32]
DT = F(1 / RATE_HZ)
_FELT_STEP, _FELT_TURN = F(1 / (RATE_HZ * FELT_S)), F(RATE_HZ / FELT_RATE)
BIAS_MAX = F(BIAS_RATE)
"""Largest bias that is subtracted from a rate, and half of the largest bias in the state [rad/s]."""
SMOOTH = F(-np.expm1(-1 / (RATE_HZ * SMOOTH_S)))
"""Smoothing factor of an innovation per sample."""
CHUNK = 500
"""Number of samples that an estimator processes at once, which limits its memory."""


class Steps(NamedTuple):
    """Parameters for the kernels, float32, per step; an axis of length 3 is that of the body."""

    mix: Floats  #: (3, V, V)
    pull: Floats  #: (3, V)
    give: Floats  #: (Q, 3, V)
    take: Floats  #: (Q, 3, V)
    read: Floats  #: (Q, 3)
    learn: Floats  #: (pairs,)
    gate: Floats  #: (Q, 5)
    level: Floats  #: (Q,)
    resume: Floats  #: (Q,)
    share: Floats  #: of the way that a gate goes in a step (Q,)
    pairs: NDArray[np.int64]  #: (pairs, 2)


class Signals(NamedTuple):
    """Trace of a run over T samples, starting with the initial state, for the gradient."""

    x: Floats  #: vectors (T + 1, V, 3, n)
    bias: Floats  #: (T + 1, 3, n) [rad/s]
    e: Floats  #: innovations, smoothed (T + 1, Q, 3, n)
    felt: Floats  #: (T, 5, n)
    opened: Floats  #: gates before they are clipped (T, Q, n)


class Senses(NamedTuple):
    """The other parts of the state, changed in place."""

    smooth: Floats  #: force, rate and surprise, smoothed (9, n)
    u: Floats  #: of the gates (Q, n)


def stepped(p: Parameters) -> Steps:
    """Convert parameters for the kernels."""
    dt = 1 / RATE_HZ
    values = (
        p.mix[[0, 0, 1]] * dt, p.pull[[0, 0, 1]] * dt, p.give[:, [0, 0, 1]] * dt, p.take[:, [0, 0, 1]],
        p.read[:, [0, 0, 1]], p.learn * dt, p.gate, p.level, p.resume, dt / p.tau,
    )  # fmt: skip
    return Steps(*(np.ascontiguousarray(each, F) for each in values), pairs=p.pairs)


@njit(cache=True)
def _room(steps, vectors, gates, n):
    return Signals(
        np.empty((steps + 1, vectors, 3, n), F),
        np.empty((steps + 1, 3, n), F),
        np.empty((steps + 1, gates, 3, n), F),
        np.empty((steps, FELT, n), F),
        np.empty((steps, gates, n), F),
    )


def new_trace(p: Parameters, steps: int, n: int) -> tuple[Signals, Senses]:
    """Return arrays for a run of n copies over T samples, with the initial state."""
    trace = _room(steps, len(p.start), len(p.level), n)
    trace.x[0], trace.bias[0], trace.e[0] = 0, 0, 0
    trace.x[0, :, 2] = p.start[:, None]
    return trace, Senses(np.zeros((9, n), F), np.tile(p.onset.astype(F)[:, None], n))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def run_floats(angle, force, again, w, trace, senses):
    """Run n copies over T samples.

    Args:
        angle: Body rate times the time of a sample (T, 3, n) [rad].
        force: Specific force (T, 3, n) [9.81 m/s²].
        again: Whether a sample is the first after a gap in the readings (T, n).
        w: Parameters.
        trace: Trace of the run; x[0], bias[0] and e[0] are read, the rest is written.
        senses: Other parts of the state, changed in place.
    """
    for t in range(angle.shape[0]):
        _feel(t, angle[t], force[t], again[t], w, trace, senses)
        _turn_and_mix(unbiased(angle[t], trace.bias[t]), force[t], w, trace.x[t], trace.x[t + 1])
        _innovate(t, force[t], w, trace)
        _learn(t, w, trace)


@njit(inline="always")
def _share(v):
    return min(max(v, F(0)), F(1))


@njit
def unbiased(angle, bias):
    """Subtract the bias from the angles of a sample (3, n)."""
    found = np.empty_like(angle)
    for i in range(3):
        for c in range(angle.shape[1]):
            found[i, c] = angle[i, c] - min(max(bias[i, c], -BIAS_MAX), BIAS_MAX) * DT
    return found


@njit(inline="always")
def _passed(opened, e):
    """Return the gated innovation d = clip(r clip(e, ±2), ±1)."""
    return min(max(_share(opened) * min(max(e, F(-2)), F(2)), F(-1)), F(1))


@njit
def _feel(t, angle, force, again, w, trace, senses):
    """Compute the inputs of the gates in this sample, and the gates."""
    smooth, u, felt = senses.smooth, senses.u, trace.felt[t]
    for i in range(3):
        still = F(i == 2)
        for c in range(angle.shape[1]):
            smooth[i, c] += _FELT_STEP * (force[i, c] - still - smooth[i, c])
            smooth[3 + i, c] += _FELT_STEP * (angle[i, c] * _FELT_TURN - smooth[3 + i, c])
            smooth[6 + i, c] += _FELT_STEP * (force[i, c] - trace.x[t, 0, i, c] - smooth[6 + i, c])
    felt[:] = 0
    for k in range(9):
        kind = 4 if k > 5 else 2 * (k // 3) + (k % 3 == 2)
        for c in range(angle.shape[1]):
            felt[kind, c] += min(abs(smooth[k, c]), F(1))
    for q in range(u.shape[0]):
        for c in range(u.shape[1]):
            heard = F(0)
            for k in range(FELT):
                heard += w.gate[q, k] * felt[k, c]
            if again[c]:
                u[q, c] += w.resume[q]
            u[q, c] += w.share[q] * (heard - u[q, c])
            trace.opened[t, q, c] = u[q, c] + w.level[q]


@njit
def _turn_and_mix(angle, force, w, x, following):
    """Rotate, mix and correct all vectors."""
    n, vectors = angle.shape[1], x.shape[0]
    cross = np.empty((3, n), F)
    for m in range(vectors):
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                cross[i, c] = angle[j, c] * x[m, k, c] - angle[k, c] * x[m, j, c]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                second = angle[j, c] * cross[k, c] - angle[k, c] * cross[j, c]
                following[m, i, c] = x[m, i, c] - cross[i, c] + F(0.5) * second + w.pull[i, m] * force[i, c]
            for other in range(vectors):
                for c in range(n):
                    following[m, i, c] += w.mix[i, m, other] * x[other, i, c]


@njit
def _innovate(t, force, w, trace):
    """Compute smoothed and gated innovations."""
    x, following, e, opened = trace.x[t], trace.x[t + 1], trace.e[t + 1], trace.opened[t]
    n, vectors = force.shape[1], x.shape[0]
    passed = np.empty(n, F)
    for q in range(e.shape[0]):
        for i in range(3):
            for c in range(n):
                passed[c] = w.read[q, i] * force[i, c]
            for m in range(vectors):
                for c in range(n):
                    passed[c] += w.take[q, i, m] * x[m, i, c]
            for c in range(n):
                e[q, i, c] = trace.e[t, q, i, c] + SMOOTH * (passed[c] - trace.e[t, q, i, c])
                passed[c] = _passed(opened[q, c], e[q, i, c])
            for m in range(vectors):
                for c in range(n):
                    following[m, i, c] += w.give[q, i, m] * passed[c]


@njit
def _learn(t, w, trace):
    """Update the gyroscope bias."""
    bias, following = trace.bias[t], trace.bias[t + 1]
    n = bias.shape[1]
    passed = np.empty((3, n), F)
    following[:] = bias
    for p in range(w.learn.size):
        q = w.pairs[p, 1]
        x, e, opened = trace.x[t, w.pairs[p, 0]], trace.e[t + 1, q], trace.opened[t, q]
        for i in range(3):
            for c in range(n):
                passed[i, c] = _passed(opened[c], e[i, c])
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(n):
                following[i, c] += w.learn[p] * (x[j, c] * passed[k, c] - x[k, c] * passed[j, c])
    for i in range(3):
        for c in range(n):
            following[i, c] = min(max(following[i, c], -2 * BIAS_MAX), 2 * BIAS_MAX)


class FloatCircuit:
    """The circuit in floats, a `NetworkCore`."""

    outputs = 3

    def __init__(self, scaling: Scaling, p: Parameters) -> None:
        vectors, gates = len(p.start), len(p.level)
        sizes = {"x": 3 * vectors, "bias": 3, "e": 3 * gates, "smooth": 9, "u": gates, "begun": 1}
        self.state = np.dtype([*encoder_fields(F), *((name, F, size) for name, size in sizes.items())])
        self.arrays = np.ravel(scaling), stepped(p), p.start.astype(F), p.onset.astype(F)
        self.kernel = _run_states


@njit(cache=True, nogil=True)
def _run_states(gyro, accel, set_points, scaling, w, start, onset, states, out):
    """Run n copies and update their states, with the signature of `NetworkCore.kernel`."""
    n, samples = gyro.shape[0], gyro.shape[1] // 3
    vectors, gates = start.size, onset.size
    scales = Scaling(scaling[:6], scaling[6:])
    ends = np.cumsum(np.array([ENCODED, 3 * vectors, 3, 3 * gates, 9, gates]))
    _, xs, biases, es, smooth, us, begun = np.split(states, ends, axis=1)
    first_of_all = begun[:, 0] == 0
    for c in range(n):
        if first_of_all[c]:
            begun[c, 0] = 1
            xs[c, 2::3], us[c] = start, onset
    for first in range(0, samples, CHUNK):
        steps = min(CHUNK, samples - first)
        angle, force = np.empty((steps, 3, n), F), np.empty((steps, 3, n), F)
        again = np.empty((steps, n), np.bool_)
        trace = _room(steps, vectors, gates, n)
        for c in range(n):
            for t in range(steps):
                here = slice(3 * (first + t), 3 * (first + t) + 3)
                encode_sample(gyro[c, here], accel[c, here], scales, states[c])
                again[t, c] = resumed(states[c]) and not (first_of_all[c] and first + t == 0)
                for i in range(3):
                    angle[t, i, c] = states[c, i] * F(2.0**-17)
                    force[t, i, c] = states[c, 3 + i] * F(1 / INPUT_ONE)
        senses = Senses(np.ascontiguousarray(smooth.T), np.ascontiguousarray(us.T))
        kept = (
            (xs, trace.x.reshape(steps + 1, 3 * vectors, n)),
            (biases, trace.bias),
            (es, trace.e.reshape(steps + 1, 3 * gates, n)),
        )
        for state, signal in kept:
            signal[0] = state.T
        run_floats(angle, force, again, w, trace, senses)
        for state, signal in kept:
            state[:] = signal[steps].T
        smooth[:], us[:] = senses.smooth.T, senses.u.T
        for c in range(n):
            for t in range(steps):
                for i in range(3):
                    out[c, 3 * (first + t) + i] = trace.x[t + 1, OUTPUT, i, c] - (i == 2)
