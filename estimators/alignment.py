"""What the encoder finds out about a flight: the tilt at an unknown start, and the biases of both sensors.

Drag takes k v from a lateral speed v, and all but it is the lateral specific force: f = −k v (Martin &
Salaün, "The true role of accelerometer feedback in quadrotor control", ICRA 2010). Gravity speeds a vehicle
up to where it leans. In the axes of `estimators.tilt`, x + iy as one complex number, with the lean λ of size
sin θ at a tilt θ, the speed v over ground, the gyroscope's reading ω, its bias b and the accelerometer's a in
body axes, the heading r of length 1, and the reading y of the lateral force:

    v̇ = f + g λ,    ḟ = −k v̇,    λ̇ = −i √(1 − |λ|²) (ω − r b),    ḃ = 0,    ȧ = 0,    y = f + r a.

At rest these hold as well, whatever k: the force is the ground's then, f = −g λ. A Kalman filter of the five
measures the lateral force; weakly, that a speed does not last, for a vehicle that has been slow stays about
where it is, and all but not for one that has been fast; and where the readings of neither sensor change, that
what the gyroscope reads is its bias (a zero-rate update, as VQF's, Laidig & Seel 2023). A lean that is known
at the start, or that changes, tells the accelerometer's bias from a tilt, and a known one nearly whole.
A heading that drifts would turn wind, which then looks like a bias that turns with the body: what the
gyroscope reads about z in the mean is taken off, and believed the less the more the vehicle yaws.

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

import numpy as np
from numba import njit

from quadsim.vehicle import GRAVITY

from .tilt import RATE_MAX

F, L, B, A, V = range(5)
"""The state: force, lean, the biases of gyroscope and accelerometer, speed over ground."""
KEPT = 92
"""What is kept: the time since the start, that since the last sample, and that at rest; the state; its
covariance, row by row; what a gyroscope's bias of 1 does to the attitude that is remembered; samples; the six
readings in a fast and in a slow low-pass; the late corrections of the force, summed, and the mean of that;
the square of the random walk of the force; by how much the force has lately been off; the variance of that
between samples, with the last; the mean square of the speed, of each axis; and the gyroscope's bias about z,
its variance, and the mean square of the yaw rate."""
STATE, SPREAD, EFFECT, SAMPLES, FAST, SLOW = 3, 13, 63, 65, 66, 72
CORRECTIONS, DRIFT, GUST, MISSED, NOISE, SPEED, YAW_BIAS = 78, 80, 82, 83, 85, 88, 89
LEAN, BIAS, ACCEL_BIAS = STATE + 2 * L, STATE + 2 * B, STATE + 2 * A
"""Where these begin in it."""
FORCE_MAX = 5.0
"""How far a force counts as away from what is expected: a bad reading does no lasting harm [m/s²]."""
LEAN_MAX = 0.95
"""Largest lean that is believed, of each axis."""
UPRIGHT_MIN = 0.3
"""Least cosine of a tilt that is believed."""
BIAS_MAX, ACCEL_BIAS_MAX, SPEED_MAX = 0.1, 2.0, 50.0
"""Largest biases and speed that are believed, of each axis [rad/s], [m/s²], [m/s]."""
READING_MAX = 1000.0
"""Beyond which no reading counts further, in its unit."""
GAP_MAX = 0.5
"""Longest time between samples for which the rate is taken to have lasted [s]."""
LEAN_SD, TOLD_SD = 0.245, 0.008
"""Spread of the lean at the start, of each axis: unknown, and told."""
SPEED_SD, SPEED_MIN, SPEED_S = 1.0, 0.2, 2.0
"""Speed over ground, of each axis: what is expected before any is seen, the least [m/s], and the time for
which a low one is taken to last [s]; what is expected lasts twice as long, a higher one with its square."""
EXPECTED_S, SPEEDS_S = 2.0, 10.0
"""Time for which that expectation counts, and the memory of the speeds that are found [s]."""
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
YAW_RATE, YAW_RATE_MIN, YAW_S = 0.1, 0.005, 0.5
"""Likewise the yaw rate [rad/s], and the time for which a low one is taken to last [s]."""
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
    state = kept[STATE:SPREAD].view(np.complex128)
    spread = kept[SPREAD:EFFECT].view(np.complex128).reshape((5, 5))
    kept[SAMPLES] += 1.0
    if kept[SAMPLES] == 1.0:
        lean_sd = LEAN_SD if kept[0] < math.inf else TOLD_SD
        state[F] = heading * reading
        spread[F, F] = noise * noise / step + offset_sd * offset_sd
        spread[F, A], spread[A, F] = -(offset_sd * offset_sd) * heading, -(offset_sd * offset_sd) * back
        spread[L, L], spread[B, B] = lean_sd * lean_sd, bias_sd * bias_sd
        spread[A, A], spread[V, V] = offset_sd * offset_sd, SPEED_SD * SPEED_SD
        kept[GUST], kept[SPEED] = BREEZE * BREEZE, SPEED_SD * SPEED_SD
    bias_before = state[B]
    elapsed, aligning = min(kept[1] + step, GAP_MAX), kept[0] < align_s
    upright = max(math.sqrt(max(1.0 - _square(state[L]), 0.0)), UPRIGHT_MIN)
    turn = complex(0.0, elapsed * upright) * heading
    _predict(state, spread, rate, turn, elapsed, drag)
    gust = STEADY * STEADY if aligning else max(kept[GUST], _sudden(noise * noise, step, kept))
    spread[F, F] += gust * elapsed
    spread[L, L] += (TURN_NOISE * TURN_NOISE + TURN_ERROR * TURN_ERROR * _square(rate)) * elapsed
    if bias_sd > 0.0:  # one that is known to be none stays none
        spread[B, B] += BIAS_WALK * BIAS_WALK * elapsed
    if offset_sd > 0.0:
        spread[A, A] += ACCEL_BIAS_WALK * ACCEL_BIAS_WALK * elapsed
    force_before, lean_before = state[F], state[L]

    off = heading * (reading - state[A]) - state[F]
    off = complex(_within(off.real, FORCE_MAX), _within(off.imag, FORCE_MAX))
    white = _noise(off, noise * noise / step, step, kept)
    kept[MISSED] += (off.real - kept[MISSED]) * step / SUDDEN_S
    kept[MISSED + 1] += (off.imag - kept[MISSED + 1]) * step / SUDDEN_S
    _correct(state, spread, F, heading, off, white)
    if kept[SAMPLES] * step > GAUGE_FROM_S:  # the first corrections are those of the start
        _gauge(state[F] - force_before, step, kept)

    if not aligning:
        lasts = SPEED_S * (1.0 + kept[SPEED] / (SPEED_SD * SPEED_SD))
        variance = max(kept[SPEED], SPEED_MIN * SPEED_MIN) * lasts / step
        _correct(state, spread, V, 0.0j, -state[V], variance)
        memory = min(EXPECTED_S + kept[SAMPLES] * step, SPEEDS_S)
        kept[SPEED] += (0.5 * _square(state[V]) - kept[SPEED]) * step / memory

    _yaw(rates[2], bias_sd, step, kept)
    kept[2] = kept[2] + step if _unchanged(rates, forces, step, kept) else 0.0
    if kept[2] >= REST_S:
        _correct(state, spread, B, 0.0j, rate - state[B], REST_NOISE * REST_NOISE / step)

    for k, limit in enumerate((READING_MAX, LEAN_MAX, BIAS_MAX, ACCEL_BIAS_MAX, SPEED_MAX)):
        state[k] = complex(_within(state[k].real, limit), _within(state[k].imag, limit))
    if aligning:
        further = complex(0.0, 1.0 / upright) * (state[L] - lean_before)
    else:
        further = (bias_before - state[B]) * complex(kept[EFFECT], kept[EFFECT + 1])
    kept[EFFECT] += step * (cosine - kept[EFFECT] / REMEMBERED_S)
    kept[EFFECT + 1] += step * (sine - kept[EFFECT + 1] / REMEMBERED_S)
    kept[1] = 0.0
    further = back * further
    return further.real, further.imag


@njit(cache=True)
def _predict(state, spread, rate, turn, elapsed, drag):
    """Advance state and covariance by the time `elapsed`; a bias of 1 turns by `turn` meanwhile."""
    _advance(state, turn, elapsed, drag)
    state[L] -= turn * rate
    for k in range(5):
        _advance(spread[:, k], turn, elapsed, drag)
    np.conjugate(spread, spread)
    for k in range(5):
        _advance(spread[k], turn, elapsed, drag)
    for k in range(5):
        spread[k, k] = spread[k, k].real
        for m in range(k):
            spread[k, m] = spread[m, k]
            spread[m, k] = spread[m, k].conjugate()


@njit(cache=True)
def _advance(x, turn, elapsed, drag):
    faster = elapsed * (x[F] + GRAVITY * x[L])
    x[V] += faster
    x[F] -= drag * faster
    x[L] += turn * x[B]


@njit(cache=True)
def _correct(state, spread, measured, of_accel_bias, innovation, variance):
    """Correct by one measurement, of one of the state and so much of the accelerometer's bias."""
    column = np.empty(5, np.complex128)
    for k in range(5):
        column[k] = spread[k, measured] + of_accel_bias.conjugate() * spread[k, A]
    scale = 1.0 / ((column[measured] + of_accel_bias * column[A]).real + variance)
    for k in range(5):
        state[k] += column[k] * (innovation * scale)
        for m in range(k, 5):
            spread[k, m] -= scale * (column[k] * column[m].conjugate())
            spread[m, k] = spread[k, m].conjugate()


@njit(cache=True)
def _yaw(rate, bias_sd, step, kept):
    """Take a yaw rate into what is known of the gyroscope's bias about z: in the mean, no vehicle yaws."""
    bias, variance, square = kept[YAW_BIAS], kept[YAW_BIAS + 1], kept[YAW_BIAS + 2]
    if kept[SAMPLES] == 1.0:
        variance, square = bias_sd * bias_sd, YAW_RATE * YAW_RATE
    off = _within(rate, RATE_MAX) - bias
    variance += BIAS_WALK * BIAS_WALK * step if bias_sd > 0.0 else 0.0
    lasts = YAW_S * (1.0 + square / (YAW_RATE * YAW_RATE))
    gain = variance / (variance + max(square, YAW_RATE_MIN * YAW_RATE_MIN) * lasts / step)
    kept[YAW_BIAS] = _within(bias + gain * off, BIAS_MAX)
    kept[YAW_BIAS + 1] = (1.0 - gain) * variance
    memory = min(EXPECTED_S + kept[SAMPLES] * step, SPEEDS_S)
    kept[YAW_BIAS + 2] = square + (off * off - square) * step / memory


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
def _square(value):
    return value.real * value.real + value.imag * value.imag


@njit(cache=True)
def _within(value, limit):
    return min(max(value, -limit), limit)
