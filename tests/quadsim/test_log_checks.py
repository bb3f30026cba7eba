"""What cannot be right in a log is said: units, frames, a late or noisy truth, stuck axes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from sensor import GRAVITY, RATE, blind, readings, report_of, reported, turned, turning, write_csv

from quadsim.logs.recording import Recording, mount_matrix, mounted
from quadsim.logs.resample import resample
from quadsim.rotation import quat_from_euler, quat_from_rotvec, quat_multiply, swap_enu_flu_ned_frd


@pytest.mark.parametrize("late_s", [-0.033, 0.0, 0.06])
def test_a_late_truth_is_found_to_a_millisecond_and_said(late_s):
    time, gyro, accel, quat = turning(seconds=20.0)
    gyro = gyro + np.random.default_rng(1).normal(0.01, 0.05, gyro.shape)
    seen = shaken(quat, 0.002)
    report = report_of(Recording("x", "test", time, gyro, accel, "mocap", time + late_s, seen))
    assert report.aligned.delay_s == pytest.approx(late_s, abs=1e-3)
    assert any("the truth is" in warning for warning in report.warnings) == (late_s != 0.0)


def shaken(quat: np.ndarray, noise: float) -> np.ndarray:
    return quat_multiply(quat, quat_from_rotvec(np.random.default_rng(0).normal(0.0, noise, (len(quat), 3))))


def gentle(noise: float, swapped: bool = False, scale: float = 0.2) -> Recording:
    """A gentle flight of a minute whose truth has white noise [rad] at every sample."""
    time, rng = np.arange(12_000) / RATE, np.random.default_rng(1)
    roll, pitch, yaw = 0.2 * np.sin(2 * time), 0.3 * np.sin(3 * time), 0.3 * np.sin(time)
    gyro, accel, quat = readings(time, scale * roll, scale * pitch, scale * yaw)
    gyro = gyro + rng.normal(0.0, 0.003, gyro.shape)
    accel = accel + rng.normal(0.0, 0.05, gyro.shape)
    order = [1, 0, 2] if swapped else [0, 1, 2]
    return Recording("x", "test", time, gyro[:, order], accel, "mocap", time, shaken(quat, noise))


@pytest.mark.parametrize("noise", [0.01, 0.025])
def test_a_noisy_truth_of_a_gentle_flight_is_believed_and_one_in_swapped_axes_is_not(noise):
    report = report_of(gentle(noise))
    assert report.aligned.agreement < 0.7  # of rates over a tenth of a second, by the truth's noise
    assert report.faults == []
    assert "does not turn as the gyroscope does" in report_of(gentle(noise, True)).faults[0]
    turned = mounted(gentle(noise), mount_matrix("y,-x,z"))
    assert "with the IMU rotated by 9" in report_of(turned).faults[0]


def test_a_noisy_truth_at_rest_is_not_judged():
    assert report_of(gentle(0.025, scale=0.0)).faults == []


def wrong(name: str) -> Recording:
    """A sensor that turns, and one thing wrong with the log of it."""
    log, upside = turned(), np.array([1.0, -1.0, -1.0])
    time, gyro, accel, quat = log.time, log.gyro, log.accel, log.quat
    changed = {
        "deg/s": {"gyro": np.degrees(gyro)},
        "rad/s as deg/s": {"gyro": np.radians(gyro)},
        "ten times the rate": {"gyro": 10 * gyro},
        "no rate": {"gyro": 0 * gyro},
        "constant force": {"accel": np.broadcast_to([0.0, 0.0, 9.81], accel.shape)},
        "twice the time": {"time": 2 * time, "truth_time": 2 * time},
        "norm": {"quat": 0.7 * quat},
        "g": {"accel": accel / 9.81},
        "mg": {"accel": accel / 9.81e-3},
        "frame": {"gyro": upside * gyro, "accel": upside * accel},
        "frd in ned": {"gyro": upside * gyro, "accel": upside * accel, "quat": swap_enu_flu_ned_frd(quat)},
        "gravity": {"accel": -accel},
        "sign of z": {"gyro": gyro * [1.0, 1.0, -1.0]},
        "upright": {"gyro": gyro[:, [2, 1, 0]] * [1, -1, 1], "accel": accel[:, [2, 1, 0]] * [1, -1, 1]},
        "axes": {"gyro": gyro[:, [1, 2, 0]], "accel": accel[:, [1, 2, 0]]},
    }
    return replace(log, **changed[name])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("deg/s", 'times the rate at which the truth turns (slope): is it in deg/s (gyro.unit = "deg/s")'),
        ("rad/s as deg/s", 'is it in rad/s (gyro.unit = "rad/s")'),
        ("ten times the rate", "look at its unit"),
        ("no rate", "the gyroscope reads the same number all the time"),
        ("constant force", "the accelerometer reads the same number all the time"),
        ("twice the time", "look at its unit, and at that of the stamps"),
        ("norm", "quaternions have a length of 0.7, not 1"),
        ("g", 'is it in g (accel.unit = "g")?'),
        ("mg", 'is it in mg (accel.unit = "mg")?'),
        ("frame", "with the IMU rotated by 180° it does"),
        ("frd in ned", 'it points down: frame = "frd"'),
        ("gravity", "accel.negate = true"),
        ("axes", "look at frame and mount"),
        ("sign of z", "the gyroscope's z does not read how the truth turns about that axis (correlation -"),
        ("g, blind", 'accel.unit = "g"'),
        ("mg, blind", 'accel.unit = "mg"'),
        ("frame, blind", 'frame = "frd"'),
        ("upright, blind", "is the frame FLU"),
    ],
)
def test_units_norms_and_frames_that_cannot_be_right_are_said(name, said):
    log = wrong(name.removesuffix(", blind"))
    report = report_of(blind(log) if "blind" in name else log)
    assert any(said in fault for fault in report.faults[: 1 if "blind" in name else None])
    assert report.faults[0] in report.warnings


def test_a_log_in_which_nothing_is_wrong_has_no_faults():
    assert report_of(turned()).faults == report_of(blind(turned())).faults == []


def test_a_force_that_is_somewhat_off_gravity_is_a_warning_and_no_fault():
    report = report_of(turned(accel=turned().accel + np.array([0.0, 0.0, 2.0])))
    assert report.faults == []
    assert any("frames disagree: turned to the world" in warning for warning in report.warnings)


def test_noise_of_the_truth_hides_no_wrong_unit_and_makes_none():
    log = turned()
    noisy = replace(log, quat=shaken(log.quat, 0.024))
    report = report_of(noisy)
    assert report.aligned.slope < 0.78  # by the truth's noise alone
    assert report.aligned.slope / report.aligned.agreement == pytest.approx(1.0, rel=0.02)
    assert not any("times the rate" in fault for fault in report.faults)
    in_degrees = report_of(replace(noisy, gyro=np.degrees(log.gyro)))
    assert any('gyro.unit = "deg/s"' in fault for fault in in_degrees.faults)


@pytest.mark.parametrize("with_truth", [True, False])
def test_a_gyroscope_in_degrees_shows_at_rest_too(with_truth):
    rng, still = np.random.default_rng(0), np.tile([0.0, 1.0, 9.75], (4000, 1))
    gyro = np.radians([0.6, -0.4, 0.3]) + rng.normal(0.0, 2e-3, still.shape)
    time = np.arange(4000) / 200
    log = Recording("x", "test", time, gyro, still + rng.normal(0.0, 0.03, still.shape))
    if with_truth:
        log = log.with_truth("truth", time, np.tile(quat_from_euler(0.1, 0, 0), (4000, 1)))
    assert report_of(log).faults == []
    said = report_of(replace(log, gyro=np.degrees(gyro))).faults
    assert any("at rest for 20 s" in fault and 'gyro.unit = "deg/s"' in fault for fault in said)
    biased = report_of(replace(log, gyro=gyro + np.radians([4.6, 0.0, 0.0])))
    assert not any("at rest" in fault for fault in biased.faults)  # a raw bias, and the right unit


@pytest.mark.parametrize("bank_deg", [15.0, 24.0, 40.0])
def test_a_steady_banked_turn_is_not_taken_for_rest(bank_deg):
    time, bank = np.arange(4000) / 200, np.radians(bank_deg)
    rate = np.tile([0.0, 2.0 * np.sin(bank), 2.0 * np.cos(bank)], (4000, 1))  # 2 rad/s about the vertical
    noise = np.random.default_rng(0).normal(0.0, 1e-3, rate.shape)
    force = np.tile([0.0, 0.0, 9.81 / np.cos(bank)], (4000, 1)) + noise
    assert report_of(Recording("x", "test", time, rate + noise, force)).faults == []


def test_a_log_that_cannot_be_right_is_scored_by_force_alone(tmp_path, printed, refused):
    log = write_csv(tmp_path, wrong("deg/s"))
    for command in (
        ["evaluate", "--logs", log, "--estimator", "mahony", "--out", "out"],
        ["export", log, "--format", "zarr", "--piece", "5", "--out", "out.zarr"],
    ):
        assert re.search(r"57.3 times the rate.*--force", refused(*command))
        printed(*command, "--force")


@pytest.mark.parametrize(("sensor", "reading"), [("gyro", 1000.0), ("gyro", 1e30), ("accel", 1e30)])
def test_a_spike_is_left_out_and_condemns_no_log(sensor, reading):
    log = turned()
    spoilt = getattr(log, sensor).copy()
    spoilt[900] = reading
    report = report_of(replace(log, **{sensor: spoilt}))
    assert report.faults == []
    assert report.counts["missing"] == 1


def test_real_recordings_agree_with_their_truth_and_raise_no_false_alarm(broad):
    for path in sorted(broad[0].parents[1].glob("*/*.npz"))[2::5]:
        log, report = reported(path)
        assert (report.faults, report.sensor_faults) == ([], ())
        if path in broad:
            assert report.counts["source_rate_hz"] == pytest.approx(285.7, abs=0.1)
            assert np.linalg.norm(np.subtract(report.gravity, GRAVITY)) < 0.15
            assert log["scored"].any()


def noisy() -> Recording:
    log, rng = turned(), np.random.default_rng(0)
    gyro = log.gyro + rng.normal(0.0, 2e-3, log.gyro.shape)
    return replace(log, gyro=gyro, accel=log.accel + rng.normal(0.0, 0.02, log.accel.shape))


@pytest.mark.parametrize(("sensor", "axis"), [("gyro", 1), ("accel", 0)])
def test_an_axis_that_is_stuck_is_left_out_there_and_refused_if_always(sensor, axis):
    log = noisy()
    readings = getattr(log, sensor).copy()
    readings[1000:1800, axis] = readings[1000, axis]
    dataset, report = resample(replace(log, **{sensor: readings}))
    name = f"the {'gyroscope' if sensor == 'gyro' else 'accelerometer'}'s {'xyz'[axis]}"
    (said,) = [line for line in report.warnings if f"{name} repeats one number for 4.0 s" in line]
    assert said.startswith("5.0 s to 9.0 s: ")
    assert said.endswith(": left out of scores")
    missing = np.isnan(dataset["gyro"][0]).any(axis=1).to_numpy()
    assert missing[1000:1800].all()
    assert missing.sum() < 810
    readings[:, axis] = 0.5
    always = report_of(replace(log, **{sensor: readings}))
    assert f"{name} reads the same number all the time" in always.faults


def test_a_coarse_sensor_at_rest_is_not_stuck():
    rng = np.random.default_rng(0)
    accel = np.round(rng.normal([0.02, 0.04, 9.81], 0.01, (4000, 3)) / 0.08) * 0.08
    gyro = np.round(rng.normal(0.0, 1e-3, (4000, 3)) / 1e-3) * 1e-3
    log, report = resample(Recording("x", "x", np.arange(4000) / 200, gyro, accel))
    assert report.sensor_faults == ()
    assert np.isfinite(log["accel"]).all()
