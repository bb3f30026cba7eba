"""The signals behind an estimate: what is logged, and that they survive packing."""

import numpy as np
import pytest
from flown import WINDY, unpack_series

import estimators
from quadsim.flight.faults import Stuck, fault_spans
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario
from quadsim.flight.vehicle_faults import PayloadDrop
from quadsim.rotation import euler_from_quat, quat_from_euler, quat_normalize
from scenarios.bench.cell import CELL, make_cell
from scenarios.bench.flight_log import fly_mission
from scenarios.bench.flight_series import SIGNAL_LEVELS

((WIND,), (STEP,)) = WINDY.wind, WINDY.faults


def flown(estimator, scenario=WINDY):
    mission = Mission(scenario, estimators.create(estimator, 200.0, vehicle="hummingbird"), 2)
    return mission, fly_mission(mission, 0)


def vector(signals, name):
    return np.stack([signals[f"{name}_{axis}"] for axis in "xyz"], axis=-1)


def test_signals_survive_packing_and_the_file_of_a_cell_and_those_without_a_value_are_left_out():
    mission, flights = flown("complementary")
    flights.signals["gyro_x"][3] = np.nan
    cell = CELL.validate_json(CELL.dump_json(make_cell("a", "eskf", mission, flights)))
    found, left_out = unpack_series(cell.series), set()
    for name, values in flights.signals.items():
        if np.isnan(values).all():
            left_out.add(name)
            continue
        half = 0.5001 * np.nanmax(np.abs(values)) / SIGNAL_LEVELS + 1e-9
        np.testing.assert_allclose(found[name], values, atol=half, rtol=0, err_msg=name)
    assert np.isnan(found["gyro_x"]).nonzero()[0].tolist() == [3]
    assert left_out == flights.signals.keys() - found.keys() >= {"bias_est_x", "roll_sigma"}
    np.testing.assert_allclose(vector(found, "wind")[5], WIND.velocity, atol=2e-3)


def test_true_bias_is_that_of_the_imu_and_of_the_fault():
    mission, flights = flown("mahony")
    bias = vector(flights.signals, "bias")
    np.testing.assert_allclose(bias[26] - bias[23], STEP.gyro_deg, atol=0.02)  # but for the random walk
    np.testing.assert_allclose(np.radians(bias[-1] - STEP.gyro_deg), mission.imu.biases["gyro"][0], atol=1e-4)


def test_mean_reading_of_a_hover_is_the_true_bias():
    calm = Scenario(description="", duration_s=20.0, start={"known_attitude": True})
    signals = flown("truth", calm)[1].signals
    bias = vector(signals, "bias").mean(axis=0)
    assert np.abs(bias).max() > 0.2
    np.testing.assert_allclose(vector(signals, "gyro").mean(axis=0), bias, atol=0.05)


def test_attributes_of_another_meaning_are_no_signals():
    class Own(estimators.create("truth", 200.0).__class__):
        roll_pitch_sigma = "unknown"

        def gyro_bias(self):
            """A method, not an array."""

    signals = fly_mission(Mission(WINDY, Own("truth", 200.0, {}), 2), 0).signals
    assert np.isnan([signals["bias_est_x"], signals["roll_sigma"]]).all()


def test_spans_of_faults_end_with_the_flight():
    stuck = Stuck(kind="stuck", at_s=5.0, length_s=0.5, every_s=4.0)
    payload = PayloadDrop(kind="payload-drop", mass=0.1, at_s=3.0)
    assert fault_spans([STEP, stuck, payload], 9.2) == [
        ("bias", 1.0, 9.2),
        ("stuck", 5.0, 5.5),
        ("stuck", 9.0, 9.2),
        ("payload", 0.0, 3.0),
    ]
    assert fault_spans([STEP], 0.5) == []
    gyro = stuck.model_copy(update={"sensor": "gyro", "axes": "xy", "every_s": None})
    assert [label for label, *_ in fault_spans([gyro], 9.2)] == ["stuck gyro xy"]


@pytest.mark.parametrize(("name", "sigma"), [("ekf", 0.01), ("eskf", 0.3)])
def test_sigma_of_a_known_attitude_is_that_of_the_start(name, sigma):
    """Of `eskf`, which estimates a bias, it is wide: a wrong start would pass for one."""
    est = estimators.create(name, 200.0)
    est.reset(2, roll_pitch=(0.3, -0.6))
    np.testing.assert_allclose(est.roll_pitch_sigma, [[sigma / np.cos(0.6), sigma]] * 2)


def test_sigma_of_the_ekf_is_that_of_quaternions_drawn_from_its_covariance():
    rng, est = np.random.default_rng(0), estimators.create("ekf", 200.0)
    est.reset(1, quat=quat_from_euler(0.3, -0.6, 2.0)[None])
    for _ in range(100):
        est.update(np.array([[0.5, -0.2, 0.3]]), np.array([[4.0, 2.0, 8.0]]))
    covariance = 1e-4 * est.state["covariance"][0]  # small, as the linearisation is exact there
    drawn = quat_normalize(est.quat[0] + rng.multivariate_normal(np.zeros(4), covariance, 20_000))
    sd = euler_from_quat(drawn)[:, :2].std(axis=0)
    np.testing.assert_allclose(est.roll_pitch_sigma[0], 100.0 * sd, rtol=0.03)
