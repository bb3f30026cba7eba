"""Checks of samples, common to all filters, and the loop over samples."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..sanitise import RATE_STEP, force_usable, rate_usable, speed_usable, within
from .inline_math import wrap_core

SAMPLES = np.dtype(
    [
        ("skipped", "f8"),  # samples that were missing in part or whole
        ("age", "f8"),  # of the last good rate [s]; infinite before the first
        ("rate", "f8", 3),  # that rate [rad/s]
        ("good_time", "f8"),  # for which there have been good ones [s]
        ("gap", "f8"),  # variance of what was turned unseen in a gap that lasts [rad²]
    ]
)
"""State of the checks of a vehicle's samples."""

WORST = 2.0 * math.pi**2
"""Squared error of an estimate that is wrong by 180° in roll and pitch or is not a number [rad²]."""
HOLD_S = 0.1
"""Longest time for which the last valid gyroscope sample replaces a missing one, before zero does [s]."""
ACCELERATION_MAX = 2000.0
"""Largest angular acceleration [rad/s²]. A rate that differs from the last valid one by more than this per
sample, and by more than `RATE_STEP`, counts as missing for up to `HOLD_S`, or for as long as rates had been
valid."""
GAP_RATE = 2.0
"""Standard deviation of the unknown body rate in a gap longer than `HOLD_S` [rad/s]."""

ROTORS_STOPPED = 1.0
"""Root of the sum of squared rotor speeds below which the rotors count as stopped [rad/s]."""

REACQUISITION_NOISE = 0.2
"""Noise density of the tilt from the accelerometer of a flying vehicle [rad √s]."""


class Sample(NamedTuple):
    """A sanitised sample of one vehicle, in compiled code."""

    gyro: tuple[float, float, float]
    """Body rate [rad/s]."""
    mean_gyro: tuple[float, float, float]
    """Mean of this body rate and the previous one, for the trapezoidal rule [rad/s]."""
    accel: tuple[float, float, float]
    """Specific force [m/s²]; zero if missing."""
    found: bool
    """Whether there is a specific force."""
    rotor_square: float
    """Σ ω² of the rotors [rad²/s²]; zero if a speed is missing or the rotors stand still."""
    unseen: float
    """Variance of the unmeasured rotation since the last sample [rad²]; zero unless a rate is missing."""
    ended: float
    """Variance of the unmeasured rotation in a gap that this sample ends [rad²]; otherwise zero."""
    dt: float
    """Sample period [s]."""


def initial_samples(rows: int) -> NDArray[np.void]:
    """Return records of `SAMPLES` before the first sample, (rows,)."""
    samples = np.zeros(rows, SAMPLES)
    samples["age"] = np.inf
    return samples


@njit
def turned_unseen(age):
    """Return the variance of the prediction error if a rate is repeated for a time `age` [s], in rad².

    The standard deviation grows first with the square of time, while the rate is close to the last one, and
    later linearly.
    """
    sigma = GAP_RATE * age * age / (age + HOLD_S)
    return sigma * sigma


@njit(error_model="numpy")
def reacquire(tilt_variance, sample):
    """Return the share of the tilt error that a filter with fixed gain corrects in a sample after a gap.

    The share is the gain of a scalar Kalman filter of this error. Filters with their own covariance add
    `unseen` to it instead.

    Returns:
        The share, and the remaining variance of the tilt [rad²].
    """
    variance = tilt_variance + sample.unseen
    share = variance / (variance + REACQUISITION_NOISE * REACQUISITION_NOISE / sample.dt)
    share = share if sample.found else 0.0
    return share, variance - share * variance


@njit
def sum_of_squares(rotor_vel, i, t):
    """Return `Sample.rotor_square` of flight i and sample t, for rotor speeds (n, T, rotors) [rad/s]."""
    total = 0.0
    for k in range(rotor_vel.shape[2]):
        if not speed_usable(rotor_vel[i, t, k]):
            return 0.0
        total += rotor_vel[i, t, k] ** 2
    return total if total >= ROTORS_STOPPED * ROTORS_STOPPED else 0.0


@njit(forceinline=True)
def sanitise_sample(state, dt, gyro, accel, rotor_vel, i, t):
    """Return a valid `Sample`: a missing rate becomes the last valid one, a missing specific force zero.

    A rate that jumps implausibly counts as missing until it has lasted. `state` is the record of `SAMPLES` of
    flight i and is updated; t is the sample; the arrays are those of `driver`.
    """
    gx, gy, gz = gyro[i, t, 0], gyro[i, t, 1], gyro[i, t, 2]
    ax, ay, az = accel[i, t, 0], accel[i, t, 1], accel[i, t, 2]
    last, known = state.rate, state.age <= HOLD_S
    lx, ly, lz = last[0], last[1], last[2]
    doubtful = state.age < min(HOLD_S, state.good_time)
    step = max(RATE_STEP, ACCELERATION_MAX * dt) if doubtful else math.inf
    smooth = within(gx - lx, gy - ly, gz - lz, step)
    rate_found, force_found, unseen = smooth and rate_usable(gx, gy, gz), force_usable(ax, ay, az), 0.0
    if rate_found:
        state.age = 0.0
        state.good_time += dt
        last[0], last[1], last[2] = gx, gy, gz
    else:
        unseen = turned_unseen(state.age + dt) - turned_unseen(state.age) if state.age < math.inf else 0.0
        state.age += dt
        share = 1.0 if state.age <= HOLD_S else 0.0
        gx, gy, gz = share * lx, share * ly, share * lz
    ended = 0.0 if unseen > 0.0 else state.gap
    state.gap = state.gap + unseen if unseen > 0.0 else 0.0
    if not force_found:
        ax = ay = az = 0.0
    if not (rate_found and force_found):
        state.skipped += 1.0
    mean = (0.5 * (lx + gx), 0.5 * (ly + gy), 0.5 * (lz + gz)) if known else (gx, gy, gz)
    rotor_square = sum_of_squares(rotor_vel, i, t)
    return Sample((gx, gy, gz), mean, (ax, ay, az), force_found, rotor_square, unseen, ended, dt)


@njit(cache=True, nogil=True)
def squared_error(estimate, truth):
    """Return the squared errors of roll and pitch (n, T, 2) [rad], summed over each flight (n,) [rad²].

    The error is `WORST` where the estimate is not a number, and 0 where the truth is not known.
    """
    total = np.zeros(estimate.shape[0])
    for i in range(estimate.shape[0]):
        for t in range(estimate.shape[1]):
            d_roll = wrap_core(estimate[i, t, 0] - truth[i, t, 0])
            d_pitch = wrap_core(estimate[i, t, 1] - truth[i, t, 1])
            square = d_roll * d_roll + d_pitch * d_pitch
            if not (math.isnan(truth[i, t, 0]) or math.isnan(truth[i, t, 1])):
                total[i] += square if square <= WORST else WORST
    return total


@njit(forceinline=True, error_model="numpy")
def run_vehicles(step, states, samples, params, dt, gyro, accel, rotor_vel, out):
    """Process all samples of all vehicles, as the `run` of a filter; the arguments are those of `driver`."""
    p = params[0]
    for i in range(states.shape[0]):
        s = states[i]
        for t in range(gyro.shape[1]):
            sample = sanitise_sample(samples[i], dt, gyro, accel, rotor_vel, i, t)
            roll, pitch = step(s, p, sample)
            if math.isnan(roll):
                states[i] = p.level
                roll = pitch = 0.0
            out[i, t, 0], out[i, t, 1] = roll, pitch


@njit(cache=True, nogil=True)
def sanitise(samples, dt, gyro, accel):
    """Sanitise sequences, for estimators of other packages.

    Returns:
        The fields of `Sample`: gyro, mean_gyro and accel (n, T, 3), unseen and ended (n, T).
    """
    rate, mean, force = np.empty_like(gyro), np.empty_like(gyro), np.empty_like(accel)
    unseen, ended = np.empty(gyro.shape[:2]), np.empty(gyro.shape[:2])
    no_rotors = np.empty((*gyro.shape[:2], 0))
    for i in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            sample = sanitise_sample(samples[i], dt, gyro, accel, no_rotors, i, t)
            for k in range(3):
                rate[i, t, k], mean[i, t, k] = sample.gyro[k], sample.mean_gyro[k]
                force[i, t, k] = sample.accel[k]
            unseen[i, t], ended[i, t] = sample.unseen, sample.ended
    return rate, mean, force, unseen, ended
