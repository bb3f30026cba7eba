"""What the encoder finds out about a flight: the tilt at an unknown start, and the biases of both sensors.

A rotor's drag is proportional to its speed and to the air's across it, what the frame adds grows with the
square, and both are all that the accelerometer reads across the body's z axis (Martin & Salaün, "The true
role of accelerometer feedback in quadrotor control", ICRA 2010; Leishman et al., "Quadrotors and
accelerometers", IEEE Control Systems 34(1), 2014). In level axes that do not yaw, x + iy as one complex
number, let λ be the lateral part of the body's z axis, of size sin θ at a tilt θ; v the speed over ground; f
what drag is at hover, −k times the speed through the air where that is low; ω the gyroscope's reading, b its
bias and a the accelerometer's in body axes, r the heading, of length 1; T thrust and c the climb. The
shortest turn from the vertical to the body's z axis makes P x = x − λ Re(x λ̄) / (1 + cos θ) of level x:

    λ̇ = P(−i r (ω − b)),    v̇ = P(y − r a) + T λ,    ḟ = −k D v̇,    ḃ = 0,    ȧ = 0,
    y = √(T / m g) (P f + k c λ) + r a,    D = 1, and more in a fast flow.

A body that does not yaw about its z axis turns from level axes by Im(λ̄ λ̇) / (1 + cos θ) all the same.
At rest all of it holds as well: the force is the ground's then, f = −g λ. A Kalman filter of the five
measures the lateral force; weakly, that neither a speed nor a force lasts, for a vehicle that has been slow
stays about where it is and air that has been calm stays so, and all but not where they have been large; and
where the readings of neither sensor change, that what the gyroscope reads is its bias (a zero-rate update, as
VQF's, Laidig & Seel 2023). A lean that is known at the start, or that changes, tells the accelerometer's bias
from a tilt, and a known one nearly whole.
A heading that drifts would turn wind, which then looks like a bias that turns with the body: what the
gyroscope reads about z in the mean is taken off, and believed the less the more the vehicle yaws; and the
heading is turned back by as much as that bias has turned it before it was found.

Wind and all that drag is not make the force walk at random: further, where the corrections of the force sum
up to more than they lower its variance by, and less far where to less (Myers & Tapley, "Adaptive sequential
estimation with unknown noise statistics", IEEE Trans. Autom. Control 21(4), 1976), so that what an unknown
lean does to the force is not taken for gusts; and at once where the force is not what it should be.
A vehicle that is told to start level stands or hovers, so that speed and turn rate are known as well.
Where corrections of the gyroscope's bias keep one sign, so that their sum is far more than its variance says,
the bias has jumped, or was large from the start: that variance is made larger by what is beyond.
Vibration is noise of the reading, found from sample to sample, and so is what the equations are wrong by, in
proportion to the acceleration.
To first order nothing prefers x or y, so that one Hermitian covariance is that of both. Inertial navigation
calls the first seconds of this the initial alignment.

The network is told by a turn: for a first second all that is found out about the lean, as if there were no
gusts, is added to the turn rates; from then on the bias is taken off, and with each correction of it what it
has done to the attitude that the network still remembers. Of the accelerometer it is fed the lateral reading
less its bias. Or it is fed what is found out itself: −g times the tilt of λ, and how fast that tilt changes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from quadsim.vehicle import GRAVITY

from .tilt import RATE_MAX

F, L, B, A, V = range(5)
"""The state: force, lean, the biases of gyroscope and accelerometer, speed over ground."""
KEPT = 109
"""What is kept: the time since the start, that since the last sample, and that at rest; the state; its
covariance, row by row; what a gyroscope's bias of 1 does to the attitude that is remembered; samples; the six
readings in a fast and in a slow low-pass; the late corrections of the force, summed, and by how much they
lowered its variance; the square of the random walk of the force; by how much the force has lately been off;
the variance of that between samples, with the last; the mean squares of speed and force, of each axis; the
gyroscope's bias about z, its variance, and the mean square of the yaw rate; thrust; the climb, and the mean
of its change; by how much the body is turned from level axes beyond its yaw; the rate and the thrust before;
the mean squares of rate and acceleration; the late corrections of the gyroscope's bias, summed, and by how
much they lowered its variance; the lean in body axes; and by how much the heading is to be turned back, with
its covariance with the bias about z."""
STATE, SPREAD, EFFECT, SAMPLES, FAST, SLOW = 3, 13, 63, 65, 66, 72
CORRECTIONS, GUST, MISSED, NOISE, SPEED, AIR = 78, 81, 82, 84, 87, 88
YAW_BIAS, THRUST, CLIMB, TWIST, BEFORE, TURNS, PUSHES = 89, 92, 93, 95, 97, 100, 101
MOVED, LEANING, YAW_BACK = 102, 105, 107
LEAN, BIAS, ACCEL_BIAS = STATE + 2 * L, STATE + 2 * B, STATE + 2 * A
"""Where these begin in it."""
FORCE_MAX = 5.0
"""How far a force counts as away from what is expected: a bad reading does no lasting harm [m/s²]."""
FORCE_VARIANCE_MIN = 1e-9
"""Least variance of it: what rounding makes of nothing is less than nothing [m²/s⁴]."""
LEAN_MAX, UPRIGHT_MIN = 0.95, 0.3
"""Largest lean that is believed, and the cosine of a tilt that goes with it."""
BIAS_MAX, ACCEL_BIAS_MAX, SPEED_MAX = 0.1, 2.0, 50.0
"""Largest biases and speed that are believed [rad/s], [m/s²], [m/s]."""
READING_MAX = 1000.0
"""Beyond which no reading counts further, in its unit."""
GAP_MAX = 0.5
"""Longest time between samples for which the rate is taken to have lasted [s]."""
LEAN_SD, TOLD_SD = 0.24, 0.0028
"""Spread of the lean at the start, of each axis: unknown, and told."""
SPEED_SD, SPEED_MIN, SPEED_S = 0.45, 0.11, 0.33
"""Speed over ground, of each axis: what is expected before any is seen, the least [m/s], and the time for
which a low one is taken to last [s]; a higher one lasts longer, with its square."""
TOLD_SPEED, TOLD_TURN, LEANT_S = 0.03, 0.015, 1.0
"""Speed [m/s] and turn rate [rad/s], of each axis, at a start that is told to be level, for such a vehicle
stands or hovers; and the time in which it took on a lean, and for which that has driven it [s]."""
LASTS_MORE = 2.2
"""How many times as long what is expected lasts, beyond a low one."""
EXPECTED_S, SPEEDS_S, AIRS_S = 0.1, 0.85, 5.5
"""Time for which what is expected counts, and the memories of the speeds and of what else is found [s]."""
STEADY, CALM, BREEZE = 0.1, 0.0027, 0.034
"""Random walk of the force: while the tilt at the start is looked for; later the least, and what is expected
before any is seen [m/s²/√s]."""
CORRECTED_S, ENOUGH, GAUGE = 0.1, 0.6, 1.7
"""Memory of the corrections of the force [s], the share of the variance that they should have which is
enough, and how many times what is beyond or short of it counts."""
GAUGE_FROM_S, BREEZE_S, FALL_S, GUSTS_S = 0.1, 0.05, 14.0, 16.0
"""Time without a look at it, that for which the expectation counts, the least in which a walk is taken for
less, and the memory of what is found [s]."""
SUDDEN_S, SUDDEN = 0.04, 1.3
"""Memory of how far the force is off [s], and how many times the variance of noise in it that may be."""
NOISE_S = 0.5
"""Memory of the noise of the force [s]."""
TURN_NOISE, TURN_ERROR, TURNS_S = 0.001, 0.0038, 2.7
"""Noise density of a turn rate [rad/s/√Hz], further in proportion to it [√s], and the memory of it [s]: a
gain that came and went with each turn would make a lasting error of what is off in every one."""
MODEL, DRAG_ERROR = 0.004, 0.05
"""Noise density of a lateral force in proportion to acceleration [√s], and random walk of it in proportion
to what drag makes of that [√s]: thrust, heading, rotors and drag are not known exactly."""
BIAS_WALK, ACCEL_BIAS_WALK = 1.2e-4, 0.0085
"""Random walks of the biases [rad/s/√s], [m/s²/√s]."""
JUMP, JUMP_S, JUMP_GAIN = 3.0, 0.96, 40.0
"""How many times the variance that they should have corrections of the gyroscope's bias may sum up to, the
memory of that sum [s], and how many times what is beyond is added to the bias's variance in that time."""
BREATH, BREATH_MIN, BREATH_S = 0.12, 0.07, 0.5
"""Likewise the force [m/s²], and the time for which a low one is taken to last [s]."""
YAW_RATE, YAW_RATE_MIN, YAW_S = 0.015, 0.005, 0.4
"""Likewise the yaw rate [rad/s], and the time for which a low one is taken to last [s]."""
FRAME = 0.007
"""What the frame takes from a speed by its square, ρ C_d A / 2 m [1/m]."""
THRUST_MIN, THRUST_MAX, THRUST_S = 0.25, 4.0, 0.0052
"""Thrust that is believed, in weights, and the memory of that by which rotors drag [s]."""
CLIMB_S, CLIMBS_S, CLIMB_FROM_S = 1.5, 20.0, 2.0
"""Memories of the climb and of its change, whose mean is the accelerometer's bias, and how long that counts
as having lasted at first [s]."""
CLIMB_MAX, RISE_MAX = 20.0, 0.5
"""Fastest climb that is believed [m/s], and the mean of its change [m/s²]."""
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
    reading = complex(_within(forces[0], READING_MAX), _within(forces[1], READING_MAX))
    rate = complex(_within(rates[0], RATE_MAX), _within(rates[1], RATE_MAX))
    state = kept[STATE:SPREAD].view(np.complex128)
    spread = kept[SPREAD:EFFECT].view(np.complex128).reshape((5, 5))
    kept[SAMPLES] += 1.0
    first = kept[SAMPLES] == 1.0
    if first:
        kept[THRUST], kept[TWIST] = _within(forces[2], THRUST_MAX * GRAVITY), 1.0
        kept[BEFORE], kept[BEFORE + 1], kept[BEFORE + 2] = rate.real, rate.imag, kept[THRUST]
    elapsed, aligning = min(kept[1] + step, GAP_MAX), kept[0] < align_s
    level = heading * complex(kept[TWIST], kept[TWIST + 1])
    slowed, upright = _move(state, spread, rate, level, forces[2], elapsed, step, drag, aligning, kept)
    if first:
        _begin(state, spread, heading, rate, reading * (1.0 / slowed), step, alignment, kept)
    bias_before = state[B]
    gust = max(STEADY * STEADY if aligning else kept[GUST], _sudden(noise * noise, step, kept))
    spread[F, F] += (gust + DRAG_ERROR * DRAG_ERROR * drag * drag * kept[PUSHES]) * elapsed
    turns = _square(rate - state[B]) - kept[TURNS]
    kept[TURNS] += turns * step / min(EXPECTED_S + kept[SAMPLES] * step, TURNS_S)
    spread[L, L] += (TURN_NOISE * TURN_NOISE + TURN_ERROR * TURN_ERROR * kept[TURNS]) * elapsed
    if bias_sd > 0.0:  # one that is known to be none stays none
        spread[B, B] += BIAS_WALK * BIAS_WALK * elapsed
    if offset_sd > 0.0:
        spread[A, A] += ACCEL_BIAS_WALK * ACCEL_BIAS_WALK * elapsed
    force_before, lean_before = state[F], state[L]
    force_variance, bias_variance = spread[F, F].real, spread[B, B].real

    expected = slowed * (_lateral(state[F], state[L], upright) + drag * kept[CLIMB] * state[L])
    off = level * (reading - state[A]) - expected
    off = complex(_within(off.real, FORCE_MAX), _within(off.imag, FORCE_MAX))
    white = _noise(off, noise * noise / step, step, kept) + MODEL * MODEL * kept[PUSHES] / step
    kept[MISSED] += (off.real - kept[MISSED]) * step / SUDDEN_S
    kept[MISSED + 1] += (off.imag - kept[MISSED + 1]) * step / SUDDEN_S
    _correct(state, spread, F, 0.5 * slowed * (1.0 + upright), level, off, white)
    if kept[SAMPLES] * step > GAUGE_FROM_S:  # the first corrections are those of the start
        _gauge(state[F] - force_before, force_variance - spread[F, F].real, step, kept)
    if not aligning:
        _lasts(state, spread, V, SPEED_SD, SPEED_MIN, SPEED_S, SPEEDS_S, step, kept, SPEED)
        _lasts(state, spread, F, BREATH, BREATH_MIN, BREATH_S, AIRS_S, step, kept, AIR)
        if bias_sd > 0.0:
            spread[B, B] += _jumped(state[B] - bias_before, bias_variance - spread[B, B].real, step, kept)

    _yaw(rates[2], bias_sd, step, kept)
    kept[2] = kept[2] + step if _unchanged(rates, forces, step, kept) else 0.0
    if kept[2] >= REST_S:
        _correct(state, spread, B, 1.0, 0.0j, rate - state[B], REST_NOISE * REST_NOISE / step)

    for k, limit in enumerate((READING_MAX, LEAN_MAX, BIAS_MAX, ACCEL_BIAS_MAX, SPEED_MAX)):
        state[k] *= min(1.0, limit / max(math.sqrt(_square(state[k])), 1e-9))
    if aligning:
        further = complex(0.0, 1.0 / upright) * level.conjugate() * (state[L] - lean_before)
    else:
        further = heading.conjugate() * (bias_before - state[B]) * complex(kept[EFFECT], kept[EFFECT + 1])
    kept[EFFECT] += step * (cosine - kept[EFFECT] / REMEMBERED_S)
    kept[EFFECT + 1] += step * (sine - kept[EFFECT + 1] / REMEMBERED_S)
    kept[1] = 0.0
    leaning = level.conjugate() * state[L]
    kept[LEANING], kept[LEANING + 1] = leaning.real, leaning.imag
    return further.real, further.imag


@njit(cache=True)
def _begin(state, spread, heading, rate, force, step, alignment, kept):
    """What is known with the first readings; a lean that is told is in the state."""
    _, _, noise, bias_sd, offset_sd = alignment
    lean_variance, speed_variance, bias_variance = LEAN_SD * LEAN_SD, SPEED_SD * SPEED_SD, bias_sd * bias_sd
    if kept[0] == math.inf:
        leant, driven = _square(state[L]) / (LEANT_S * LEANT_S), LEANT_S * LEANT_S * GRAVITY
        lean_variance = TOLD_SD * TOLD_SD
        speed_variance = TOLD_SPEED * TOLD_SPEED + driven * driven * leant
        turning = TOLD_TURN * TOLD_TURN + leant + TURN_NOISE * TURN_NOISE / step
        share = bias_variance / (bias_variance + turning)
        state[B], bias_variance = share * rate, (1.0 - share) * bias_variance
    offset_variance = offset_sd * offset_sd
    spread[:] = 0.0
    state[F], state[V] = heading * force, 0.0
    spread[F, F] = noise * noise / step + offset_variance
    spread[F, A], spread[A, F] = -offset_variance * heading, -offset_variance * heading.conjugate()
    spread[L, L], spread[B, B] = lean_variance, bias_variance
    spread[A, A], spread[V, V] = offset_variance, speed_variance
    kept[GUST], kept[SPEED] = BREEZE * BREEZE, SPEED_SD * SPEED_SD
    kept[AIR] = BREATH * BREATH + 0.5 * _square(force)


@njit(cache=True)
def _move(state, spread, rate, level, thrust, elapsed, step, drag, aligning, kept):
    """Advance state, covariance and level axes to a sample.

    Returns:
        What the force of drag is to be multiplied by for a reading, and the cosine of the tilt.
    """
    mean_rate = 0.5 * (rate + complex(kept[BEFORE], kept[BEFORE + 1]))
    kept[BEFORE], kept[BEFORE + 1] = rate.real, rate.imag
    turning = complex(0.0, -elapsed) * level * (mean_rate - state[B])
    lean = state[L] + 0.5 * _lateral(turning, state[L], _upright(state[L]))
    lean *= min(1.0, LEAN_MAX / max(math.sqrt(_square(lean)), 1e-9))
    upright = _upright(lean)  # both half-way
    leant = _lateral(turning, lean, upright)
    twist = complex(kept[TWIST], kept[TWIST + 1])
    twist *= complex(1.0, (lean.conjugate() * leant).imag / (1.0 + upright))
    twist *= 1.5 - 0.5 * _square(twist)
    kept[TWIST], kept[TWIST + 1] = twist.real, twist.imag

    now = _within(thrust, THRUST_MAX * GRAVITY)
    thrust, kept[BEFORE + 2] = 0.5 * (kept[BEFORE + 2] + now), now
    kept[THRUST] += (thrust - kept[THRUST]) * min(step / THRUST_S, 1.0)
    size = math.sqrt(_square(state[F]))
    along = math.sqrt(1.0 + 4.0 * FRAME * size / (drag * drag))  # a speed's, along the force
    across = 0.5 * (1.0 + along)  # across it, and the whole force over that of rotors
    slowed = 1.0 + (math.sqrt(max(kept[THRUST] / GRAVITY, THRUST_MIN)) - 1.0) / across
    force = slowed * (_lateral(state[F], lean, upright) + drag * kept[CLIMB] * lean)
    rise = max(thrust, 0.0) * upright - (force * lean.conjugate()).real - GRAVITY
    if not aligning:
        memory = min(CLIMB_FROM_S + kept[SAMPLES] * step, CLIMBS_S)
        kept[CLIMB + 1] += (rise - kept[CLIMB + 1]) * step / memory
        kept[CLIMB + 1] = _within(kept[CLIMB + 1], RISE_MAX)
        rise -= kept[CLIMB + 1]
        kept[CLIMB] = _within(kept[CLIMB] + step * (rise - kept[CLIMB] / CLIMB_S), CLIMB_MAX)
    thrust = max(thrust, 0.0) - kept[CLIMB + 1] / upright
    faster = elapsed * (_lateral(force, lean, upright) + thrust * lean)
    pushes = _square(faster * (1.0 / elapsed)) - kept[PUSHES]
    kept[PUSHES] += pushes * step / min(EXPECTED_S + kept[SAMPLES] * step, TURNS_S)
    unit = state[F] * (1.0 / max(size, 1e-9))
    state[V] += faster
    state[F] += -drag * (across * faster + (along - across) * (unit.conjugate() * faster).real * unit)
    state[L] += leant

    share = 0.5 * (1.0 + upright)  # what is left of a lateral part in the mean of all directions
    turn, slope = complex(0.0, elapsed * share) * level, 0.5 * drag * (along + across)
    for k in range(5):
        _advance(spread[:, k], turn, elapsed, slope, slowed * share * share, thrust)
    np.conjugate(spread, spread)
    for k in range(5):
        _advance(spread[k], turn, elapsed, slope, slowed * share * share, thrust)
    for k in range(5):
        spread[k, k] = spread[k, k].real
        for m in range(k):
            spread[k, m] = spread[m, k]
            spread[m, k] = spread[m, k].conjugate()
    return slowed, upright


@njit(cache=True)
def _advance(x, turn, elapsed, slope, of_force, thrust):
    """Advance a small change of the state."""
    faster = elapsed * (of_force * x[F] + thrust * x[L])
    x[V] += faster
    x[F] -= slope * faster
    x[L] += turn * x[B]


@njit(cache=True)
def _correct(state, spread, measured, of_it, of_accel_bias, innovation, variance):
    """Correct by one measurement, of so much of one of the state and so much of the accelerometer's bias."""
    column = np.empty(5, np.complex128)
    for k in range(5):
        column[k] = of_it * spread[k, measured] + of_accel_bias.conjugate() * spread[k, A]
    scale = 1.0 / ((of_it * column[measured] + of_accel_bias * column[A]).real + variance)
    for k in range(5):
        state[k] += column[k] * (innovation * scale)
        for m in range(k, 5):
            spread[k, m] -= scale * (column[k] * column[m].conjugate())
            spread[m, k] = spread[k, m].conjugate()
    spread[F, F] = max(spread[F, F].real, FORCE_VARIANCE_MIN)


@njit(cache=True)
def _lasts(state, spread, which, expected, least, lasts, memory, step, kept, square):
    """Correct by the expectation that one of the state is nothing; its mean square is kept at `square`."""
    lasts *= 1.0 + LASTS_MORE * kept[square] / (expected * expected)
    variance = max(kept[square], least * least) * lasts / step
    _correct(state, spread, which, 1.0, 0.0j, -state[which], variance)
    memory = min(EXPECTED_S + kept[SAMPLES] * step, memory)
    kept[square] += (0.5 * _square(state[which]) - kept[square]) * step / memory


@njit(cache=True)
def _upright(lean):
    """Cosine of a tilt."""
    return max(math.sqrt(max(1.0 - _square(lean), 0.0)), UPRIGHT_MIN)


@njit(cache=True)
def _lateral(x, lean, upright):
    """Lateral part, in body axes, of a level vector; in level axes, of a lateral one of the body."""
    return x - lean * ((x * lean.conjugate()).real / (1.0 + upright))


@njit(cache=True)
def _yaw(rate, bias_sd, step, kept):
    """Take a yaw rate into what is known of the gyroscope's bias about z: in the mean, no vehicle yaws."""
    rate = _within(rate, RATE_MAX)
    bias, variance, square = kept[YAW_BIAS], kept[YAW_BIAS + 1], kept[YAW_BIAS + 2]
    if kept[SAMPLES] == 1.0:
        variance, square = bias_sd * bias_sd, YAW_RATE * YAW_RATE + rate * rate
    off = rate - bias
    variance += BIAS_WALK * BIAS_WALK * step if bias_sd > 0.0 else 0.0
    lasts = YAW_S * (1.0 + square / (YAW_RATE * YAW_RATE))
    scale = 1.0 / (variance + max(square, YAW_RATE_MIN * YAW_RATE_MIN) * lasts / step)
    turned = kept[YAW_BACK + 1] + variance * step
    kept[YAW_BIAS] = _within(bias + scale * variance * off, BIAS_MAX)
    kept[YAW_BIAS + 1] = (1.0 - scale * variance) * variance
    kept[YAW_BACK], kept[YAW_BACK + 1] = scale * turned * off, (1.0 - scale * variance) * turned
    memory = min(EXPECTED_S + kept[SAMPLES] * step, AIRS_S)
    kept[YAW_BIAS + 2] = square + (off * off - square) * step / memory


@njit(cache=True)
def _gauge(moved, lowered, step, kept):
    """Take a correction of the force, and by how much it lowered the variance, into what its walk is."""
    scatter, due = _summed(moved, lowered, CORRECTED_S, step, kept[CORRECTIONS:GUST])
    beyond = GAUGE * 2.0 * (scatter - ENOUGH * due) / CORRECTED_S
    memory = min(BREEZE_S + kept[SAMPLES] * step, GUSTS_S)
    if beyond < 0.0:
        memory = max(memory, FALL_S)
    kept[GUST] = max(kept[GUST] + beyond * step / memory, CALM * CALM)


@njit(cache=True)
def _summed(moved, lowered, memory, step, sums):
    """Square of late corrections' sum, of each axis, and what its mean should be, with what they lowered."""
    sums[0] += moved.real - sums[0] * step / memory
    sums[1] += moved.imag - sums[1] * step / memory
    sums[2] += max(lowered, 0.0) - 2.0 * sums[2] * step / memory
    return 0.5 * _square(complex(sums[0], sums[1])), sums[2]


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
def _jumped(moved, lowered, step, kept):
    """What a bias's variance lacks: its corrections sum up to no more than they lower it by, or it jumped."""
    scatter, due = _summed(moved, lowered, JUMP_S, step, kept[MOVED:LEANING])
    return max(scatter - JUMP * due, 0.0) * JUMP_GAIN * step / JUMP_S


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
