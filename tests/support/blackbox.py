"""Logs that Betaflight's firmware writes itself, on readings that are known.

`python tests/support/blackbox.py FILE` makes tests/data/turning.bbl, on the readings of `sensor.turning`.
"""

import sys
from pathlib import Path
from unittest import mock

import numpy as np
from sensor import turning

from quadsim.autopilot import flight
from quadsim.autopilot.flight import ARM, Betaflight, settings
from quadsim.autopilot.protocol import LOW
from quadsim.rotation import roll_pitch_from_quat
from quadsim.vehicle import load_vehicle

UNUSED = ("pids", "rc", "setpoint", "bat", "alt", "rssi", "gyrounfilt", "motors")
FILTERS = "gyro_lpf1_dyn_min_hz", "gyro_lpf1_static_hz", "gyro_lpf2_static_hz", "acc_lpf_hz"
LOGGING = (
    "set blackbox_device = VIRTUAL",
    "set blackbox_high_resolution = ON",
    "set blackbox_sample_rate = 1/16",
    *(f"set blackbox_disable_{name} = ON" for name in UNUSED),
    "set simplified_gyro_filter = OFF",
    *(f"set {name} = 0" for name in FILTERS),
)


class Logging(Betaflight):
    """A Betaflight with a blackbox; `history` has its readings and attitudes, and until when each holds."""

    def __init__(self, *arguments, **named):
        with mock.patch.object(flight, "settings", lambda vehicle: [*settings(vehicle), *LOGGING]):
            super().__init__(*arguments, **named)
        self.history = []

    def update(self, gyro, accel, **sensors):
        estimate = super().update(gyro, accel, **sensors)
        row = self.firmware[0].time_s, self._gyro[0], self._accel[0], self.quat[0]
        self.history.append(np.hstack(row))
        return estimate

    def finish(self) -> bytes:
        """Disarm, which ends the log, and return it."""
        self.channels[:, ARM] = LOW
        for _ in range(100):
            self._run(self.firmware, 0.005)
        self.close()
        (log,) = Path(self._folder.name).glob("LOG*")
        return log.read_bytes()


if __name__ == "__main__":
    autopilot = Logging(load_vehicle("hummingbird"), rate_hz=500.0)
    _, gyro, accel, quat = turning(500.0)
    autopilot.reset(1, roll_pitch_from_quat(quat[:1]))
    for k in range(len(gyro)):
        autopilot.update(gyro[k : k + 1], accel[k : k + 1])
    Path(sys.argv[1]).write_bytes(autopilot.finish())
