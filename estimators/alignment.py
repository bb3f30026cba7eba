"""What the encoder finds out about a flight: the tilt at an unknown start, and the gyroscope's bias.

Drag takes k v from a lateral speed v, and all but it is the lateral specific force: f = −k v (Martin &
Salaün, "The true role of accelerometer feedback in quadrotor control", ICRA 2010). Gravity speeds a vehicle
up to where it leans. In the axes of `estimators.tilt`, x + iy as one complex number, with the lean
λ = θ_y − i θ_x of a tilt θ [rad], the gyroscope's reading ω, its bias b in body axes, and the heading r of
length 1:

    ḟ = −k (f + g λ),    λ̇ = −i (ω − r b),    ḃ = 0.

At rest the first holds as well, whatever k: the force is the ground's then, f = −g λ. A Kalman filter of
these three measures the lateral force; weakly, that a lean does not last, but for its mean, which tells the
bias where the force is none of drag's, as in a hand; and where the readings of neither sensor change, that
what the gyroscope reads is its bias (a zero-rate update, as VQF's, Laidig & Seel 2023). Wind and all that
drag is not make the force walk at random; how far is taken from the corrections of the force that are found
to be needed (Myers & Tapley, "Adaptive sequential estimation with unknown noise statistics", IEEE Trans.
Autom. Control 21(4), 1976). Nothing prefers x or y, so that one Hermitian covariance is that of both.
Inertial navigation calls the first seconds of this the initial alignment.

The network is told by a turn: for a first second all that is found out about the lean, as if there were no
gusts, is added to the turn rates; from then on the bias is taken off, and with each correction of it what it
has done to the attitude that the network still remembers.
"""

from __future__ import annotations

import math

from numba import njit

from quadsim.vehicle import GRAVITY

from .tilt import RATE_MAX

KEPT = 40
"""What is kept: the time since the start, that since the last sample, and that at rest; force, lean and bias;
their variances; the covariances of force and lean, force and bias, lean and bias; what a bias of 1 does to
the attitude that is remembered; samples; the six readings in a fast and in a slow low-pass; the late
corrections of the force, summed, and the mean of that; the mean lean; the square of the random walk of the
force."""
LEAN, BIAS, EFFECT, SAMPLES, FAST, SLOW, CORRECTIONS, DRIFT, MEAN, GUST = 5, 7, 18, 20, 21, 27, 33, 35, 37, 39
"""Where these begin in it."""
FORCE_MAX = 5.0
"""How far a force counts as away from what is expected: a bad reading does no lasting harm [m/s²]."""
LEAN_MAX = 1.5
"""Largest lean that is believed, of each axis [rad]."""
BIAS_MAX = 0.1
"""Largest bias that is believed, of each axis [rad/s]."""
READING_MAX = 1000.0
"""Beyond which no reading counts further, in its unit."""
GAP_MAX = 0.5
"""Longest time between samples for which the rate is taken to have lasted [s]."""
LEAN_SD, TOLD_SD = 0.245, 0.01
"""Spread of the lean at the start, of each axis: unknown, and told [rad]."""
UPRIGHT_S, MEAN_S = 1.0, 20.0
"""Time for which a lean is taken to last about its mean, and the memory of that [s]."""
STEADY, CALM, BREEZE = 0.05, 0.15, 0.2
"""Random walk of the force: while the tilt at the start is looked for; later the least, and what is expected
before any is seen [m/s²/√s]."""
GAUGE_FROM_S, BREEZE_S, GUSTS_S = 0.25, 2.0, 20.0
"""Time without a look at it, that for which the expectation counts, and the memory of what is found [s]."""
CORRECTED_S, DRIFT_S = 0.5, 2.0
"""Memories of the corrections of the force, and of their mean, which is a bias's and no wind's [s]."""
GAUGE = 4.0
"""Their scatter is taken for this many times as much: what is slow is left out of it."""
TURN_NOISE = 0.015
"""Noise density of a turn rate, errors of scale included [rad/√s]."""
BIAS_WALK = 4e-4
"""Random walk of the bias [rad/s/√s]."""
REMEMBERED_S = 2.0
"""Time for which the network remembers a turn [s]."""
REST_S, FAST_S = 0.5, 0.1
"""How long a rest is before it counts, the slow low-pass's memory too; the fast one's [s]."""
REST_RATE, REST_FORCE = 0.01, 0.1
"""By how much the two may differ at rest [rad/s], [m/s²]."""
REST_NOISE = 0.01
"""Noise density of a turn rate at rest [rad/√s]."""


@njit(cache=True)
def follow(rates, forces, cosine, sine, step, align_s, drag, noise, spread, kept):
    """Take one sample into what is `kept`.

    Args:
        rates: Readings of the gyroscope, 3 [rad/s].
        forces: Of the accelerometer, 3 [m/s²].
        cosine: Of the heading.
        sine: Of the heading.
        step: Time between samples [s].
        align_s: Time for which all that is found out about the lean is told [s].
        drag: What drag takes from a lateral speed, k [1/s].
        noise: Noise density of a lateral force [m/s²·√s].
        spread: Standard deviation of the bias, of each axis [rad/s].
        kept: Shape (KEPT,), all 0 at the start; changed.

    Returns:
        How far the network's attitude is to turn about x and y of the body with this sample, beyond what the
        gyroscope says less the bias [rad].
    """
    heading = complex(cosine, sine)
    reading = complex(_within(forces[0], READING_MAX), _within(forces[1], READING_MAX))
    rate = complex(_within(rates[0], RATE_MAX), _within(rates[1], RATE_MAX))
    state, spreads, shared = _unpacked(kept)
    kept[SAMPLES] += 1.0
    if kept[SAMPLES] == 1.0:
        lean_sd = LEAN_SD if kept[0] < math.inf else TOLD_SD
        state = heading * reading, state[1], state[2]
        spreads = noise * noise / step, lean_sd * lean_sd, spread * spread
        kept[GUST] = BREEZE * BREEZE
    bias_before = state[2]
    elapsed, aligning = min(kept[1] + step, GAP_MAX), kept[0] < align_s
    gust = STEADY * STEADY if aligning else kept[GUST]
    walk = BIAS_WALK if spread > 0.0 else 0.0  # a bias that is known to be none stays none
    state, spreads, shared = _predicted(state, spreads, shared, rate, heading, elapsed, drag, gust, walk)
    lean_before = state[1]

    off = heading * reading - state[0]
    off = complex(_within(off.real, FORCE_MAX), _within(off.imag, FORCE_MAX))
    column = complex(spreads[0], 0.0), shared[0].conjugate(), shared[1].conjugate()
    force_before = state[0]
    variance = spreads[0] + noise * noise / step
    state, spreads, shared = _corrected(state, spreads, shared, column, off, variance)
    if kept[SAMPLES] * step > GAUGE_FROM_S:  # the first corrections are those of the start
        _gauge(state[0] - force_before, step, kept)

    if not aligning:
        column = shared[0], complex(spreads[1], 0.0), shared[2].conjugate()
        usual = complex(kept[MEAN], kept[MEAN + 1])
        variance = spreads[1] + LEAN_SD * LEAN_SD * UPRIGHT_S / step
        state, spreads, shared = _corrected(state, spreads, shared, column, usual - state[1], variance)
    seen = step / min(UPRIGHT_S + kept[SAMPLES] * step, MEAN_S)
    kept[MEAN] += (state[1].real - kept[MEAN]) * seen
    kept[MEAN + 1] += (state[1].imag - kept[MEAN + 1]) * seen

    kept[2] = kept[2] + step if _unchanged(rates, forces, step, kept) else 0.0
    if kept[2] >= REST_S:
        column = shared[1], shared[2], complex(spreads[2], 0.0)
        variance = spreads[2] + REST_NOISE * REST_NOISE / step
        state, spreads, shared = _corrected(state, spreads, shared, column, rate - state[2], variance)

    _pack(state, spreads, shared, kept)
    _, lean, bias = _unpacked(kept)[0]
    if aligning:
        further = 1j * (lean - lean_before)
    else:
        further = (bias_before - bias) * complex(kept[EFFECT], kept[EFFECT + 1])
    kept[EFFECT] += step * (cosine - kept[EFFECT] / REMEMBERED_S)
    kept[EFFECT + 1] += step * (sine - kept[EFFECT + 1] / REMEMBERED_S)
    kept[1] = 0.0
    further = heading.conjugate() * further
    return further.real, further.imag


@njit(cache=True)
def _predicted(state, spreads, shared, rate, heading, elapsed, drag, gust, walk):
    """Advance force, lean and bias, their variances, and their covariances, by the time `elapsed`."""
    force, lean, bias = state
    force_var, lean_var, bias_var = spreads
    force_lean, force_bias, lean_bias = shared
    left, fall = 1.0 - drag * elapsed, drag * GRAVITY * elapsed
    turn = complex(-heading.imag * elapsed, heading.real * elapsed)
    state = left * force - fall * lean, lean + turn * (bias - rate), bias
    of_bias = left * force_bias - fall * lean_bias
    by_turn = turn.real * lean_bias.real + turn.imag * lean_bias.imag
    spreads = (
        left * left * force_var
        - 2.0 * left * fall * force_lean.real
        + fall * fall * lean_var
        + gust * elapsed,
        lean_var + 2.0 * by_turn + elapsed * elapsed * bias_var + TURN_NOISE * TURN_NOISE * elapsed,
        bias_var + walk * walk * elapsed,
    )
    shared = (
        left * force_lean - fall * lean_var + of_bias * turn.conjugate(),
        of_bias,
        lean_bias + bias_var * turn,
    )
    return state, spreads, shared


@njit(cache=True)
def _corrected(state, spreads, shared, column, innovation, variance):
    """Correct by one measurement: its column of the covariance, innovation, and the innovation's variance."""
    first, second, third = column
    scale = 1.0 / variance
    gain = innovation * scale
    state = state[0] + first * gain, state[1] + second * gain, state[2] + third * gain
    spreads = (
        spreads[0] - scale * _square(first),
        spreads[1] - scale * _square(second),
        spreads[2] - scale * _square(third),
    )
    shared = (
        shared[0] - scale * (first * second.conjugate()),
        shared[1] - scale * (first * third.conjugate()),
        shared[2] - scale * (second * third.conjugate()),
    )
    return state, spreads, shared


@njit(cache=True)
def _gauge(correction, step, kept):
    """Take a correction of the force into what is known of its random walk: their sum scatters as far."""
    kept[CORRECTIONS] += correction.real - kept[CORRECTIONS] * step / CORRECTED_S
    kept[CORRECTIONS + 1] += correction.imag - kept[CORRECTIONS + 1] * step / CORRECTED_S
    off_x, off_y = kept[CORRECTIONS] - kept[DRIFT], kept[CORRECTIONS + 1] - kept[DRIFT + 1]
    kept[DRIFT] += off_x * step / DRIFT_S
    kept[DRIFT + 1] += off_y * step / DRIFT_S
    walked = max(GAUGE * _square(complex(off_x, off_y)) / CORRECTED_S, CALM * CALM)
    kept[GUST] += (walked - kept[GUST]) * step / min(BREEZE_S + kept[SAMPLES] * step, GUSTS_S)


@njit(cache=True)
def _unchanged(rates, forces, step, kept):
    """Take both readings into their low-passes; whether these agree."""
    fast = 1.0 / min(kept[SAMPLES], FAST_S / step)
    slow = 1.0 / min(kept[SAMPLES], REST_S / step)
    still = True
    for k in range(6):
        value = rates[k] if k < 3 else forces[k - 3]
        kept[FAST + k] += fast * (_within(value, READING_MAX) - kept[FAST + k])
        kept[SLOW + k] += slow * (_within(value, READING_MAX) - kept[SLOW + k])
        limit = REST_RATE if k < 3 else REST_FORCE
        if abs(kept[FAST + k] - kept[SLOW + k]) > limit or (k < 3 and abs(kept[SLOW + k]) > BIAS_MAX):
            still = False
    return still


@njit(cache=True)
def _unpacked(kept):
    state = complex(kept[3], kept[4]), complex(kept[5], kept[6]), complex(kept[7], kept[8])
    spreads = kept[9], kept[10], kept[11]
    shared = complex(kept[12], kept[13]), complex(kept[14], kept[15]), complex(kept[16], kept[17])
    return state, spreads, shared


@njit(cache=True)
def _pack(state, spreads, shared, kept):
    for k in range(3):
        limit = BIAS_MAX if k == 2 else LEAN_MAX if k == 1 else READING_MAX
        kept[3 + 2 * k], kept[4 + 2 * k] = _within(state[k].real, limit), _within(state[k].imag, limit)
        kept[9 + k] = spreads[k]
        kept[12 + 2 * k], kept[13 + 2 * k] = shared[k].real, shared[k].imag


@njit(cache=True)
def _square(value):
    return value.real * value.real + value.imag * value.imag


@njit(cache=True)
def _within(value, limit):
    return min(max(value, -limit), limit)
