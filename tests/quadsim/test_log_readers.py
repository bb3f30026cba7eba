"""Logs of the Crazyflie's uSD deck: what was written is read, and damage is named."""

import struct
from zlib import crc32

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor import reported

from quadsim.dataset.reading import open_dataset
from quadsim.logs import read_log, read_recording
from quadsim.logs.convert import convert
from quadsim.logs.readers.usdlog import read_usdlog
from quadsim.logs.resample import resample

IMU = ("acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z")
QUAT = tuple(f"stateEstimate.{name}" for name in ("qw", "qx", "qy", "qz"))
RPM = tuple(f"rpm.m{k}" for k in (1, 2, 3, 4))
ROW = (0.0, 0.0, 1.0, 90.0, 0.0, -180.0, 1.0, 0.0, 0.0, 0.0, 3000.0, 6000.0, 9000.0, 12000.0)


def write_usd(path, version=2, names=IMU + QUAT + RPM, rows=400):
    """A log of one event type at 200 Hz, as the deck writes it."""
    data = struct.pack("<BHHH", 0xBC, version, 1, 7) + b"fixedFrequency\0" + struct.pack("<H", len(names))
    data += b"".join(f"{name}(f)".encode() + b"\0" for name in names)
    for k in range(rows):
        data += struct.pack("<HI", 7, 5 * k) if version == 1 else struct.pack("<HQ", 7, 5000 * k)
        data += struct.pack(f"<{len(names)}f", *ROW[: len(names)])
    path.write_bytes(data + struct.pack("<I", crc32(data)))
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_a_usd_log_is_read_in_si_units(tmp_path, version):
    log = read_recording(write_usd(tmp_path / "log00", version))
    assert log.time.size == 400
    np.testing.assert_allclose(np.diff(log.time), 0.005, atol=1e-12)
    np.testing.assert_allclose(log.gyro[-1], [np.pi / 2, 0, -np.pi])
    np.testing.assert_allclose(log.accel[-1], [0, 0, 9.80665])
    assert log.quat is not None
    np.testing.assert_allclose(log.quat[-1], [1, 0, 0, 0])
    np.testing.assert_allclose(log.sensors["rotor_vel"].values[0], np.array([1, 2, 3, 4]) * 100 * np.pi)
    assert "no independent truth" in log.truth
    assert not any("checksum" in note for note in log.notes)


EVENT = 10 + 4 * len(IMU + QUAT + RPM)
"""Bytes of an event."""


@pytest.mark.parametrize(("cut", "flip", "rows"), [(100, 0, 398), (0, 1, 400), (0, 4 + 100 * EVENT, 300)])
def test_a_damaged_usd_log_is_read_up_to_the_damage_which_is_named(tmp_path, cut, flip, rows):
    path = write_usd(tmp_path / "log00")
    data = bytearray(path.read_bytes())
    there = len(data) - 4 - (400 - rows) * EVENT
    data = data[: len(data) - cut]
    if flip:
        data[-flip] ^= 0xFF
    path.write_bytes(data)
    assert read_recording(path).time.size == rows
    said = f"damaged: bad checksum, read up to byte {there} of {len(data)}"
    assert said in reported(path)[1].warnings


CHANGES = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=8)


@given(changes=CHANGES, cut=st.integers(0, 10**6), header=st.booleans())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_damage_to_a_usd_log_is_read_or_one_line(tmp_path, changes, cut, header):
    path = write_usd(tmp_path / "log00", rows=12)
    data = bytearray(path.read_bytes())
    for at, value in changes:
        data[at % (200 if header else len(data))] = value
    path.write_bytes(data[: 1 + cut % (2 * len(data))])
    try:
        resample(read_usdlog(path))
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017  (most of them are read)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\xbc\x03\x00\x01\x00", "version 3"),
        (b"\xbc\x02\x00\x01\x00\x07\x00fixed", "cut off"),
        (b"", "not a log"),
        (b"\x00\x01\x02\x03", "not a log"),
    ],
)
def test_a_damaged_usd_log_is_refused_in_one_line(tmp_path, data, message):
    path = tmp_path / "log00"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=message) as error:
        read_recording(path)
    assert "\n" not in str(error.value)


def write_usd_events(path, rates_hz, seconds=4.0, gap=()):
    """A log whose gyroscope and accelerometer are events of their own, on stamps of their own."""
    kinds = {7: (b"estGyroscope", IMU[3:]), 9: (b"estAcceleration", IMU[:3])}
    data = struct.pack("<BHH", 0xBC, 2, len(kinds))
    for number, (name, variables) in kinds.items():
        data += struct.pack("<H", number) + name + b"\0" + struct.pack("<H", len(variables))
        data += b"".join(f"{each}(f)".encode() + b"\0" for each in variables)
    events = [(1e6 * k / rates_hz[0], 7) for k in range(round(seconds * rates_hz[0]))]
    events += [(700 + 1e6 * k / rates_hz[1], 9) for k in range(round(seconds * rates_hz[1]))]
    for stamp, number in sorted(events):
        wave = np.sin(2e-6 * stamp)
        values = (90.0 * wave, 0.0, 10.0) if number == 7 else (0.1 * wave, 0.0, 1.0)
        if number != 9 or not gap or not gap[0] < stamp < gap[1]:
            data += struct.pack("<HQ3f", number, round(stamp), *values)
    path.write_bytes(data + struct.pack("<I", crc32(data)))
    return path


@pytest.mark.parametrize("rates_hz", [(500.0, 500.0), (1000.0, 400.0), (250.0, 1000.0)])
def test_a_usd_log_whose_sensors_are_events_of_their_own_is_read(tmp_path, rates_hz):
    log = read_recording(write_usd_events(tmp_path / "log00", rates_hz))
    np.testing.assert_allclose(log.gyro[:, 0], np.pi / 2 * np.sin(2 * log.time), atol=1e-5)
    np.testing.assert_allclose(log.accel[:, 0], 0.980665 * np.sin(2 * log.time), atol=1e-4)
    assert 1 / np.median(np.diff(log.time)) == pytest.approx(rates_hz[0])
    assert any("estGyroscope and estAcceleration" in note for note in log.notes)


def test_where_one_event_of_a_usd_log_is_missing_nothing_is_interpolated(tmp_path):
    data, report = reported(write_usd_events(tmp_path / "log00", (500.0, 500.0), gap=(1e6, 2e6)))
    assert report.counts["longest_gap_s"] == pytest.approx(1.0, abs=0.01)
    missing = np.isnan(data["accel"][0]).any(axis=1).to_numpy()
    assert missing.sum() == pytest.approx(200, abs=2)


def test_a_usd_log_without_an_imu_names_what_it_has(tmp_path):
    with pytest.raises(ValueError, match=r"no event has all of gyro\.x.*logged: acc\.x"):
        read_recording(write_usd(tmp_path / "log00", names=IMU[:3]))


def test_converted_logs_have_the_rotor_speeds_of_the_log(tmp_path):
    log = read_log(write_usd(tmp_path / "log00"))
    flights = open_dataset(convert([log], tmp_path / "out.zarr", piece_s=1.0))
    np.testing.assert_allclose(flights["rotor_vel"][0, 50], np.array([1, 2, 3, 4]) * 100 * np.pi, rtol=1e-6)
