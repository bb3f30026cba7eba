"""Samples of a log at even instants: motion is kept, gaps stay gaps, and odd stamps are counted."""

import numpy as np
import pytest
from sensor import GRAVITY, RATE, consistent, report_of, turned, turning

from quadsim.logs.cleaning import split_at_gaps
from quadsim.logs.recording import Recording, Track
from quadsim.logs.resample import resample


def test_sensors_beside_the_imu_are_interpolated_but_not_over_gaps():
    time = np.arange(800) / RATE
    slow = time[::10][(time[::10] < 1.0) | (time[::10] > 2.0)]
    speeds = Track(slow, np.stack([100.0 + slow, 200.0 - slow], axis=1))
    still = np.tile(GRAVITY, (800, 1))
    log = resample(Recording("x", "x", time, 0 * still, still, sensors={"rotor_vel": speeds}), RATE)[0]
    given = log["rotor_vel"][0].to_numpy()
    assert np.isnan(given[(time > 1.0) & (time < 1.99)]).all()
    np.testing.assert_allclose(given[:180, 0], 100.0 + time[:180])


def tones(rate_hz: float, *hz: float) -> Recording:
    time = np.arange(round(4 * rate_hz)) / rate_hz
    wave = sum(np.sin(2 * np.pi * each * time) for each in hz)
    signal = np.stack([wave, 0.5 * wave, -wave], axis=1)
    return Recording("x", "x", time, signal, signal + GRAVITY)


@pytest.mark.parametrize("rate_hz", [100.0, 285.7, 1000.0])
def test_motion_passes_the_resampling_at_any_rate(rate_hz):
    log, _ = resample(tones(rate_hz, 10.0))
    time = log["time"].to_numpy()
    error = log["gyro"].to_numpy()[0, :, 0] - np.sin(2 * np.pi * 10.0 * time)
    assert np.abs(error[20:-20]).max() < 2e-3


def test_vibration_above_the_new_nyquist_frequency_does_not_fold():
    log, report = resample(tones(1000.0, 190.0))  # would fold to 10 Hz
    assert np.abs(log["gyro"].to_numpy()[0, 50:-50]).max() < 5e-3
    assert report.filter_hz == 90.0
    aliased = tones(1000.0, 190.0).gyro[::5, 0]
    assert np.abs(aliased).max() > 0.9


def test_everything_odd_is_counted_and_no_gap_is_bridged():
    log = tones(200.0, 1.0)
    time, gyro = log.time.copy(), np.clip(log.gyro, -0.9, None)
    gyro[100] = gyro[99]
    accel = log.accel.copy()
    accel[100] = accel[99]
    time[140] = time[139]  # a stamp that stands still
    accel[300, 1] = np.nan
    kept = np.ones(time.size, bool)
    kept[400:420] = kept[500:501] = False  # a gap, and a lost sample
    odd = Recording("x", "x", time[kept], gyro[kept], accel[kept])
    even, report = resample(odd)
    assert (report.counts["repeated"], report.counts["stamps_back"], report.counts["missing"]) == (1, 1, 1)
    assert (report.counts["gaps"], report.counts["lost"]) == (1, 3)
    assert report.counts["longest_gap_s"] == pytest.approx(0.105)
    assert any("the longest 0.105 s: left out of scores" in line for line in report.warnings)
    missing = np.flatnonzero(np.isnan(even["gyro"].to_numpy()[0]).any(axis=1))
    assert missing.tolist() == list(range(400, 420))
    assert [fault.kind for fault in report.sensor_faults] == ["saturation", "saturation"]
    assert len(report.warnings) == 8


def test_irregular_stamps_are_evened_by_when_they_were_taken():
    rng = np.random.default_rng(0)
    time = np.sort(np.arange(2000) / 500 + rng.uniform(-0.0005, 0.0005, 2000))
    signal = np.stack([np.sin(2 * np.pi * 5 * time)] * 3, axis=1)
    log, report = resample(Recording("x", "x", time, signal, signal))
    expected = np.sin(2 * np.pi * 5 * (log["time"].to_numpy() + time[0]))
    assert np.abs(log["gyro"].to_numpy()[0, 20:-20, 0] - expected[20:-20]).max() < 2e-3
    assert report.counts["jitter_ms"] == pytest.approx(0.41, abs=0.05)


def test_one_wrong_stamp_costs_one_sample():
    for jump in (1e6, -1e6, 1e18):
        stamps = turned().time
        stamps[700] += jump
        dataset, report = resample(turned(time=stamps))
        assert dataset.sizes["time"] == stamps.size
        assert (report.counts["gaps"], report.counts["lost"]) == (0, 1)
        consistent(dataset.isel(time=slice(100, 600)))


def test_stamps_of_truth_and_sensors_that_go_back_are_left_out():
    log = turned()
    stamps = log.time - np.where(np.arange(4000) // 10 == 70, 1.0, 0.0)
    dataset = resample(turned(truth_time=stamps, sensors={"mag": Track(stamps, log.accel)}))[0]
    consistent(dataset.isel(time=slice(720, 4000)))
    np.testing.assert_allclose(dataset["mag"][0], log.accel, atol=0.1)


def test_a_truth_of_another_time_is_no_truth():
    assert report_of(turned(truth_time=turned().time + 1e5)).counts["truth_share"] == 0.0


def test_long_gaps_split_a_log_and_every_part_is_converted():
    time = turned().time
    stamps = time + np.where(time >= 12.0, 1e6, 0.0)
    log = turned(time=stamps, truth_time=stamps)
    dataset, report = resample(log)
    assert report.counts["parts"] == 2
    assert dataset.sizes["time"] == 2400
    assert "cut this log into 2 parts" in report.warnings[0]
    assert [part.time.size for part in split_at_gaps(log)] == [2400, 1600]


def test_doublets_of_stamps_are_one_sample_each():
    log = turned()
    doublets = np.repeat(log.time, 2) + np.tile([0.0, 1e-9], 4000)
    gyro = np.repeat(log.gyro, 2, 0) + np.tile([0.0, 1.0], 4000)[:, None]
    dataset, report = resample(turned(time=doublets, gyro=gyro, accel=np.repeat(log.accel, 2, 0)))
    assert report.counts["stamps_back"] == 4000
    consistent(dataset)
    few = np.repeat(np.arange(4000), np.where(np.arange(4000) % 40, 1, 2))
    stamps = log.time[few] + np.append(False, np.diff(few) == 0) * 1e-4
    found = report_of(turned(time=stamps, gyro=log.gyro[few], accel=log.accel[few]))
    assert found.counts["stamps_back"] == 100


@pytest.mark.parametrize(("rate_hz", "jitter_ms"), [(200.0, 2.0), (1000.0, 2.0)])
def test_jittering_stamps_are_no_gaps(rate_hz, jitter_ms):
    time, gyro, accel, _ = turning(rate_hz, 20.0)
    stamps = time + np.random.default_rng(0).uniform(-1e-3, 1e-3, time.size) * jitter_ms
    log, report = resample(Recording("x", "x", stamps, gyro, accel))
    assert report.counts["gaps"] == 0
    assert np.isfinite(log["gyro"]).all()
    if rate_hz == 200.0:
        assert (report.counts["stamps_back"], report.counts["lost"] <= 0.01 * time.size) == (0, True)


def test_repeated_and_backward_stamps_are_left_out_and_rows_out_of_order_are_refused():
    log = turned()
    repeated = log.time.copy()
    repeated[1000:1010] = log.time[999]
    assert report_of(turned(time=repeated)).counts["stamps_back"] == 10
    absent = np.where(np.arange(4000) % 100 == 0, np.nan, log.time)
    assert report_of(turned(time=absent)).counts["missing"] == 40
    mixed = np.random.default_rng(0).permutation(log.time)
    pairs = np.repeat(np.arange(2000), 2) * 20.0 + np.tile([0.0, 0.005], 2000)
    for stamps, said in (
        (pairs, r"4000 samples at 200 Hz in \d+ s: most of the log is missing"),
        (mixed, r"\d+ % of the stamps go back: sort the rows by time"),
        (np.full(4000, np.nan), "0 usable samples; at least 8 are required"),
        (np.zeros(4000), "1 usable samples whose stamps go forward; at least 8 are required"),
    ):
        with pytest.raises(ValueError, match=f"^x: {said}$"):
            resample(turned(time=stamps))


@pytest.mark.parametrize(
    ("rate_hz", "hint"),
    [
        (20.0, ""),
        (32_000.0, ""),
        (0.2, 'are the stamps in ms \\(time.unit = "ms"\\)'),
        (2e-7, 'are the stamps in ns \\(time.unit = "ns"\\)'),
    ],
)
def test_rates_of_no_imu_are_one_line_and_the_unit_of_the_stamps_is_named(rate_hz, hint):
    with pytest.raises(ValueError, match=hint or "samples per second; 40 to 10000 are allowed") as refused:
        report_of(turned(time=np.arange(4000) / rate_hz))
    assert "\n" not in str(refused.value)
