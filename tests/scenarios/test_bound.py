"""The least error that an IMU allows, against closed forms and against filters that fly."""

import numpy as np
import pytest

from quadsim.flight.scenario import load_scenario
from quadsim.imu.spec import Sensor, load_imu
from quadsim.vehicle import GRAVITY, load_vehicle
from scenarios.bench.linear_bound import least_error

HOVER, VEHICLE, PERFECT = load_scenario("hover"), load_vehicle("hummingbird"), load_imu("perfect")


def imu(gyro=None, accel=None):
    return PERFECT.model_copy(
        update={"gyro": Sensor(**gyro or {}), "accel": Sensor(**accel or {"noise": 1e3})}
    )


def test_a_perfect_gyroscope_leaves_no_error_from_a_start_that_is_known():
    assert least_error(imu(), VEHICLE, HOVER, 5.0) == pytest.approx(0.0, abs=1e-9)


def test_a_gyroscope_alone_drifts_by_its_noise_and_its_bias():
    """Of both axes, in the mean over a time T: noise² T + bias² 2 T² / 3."""
    noisy = least_error(imu({"noise": 0.01}), VEHICLE, HOVER, 5.0)
    assert noisy == pytest.approx(0.01 * np.sqrt(5.0), rel=0.01)
    biased = least_error(imu({"turn_on": 0.01}), VEHICLE, HOVER, 5.0)
    assert biased == pytest.approx(0.01 * 5.0 * np.sqrt(2 / 3), rel=0.01)


def test_a_speed_that_is_known_leaves_a_lean_and_its_bias_no_room():
    sensors = imu({"noise": 1e-4, "turn_on": 0.01}, {"noise": 1e-3, "turn_on": 0.2})
    errors = [least_error(sensors, VEHICLE, HOVER, 20.0, speed) for speed in (np.inf, 1.0, 0.1, 0.001)]
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < 0.1 * 0.2 / GRAVITY


BAD = [{"duration_s": 0.0}, {"duration_s": np.nan}, {"speed_sd": np.nan}, {"speed_sd": 0.0}]


@pytest.mark.parametrize("bad", BAD)
def test_a_flight_of_no_sample_and_a_speed_known_too_well_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        least_error(imu(), VEHICLE, HOVER, **{"duration_s": 1.0} | bad)


def test_turbulence_hides_a_lean():
    calm, rough = (
        least_error(load_imu("adis16448"), VEHICLE, load_scenario(name), 20.0)
        for name in ("wind-8", "dryden-moderate")
    )
    assert rough > 2 * calm
