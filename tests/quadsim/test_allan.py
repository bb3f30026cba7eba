"""An IMU's noise and biases from a log at rest."""

from dataclasses import replace

import numpy as np
import pytest
from sensor import GRAVITY, RATE

from quadsim.imu.spec import ImuSpec, load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs.allan import allan_variance, calibrate, model_variance, write_imu
from quadsim.logs.recording import Recording
from quadsim.rotation import quat_from_euler, quat_rotate_inverse


def test_allan_variance_is_allantools():
    allantools = pytest.importorskip("allantools")
    signal = np.random.default_rng(0).normal(size=(20_000, 3)).cumsum(axis=0)
    sizes = np.array([1, 10, 300])
    found = allan_variance(signal, 100.0, sizes)
    for axis in range(3):
        _, deviation, *_ = allantools.oadev(signal[:, axis], 100.0, "freq", taus=sizes / 100.0)
        np.testing.assert_allclose(np.sqrt(found[:, axis]), deviation, rtol=1e-9)


def test_model_variance_is_smooth_where_it_is_expanded():
    times = np.array([9.99, 10.01])
    low, high = model_variance(times, 0.0, 1.0, 1000.0)
    assert high / low == pytest.approx(10.01 / 9.99, rel=1e-4)
    assert low == pytest.approx(9.99 / 3, rel=0.01)  # σ_b² t/3 of a pure random walk


def test_an_hour_at_rest_calibrates_the_sensor_that_recorded_it(tmp_path):
    log, imu = at_rest(3600.0)
    found = calibrate(log)
    for sensor, true in ((found.gyro, imu.gyro), (found.accel, imu.accel)):
        assert sensor.noise == pytest.approx(true.noise, rel=0.02)
        assert sensor.random_walk == pytest.approx(true.random_walk, rel=0.2)
        assert true.time_constant is not None
        assert 1 / 2.5 < sensor.time_constant / true.time_constant < 2.5
    np.testing.assert_allclose(found.gyro.bias, log.gyro.mean(axis=0), atol=1e-12)
    write_imu(found, tmp_path / "mine.toml")
    written = load_imu(tmp_path / "mine.toml")
    assert written.gyro.noise == pytest.approx(found.gyro.noise, rel=1e-4)
    assert written.accel.turn_on == pytest.approx(found.accel.turn_on, rel=1e-4)


def at_rest(seconds: float, seed: int = 1) -> tuple[Recording, ImuSpec]:
    imu = load_imu("adis16448")
    steps = round(seconds * RATE)
    force = np.tile(quat_rotate_inverse(quat_from_euler(0.1, -0.2, 0.0), GRAVITY), (1, steps, 1))
    gyro, accel = simulate_imu(imu, np.zeros((1, steps, 3)), force, RATE, seed=seed)
    return Recording("still", "x", np.arange(steps) / RATE, gyro[0], accel[0]), imu


def test_half_a_minute_at_rest_gives_the_noise_and_says_what_the_walk_needs():
    log, imu = at_rest(30.0)
    found = calibrate(log)
    for sensor, true in ((found.gyro, imu.gyro), (found.accel, imu.accel)):
        assert sensor.noise == pytest.approx(true.noise, rel=0.1)
        assert sensor.random_walk == 0.0
    along_gravity = abs(np.linalg.norm(log.accel.mean(axis=0)) - 9.81)
    assert found.accel.turn_on == pytest.approx(along_gravity, abs=0.01)
    (line,) = found.lacking
    assert line.startswith("bias random walk and its time constant: need 60 s")


def test_a_walk_that_does_not_show_is_bounded():
    log, imu = at_rest(70.0)
    white = np.random.default_rng(0).normal(0.0, imu.gyro.noise * np.sqrt(RATE), log.gyro.shape)
    found = calibrate(replace(log, gyro=white))
    assert found.gyro.random_walk == 0.0
    (line,) = [each for each in found.lacking if each.startswith("gyroscope, bias random walk")]
    bound = float(line.split("below about ")[1].split(" ")[0])
    assert bound == pytest.approx(4 * np.sqrt(3) * imu.gyro.noise / 70, rel=0.1)


def test_the_seconds_before_take_off_are_at_rest_and_a_hover_with_vibration_is_not():
    log, _ = at_rest(20.0)
    shake = np.random.default_rng(0).normal(0.0, 1.0, log.accel.shape) * (log.time > 12.0)[:, None]
    flown = replace(log, accel=log.accel + shake)
    assert calibrate(flown).still_s == pytest.approx(12.0, abs=1.0)
    late = replace(log, accel=log.accel + shake[::-1] + shake)
    with pytest.raises(ValueError, match=r"still: at rest for \d s at a stretch; at least 10 s are required"):
        calibrate(late)


def test_odd_stamps_at_rest_are_left_out_and_bad_logs_are_one_line():
    log, _ = at_rest(20.0)
    stamps = log.time.copy()
    stamps[500:503], stamps[2000] = stamps[499], np.nan
    found = calibrate(replace(log, time=stamps))
    np.testing.assert_allclose(found.gyro.bias, log.gyro.mean(axis=0), atol=3e-4)
    with pytest.raises(ValueError, match="no noise to measure"):
        calibrate(replace(log, accel=np.tile(GRAVITY, (log.time.size, 1))))
    with pytest.raises(ValueError, match=r"at rest it reads a specific force of 0\.98\d* m/s²"):
        calibrate(replace(log, accel=log.accel / 9.81))


def test_the_command_prints_the_bias_and_writes_an_imu(tmp_path, printed):
    log, _ = at_rest(12.0)
    np.savez(tmp_path / "x.npz", t=log.time, gyro=log.gyro, acc=log.accel)
    out = tmp_path / "mine.toml"
    found = printed("identify", "x.npz", "--still", "--out", out)
    assert all(f"{value:+.5f}" in found for value in log.gyro.mean(axis=0))
    assert load_imu(out).gyro.turn_on == pytest.approx(np.sqrt((log.gyro.mean(axis=0) ** 2).mean()), rel=1e-4)
    assert out.with_suffix(".png").is_file()
