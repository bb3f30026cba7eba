"""Missing, absurd and repeated samples: bridged, counted, and forgotten within ten seconds."""

import numpy as np
import pytest
from filter_cases import CLASSICAL, arrays, make

from estimators import run
from estimators.filters.samples import Sample, reacquire
from estimators.metrics import inclination_error


@pytest.mark.parametrize("name", CLASSICAL)
def test_missing_samples_are_bridged_counted_and_reported(flights, name, caplog):
    gyro, accel, _ = (each.copy() for each in arrays(flights, 2, 300))
    whole = run(make(name), gyro, accel)
    gyro[0, 100:103] = np.nan
    accel[0, 150] = np.nan
    accel[1, 200:210] = 0.0
    est = make(name)
    out = run(est, gyro, accel)
    assert np.isfinite(out).all()
    assert est.skipped.tolist() == [4, 10]
    assert np.degrees(np.abs(out - whole)).max() < 2.0
    assert len(caplog.records) == 1
    assert "14 of 600 samples were missing" in caplog.text


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_long_gap_holds_the_attitude(flights, name):
    gyro, accel, _ = (each.copy() for each in arrays(flights, 1, 600))
    gyro[:, 200:] = np.nan
    accel[:, 200:] = np.nan
    out = run(make(name), gyro, accel)
    if name != "vqf":  # whose bias estimate turns it on, slowly
        assert np.degrees(np.abs(out[:, 230:] - out[:, 230:231])).max() < 2.0
    assert np.isfinite(out).all()


def test_one_vehicle_can_be_started_again_while_the_others_fly_on(flights):
    gyro, accel, _ = arrays(flights, 2, 40)
    for name in CLASSICAL:
        est, other = make(name), make(name)
        run(est, gyro, accel)
        run(other, gyro, accel)
        est.restart([1], roll_pitch=[[0.1, 0.2]])
        both, alone = est.update(gyro[:, 0], accel[:, 0]), other.update(gyro[:, 0], accel[:, 0])
        np.testing.assert_array_equal(both[0], alone[0])
        assert np.degrees(np.abs(both[1] - [0.1, 0.2])).max() < 2.0


def test_a_sample_without_a_force_takes_back_nothing_of_what_a_gap_has_left():
    zero = (0.0, 0.0, 0.0)
    sample = Sample(zero, zero, zero, found=False, rotor_square=0.0, unseen=0.5, ended=0.0, dt=0.005)
    assert reacquire(0.1, sample) == (0.0, pytest.approx(0.6))


FAULTS = {
    "two rates of 1e30": ("gyro", 2, 1e30),
    "a force of 1e30": ("accel", 1, 1e30),
    "a force of 1000 m/s²": ("accel", 1, 1000.0),
    "a force of 300 m/s²": ("accel", 1, 300.0),
    "a rate of 1000 rad/s": ("gyro", 1, 1000.0),
    "a rate of 60 rad/s": ("gyro", 1, 60.0),
    "ten rates of 60 rad/s": ("gyro", 10, 60.0),
    "two rates of 35 rad/s": ("gyro", 2, 35.0),
    "no 100 samples": ("both", 100, np.nan),
}
"""The sensor, the number of samples and their reading, on every axis."""


def disturbed(gyro, accel, at):
    """Readings (n, time, 3) without and with every fault from a sample on, (1 + faults, n, time, 3)."""
    gyro, accel = (each[None].repeat(1 + len(FAULTS), 0) for each in (gyro, accel))
    for k, (sensor, samples, reading) in enumerate(FAULTS.values(), start=1):
        for name, values in (("gyro", gyro), ("accel", accel)):
            if sensor in (name, "both"):
                values[k, :, at : at + samples] = reading
    return gyro, accel


@pytest.fixture(scope="module")
def clean(make_flights):
    flights = make_flights(2, 23.0)
    return flights.gyro.values, flights.accel.values


def away_after_faults(clean, name):
    """Distance from the run without a fault after 10 s, by fault, in the worst flight [deg]."""
    if name.endswith("filterpy"):  # in Python, and without a bias, which takes long to settle
        rate, (gyro, accel) = 100, disturbed(*(each[:1, 2200::2] for each in clean), at=100)
    else:
        rate, (gyro, accel) = 200, disturbed(*clean, at=2400)
    runs, count, steps, _ = gyro.shape
    flat = (each.reshape(runs * count, steps, 3) for each in (gyro, accel))
    out = run(make(name, rate), *flat).reshape(runs, count, steps, 2)
    assert np.isfinite(out).all()
    away = inclination_error(out, out[:1].repeat(len(out), 0))[1:, :, -rate:].mean(axis=2)
    return dict(zip(FAULTS, away.max(axis=1), strict=True))


CIRCUIT = ("att-snn", "att-rnn", "att-snn-loihi")
GAP = "no 100 samples"


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CLASSICAL, *CIRCUIT])
def test_ten_seconds_after_a_bad_sample_or_a_gap_an_estimate_is_within_two_degrees(clean, name):
    faults = [each for each in FAULTS if each != GAP or name not in CIRCUIT]
    found = away_after_faults(clean, name)
    assert {fault: found[fault] for fault in faults} == dict.fromkeys(faults, pytest.approx(0, abs=2))


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="2.2° in one of two flights; filters find it better")
@pytest.mark.parametrize("name", CIRCUIT)
def test_the_circuit_finds_its_attitude_within_ten_seconds_after_a_gap(clean, name):
    assert away_after_faults(clean, name)[GAP] < 2


@pytest.mark.parametrize("name", [*CLASSICAL, *CIRCUIT])
def test_gaps_and_bad_samples_are_the_same_in_streaming_and_in_sequence(flights, name):
    gyro, accel, _ = (each.copy() for each in arrays(flights, 2, 300))
    gyro[0, 40:120], accel[0, 40:120], gyro[1, 90], accel[1, 200] = np.nan, np.nan, 1e30, 1000.0
    est = make(name)
    whole = run(est, gyro, accel)
    est.reset(2)
    steps = np.stack([est.update(gyro[:, t], accel[:, t]) for t in range(300)], axis=1)
    np.testing.assert_array_equal(whole, steps)


@pytest.mark.parametrize("name", ["complementary", "complementary-adaptive"])
def test_angles_stay_within_half_a_turn(name):
    rolling = np.tile([3.0, 0.0, 0.0], (1, 2000, 1))
    out = run(make(name), rolling, np.zeros_like(rolling))
    assert np.abs(out).max() <= np.pi


@pytest.mark.parametrize("name", ["ekf", "ekf-drag", "mahony"])
def test_readings_that_no_sensor_gives_count_as_missing(flights, name):
    gyro, accel, _ = (each.copy() for each in arrays(flights, 1, 200))
    missing = gyro.copy(), accel.copy()
    gyro[0, 50:52, 1], accel[0, 90, 2] = 1e30, -1000.0
    missing[0][0, 50:52], missing[1][0, 90] = np.nan, np.nan
    np.testing.assert_array_equal(run(make(name), gyro, accel), run(make(name), *missing))
