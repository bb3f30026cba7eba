"""What the encoder finds out about a flight: the tilt at an unknown start, and the biases of both sensors.

Drag takes k v from a lateral speed v, and all but it is the lateral specific force: f = −k v (Martin &
Salaün, "The true role of accelerometer feedback in quadrotor control", ICRA 2010). Gravity speeds a vehicle
up to where it leans. In the axes of `estimators.tilt`, x + iy as one complex number, with the lean λ of size
sin θ at a tilt θ, the gyroscope's reading ω, its bias b and the accelerometer's a in body axes, the heading
r of length 1, and the reading y of the lateral force:

    ḟ = −k (f + g λ),    λ̇ = −i √(1 − |λ|²) (ω − r b),    ḃ = 0,    ȧ = 0,    y = f + r a.

At rest these hold as well, whatever k: the force is the ground's then, f = −g λ. A Kalman filter of the four
measures the lateral force; weakly, that a lean does not last, but for its mean, which tells the gyroscope's
bias where the force is none of drag's, as in a hand; and where the readings of neither sensor change, that
what the gyroscope reads is its bias (a zero-rate update, as VQF's, Laidig & Seel 2023). A lean that is known
at the start, or that changes, tells the accelerometer's bias from a tilt, and a known one nearly whole.

Wind and all that drag is not make the force walk at random; how far is taken from the corrections of the
force that are found to be needed (Myers & Tapley, "Adaptive sequential estimation with unknown noise
statistics", IEEE Trans. Autom. Control 21(4), 1976), and at once where the force is not what it should be.
Vibration is noise of the reading, found from sample to sample.
Nothing prefers x or y, so that one Hermitian covariance is that of both. Inertial navigation calls the first
seconds of this the initial alignment.

The network is told by a turn: for a first second all that is found out about the lean, as if there were no
gusts, is added to the turn rates; from then on the bias is taken off, and with each correction of it what it
has done to the attitude that the network still remembers. The accelerometer's is taken off its reading.
"""

from __future__ import annotations

import math

from numba import njit

from quadsim.vehicle import GRAVITY

from .tilt import RATE_MAX

KEPT = 54
"""What is kept: the time since the start, that since the last sample, and that at rest; force, lean and the
biases of gyroscope and accelerometer; their variances; the covariances of force and lean, force and the
first, lean and the first, and of these three and the second; what a bias of 1 does to the attitude that is
remembered; samples; the six readings in a fast and in a slow low-pass; the late corrections of the force,
summed, and the mean of that; the mean lean; the square of the random walk of the force; by how much the
force has lately been off; and the variance of that between samples, with the last."""
LEAN, BIAS, ACCEL_BIAS, EFFECT, SAMPLES = 5, 7, 9, 27, 29
FAST, SLOW, CORRECTIONS, DRIFT, MEAN, GUST, MISSED, NOISE = 30, 36, 42, 44, 46, 48, 49, 51
"""Where these begin in it; `BIAS` is the gyroscope's."""
FORCE_MAX = 5.0
"""How far a force counts as away from what is expected: a bad reading does no lasting harm [m/s²]."""
LEAN_MAX = 0.95
"""Largest lean that is believed, of each axis."""
UPRIGHT_MIN = 0.3
"""Least cosine of a tilt that is believed."""
BIAS_MAX, ACCEL_BIAS_MAX = 0.1, 2.0
"""Largest biases that are believed, of each axis [rad/s], [m/s²]."""
READING_MAX = 1000.0
"""Beyond which no reading counts further, in its unit."""
GAP_MAX = 0.5
"""Longest time between samples for which the rate is taken to have lasted [s]."""
LEAN_SD, TOLD_SD = 0.245, 0.008
"""Spread of the lean at the start, of each axis: unknown, and told."""
UPRIGHT_S, MEAN_S = 5.0, 20.0
"""Time for which a lean is taken to last about its mean, and the memory of that [s]."""
STEADY, CALM, BREEZE = 0.05, 0.03, 0.2
"""Random walk of the force: while the tilt at the start is looked for; later the least, and what is expected
before any is seen [m/s²/√s]."""
GAUGE_FROM_S, BREEZE_S, GUSTS_S = 0.1, 0.1, 20.0
"""Time without a look at it, that for which the expectation counts, and the memory of what is found [s]."""
CORRECTED_S, DRIFT_S = 0.5, 2.0
"""Memories of the corrections of the force, and of their mean, which is a bias's and no wind's [s]."""
GAUGE = 2.0
"""Their scatter is taken for this many times as much: what is slow is left out of it."""
SUDDEN_S, SUDDEN = 0.1, 4.0
"""Memory of how far the force is off [s], and how many times the variance of noise in it that may be."""
NOISE_S = 1.0
"""Memory of the noise of the force [s]."""
TURN_NOISE, TURN_ERROR = 0.003, 0.01
"""Noise density of a turn rate [rad/s/√Hz], and further in proportion to it [√s]."""
BIAS_WALK, ACCEL_BIAS_WALK = 4e-4, 0.006
"""Random walks of the biases [rad/s/√s], [m/s²/√s]."""
REMEMBERED_S = 2.0
"""Time for which the network remembers a turn [s]."""
REST_S, FAST_S = 0.5, 0.1
"""How long a rest is before it counts, the slow low-pass's memory too; the fast one's [s]."""
REST_RATE, REST_FORCE = 0.01, 0.1
"""By how much the two may differ at rest [rad/s], [m/s²]."""
REST_NOISE = 0.01
"""Noise density of a turn rate at rest [rad/√s]."""


@njit(cache=True)
def follow(rates, forces, cosine, sine, step, alignment, kept):
    """Take one sample into what is `kept`.

    Args:
        rates: Readings of the gyroscope, 3 [rad/s].
        forces: Of the accelerometer, 3 [m/s²].
        cosine: Of the heading.
        sine: Of the heading.
        step: Time between samples [s].
        alignment: Time for which all that is found out about the lean is told [s]; what drag takes from a
            lateral speed, k [1/s]; noise density of a lateral force [m/s²·√s]; standard deviations, of each
            axis, of the gyroscope's bias [rad/s] and of the accelerometer's [m/s²].
        kept: Shape (KEPT,), all 0 at the start; changed.

    Returns:
        How far the network's attitude is to turn about x and y of the body with this sample, beyond what the
        gyroscope says less its bias [rad].
    """
    align_s, drag, noise, bias_sd, offset_sd = alignment
    heading = complex(cosine, sine)
    back = heading.conjugate()
    reading = complex(_within(forces[0], READING_MAX), _within(forces[1], READING_MAX))
    rate = complex(_within(rates[0], RATE_MAX), _within(rates[1], RATE_MAX))
    state, spreads, shared = _unpacked(kept)
    kept[SAMPLES] += 1.0
    if kept[SAMPLES] == 1.0:
        lean_sd = LEAN_SD if kept[0] < math.inf else TOLD_SD
        offset_var = offset_sd * offset_sd
        state = heading * reading, state[1], state[2], state[3]
        spreads = noise * noise / step + offset_var, lean_sd * lean_sd, bias_sd * bias_sd, offset_var
        shared = shared[0], shared[1], shared[2], -offset_var * heading, shared[4], shared[5]
        kept[GUST] = BREEZE * BREEZE
    bias_before = state[2]
    elapsed, aligning = min(kept[1] + step, GAP_MAX), kept[0] < align_s
    gust = STEADY * STEADY if aligning else max(kept[GUST], _sudden(noise * noise, step, kept))
    turning = TURN_NOISE * TURN_NOISE + TURN_ERROR * TURN_ERROR * _square(rate)
    walks = gust, turning, _walk(BIAS_WALK, bias_sd), _walk(ACCEL_BIAS_WALK, offset_sd)
    upright = max(math.sqrt(max(1.0 - _square(state[1]), 0.0)), UPRIGHT_MIN)
    turn = complex(0.0, elapsed * upright) * heading
    state, spreads, shared = _predicted(state, spreads, shared, rate, turn, elapsed, drag, walks)
    lean_before = state[1]

    off = heading * (reading - state[3]) - state[0]
    off = complex(_within(off.real, FORCE_MAX), _within(off.imag, FORCE_MAX))
    white = _noise(off, noise * noise / step, step, kept)
    kept[MISSED] += (off.real - kept[MISSED]) * step / SUDDEN_S
    kept[MISSED + 1] += (off.imag - kept[MISSED + 1]) * step / SUDDEN_S
    column = (
        spreads[0] + back * shared[3],
        shared[0].conjugate() + back * shared[4],
        shared[1].conjugate() + back * shared[5],
        shared[3].conjugate() + back * spreads[3],
    )
    force_before = state[0]
    variance = spreads[0] + spreads[3] + 2.0 * (back * shared[3]).real + white
    state, spreads, shared = _corrected(state, spreads, shared, column, off, variance)
    if kept[SAMPLES] * step > GAUGE_FROM_S:  # the first corrections are those of the start
        _gauge(state[0] - force_before, step, kept)

    if not aligning:
        column = shared[0], complex(spreads[1], 0.0), shared[2].conjugate(), shared[4].conjugate()
        usual = complex(kept[MEAN], kept[MEAN + 1])
        variance = spreads[1] + LEAN_SD * LEAN_SD * UPRIGHT_S / step
        state, spreads, shared = _corrected(state, spreads, shared, column, usual - state[1], variance)
    seen = step / min(UPRIGHT_S + kept[SAMPLES] * step, MEAN_S)
    kept[MEAN] += (state[1].real - kept[MEAN]) * seen
    kept[MEAN + 1] += (state[1].imag - kept[MEAN + 1]) * seen

    kept[2] = kept[2] + step if _unchanged(rates, forces, step, kept) else 0.0
    if kept[2] >= REST_S:
        column = shared[1], shared[2], complex(spreads[2], 0.0), shared[5].conjugate()
        variance = spreads[2] + REST_NOISE * REST_NOISE / step
        state, spreads, shared = _corrected(state, spreads, shared, column, rate - state[2], variance)

    _pack(state, spreads, shared, kept)
    _, lean, bias, _ = _unpacked(kept)[0]
    if aligning:
        further = complex(0.0, 1.0 / upright) * (lean - lean_before)
    else:
        further = (bias_before - bias) * complex(kept[EFFECT], kept[EFFECT + 1])
    kept[EFFECT] += step * (cosine - kept[EFFECT] / REMEMBERED_S)
    kept[EFFECT + 1] += step * (sine - kept[EFFECT + 1] / REMEMBERED_S)
    kept[1] = 0.0
    further = back * further
    return further.real, further.imag


@njit(cache=True)
def _predicted(state, spreads, shared, rate, turn, elapsed, drag, walks):
    """Advance the state, its variances and covariances by the time `elapsed`; a bias of 1 turns by `turn`."""
    force, lean, bias, offset = state
    force_var, lean_var, bias_var, offset_var = spreads
    force_lean, force_bias, lean_bias, force_offset, lean_offset, bias_offset = shared
    left, fall = 1.0 - drag * elapsed, drag * GRAVITY * elapsed
    state = left * force - fall * lean, lean + turn * (bias - rate), bias, offset
    of_bias = left * force_bias - fall * lean_bias
    by_turn = turn.real * lean_bias.real + turn.imag * lean_bias.imag
    spreads = (
        left * left * force_var
        - 2.0 * left * fall * force_lean.real
        + fall * fall * lean_var
        + walks[0] * elapsed,
        lean_var + 2.0 * by_turn + _square(turn) * bias_var + walks[1] * elapsed,
        bias_var + walks[2] * elapsed,
        offset_var + walks[3] * elapsed,
    )
    shared = (
        left * force_lean - fall * lean_var + of_bias * turn.conjugate(),
        of_bias,
        lean_bias + bias_var * turn,
        left * force_offset - fall * lean_offset,
        lean_offset + turn * bias_offset,
        bias_offset,
    )
    return state, spreads, shared


@njit(cache=True)
def _corrected(state, spreads, shared, column, innovation, variance):
    """Correct by one measurement: its column of the covariance, innovation, and the innovation's variance."""
    a, b, c, d = column
    scale = 1.0 / variance
    gain = innovation * scale
    state = state[0] + a * gain, state[1] + b * gain, state[2] + c * gain, state[3] + d * gain
    spreads = (
        spreads[0] - scale * _square(a),
        spreads[1] - scale * _square(b),
        spreads[2] - scale * _square(c),
        spreads[3] - scale * _square(d),
    )
    shared = (
        shared[0] - scale * (a * b.conjugate()),
        shared[1] - scale * (a * c.conjugate()),
        shared[2] - scale * (b * c.conjugate()),
        shared[3] - scale * (a * d.conjugate()),
        shared[4] - scale * (b * d.conjugate()),
        shared[5] - scale * (c * d.conjugate()),
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
def _noise(off, least, step, kept):
    """Variance of a reading of the force, of each axis: a quarter of that of the change of what it is off."""
    change = off - complex(kept[NOISE + 1], kept[NOISE + 2]) if kept[SAMPLES] > 1.0 else 0.0j
    kept[NOISE] += (0.25 * _square(change) - kept[NOISE]) * step / NOISE_S
    kept[NOISE + 1], kept[NOISE + 2] = off.real, off.imag
    return max(kept[NOISE], least)


@njit(cache=True)
def _sudden(density, step, kept):
    """Square of the random walk that takes the force to where it has lately been off by more than noise."""
    off = _square(complex(kept[MISSED], kept[MISSED + 1]))
    return max(off - SUDDEN * max(kept[NOISE] * step, density) / SUDDEN_S, 0.0) / SUDDEN_S


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
def _pair(kept, k):
    return complex(kept[k], kept[k + 1])


@njit(cache=True)
def _unpacked(kept):
    state = _pair(kept, 3), _pair(kept, 5), _pair(kept, 7), _pair(kept, 9)
    spreads = kept[11], kept[12], kept[13], kept[14]
    shared = (
        _pair(kept, 15), _pair(kept, 17), _pair(kept, 19), _pair(kept, 21), _pair(kept, 23), _pair(kept, 25)
    )  # fmt: skip
    return state, spreads, shared


@njit(cache=True)
def _pack(state, spreads, shared, kept):
    limits = READING_MAX, LEAN_MAX, BIAS_MAX, ACCEL_BIAS_MAX
    for k in range(4):
        kept[3 + 2 * k] = _within(state[k].real, limits[k])
        kept[4 + 2 * k] = _within(state[k].imag, limits[k])
        kept[11 + k] = spreads[k]
    for k in range(6):
        kept[15 + 2 * k], kept[16 + 2 * k] = shared[k].real, shared[k].imag


@njit(cache=True)
def _walk(density, spread):
    return density * density if spread > 0.0 else 0.0  # a bias that is known to be none stays none


@njit(cache=True)
def _square(value):
    return value.real * value.real + value.imag * value.imag


@njit(cache=True)
def _within(value, limit):
    return min(max(value, -limit), limit)
