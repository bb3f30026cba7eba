"""The estimator imm: which model it believes, how sure it is, and what it makes of what it does not know."""

import numpy as np
import pytest
from imm_flights import RATE, VARIED, imm, rmse
from scipy.stats import multivariate_t
from small_dataset import generated

from estimators import create, run
from estimators.evaluation.beliefs import beliefs
from estimators.evaluation.flights import load_flights
from estimators.filters.drag.drag_aided import ACCEL_BIAS, ERRORS, GYRO_BIAS, LEVER, SHARED, transition
from estimators.filters.drag.imm import RECORD, accumulate
from estimators.filters.drag.imm_model import FREEDOM, MODELS, MULTIROTOR, STATE, adapt_bias, student
from estimators.filters.samples import Sample
from estimators.metrics import inclination_error
from quadsim.flight.recipe import load_recipe
from quadsim.rotation import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    roll_pitch_from_quat,
)
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

BIAS = np.radians([4.1, -1.2, -1.6])


def in_the_hand(seconds=20.0, speed=0.3):
    """Gyroscope, accelerometer and quat_WB (1, T, ·) of an IMU that is turned and moved by hand."""
    t = np.arange(round(seconds * RATE)) / RATE
    quat = quat_from_euler(0.6 * np.sin(1.1 * t), 0.5 * np.sin(0.7 * t + 1.0), 0.8 * np.sin(0.4 * t))
    turn = quat_multiply(quat_conjugate(quat[:-1]), quat[1:])
    rate = np.concatenate([np.zeros((1, 3)), 2.0 * RATE * turn[:, 1:]])
    wave = np.array([2.0, 2.6, 3.1])
    acceleration = speed * wave * np.cos(np.outer(t, wave))
    force = quat_rotate_inverse(quat, acceleration + np.array([0.0, 0.0, GRAVITY]))
    return rate[None], force[None], quat[None]


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Ten aggressive flights of a Hummingbird: gyroscope, accelerometer, and the attitude that is true."""
    folder = tmp_path_factory.mktemp("imm")
    found = load_flights([generated(folder, VARIED, 10, 30.0, seed=71)])
    return found.gyro, found.accel, found.truth


@pytest.fixture
def flight(flights):
    return tuple(each[:2] for each in flights)


def believed(est, gyro, accel):
    found = beliefs(est, gyro, accel)
    assert found is not None
    return found


def test_the_density_is_student_s_t_of_scipy():
    rng = np.random.default_rng(0)
    root = rng.normal(0, 1, (2, 2))
    shape = root @ root.T
    points = rng.normal(0, 3, (5, 2))
    ours = [student(x @ np.linalg.solve(shape, x), np.linalg.det(shape)) for x in points]
    theirs = multivariate_t(None, shape, FREEDOM).logpdf(points)  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(np.diff(ours), np.diff(theirs), atol=1e-12)


@njit
def gather(records, params, sample, count):
    for _ in range(count):
        accumulate(records[0], params[0], sample)


def test_a_force_is_integrated_in_the_axes_at_the_end_of_a_turn():
    """In closed form: about z by one radian, with a force along body x."""
    turn, count, dt = 1.0, 200, 1e-4
    rate, force = (0.0, 0.0, turn / (count * dt)), (1.0, 0.0, 0.0)
    sample = Sample(rate, rate, force, found=True, rotor_square=0.0, unseen=0.0, ended=0.0, dt=dt)
    records = np.zeros(1, RECORD)
    records["turn"][:, 0] = 1.0
    gather(records, imm()._params, sample, count)
    expected = np.array([np.sin(turn), np.cos(turn) - 1.0, 0.0]) / rate[2]
    np.testing.assert_allclose(records["push"][0], expected, atol=0.01 * count * dt)


def test_in_flight_it_believes_in_a_multirotor_and_beats_estimators_that_do_not(flight):
    gyro, accel, truth = flight
    est = imm()
    found = believed(est, gyro, accel)
    assert found.probability.shape == (2, 300, len(MODELS))
    np.testing.assert_allclose(found.probability.sum(axis=-1), 1.0, atol=1e-12)
    assert (found.probability >= 0.0).all()
    assert found.probability[:, 100:, est.models.index("multirotor")].mean() > 0.9
    others = [rmse(create(name), gyro, accel, truth) for name in ("vqf", "eskf", "mahony")]
    assert rmse(est, gyro, accel, truth) < 0.8 * min(others)


def test_in_the_hand_it_believes_in_the_hand_and_is_as_good_as_vqf():
    gyro, accel, quat = in_the_hand()
    est = imm()
    found = believed(est, gyro, accel)
    assert found.probability[0, 50:, MODELS.index("hand")].mean() > 0.9
    truth = roll_pitch_from_quat(quat)
    assert rmse(est, gyro, accel, truth) < rmse(create("vqf"), gyro, accel, truth) + 0.3


def test_rest_is_given_up_at_once():
    """From the table into the hand: an estimate that still took the velocity for zero would tilt."""
    gyro, accel, quat = in_the_hand(10.0)
    still = np.zeros((1, 1000, 3))
    force = np.tile(quat_rotate_inverse(quat[0, 0], np.array([0.0, 0.0, GRAVITY])), (1, 1000, 1))
    out = run(imm(), np.concatenate([still, gyro], axis=1), np.concatenate([force, accel], axis=1))
    error = inclination_error(out[:, 1000:], roll_pitch_from_quat(quat))
    assert error.max() < 1.0


def test_it_changes_its_model_within_seconds(flight):
    readings = zip(flight, in_the_hand(10.0)[:2], strict=False)
    gyro, accel = (np.concatenate([air[:1, :3000], hand, air[:1, 3000:]], axis=1) for air, hand in readings)
    found = believed(imm(), gyro, accel)
    flying = found.probability[0, :, MULTIROTOR]
    assert flying[150:].max() > 0.99
    assert flying[200:250].max() < 0.5
    assert flying[100:150].min() > 0.9
    assert flying[-50:].min() > 0.9


def test_a_start_that_is_given_wrong_is_not_taken_for_a_bias(flight):
    gyro, accel, truth = flight
    est = imm()
    out = run(est, gyro, accel, roll_pitch=truth[:, 0] + np.radians([14.0, -14.0]))
    error = inclination_error(out, truth)
    assert np.median(error[:, round(5.0 * RATE)]) < 5.0
    assert error[:, round(20.0 * RATE) :].mean() < 2.0
    assert np.degrees(np.abs(est.gyro_bias[:, :2])).max() < 1.0


def test_a_bias_that_steps_in_flight_is_found_within_ten_seconds(flights):
    """Four degrees a second, as of a sensor that has been hit, and how much worse it is without the test."""
    gyro, accel, truth = (each.copy() for each in flights)
    gyro[:, 3000:] += np.radians(4.0) * np.array([0.6, -0.64, 0.48])
    late = slice(round(25.0 * RATE), None)
    error, blind = (
        np.median(inclination_error(run(est, gyro, accel), truth)[:, late].mean(axis=1))
        for est in (imm(), imm(step_ratio=1e9))
    )
    assert error < 0.35 * blind


def test_dashes_that_follow_each_other_are_not_taken_for_steps(tmp_path):
    """A dash turns the estimate as a step would: only its being usual tells that it is none."""
    found = load_flights([generated(tmp_path, load_recipe("cruise"), 4, 60.0, seed=9000)])
    dashes = found.gyro, found.accel, found.truth
    assert rmse(imm(), *dashes) < 1.15 * rmse(imm(step_ratio=1e9), *dashes)


@njit
def take_step(models, params, matrix):
    adapt_bias(models[0], params[0], 0.02, np.zeros(ERRORS), 0.0, matrix)


def test_a_step_that_is_found_adds_what_an_unknown_bias_does_within_its_time():
    """The covariance is propagated in small steps from a variance of the bias alone."""
    est = imm()
    params = est._params
    models = np.zeros(1, STATE)
    models["step_clock"], models["tilt_due"], models["tilt_sum"] = 10.0, 1.0, 100.0
    rows = matrix_from_quat(quat_from_euler(0.3, -0.5, 0.8)).ravel()
    take_step(models, params, tuple(rows))
    found = models["covariance"][0, :ACCEL_BIAS, :ACCEL_BIAS]
    time, steps = params["step_time"][0], 4000
    P = np.zeros((ERRORS, ERRORS))
    P[range(GYRO_BIAS, ACCEL_BIAS), range(GYRO_BIAS, ACCEL_BIAS)] = params["step_sigma"][0] ** 2
    for _ in range(steps):
        for _ in range(2):  # F (F P)ᵀ
            transition(P, tuple(rows), np.zeros(3), np.zeros(2), time / steps, False)
            P = np.ascontiguousarray(P.T)
    np.testing.assert_allclose(found, P[:ACCEL_BIAS, :ACCEL_BIAS], atol=1e-3 * found.max())
    assert models["step_clock"] == models["tilt_due"] == 0.0


def test_a_hand_that_shakes_harder_than_80_m_s2_is_measured():
    gyro, accel, quat = in_the_hand()
    t = np.arange(gyro.shape[1]) / RATE
    hard = 95.0 * np.sin(2.0 * np.pi * 5.0 * t) * (np.abs(np.sin(np.pi * t / 3.0)) > 0.7)
    accel = accel + quat_rotate_inverse(quat, np.stack([hard, 0.5 * hard, 0.0 * hard], axis=-1))
    assert np.abs(accel).max() > 90.0
    assert rmse(imm(), gyro, accel, roll_pitch_from_quat(quat)) < 1.5


def test_a_raw_bias_of_several_degrees_a_second_is_found(flight):
    gyro, accel, truth = flight
    assert rmse(imm(), gyro + BIAS, accel, truth) < rmse(imm(), gyro, accel, truth) + 0.5


def test_an_imu_over_the_centre_of_mass_is_found(flights):
    gyro, accel, truth = flights
    lever = np.array([0.0, 0.0, 0.1])
    turning = np.gradient(gyro, 1.0 / RATE, axis=1)
    moved = accel + np.cross(turning, lever)
    est = imm(lever_sigma=0.1)
    error = rmse(est, gyro, moved, truth)
    model = est.state["models"][:, MULTIROTOR]
    sigma = np.sqrt(model["covariance"][:, LEVER, LEVER])
    assert (sigma < 0.05).all()  # of 0.1 before
    assert (np.abs(model["lever"] - 0.1) < 2.0 * sigma).all()
    assert error < rmse(imm(lever_sigma=0.0, lever_noise=0.0), gyro, moved, truth)


def test_a_thrust_that_is_not_along_body_z_is_no_tilt(flight):
    """An IMU that sits six degrees off: the estimate is of its own axes."""
    gyro, accel, truth = flight
    mount = quat_from_euler(0.1, -0.06, 0.0)
    est = imm()
    out = run(est, quat_rotate(mount, gyro), quat_rotate(mount, accel))
    true = quat_multiply(quat_from_euler(truth[..., 0], truth[..., 1], 0.0), quat_conjugate(mount))
    error = inclination_error(out, roll_pitch_from_quat(true))[:, 2000:]
    assert np.sqrt(np.mean(error**2)) < 2.0


def test_sigma_grows_in_a_gap(flight):
    gyro, accel, _ = flight
    est = imm()
    est.reset(2)
    est.sequence(gyro[:, :4000], accel[:, :4000])
    before = est.roll_pitch_sigma
    assert np.degrees(before).max() < 3.0
    nothing = np.full((2, 100, 3), np.nan)
    est.sequence(nothing, nothing)
    assert (est.roll_pitch_sigma > 5.0 * before).all()
    np.testing.assert_allclose(est.model_probability.sum(axis=-1), 1.0)


def test_the_truth_is_within_the_95_percent_interval_which_grows_under_vibration(flight):
    gyro, accel, truth = flight
    rng = np.random.default_rng(4)
    shaken = accel + 5.0 * rng.normal(size=accel.shape) + 0.5
    sigma = []
    for force, least in ((accel, 0.9), (shaken, 0.85)):
        found = believed(imm(), gyro, force)
        sigma.append(np.degrees(np.median(found.sigma[:, 200:])))
        assert found.interval(truth).inside > least
    assert 0.1 < sigma[0] < 3.0  # an interval of ±180° would hold it as well
    assert sigma[1] > 1.5 * sigma[0]


@pytest.mark.parametrize("sensor", [0, 1])
def test_a_sensor_that_is_missing_for_two_seconds_does_no_lasting_harm(flight, sensor):
    readings = [each.copy() for each in flight]
    readings[sensor][:, 3000:3400] = np.nan
    assert rmse(imm(), *readings, after=25.0) < 3.0


def test_an_estimate_that_is_upside_down_is_given_up_within_seconds(flight):
    gyro, accel, truth = flight
    out = run(imm(), gyro, accel, roll_pitch=truth[:, 0] + [np.pi, 0.0])
    error = inclination_error(out, truth)
    assert (error[:, round(0.2 * RATE)] > 90.0).all()
    assert error[:, round(5.0 * RATE) : round(8.0 * RATE)].max() < 20.0


def test_free_fall_is_not_taken_for_it():
    gyro, accel = np.zeros((1, 2000, 3)), np.tile([0.0, 0.0, 0.02], (1, 2000, 1))
    accel[:, :400, 2] = GRAVITY
    est = imm()
    est.reset(1, roll_pitch=[[0.3, 0.0]])
    out = est.sequence(gyro, accel)
    assert est.state["time"][0] == pytest.approx(10.0)  # a start anew sets it to zero
    assert np.isfinite(out).all()


def test_covariance_stays_symmetric_and_positive_on_noise():
    rng = np.random.default_rng(0)
    est = imm()
    for rate, force in ((0.0, 0.0), (3.0, 10.0), (10.0, 30.0)):
        gyro = rng.normal(0, rate, (1, 3000, 3))
        assert np.isfinite(run(est, gyro, rng.normal([0.0, 0.0, GRAVITY], force, (1, 3000, 3)))).all()
        own = est.state["models"]["covariance"][0]
        for P in (est.state["covariance"][0], own[MULTIROTOR], *own[1:, :SHARED, :SHARED]):
            np.testing.assert_allclose(P, P.T, atol=1e-9 * np.abs(P).max())
            assert np.linalg.eigvalsh(0.5 * (P + P.T)).min() > -1e-9 * np.abs(P).max()
        assert est.roll_pitch_sigma.max() < np.pi + 1e-9


def test_shipped_parameters_are_for_every_vehicle():
    assert imm().values == imm(vehicle="px4-quad", imu="px4-mini").values
