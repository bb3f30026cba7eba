"""Flights of RotorPy: its conventions turned into ours, and our IMU on them."""

from functools import partial

import numpy as np
import pytest

from estimators.evaluation.flights import vehicle_of
from quadsim.imu.spec import load_imu
from quadsim.rotation import (
    euler_from_quat,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)

pytest.importorskip("rotorpy")

import scenarios.task.rotorpy_flights as rotorpy

DT = 1 / 200.0
GRAVITY = np.array([0.0, 0.0, -9.81])
PLAN = rotorpy.RotorpyPlan("hummingbird", "lissajous", "dryden", 0.0, 1)


@pytest.fixture(scope="module", params=["hummingbird", "crazyflie"])
def flight(request):
    """Two seconds in turbulence with a turn, after one second: name of the airframe, arrays."""
    plan = rotorpy.RotorpyPlan(request.param, "lissajous", "dryden", 0.3, 5)
    return request.param, rotorpy.fly_plan(plan, duration_s=2.0, warmup_s=1.0)


@pytest.fixture
def hovering(monkeypatch):
    from rotorpy.trajectories.hover_traj import HoverTraj
    from rotorpy.wind.default_winds import NoWind

    monkeypatch.setattr(rotorpy, "lissajous", lambda rng: HoverTraj(np.array([0.0, 0.0, 2.0])))
    monkeypatch.setattr(rotorpy, "wind_of", lambda plan, rng: NoWind())
    monkeypatch.setattr(rotorpy, "fly_plan", partial(rotorpy.fly_plan, warmup_s=0.0))


def test_forces_velocities_and_body_rates_integrate_to_the_motion(flight):
    _, motion = flight
    accel = quat_rotate(motion["quat"], motion["specific_force"]) + GRAVITY
    assert np.ptp(motion["velocity"], axis=0).max() > 1.0
    for rate, name, atol in ((accel, "velocity", 0.02), (motion["velocity"], "position", 1e-3)):
        change = np.cumsum(0.5 * DT * (rate[1:] + rate[:-1]), axis=0)
        np.testing.assert_allclose(change, motion[name][1:] - motion[name][0], atol=atol)
    midpoint = 0.5 * (motion["ang_vel"][1:] + motion["ang_vel"][:-1])
    quat = motion["quat"][0]
    for turn in quat_from_rotvec(midpoint * DT):
        quat = quat_multiply(quat, turn)
    assert abs(quat @ motion["quat"][0]) < 0.99  # it turned
    assert abs(quat @ motion["quat"][-1]) > 1.0 - 1e-6
    yaw = np.unwrap(euler_from_quat(motion["quat"])[:, 2])
    assert (yaw[-1] - yaw[0]) / 2.0 == pytest.approx(0.3, abs=0.1)  # to the left


def test_thrust_torques_and_drag_are_those_of_rotorpy(flight):
    from rotorpy.vehicles.multirotor import Multirotor

    airframe, motion = flight
    vehicle = rotorpy.vehicle(airframe)
    theirs = Multirotor(rotorpy.AIRFRAMES[airframe])
    np.testing.assert_allclose(vehicle.allocation / vehicle.motor.k_f, theirs.f_to_TM, atol=1e-12)
    air = quat_rotate_inverse(motion["quat"], motion["velocity"] - motion["wind"])
    rotors = vehicle.motor.rotor_drag * motion["rotor_vel"].sum(axis=1, keepdims=True)
    frame = 0.5 * 1.225 * np.array(vehicle.frame.drag_area) * np.linalg.norm(air, axis=1, keepdims=True)
    drag = -(rotors + frame) * air / vehicle.mass
    assert np.abs(drag[:, :2]).max() > 0.2
    np.testing.assert_allclose(motion["specific_force"][:, :2], drag[:, :2], atol=5e-3)


def test_a_flight_follows_from_its_seed_alone(flight):
    airframe, motion = flight
    np.random.rand(3)  # noqa: NPY002  # the global generator, which RotorPy draws from
    plan = rotorpy.RotorpyPlan(airframe, "lissajous", "dryden", 0.3, 5)
    again = rotorpy.fly_plan(plan, duration_s=0.1, warmup_s=1.0)
    np.testing.assert_array_equal(again["position"], motion["position"][:20])
    other = rotorpy.fly_plan(plan._replace(seed=6), duration_s=0.1, warmup_s=1.0)
    assert not np.allclose(other["wind"], again["wind"])


def test_waypoints_begin_at_rest_and_last_long_enough():
    path = rotorpy.waypoints(np.random.default_rng(0), 20.0)
    begin, late = path.update(0.0), path.update(19.9)
    np.testing.assert_allclose([begin["x"], begin["x_dot"]], 0.0, atol=1e-6)
    assert np.linalg.norm(late["x_dot"]) > 0.0


def test_in_hover_the_accelerometer_reads_gravity_and_a_finished_flight_is_not_simulated_again(
    hovering, tmp_path, monkeypatch
):
    dataset = rotorpy.rotorpy_flights([PLAN], tmp_path, load_imu("perfect"), 0.5)
    np.testing.assert_allclose(dataset["accel"], np.broadcast_to(-GRAVITY, (1, 100, 3)), atol=1e-6)
    np.testing.assert_array_equal(dataset["gyro"], dataset["ang_vel"])
    assert vehicle_of(dataset) == rotorpy.vehicle("hummingbird")
    fly = rotorpy.fly_plan
    monkeypatch.setattr(rotorpy, "fly_plan", None)
    again = rotorpy.rotorpy_flights([PLAN], tmp_path, load_imu("px4-mini"), 0.5)
    assert again.sizes["time"] == 100
    monkeypatch.setattr(rotorpy, "fly_plan", fly)
    file = tmp_path / "hummingbird-1.npz"
    turned = rotorpy.stored(PLAN._replace(yaw_rate=0.5), file, 0.5)  # of another plan
    assert np.ptp(euler_from_quat(turned["quat"])[:, 2]) > 0.01
