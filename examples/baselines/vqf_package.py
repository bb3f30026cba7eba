"""VQF (Laidig & Seel 2023) from its authors' package `vqf`, with the package's default parameters."""

import numpy as np
from vqf import VQF

from quadsim.rotation import roll_pitch_from_quat


class Vqf:
    """VQF with the default parameters of its package, including rest detection and bias estimation."""

    parameter_count = 5  # tauAcc, and four of the bias

    def __init__(self, rate_hz):
        self.rate_hz = rate_hz

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles."""
        self.filters = [VQF(1.0 / self.rate_hz) for _ in range(n)]
        self.last = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], (n, 1))

    def update(self, gyro, accel):
        """Roll and pitch (n, 2) [rad]; the last good number stands in for a missing one."""
        readings = np.hstack([gyro, accel])
        self.last = np.where(np.isfinite(readings), readings, self.last)
        for vqf, row in zip(self.filters, self.last, strict=True):
            vqf.update(row[:3], row[3:])
        return roll_pitch_from_quat(np.array([vqf.getQuat6D() for vqf in self.filters]))
