"""The inputs of a network: scaled readings of the IMU as integers, the last good one where one is missing.

    x = clip(round(1024 (reading − offset) / range), ±32767) / 1024

A sample is missing where `sanitise` refuses it. The host does this before the chip; its only memory is the
last good inputs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.compiled import njit

from ..sanitise import force_usable, rate_usable
from .weights_file import InputScaling

Array = NDArray[np.float64]

INPUT_ONE = 1024
"""Integer input of the network for a scaled reading of 1.0."""
INPUT_MAX = 32767
INPUT_STATE = 7
"""Numbers in the state of the encoder: the 6 last inputs, and the count of missing samples."""


def input_scaling(inputs: InputScaling) -> tuple[Array, Array]:
    """Offset and gain (6,) of the readings: integer input = round((reading - offset) gain)."""
    offset = np.array([0.0, 0.0, 0.0, *inputs.accel_offset])
    return offset, INPUT_ONE / np.array([*[inputs.gyro] * 3, *inputs.accel])


def scaled_inputs(
    inputs: InputScaling, gyro: ArrayLike, accel: ArrayLike, state: NDArray[np.generic] | None = None
) -> Array:
    """Inputs of the network.

    Args:
        inputs: Offsets and ranges.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        state: State of the encoder (n, INPUT_STATE) so far, changed in place; None: a new one.

    Returns:
        The inputs (n, T, 6) in steps of 1/1024.
    """
    gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
    state = np.zeros((len(gyro), INPUT_STATE)) if state is None else state
    return encoded(input_scaling(inputs), gyro, accel, state)


def encoded(scaling: tuple[Array, Array], gyro: Array, accel: Array, state: NDArray[np.generic]) -> Array:
    """What `scaled_inputs` returns, of contiguous arrays and the offset and gain of `input_scaling`."""
    x = np.empty((*gyro.shape[:2], 6))
    encode(gyro, accel, *scaling, state, x)
    x /= INPUT_ONE
    return x


@njit(cache=True, inline="always")
def _integer(value, gain):
    return min(max(np.rint(value * gain), -INPUT_MAX), INPUT_MAX)


@njit(cache=True)
def encode_sample(gyro, accel, offset, gain, state):
    """Scale one sample, (3,) [rad/s] and (3,) [m/s²], into the state (7,) of the encoder."""
    rate_found = rate_usable(gyro[0], gyro[1], gyro[2])
    force_found = force_usable(accel[0], accel[1], accel[2])
    if rate_found:
        for k in range(3):
            state[k] = _integer(gyro[k] - offset[k], gain[k])
    if force_found:
        for k in range(3):
            state[3 + k] = _integer(accel[k] - offset[3 + k], gain[3 + k])
    if not (rate_found and force_found):
        state[6] += 1.0


@njit(cache=True)
def encode(gyro, accel, offset, gain, state, x):
    """Integer inputs x (n, T, 6) of readings (n, T, 3) twice; the states (n, 7) are changed."""
    for n in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            encode_sample(gyro[n, t], accel[n, t], offset, gain, state[n])
            for k in range(6):
                x[n, t, k] = state[n, k]
