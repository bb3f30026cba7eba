"""Faults that begin inside a log: found, dated, and none in a log without one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sensor import GRAVITY, blind, readings, report_of

from quadsim.logs.log_faults import find_faults
from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample


def moving(seconds=60.0, rate_hz=200.0, size=1.0, seed=0, spin=0.0) -> Recording:
    """A sensor with white noise that sways, is biased by a constant and spins [rad/s] after half the time."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    roll, pitch = 0.3 * size * np.sin(2.1 * time), 0.2 * size * np.sin(3.3 * time + 1)
    gyro, accel, quat = readings(time, roll, pitch, spin * (time - 0.5 * seconds).clip(0.0))
    gyro = gyro + np.array([0.02, -0.01, 0.005]) + rng.normal(0.0, 3e-3, gyro.shape)
    return Recording("x", "x", time, gyro, accel + rng.normal(0.0, 0.05, accel.shape), "x", time, quat)


def coarse(log: Recording, gyro=1e-3, accel=5e-3) -> Recording:
    return replace(log, gyro=np.round(log.gyro / gyro) * gyro, accel=np.round(log.accel / accel) * accel)


def faults(log: Recording):
    """Faults of a log that is even as it is."""
    quat = np.full((log.time.size, 4), np.nan) if log.quat is None else log.quat
    rate_hz = 1.0 / float(np.median(np.diff(log.time)))
    both, stuck = np.hstack([log.gyro, log.accel]), np.zeros((log.time.size, 6), bool)
    return find_faults(log.time, both, stuck, even_gyro=log.gyro, quat=quat, rate_hz=rate_hz)


def save(path: Path, log: Recording) -> None:
    np.savez(path, t=log.time, gyro=log.gyro, acc=log.accel, quat=log.quat)


def with_jump(log: Recording, start, end, degrees) -> Recording:
    during = (log.time >= start) & (log.time < end)
    return replace(log, gyro=log.gyro + np.radians(degrees) * during[:, None])


def vibrating(log: Recording, start, end, rms) -> Recording:
    noise = np.random.default_rng(1).normal(0.0, rms / np.sqrt(3), log.accel.shape)
    return replace(log, accel=log.accel + noise * ((log.time >= start) & (log.time < end))[:, None])


def clipped(log: Recording, start, sensor="gyro", axis=0, share=0.5) -> Recording:
    readings = getattr(log, sensor).copy()
    limit = share * np.abs(readings[:, axis]).max()
    readings[log.time >= start, axis] = readings[log.time >= start, axis].clip(-limit, limit)
    return replace(log, **{sensor: readings})


def take_off() -> Recording:
    """Carried for a while, at rest until 20 s, then the motors start, and the vehicle flies and vibrates."""
    still, log = moving(size=0.0), moving()
    gyro, accel = (np.where(((log.time > 4.0) & (log.time < 20.0))[:, None], a, b) for a, b in
                   ((still.gyro, log.gyro), (still.accel, log.accel)))  # fmt: skip
    return vibrating(blind(replace(log, gyro=gyro, accel=accel)), 19.0, 60.0, 4.0)


def tapped() -> Recording:
    """A tap of 10 ms five times a second, while moving, after 20 s."""
    log = moving()
    return replace(log, accel=log.accel + 40.0 * ((log.time > 20.0) & (log.time % 0.2 < 0.01))[:, None])


def held() -> Recording:
    """A log of a sensor that is read at 50 Hz and logged at 200 Hz."""
    log, every = coarse(moving()), np.arange(12000) // 4 * 4
    return replace(log, gyro=log.gyro[every], accel=log.accel[every])


def upside_down() -> Recording:
    """A coarse sensor that lies upside down, is moved and lies there once more: its z is at its least."""
    still, log = moving(size=0.0), moving(spin=0.5)
    lies = ((log.time < 10.0) | (log.time > 50.0))[:, None]
    rest = 0.2 * (still.accel - GRAVITY) + [0.0, 0.05, 9.81]  # y is between two numbers
    gyro, accel = np.where(lies, 0.0 * still.gyro, log.gyro), np.where(lies, rest, 0.8 * log.accel)
    return coarse(blind(replace(log, gyro=gyro, accel=-accel)), accel=0.1)


@pytest.mark.parametrize(
    "log",
    [
        moving(size=0.0), moving(rate_hz=1000.0, seconds=30.0), coarse(moving(size=3.0)),
        coarse(moving(), 2e-2, 0.1), take_off(), tapped(), held(), upside_down(),
        replace(spun := moving(spin=1.0), gyro=1.05 * spun.gyro),
        blind(with_jump(moving(), 23.0, 60.0, [3.0, 0.0, 0.0])),
    ],
    ids=["still", "kilohertz", "coarse", "coarser", "take-off", "tapped", "held", "down", "scale", "jump"],
)  # fmt: skip
def test_a_log_without_a_fault_has_none(log):
    assert faults(log) == ()


@pytest.mark.parametrize("end", [35.0, 60.0])
def test_a_bias_that_jumps_is_found_measured_and_dated(end):
    (found,) = faults(with_jump(moving(), 23.0, end, [3.0, 0.0, -2.5]))  # of two axes together
    assert (found.kind, found.sensor, found.axes) == ("bias jump", "gyroscope", "xz")
    assert abs(found.start_s - 23.0) < 1.0
    assert abs(found.end_s - end) < 1.5
    assert "+3.0 °/s about x and -2.5 °/s about z" in found.evidence


@pytest.mark.parametrize(("sensor", "fine"), [("gyro", True), ("accel", False)])
def test_an_axis_that_saturates_from_some_time_on_is_found_and_is_not_called_stuck(sensor, fine):
    log = moving() if fine else coarse(moving())
    faulty = clipped(log, 21.0, sensor)
    first = np.flatnonzero((getattr(faulty, sensor) != getattr(log, sensor))[:, 0])[0] / 200.0
    found = report_of(faulty).sensor_faults
    assert {(fault.kind, fault.axes) for fault in found} == {("saturation", "x")}
    assert found[0].start_s == pytest.approx(first, abs=1.0)
    assert found[0].end_s > 55.0
    assert "of its range" in found[0].evidence


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_a_sensor_that_freezes_while_the_other_moves_is_left_out_and_said(sensor):
    log = moving(seconds=20.0)
    readings = getattr(log, sensor).copy()
    readings[1000:1130] = readings[1000]
    even, report = resample(replace(log, **{sensor: readings}))
    (found,) = report.sensor_faults
    assert (found.kind, found.axes) == ("stuck axis", "xyz")
    assert (found.start_s, found.end_s) == pytest.approx((5.0, 5.65), abs=0.01)
    assert np.isnan(even["gyro"][0, 1000:1130]).all()


@pytest.mark.parametrize("end", [30.5, 60.0])
def test_vibration_that_begins_in_motion_is_found(end):
    (found,) = faults(vibrating(moving(), 25.0, end, 3.0))
    assert found.kind == "vibration"
    assert abs(found.start_s - 25.0) < 0.5
    assert abs(found.end_s - end) < 1.5
    assert float(found.evidence.split(" m/s²")[0].split()[-1]) == pytest.approx(3.0, rel=0.15)


def test_faults_come_in_their_order():
    log = clipped(with_jump(moving(), 40.0, 60.0, [5.0, 0.0, 0.0]), 25.0, "accel", 1)
    log = vibrating(log, 12.0, 20.0, 4.0)
    assert [fault.kind for fault in faults(log)] == ["vibration", "saturation", "bias jump"]


def test_calibration_is_no_advice_for_a_sensor_that_fails():
    still = blind(moving(size=0.0, seconds=30.0))
    biased = replace(still, gyro=still.gyro + np.array([0.05, 0.0, 0.0]))
    assert any("identify LOG --still" in line for line in report_of(biased).warnings)
    stuck = biased.gyro.copy()
    stuck[4000:4300, 2] = stuck[4000, 2]
    warnings = report_of(replace(biased, gyro=stuck)).warnings
    assert not any("identify LOG --still" in line for line in warnings)
    assert any("a calibration does not correct a sensor that fails" in line for line in warnings)


def test_the_report_of_a_log_prints_its_faults(tmp_path, printed):
    save(tmp_path / "x.npz", with_jump(moving(), 23.0, 60.0, [0.0, -3.0, 0.0]))
    said = "! 23.0 s to 60.0 s: the gyroscope's bias jumps by -3.0 °/s about y"
    assert said in printed("report", "x.npz")


def test_a_clock_that_restarts_inside_a_log_is_said():
    log = moving(seconds=20.0)
    again = np.where(log.time < 10.0, log.time, log.time - 8.0)
    (said,) = [line for line in report_of(replace(log, time=again)).warnings if "clock" in line]
    assert said.startswith("1600 samples do not follow the one before in time: left out")
    assert "the clock goes back by 8.0 s" in said


def test_a_log_of_a_second_is_one_line(tmp_path, printed, refused):
    save(tmp_path / "x.npz", moving(seconds=1.0))
    printed("report", "x.npz")
    said = refused("evaluate", "--logs", "x.npz", "--out", "out", "--estimator", "mahony")
    assert "nothing to score: nothing is known after the first 3 s" in said


@pytest.mark.parametrize(("rate_hz", "seconds"), [(50.0, 60.0), (4000.0, 20.0)])
def test_slow_and_fast_logs_have_their_faults_found(rate_hz, seconds):
    log = moving(seconds, rate_hz)
    report = report_of(log)
    assert report.sensor_faults == ()
    assert any("motion above 20 Hz is not in this log" in line for line in report.warnings) == (rate_hz < 90)
    (found,) = report_of(with_jump(log, 0.5 * seconds, seconds, [0.0, 4.0, 0.0])).sensor_faults
    assert (found.kind, found.start_s) == ("bias jump", pytest.approx(0.5 * seconds, abs=1.0))
