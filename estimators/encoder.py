"""What a network is fed: readings of the IMU, freed of biases, of yaw and of gaps, as integers.

The host does this before the chip. Missing samples (NaN, or a specific force of exactly zero) are bridged by
the last good one and counted.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from quadsim.vehicle import GRAVITY

from .alignment import ACCEL_BIAS, BIAS, KEPT, LEAN, LEANING, YAW_BACK, YAW_BIAS, follow
from .filters import paired
from .tilt import tilt_of, to_roll_pitch, turned_by, yawed
from .weights_file import InputScaling

Array = NDArray[np.float64]
Encoding = tuple[
    Array,
    Array,
    tuple[float, float, float],
    tuple[float, float, float, float, float],
    tuple[float, bool, bool],
]

INPUT_ONE = 1024
"""Integer input of the network for a scaled reading of 1.0."""
INPUT_MAX = 32767
HEADING, FED, ALIGNMENT = 12, 14, 18
HELD = ALIGNMENT + KEPT
"""What the encoder keeps: 6 inputs, missing samples, samples in the low-passes of the lateral forces, the
fast one and the slow one of both; at `HEADING` its cosine and sine; at `FED` the tilt that fed rates sum up
to, and the lateral rates that the gyroscope last read, less its bias; at `ALIGNMENT` what `follow` keeps."""
LEAD_CLIP = 5.0
"""How far a lateral force counts as away from its low-pass: a bad reading does no lasting harm [m/s²]."""


def input_scaling(inputs: InputScaling) -> tuple[Array, Array]:
    """Offset and gain (6,) of the readings: integer input = round((reading - offset) gain)."""
    offset = np.array([0.0, 0.0, 0.0, *inputs.accel_offset])
    return offset, INPUT_ONE / np.array([*[inputs.gyro] * 3, *inputs.accel])


def encoder_of(inputs: InputScaling, rate_hz: float) -> Encoding:
    """What `encode` needs.

    Returns:
        Offset and gain, the lead with its two memories, the alignment's time, drag and noise with the spreads
        of both biases, and the time between samples with whether axes do not yaw and the lean is fed.
    """
    fast, slow = inputs.lead_samples
    lead = inputs.lead, float(fast), float(slow)
    alignment = inputs.align_s, inputs.align_drag, inputs.align_noise, inputs.bias_sd, inputs.accel_bias_sd
    return *input_scaling(inputs), lead, alignment, (1.0 / rate_hz, inputs.yaw_free, inputs.lean_fed)


def scaled_inputs(
    inputs: InputScaling,
    rate_hz: float,
    gyro: ArrayLike,
    accel: ArrayLike,
    held: NDArray[np.generic] | None = None,
) -> tuple[Array, Array]:
    """Inputs of the network.

    Args:
        inputs: How they are scaled.
        rate_hz: Samples per second.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        held: What the encoder keeps (n, HELD), changed in place, to go on from the window before; None: anew.

    Returns:
        The inputs (n, T, 6) in steps of 1/1024, and the heading's cosine and sine (n, T, 2); in
        body axes they are 1 and 0.
    """
    gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
    held = np.zeros((len(gyro), HELD)) if held is None else held
    return encoded(encoder_of(inputs, rate_hz), gyro, accel, held)


def lean_found(
    inputs: InputScaling, rate_hz: float, gyro: ArrayLike, accel: ArrayLike, start: ArrayLike | None = None
) -> Array:
    """Roll and pitch by what `follow` alone finds out, without a network.

    Args:
        inputs: Drag, noise and the spreads of the biases.
        rate_hz: Samples per second.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force (n, T, 3) [m/s²].
        start: Roll and pitch one sample before the first (n, 2) [rad]; None where they are not known.

    Returns:
        Roll and pitch (n, T, 2) [rad].

    Raises:
        ValueError: Shapes that do not fit, or a start that is not finite.
    """
    gyro, accel = paired(gyro, accel)
    inputs = inputs.model_copy(update={"lean_fed": True, "yaw_free": False, "lead": 0.0})
    held = None if start is None else known_to(checked_start(start, len(gyro)))
    x, heading = scaled_inputs(inputs, rate_hz, gyro, accel, held)
    pitch, roll = np.moveaxis(x[..., 3:5] * inputs.accel[:2] / [-GRAVITY, GRAVITY], -1, 0)
    tilt = np.stack([roll, pitch], -1)
    to_roll_pitch(tilt, heading)
    return tilt


def encoded(encoding: Encoding, gyro: Array, accel: Array, held: NDArray[np.generic]) -> tuple[Array, Array]:
    """What `scaled_inputs` returns, of arrays that are laid out for `encode`."""
    x, heading = np.empty((*gyro.shape[:2], 6)), np.empty((*gyro.shape[:2], 2))
    encode(gyro, accel, encoding, held, x, heading)
    x /= INPUT_ONE
    return x, heading


def outputs_at(
    inputs: InputScaling, roll_pitch: NDArray[np.floating], heading: Array | None = None
) -> NDArray[np.floating]:
    """What the outputs should say at roll and pitch (..., 2) [rad]; the heading (..., 2) of None is zero."""
    if not inputs.yaw_free:
        return roll_pitch
    return tilt_of(roll_pitch, np.array([1.0, 0.0]) if heading is None else heading)


def checked_start(roll_pitch: ArrayLike, n: int) -> Array:
    """Roll and pitch (n, 2) [rad] that are told, or ValueError."""
    known = np.asarray(roll_pitch, dtype=np.float64)
    if known.shape != (n, 2):
        raise ValueError(f"roll_pitch: shape {known.shape}, should be ({n}, 2)")
    if not np.isfinite(known).all():
        raise ValueError("roll_pitch: not finite; leave it out where the attitude is unknown")
    return known


def known_to(roll_pitch: NDArray[np.floating]) -> Array:
    """What encoders keep (n, HELD) that know roll and pitch (n, 2) [rad] and have seen nothing yet."""
    roll, pitch = roll_pitch.T
    held = np.zeros((len(roll_pitch), HELD))
    held[:, ALIGNMENT] = np.inf  # the start is over
    held[:, ALIGNMENT + LEAN] = np.sin(pitch)
    held[:, ALIGNMENT + LEAN + 1] = -np.sin(roll) * np.cos(pitch)
    return held


@njit(cache=True)
def _led(k, force, lead, held):
    """A lateral force with its change brought out, in the band between two low-passes that begin as means."""
    if lead[0] == 0.0:
        return force
    if held[7] == 0.0:
        held[8 + k] = held[10 + k] = force
    seen = held[7] + 1.0
    held[8 + k] += min(max(force - held[8 + k], -LEAD_CLIP), LEAD_CLIP) / min(seen, lead[1])
    held[10 + k] += (held[8 + k] - held[10 + k]) / min(seen, lead[2])
    return force + lead[0] * (held[8 + k] - held[10 + k])


@njit(cache=True)
def _scaled(value, gain):
    return min(max(np.rint(value * gain), -INPUT_MAX), INPUT_MAX)


@njit(cache=True)
def encode_sample(gyro, accel, encoding, held):
    """Scale one sample into `held`; what is missing leaves inputs as they are. Returns the axes' heading.

    A lean is fed as −g times the tilt, and its rates sum up to the tilt, with what rounding left out before.
    """
    offset, gain, lead, alignment, (step, yaw_free, lean_fed) = encoding
    aligned = alignment[0] > 0.0 or alignment[3] > 0.0 or alignment[4] > 0.0 or lean_fed
    rate_found = np.isfinite(gyro[0] + gyro[1] + gyro[2])
    force = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2]
    force_found = np.isfinite(force) and force > 0.0
    if held[HEADING] == 0.0 and held[HEADING + 1] == 0.0:  # nothing has been seen yet
        held[HEADING] = 1.0
        lean_x, lean_y = turned_by(held[ALIGNMENT + LEAN], held[ALIGNMENT + LEAN + 1])
        held[FED], held[FED + 1] = -lean_y, lean_x
    if rate_found and (yaw_free or aligned):
        turning = gyro[2] - held[ALIGNMENT + YAW_BIAS] - held[ALIGNMENT + YAW_BACK] / step
        held[HEADING], held[HEADING + 1] = yawed(held[HEADING], held[HEADING + 1], turning, step)
        held[ALIGNMENT + YAW_BACK] = 0.0
    cosine, sine = (held[HEADING], held[HEADING + 1]) if yaw_free else (1.0, 0.0)
    kept = held[ALIGNMENT:]
    turn_x = turn_y = 0.0
    if aligned:
        if rate_found and force_found:
            forces = accel[0] - offset[3], accel[1] - offset[4], accel[2]
            cos_yaw, sin_yaw = held[HEADING], held[HEADING + 1]
            turn_x, turn_y = follow(gyro, forces, cos_yaw, sin_yaw, step, alignment, kept)
        else:
            kept[1] += step
        kept[0] += step
    lean_known = lean_fed and rate_found and force_found
    lean_x, lean_y = turned_by(kept[LEANING], kept[LEANING + 1]) if lean_fed else (0.0, 0.0)
    if rate_found:
        x = gyro[0] - offset[0] - kept[BIAS] + turn_x / step
        y = gyro[1] - offset[1] - kept[BIAS + 1] + turn_y / step
        x, y = cosine * x - sine * y, cosine * y + sine * x
        held[FED + 2], held[FED + 3] = x, y
        if lean_known:
            x = (-cosine * lean_y - sine * lean_x - held[FED]) / step
            y = (cosine * lean_x - sine * lean_y - held[FED + 1]) / step
        held[0], held[1] = _scaled(x, gain[0]), _scaled(y, gain[1])
        held[2] = _scaled(gyro[2] - offset[2] - kept[YAW_BIAS], gain[2])
    elif lean_fed:  # what made up for rounding and gaps before does not go on
        held[0], held[1] = _scaled(held[FED + 2], gain[0]), _scaled(held[FED + 3], gain[1])
    if force_found:
        x, y = accel[0] - offset[3] - kept[ACCEL_BIAS], accel[1] - offset[4] - kept[ACCEL_BIAS + 1]
        if lean_fed:
            x, y = -GRAVITY * lean_x, -GRAVITY * lean_y
        held[3] = _scaled(_led(0, cosine * x - sine * y, lead, held), gain[3])
        held[4] = _scaled(_led(1, cosine * y + sine * x, lead, held), gain[4])
        held[5] = _scaled(accel[2] - offset[5], gain[5])
        held[7] += 1.0
    if lean_fed:
        held[FED] += held[0] / gain[0] * step
        held[FED + 1] += held[1] / gain[1] * step
    if not (rate_found and force_found):
        held[6] += 1.0
    return cosine, sine


@njit(cache=True)
def encode(gyro, accel, encoding, held, x, heading):
    """Integer inputs x (n, T, 6), heading (n, T, 2) of readings (n, T, 3) twice; `held` (n, HELD) goes on."""
    for n in range(gyro.shape[0]):
        for t in range(gyro.shape[1]):
            heading[n, t] = encode_sample(gyro[n, t], accel[n, t], encoding, held[n])
            for k in range(6):
                x[n, t, k] = held[n, k]
