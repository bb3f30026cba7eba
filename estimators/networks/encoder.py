"""The inputs of a network: scaled IMU readings as integers, with the last valid one for a missing one.

    x = clip(round(1024 (reading − offset) / range), ±32767) / 1024

A sample counts as missing if `sanitise` refuses it, or if a rate jumps implausibly. After `HOLD` missing
rates, the rate is zero, and any rate is accepted again. The host does this; its state is the last valid
inputs and counts. At 200 Hz, the rate of the networks, filters do the same (`estimators.filters.samples`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from quadsim.runs.compiled import njit

from ..sanitise import RATE_STEP, force_usable, rate_usable
from .weights_file import READINGS, InputScaling

Array = NDArray[np.float64]

INPUT_ONE = 1024
"""Integer input of the network for a scaled reading of 1.0."""
INPUT_MAX = 32767
HOLD = 20
"""Number of samples for which the last valid rate replaces a missing one: 0.1 s at 200 Hz."""
MISSING, AGE, GOOD, ENCODED = range(READINGS, READINGS + 4)
"""Indices of the counts in an encoder's state, after the last inputs, and the length of the state."""


def encoder_fields(number: DTypeLike) -> list[tuple[Any, ...]]:
    """Return the fields of an encoder's state.

    The fields are the last integer inputs, the number of incomplete samples, the number of samples since the
    last valid rate, and the number of valid rates since the start or the last gap, up to `HOLD`.
    """
    return [("inputs", number, READINGS), ("missing", number), ("age", number), ("good", number)]


ENCODER = np.dtype(encoder_fields(np.float64))


class Scaling(NamedTuple):
    """Scaling of the readings, gyroscope first: integer input = round((reading - offset) gain)."""

    offset: Array  #: shape (6,) [rad/s, m/s²]
    gain: Array  #: shape (6,)


def input_scaling(inputs: InputScaling) -> Scaling:
    """Return offset and gain of a network's inputs."""
    offset = np.array([0.0, 0.0, 0.0, *inputs.accel_offset])
    return Scaling(offset, INPUT_ONE / np.array([*[inputs.gyro] * 3, *inputs.accel]))


def scaled_inputs(
    inputs: InputScaling, gyro: ArrayLike, accel: ArrayLike, state: NDArray[np.void] | None = None
) -> Array:
    """Compute the inputs of a network.

    Args:
        inputs: Offsets and ranges of the scaling.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        state: State of the encoder, `ENCODER` (n,), changed in place; None starts a new one.

    Returns:
        The inputs (n, T, 6) in steps of 1/1024.
    """
    gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
    state = np.zeros(len(gyro), ENCODER) if state is None else state
    x = np.empty((*gyro.shape[:2], 6))
    encode(gyro, accel, input_scaling(inputs), state.view(np.float64).reshape(len(state), -1), x)
    return x


@njit(inline="always")
def _integer(value, gain):
    return min(max(np.rint(value * gain), -INPUT_MAX), INPUT_MAX)


@njit
def encode_sample(gyro, accel, scaling, state):
    """Scale one sample, (3,) [rad/s] and (3,) [m/s²], and update the state of an encoder."""
    rate_found = rate_usable(gyro[0], gyro[1], gyro[2])
    force_found = force_usable(accel[0], accel[1], accel[2])
    if state[AGE] < state[GOOD]:
        for k in range(3):
            change = _integer(gyro[k] - scaling.offset[k], scaling.gain[k]) - state[k]
            rate_found = rate_found and abs(change) <= RATE_STEP * scaling.gain[k]
    if rate_found:
        state[AGE], state[GOOD] = 0, min(state[GOOD] + 1, HOLD)
        for k in range(3):
            state[k] = _integer(gyro[k] - scaling.offset[k], scaling.gain[k])
    elif state[AGE] < HOLD:
        state[AGE] += 1
    else:
        state[GOOD] = 0
        for k in range(3):
            state[k] = _integer(-scaling.offset[k], scaling.gain[k])
    if force_found:
        for k in range(3):
            state[3 + k] = _integer(accel[k] - scaling.offset[3 + k], scaling.gain[3 + k])
    if not (rate_found and force_found):
        state[MISSING] += 1


@njit(inline="always")
def resumed(state):
    """Return whether the last sample had the first valid rate, at the start or after `HOLD` missing ones."""
    return state[AGE] == 0 and state[GOOD] == 1


@njit(cache=True)
def encode(gyro, accel, scaling, state, x):
    """Write the inputs (n, T, 6) for readings of both sensors (n, T, 3), and update the states."""
    for n in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            encode_sample(gyro[n, t], accel[n, t], scaling, state[n])
            for k in range(6):
                x[n, t, k] = state[n, k] / INPUT_ONE
