"""The drag-aided filter: its linearisation, its corrections, and what each adaptation of its noise is for."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import create, run
from estimators.filters.drag.drag_aided import DRAG as ERRORS
from estimators.filters.drag.drag_aided import correct_by_zero_velocity, propagate, transition
from estimators.filters.drag.ekf_drag import RECORD
from estimators.metrics import attitude_error
from quadsim.rotation import (
    matrix_from_quat,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    roll_pitch_from_quat,
)
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY, load_vehicle

PARTS = np.repeat([0, 1, 2, 3, 4, 1, 3], [2, 2, 3, 2, 2, 1, 1])
"""Which part each component of the error state belongs to: θ, δv, δb, δc or δw; the last are δv_z, δc_z."""
V, B, C, W = [2, 3, 11], slice(4, 7), [7, 8, 12], slice(9, 11)
"""The components of each part."""


def propagated(P, matrix, velocity, wind, dt, noise):
    """P after a sample; noise: variances added to each part."""
    records = np.zeros(1, RECORD)
    records["covariance"][0, :ERRORS, :ERRORS] = P
    records["velocity"], records["wind"] = velocity, wind[:2]
    records["walks"][0, :ERRORS] = np.asarray(noise)[PARTS]
    _propagate(records, tuple(matrix.ravel()), dt)
    assert not records["covariance"][0, :, ERRORS:].any()
    return records["covariance"][0, :ERRORS, :ERRORS].copy()


@njit
def _propagate(records, matrix, dt):
    propagate(records[0], records[0], ERRORS, matrix, dt, True)


def filter_of(**params):
    return create("ekf-drag", 200.0, vehicle="hummingbird", **params)


def errors_of(est, data, late):
    truth = roll_pitch_from_quat(data.quat.values)
    return attitude_error(run(est, data.gyro.values, data.accel.values)[:, late], truth[:, late]).mean


def perturbed(state, error):
    """A state (quat, v, w, b, c) moved by an error state (13,), as `ekf_drag` defines it."""
    quat, v, w, b, c = state
    turn = quat_from_rotvec(np.array([error[0], error[1], 0.0]))
    v = quat_rotate(turn, v) + error[V]
    w = quat_rotate(turn, w) + np.array([*error[W], 0.0])
    return quat_multiply(turn, quat), v, w, b + error[B], c + error[C]


def moved(state, gyro, accel, dt):
    quat, v, w, b, c = state
    quat = quat_multiply(quat, quat_from_rotvec((gyro - b) * dt))
    return quat, v + (quat_rotate(quat, accel - c) - [0.0, 0.0, GRAVITY]) * dt, w, b, c


def difference(state, other):
    """The error state (13,) that takes `state` to `other`, without its heading."""
    inverse = state[0] * [1.0, -1.0, -1.0, -1.0]
    turn = 2.0 * quat_multiply(other[0], inverse)[1:]
    turned = quat_from_rotvec(turn)
    v, w = other[1] - quat_rotate(turned, state[1]), other[2] - quat_rotate(turned, state[2])
    b, c = other[3] - state[3], other[4] - state[4]
    return np.concatenate([turn[:2], v[:2], b, c[:2], w[:2], v[2:], c[2:]])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_covariance_is_propagated_with_the_derivative_of_the_equations(seed):
    rng = np.random.default_rng(seed)
    dt, step = 1e-4, 1e-5
    quat = quat_from_rotvec(rng.normal(0, 0.5, 3))
    wind = np.array([*rng.normal(0, 3, 2), 0.0])
    state = quat, rng.normal(0, 3, 3), wind, rng.normal(0, 0.1, 3), rng.normal(0, 0.2, 3)
    gyro, accel = rng.normal(0, 2, 3), np.array([0.3, -0.2, 9.81]) + rng.normal(0, 1, 3)
    plain = moved(state, gyro, accel, dt)

    def after(error):
        return difference(plain, moved(perturbed(state, error), gyro, accel, dt))

    F = np.stack([(after(step * e) - after(-step * e)) / (2 * step) for e in np.eye(ERRORS)], axis=1)
    root = rng.normal(size=(ERRORS, ERRORS))
    P, noise = root @ root.T, rng.uniform(0, 1, 5)
    expected = F @ P @ F.T + np.diag(noise[PARTS])
    P = propagated(P, matrix_from_quat(plain[0]), plain[1], plain[2], dt, noise)
    # the specific force tilts with the attitude beyond gravity's share only in second order of dt
    np.testing.assert_allclose(P, expected, atol=20 * dt * np.abs(expected).max() * dt + 1e-4)


def test_errors_are_the_same_where_the_climb_is_none_of_them():
    matrix, (v, w) = tuple(matrix_from_quat(quat_from_rotvec([0.3, -0.2, 0.5])).ravel()), np.ones((2, 3))
    with_climb, without = np.eye(16), np.eye(16)
    transition(with_climb, matrix, v, w, 0.005, True)
    transition(without, matrix, v, w, 0.005, False)
    with_climb[11], with_climb[:, 12] = np.eye(16)[11], np.eye(16)[12]
    np.testing.assert_array_equal(without, with_climb)


def test_two_scalar_corrections_by_drag_are_filterpy_s_one_of_both_axes(make_flights):
    """With nothing adapted and no other measurement, the first sample is a Kalman update in closed form."""
    data = make_flights(1, 1.0, noise=0.0)
    gyro, accel = data.gyro.values[0, 0], data.accel.values[0, 0]
    params = {"model_noise": 0.0, "speed_least": 1e6, "climb_noise": 1e6}
    est = filter_of(**params)
    values = est.values
    est.reset(1)
    est.update(gyro[None], accel[None])
    dt = 1 / 200.0
    names = ("attitude", "speed", "bias", "accel_bias", "wind")
    P = np.diag(np.array([values[f"{name}_sigma"] for name in names])[PARTS] ** 2)
    noise = np.array([values[f"{name}_noise"] for name in ("gyro", "accel", "bias", "accel_bias", "wind")])
    quat = quat_from_rotvec(gyro * dt)
    matrix = matrix_from_quat(quat)
    v = (quat_rotate(quat, accel) - [0.0, 0.0, GRAVITY]) * dt
    P = propagated(P, matrix, np.zeros(3), np.zeros(3), dt, noise**2 * dt)
    drag = np.sqrt(accel[2] / GRAVITY) / values["drag_time"] + values["frame_drag"] * np.linalg.norm(v)
    H = np.zeros((2, ERRORS))
    H[:, V] = -drag * matrix.T[:2]
    H[:, W] = drag * matrix.T[:2, :2]
    H[:, 7:9] = np.eye(2)
    reference = KalmanFilter(ERRORS, 2)
    reference.P, reference.H, reference.R = P, H, np.eye(2) * values["drag_noise"] ** 2 / dt
    reference.update(accel[:2] + drag * matrix.T[:2] @ v)
    state = est.state[0]
    np.testing.assert_allclose(state["gyro_bias"], reference.x[B, 0], atol=1e-9)
    np.testing.assert_allclose(state["accel_bias"], reference.x[C, 0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(state["wind"], reference.x[W, 0], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(state["covariance"][:ERRORS, :ERRORS], reference.P, atol=1e-7)


@njit
def _correct_by_zero_velocity(records):
    correct_by_zero_velocity(records[0], records[0], ERRORS, 3, 0.5, 0.2)


def test_zero_velocity_is_measured_with_the_derivative_of_the_velocity():
    root, v = np.random.default_rng(0).normal(size=(ERRORS, ERRORS)), np.array([1.0, -2.0, 0.5])
    state = np.array([1.0, 0.0, 0.0, 0.0]), v, np.zeros(3), np.zeros(3), np.zeros(3)
    H = np.stack([(perturbed(state, 1e-6 * e)[1] - v) / 1e-6 for e in np.eye(ERRORS)], axis=1)
    records = np.zeros(1, RECORD)
    records["velocity"], records["covariance"][0, :ERRORS, :ERRORS] = v, root @ root.T
    _correct_by_zero_velocity(records)
    reference = KalmanFilter(ERRORS, 3)
    reference.P, reference.H, reference.R = root @ root.T, H, np.diag([0.5, 0.5, 0.2])
    reference.update(-v)
    np.testing.assert_allclose(records["error"][0, :ERRORS], reference.x[:, 0], atol=1e-4)
    np.testing.assert_allclose(records["covariance"][0, :ERRORS, :ERRORS], reference.P, atol=1e-4)


def test_tilt_and_velocity_are_found_where_the_accelerometer_shows_drag_alone(make_flights):
    data = make_flights(4, 40.0, noise=0.0)
    late = slice(4000, None)
    exact = {"frame_drag": 0.0}
    assert errors_of(filter_of(**exact), data, late) < 0.1
    assert errors_of(create("eskf"), data, late) > 0.3


def test_the_vehicle_s_file_gives_the_drag():
    hummingbird = filter_of()
    assert hummingbird.values["drag_time"] == pytest.approx(4.90, abs=0.01)
    assert hummingbird.values["frame_drag"] == pytest.approx(0.00684, abs=1e-5)
    px4 = create("ekf-drag", vehicle="px4-quad")
    assert px4.values["drag_time"] == pytest.approx(load_vehicle("px4-quad").drag_time_constant)
    same = create("ekf-drag", vehicle=load_vehicle("px4-quad"))
    assert same.values == px4.values
    assert create("ekf-drag", drag_time=3.0, frame_drag=0.01).values["drag_time"] == 3.0


@pytest.mark.parametrize(
    ("name", "bias"), [("ekf-drag", [0.02, -0.015, 0.01]), ("imm", np.radians([4.1, -1.2, -1.6]))]
)
def test_at_rest_the_gyroscope_s_bias_is_found_on_every_axis_in_three_seconds(name, bias):
    rng = np.random.default_rng(0)
    gyro = rng.normal(bias, 0.002, (1, 600, 3))
    accel = rng.normal((0.0, 0.0, GRAVITY), 0.02, (1, 600, 3))
    est = create(name, 200.0, vehicle="hummingbird")
    run(est, gyro, accel)
    np.testing.assert_allclose(est.gyro_bias[0], bias, atol=1e-3)


def test_a_step_of_the_gyroscope_s_bias_is_found_sooner_than_without_its_detection(make_flights):
    data = make_flights(4, 30.0)
    gyro = data.gyro.values.copy()
    gyro[:, 2000:, 0] += 0.07
    stepped = data.assign(gyro=(data.gyro.dims, gyro))
    late = slice(3000, 4000)
    assert errors_of(filter_of(), stepped, late) < 0.5 * errors_of(filter_of(step_gain=0.0), stepped, late)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), rate=st.floats(0.0, 10.0), force=st.floats(0.0, 30.0))
def test_covariance_stays_symmetric_and_positive(seed, rate, force):
    rng = np.random.default_rng(seed)
    gyro = rng.normal(0, rate, (1, 2000, 3))
    accel = rng.normal([0.0, 0.0, GRAVITY], force, (1, 2000, 3))
    est = filter_of()
    assert np.isfinite(run(est, gyro, accel)).all()
    P = est.state[0]["covariance"][:ERRORS, :ERRORS]
    np.testing.assert_allclose(P, P.T, atol=1e-9 * np.abs(P).max())
    assert np.linalg.eigvalsh(0.5 * (P + P.T)).min() > -1e-9 * np.abs(P).max()
