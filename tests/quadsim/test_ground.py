"""Flights that begin on the ground."""

import numpy as np
import pytest

from quadsim.flight.recipe import load_recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import RotorVibration, load_imu
from quadsim.rotation import quat_rotate, roll_pitch_from_quat
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import GRAVITY

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def config():
    return load_recipe("take-off").model_copy(update={"warmup_s": 2.0})


@pytest.fixture(scope="module")
def flights(config):
    return simulate_flights(config, vehicle_seeds(5, 3), 2400)


@pytest.fixture(scope="module")
def begins(config, flights):
    """The flights that the seeds give without a start, and the samples at which they begin after one."""
    alone = simulate_flights(config.model_copy(update={"ground": False}), vehicle_seeds(5, 3), 2400)
    same = (flights["quat"] == alone["quat"][:, :1]).all(-1)
    return alone, same.argmax(1)


def test_a_flight_stands_still_on_a_slope_with_rotors_at_rest(flights):
    first = slice(0, 200)
    assert not np.any(flights["velocity"][:, first])
    assert not np.any(flights["ang_vel"][:, first])
    assert not np.any(flights["rotor_vel"][:, first])
    slopes = np.degrees(np.linalg.norm(roll_pitch_from_quat(flights["quat"][:, 0]), axis=-1))
    assert (slopes <= 4.01).all()
    assert np.ptp(slopes) > 0.1
    np.testing.assert_allclose(np.linalg.norm(flights["specific_force"][:, first], axis=-1), GRAVITY)


def test_force_rate_and_velocity_are_those_of_one_motion(flights, begins):
    quat, velocity = flights["quat"], flights["velocity"]
    accel = quat_rotate(quat, flights["specific_force"]) - np.array([0.0, 0.0, GRAVITY])
    step = np.diff(velocity, axis=1) * RATE_HZ
    mean = 0.5 * (accel[:, 1:] + accel[:, :-1])
    for i, begin in enumerate(begins[1]):
        np.testing.assert_allclose(mean[i, : begin - 1], step[i, : begin - 1], atol=0.1)
    moved = np.diff(flights["position"], axis=1) * RATE_HZ
    np.testing.assert_allclose(moved, 0.5 * (velocity[:, 1:] + velocity[:, :-1]), atol=0.02)
    up = quat_rotate(quat * np.array([1.0, -1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    turned = np.diff(up, axis=1) * RATE_HZ
    expected = np.cross(up, flights["ang_vel"])
    mean = 0.5 * (expected[:, 1:] + expected[:, :-1])
    for i, begin in enumerate(begins[1]):
        np.testing.assert_allclose(mean[i, : begin - 1], turned[i, : begin - 1], atol=0.05)


def test_after_the_start_comes_the_flight_that_the_seed_gives_without_one(flights, begins):
    alone = begins[0]
    for i, begin in enumerate(begins[1]):
        assert begin >= 400
        np.testing.assert_array_equal(flights["quat"][i, begin:], alone["quat"][i, : 2400 - begin])
        np.testing.assert_array_equal(flights["wind"][i, begin:], alone["wind"][i, : 2400 - begin])


def test_rotors_shake_the_imu_before_the_lift_off(config):
    shaken = RotorVibration(rotor_vel=453.0, gyro=(0.05, 0.05, 0.02), accel=(2.0, 2.0, 5.0))
    config = config.model_copy(update={"imu": load_imu("perfect").model_copy(update={"vibration": shaken})})
    flight = simulate_flights(config, vehicle_seeds(5, 1), 1200)
    rotor, noise = flight["rotor_vel"][0, :, 0], flight["accel"][0] - flight["specific_force"][0]
    spinning = (rotor > 300.0) & (np.abs(flight["velocity"][0]).sum(-1) == 0.0)
    assert spinning.sum() > 20
    assert np.abs(noise[rotor == 0.0]).max() < 1e-9
    assert (noise[spinning].std(0) > 0.3).all()
