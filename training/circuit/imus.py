"""Random IMUs for the training of a circuit, none worse than a given one."""

from __future__ import annotations

import numpy as np

from quadsim.imu.spec import ImuSpec

CALIBRATED = 0.2
"""Constant errors of a calibrated IMU, as a share of those of the worst IMU."""
NOISE = 6.0
"""Largest ratio of the noise and vibration of the worst IMU to those of another one."""
LOW_PASS_MAX_HZ = 90.0
RANGE = 30.0
"""Largest ratio of the range of a sensor to that of the worst IMU."""
VIBRATE, DISPLACED, LOSE, SATURATE = 0.5, 0.5, 0.2, 0.15
"""Shares of IMUs with vibration, with a lever arm, with lost samples, and with saturation."""


def draw_imu(worst: ImuSpec, calibrated: bool, rng: np.random.Generator) -> ImuSpec:
    """Draw an IMU whose errors are random shares of those of `worst`.

    Args:
        worst: The IMU with the largest errors, the lowest corner of the low-pass and the smallest range.
        calibrated: Whether biases, scales, misalignment and mounting errors are as small as possible.
        rng: Random generator.
    """

    def part() -> float:
        return CALIBRATED if calibrated else rng.uniform(CALIBRATED, 1.0)

    low_pass = np.exp(rng.uniform(0.0, np.log(LOW_PASS_MAX_HZ / (worst.gyro.low_pass_hz or LOW_PASS_MAX_HZ))))
    saturates = rng.random() < SATURATE
    sensors = {}
    for name, sensor in worst.sensors.items():
        errors = {
            "noise": sensor.noise * NOISE ** -rng.random(),
            "turn_on": sensor.turn_on * part(),
            "scale_factor": sensor.scale_factor * part(),
            "misalignment": sensor.misalignment * part(),
            "low_pass_hz": sensor.low_pass_hz * low_pass,
            "saturation": sensor.saturation
            and (sensor.saturation * RANGE ** rng.random() if saturates else None),
        }
        sensors[name] = sensor.model_copy(update=errors)
    mounting = part() * rng.uniform(-1.0, 1.0, 3) * worst.mounting_deg
    arm = (rng.random() < DISPLACED) * rng.uniform(-1.0, 1.0, 3) * worst.lever_arm
    dropped = (rng.random() < LOSE) * rng.random() * worst.dropped
    vibration, size = worst.vibration, NOISE ** -rng.random()
    if vibration is not None:
        scaled = {name: tuple(size * np.array(getattr(vibration, name))) for name in ("gyro", "accel")}
        vibration = vibration.model_copy(update=scaled) if rng.random() < VIBRATE else None
    others = {"mounting_deg": tuple(mounting), "lever_arm": tuple(arm), "dropped": dropped}
    return worst.model_copy(update=sensors | others | {"vibration": vibration})
