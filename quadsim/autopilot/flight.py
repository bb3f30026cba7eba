"""Betaflight in the loop: its firmware is both the attitude estimator and the attitude controller.

At each sample, the firmware receives the readings and the stick positions and runs for one sample period. It
replies with its attitude and its motor commands, which drive the rotors until the next sample. The position
and velocity loops of the cascade move the sticks; the firmware reads the stick positions of the previous
sample. The speed of a rotor is proportional to its command, and a command of 1 is the highest speed.
"""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..control.cascade import Controller
from ..estimator import OtherSensors
from ..rotation import quat_from_roll_pitch, quat_rotate_inverse, roll_pitch_from_quat
from ..runs.fingerprint import ASSETS
from ..vehicle import GRAVITY, Vehicle
from .firmware import SAFE, Firmware, compiled, configure
from .protocol import HIGH, LOW, stick, throttle

Array = NDArray[np.float64]

Mode = Literal["betaflight", "betaflight-rate"]
AUTOPILOTS: tuple[Mode, ...] = get_args(Mode)
"""Betaflight in angle mode, in which sticks command roll and pitch, and in rate mode, in which sticks command
the body rate. In rate mode, the cascade's gain converts attitude errors to body rates."""
ARM, ANGLE, THROTTLE = 4, 5, 2
"""Indices of the channels of the two switches and the throttle."""
BOOT_S, ARMING_S, HOLD_S = 2.5, 0.5, 0.2
"""Times at rest before a flight: for the estimate to settle, to arm, and with the throttle of hover [s]."""
IDLE = 0.055
"""The firmware's default `motor_idle`: the smallest command of a motor in flight."""
ANGLE_LIMIT = np.radians(60.0)
"""The firmware's default `angle_limit`: roll and pitch at full stick deflection [rad]."""
RATE_LIMIT = np.radians(670.0)
"""Body rate at full stick deflection with the settings in `assets/autopilot/betaflight.txt` [rad/s]."""


def settings(vehicle: Vehicle) -> list[str]:
    """Return the firmware's settings: `assets/autopilot/betaflight.txt` and the mixer of the vehicle.

    Raises:
        ValueError: The vehicle does not have four rotors.
    """
    if len(vehicle.rotors) != 4:
        raise ValueError(f"betaflight's simulator has four motors, and {vehicle.name} {len(vehicle.rotors)}")
    lines = (ASSETS / "autopilot" / "betaflight.txt").read_text("utf-8").splitlines()
    shares = vehicle.allocation[1:] * [[1.0], [1.0], [-1.0]]  # its yaw column counts the other way
    shares /= np.abs(shares).max(axis=1, keepdims=True)
    rotors = [3, 0, 1, 2]  # of its motors, by the order in which sitl.c sends their commands
    rows = [f"mmix {i} 1 {' '.join(f'{share:.4f}' for share in shares[:, k])}" for i, k in enumerate(rotors)]
    return [*(line for line in lines if not line.startswith("#")), "mixer CUSTOM", "mmix reset", *rows]


class Betaflight:
    """The firmware of n vehicles as an `AttitudeEstimator`; `pilot` is the matching `AttitudeController`.

    Args:
        vehicle: The vehicle, with four rotors.
        rate_hz: Samples per second.
        mode: Angle or rate mode.
        program: Path of the compiled firmware; None compiles the source in the package betaflight.

    Raises:
        ModuleNotFoundError: The package betaflight is not installed.
        ValueError: The firmware cannot be compiled or configured, or the vehicle does not have four rotors.
    """

    def __init__(
        self, vehicle: Vehicle, rate_hz: float = 200.0, mode: Mode = "betaflight", program: Path | None = None
    ) -> None:
        self.rate_hz, self.mode = rate_hz, mode
        commands = settings(vehicle)
        self._program, self._folder = program or compiled(), TemporaryDirectory(prefix="quadsim-betaflight-")
        configure(self._program, Path(self._folder.name), commands)
        self.pilot = Pilot(self, vehicle)
        self.firmware: dict[int, Firmware] = {}

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Start and arm n firmwares at rest, level or at an attitude (n, 2) [rad].

        Raises:
            ValueError: A firmware fails or does not arm.
        """
        self.close()
        self.firmware, self.channels = {}, np.tile(SAFE, (n, 1))
        self.motors, self.quat = np.zeros((n, 4)), np.zeros((n, 4))
        self._gyro, self._accel = np.zeros((n, 3)), np.zeros((n, 3))
        self.restart(np.arange(n), roll_pitch)

    def restart(self, ids: NDArray[np.int_], roll_pitch: ArrayLike | None = None) -> None:
        """Restart the firmwares of some vehicles; the others continue."""
        attitude = np.zeros((len(ids), 2)) if roll_pitch is None else np.asarray(roll_pitch)
        up = quat_rotate_inverse(quat_from_roll_pitch(attitude), [0.0, 0.0, GRAVITY])
        self._gyro[ids], self._accel[ids], self.channels[ids] = 0.0, up, SAFE
        self.channels[ids, ANGLE] = HIGH if self.mode == "betaflight" else LOW
        for i in ids.tolist():
            self.firmware[i] = Firmware(self._program, Path(self._folder.name))
        hover = throttle(np.array(self.pilot.hover), IDLE)
        for channel, value, seconds in ((ARM, LOW, BOOT_S), (ARM, HIGH, ARMING_S), (THROTTLE, hover, HOLD_S)):
            self.channels[ids, channel] = value
            for _ in range(round(seconds * self.rate_hz)):
                self._run(ids.tolist(), 1.0 / self.rate_hz)
        for i in ids.tolist():
            reply = self.firmware[i].reply
            if not reply["armed"]:
                self.close()
                flags = f"{reply['arming_disabled']:#x}"
                raise ValueError(f"betaflight does not arm; its arming disable flags are {flags}")

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Return roll and pitch as estimated by the firmware, (n, 2) [rad].

        A NaN reading keeps its last value.
        """
        self._gyro = np.where(np.isfinite(gyro), gyro, self._gyro)
        self._accel = np.where(np.isfinite(accel), accel, self._accel)
        self._run(self.firmware, 1.0 / self.rate_hz)
        return roll_pitch_from_quat(self.quat)

    def _run(self, ids: Iterable[int], seconds: float) -> None:
        for i in ids:
            self.firmware[i].send(seconds, self._gyro[i], self._accel[i], self.channels[i])
        for i in ids:
            self.firmware[i].receive()
            self.motors[i], self.quat[i] = self.firmware[i].reply["motors"], self.firmware[i].reply["quat"]

    def close(self) -> None:
        """End all firmwares."""
        for firmware in self.firmware.values():
            firmware.close()


class Pilot:
    """Moves the sticks of a `Betaflight`: an `AttitudeController` that returns rotor speeds.

    Args:
        autopilot: The autopilot.
        vehicle: The vehicle that the autopilot flies.
    """

    rotor_speeds = True
    """`update` returns rotor speeds; see `AttitudeController`."""

    def __init__(self, autopilot: Betaflight, vehicle: Vehicle) -> None:
        self.autopilot, self.vehicle = autopilot, vehicle
        self.hover = vehicle.hover_rotor_vel / vehicle.motor.omega_max
        gains = Controller(vehicle, rate_hz=autopilot.rate_hz).records["gains"]
        self.gain = float(gains["attitude"][0])

    def reset(self, n: int) -> None:
        """Do nothing: resetting the estimator starts the firmware."""

    def restart(self, ids: NDArray[np.int_]) -> None:
        """Do nothing, as in `reset`."""

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """Move the sticks and return the rotor speeds of the firmware's last commands, (n, 4) [rad/s]."""
        channels = self.autopilot.channels
        if self.autopilot.mode == "betaflight":
            roll_pitch_stick = set_point[:, :2] / ANGLE_LIMIT
        else:
            roll_pitch_stick = self.gain * (set_point[:, :2] - roll_pitch) / RATE_LIMIT
        channels[:, :2] = stick(roll_pitch_stick)
        channels[:, THROTTLE] = throttle(self.hover * np.sqrt(set_point[:, 3] / GRAVITY), IDLE)
        channels[:, 3] = stick(-set_point[:, 2] / RATE_LIMIT)
        return self.autopilot.motors * self.vehicle.motor.omega_max
