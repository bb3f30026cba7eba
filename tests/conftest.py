"""The command line, recordings, and small synthetic flights: cheap, seeded, and of a known physics."""

import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import xarray as xr
from sensor import body_rate

from quadsim.cli import main
from quadsim.rotation import quat_from_euler, quat_rotate, quat_rotate_inverse

GRAVITY = np.array([0.0, 0.0, -9.81])
DOCS = Path(__file__).parents[1] / "docs"
RECORDINGS = Path(os.environ.get("QUADSIM_REALDATA", Path(__file__).parents[2] / "shared" / "realdata"))


@pytest.fixture(scope="session", autouse=True)
def _one_process() -> Iterator[None]:
    """Commands without a number of workers start no processes: those of pytest have the CPUs already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "sched_getaffinity", lambda pid: {0})
        yield


@pytest.fixture(scope="session")
def broad() -> list[Path]:
    """BROAD trials, hand-moved with optical truth."""
    trials = sorted((RECORDINGS / "broad").glob("*.npz"))
    if not trials:
        pytest.skip("no BROAD trials: set QUADSIM_REALDATA to the folder that holds broad/")
    return trials


@pytest.fixture(scope="module")
def script() -> Iterator[Callable[[str], ModuleType]]:
    """Import a script of docs/."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        yield import_module
    for name in set(sys.modules) - before:
        if str(DOCS) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture
def quadsim(monkeypatch, capsys, tmp_path):
    """Run the command line in an empty folder: (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)  # `main` sets its own

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["quadsim", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        return stop.value.code, captured.out, captured.err

    return run


@pytest.fixture
def printed(quadsim):
    """Run the command line, which has to succeed: standard output."""

    def run(*arguments):
        code, out, err = quadsim(*arguments)
        assert code == 0, err
        return out

    return run


@pytest.fixture
def refused(quadsim):
    """Run the command line, which has to refuse in one line: that line."""

    def run(*arguments):
        code, _, err = quadsim(*arguments)
        assert code == 2, err
        (line,) = (line for line in err.splitlines() if line.startswith("quadsim:"))
        assert "Traceback" not in err
        return line

    return run


def fly(
    flights: int = 4, seconds: float = 20.0, rate_hz: float = 200.0, noise: float = 1.0, seed: int = 0
) -> xr.Dataset:
    """Flights of a point mass, thrust along body z and drag across it, tilt and heading sums of sines.

    Noise and turn-on biases are those of an ADIS16448, times `noise`. A dataset as the generator makes it.
    """
    rng, dt = np.random.default_rng(seed), 1.0 / rate_hz
    t = np.arange(round(seconds * rate_hz)) * dt
    freq = rng.uniform(0.1, 1.0, (flights, 3, 4, 1)) * 2.0 * np.pi
    phase = rng.uniform(0.0, 2.0 * np.pi, freq.shape)
    size = rng.normal(0.0, 0.15, freq.shape)
    roll, pitch, yaw = np.moveaxis((size * np.sin(freq * t + phase)).sum(axis=2), 1, 0)
    d_roll, d_pitch, d_yaw = np.moveaxis((size * freq * np.cos(freq * t + phase)).sum(axis=2), 1, 0)
    quat = quat_from_euler(roll, pitch, yaw)
    rate = body_rate(roll, pitch, d_roll, d_pitch, d_yaw)
    thrust = 9.81 / (np.cos(roll) * np.cos(pitch))
    force, velocity = np.empty_like(rate), np.zeros((flights, 3))
    for k in range(t.size):
        across = quat_rotate_inverse(quat[:, k], velocity)
        force[:, k] = -across / 4.90 * np.sqrt(thrust[:, k] / 9.81)[:, None]
        force[:, k, 2] = thrust[:, k]
        velocity = velocity + dt * (quat_rotate(quat[:, k], force[:, k]) + GRAVITY)
    spread = rng.normal(size=(2, flights, 1, 3)) * np.array([0.0087, 0.196])[:, None, None, None]
    white = rng.normal(size=(2, *rate.shape)) * np.array([3.394e-4, 0.004])[:, None, None, None] / np.sqrt(dt)
    gyro, accel = np.stack([rate, force]) + noise * (spread + white)
    dims = ("flight", "time", "axis")
    return xr.Dataset(
        {"gyro": (dims, gyro), "accel": (dims, accel), "quat": (("flight", "time", "quat"), quat)},
        attrs={"rate_hz": rate_hz},
    )


@pytest.fixture(scope="session")
def make_flights():
    return fly


@pytest.fixture(scope="session")
def flights():
    """Four flights of 20 s at 200 Hz with the noise and biases of an ADIS16448."""
    return fly()
