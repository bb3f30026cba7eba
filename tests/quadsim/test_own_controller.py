"""Attitude controllers of a user in the closed loop."""

import numpy as np
import pytest

from quadsim.control.attitude_controller import attitude_set_point
from quadsim.control.cascade import Controller, control
from quadsim.control.records import MEASURED, SET_POINT
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from quadsim.rotation import from_euler_core, rotate_core
from quadsim.vehicle import load_vehicle

SEEDS = np.random.SeedSequence(1).spawn(2)


def begun(controller):
    """A hover of two vehicles."""
    mission = Mission(load_scenario("hover"), n=2, controller=controller)
    mission.begin(SEEDS)
    return mission


def test_the_set_point_is_the_attitude_that_points_the_thrust_where_the_cascade_wants_it():
    rng = np.random.default_rng(0)
    vehicle = load_vehicle("hummingbird")
    for _ in range(50):
        c = Controller(vehicle).records[0]
        u, m, out = np.zeros(1, SET_POINT)[0], np.zeros(1, MEASURED)[0], np.zeros(4)
        u["position"], m["yaw"] = rng.normal(0, 3, 3), rng.uniform(-3, 3)
        m["roll_pitch"] = rng.normal(0, 0.3, 2)
        attitude_set_point(0, u, m, c, out)
        q = from_euler_core(out[0], out[1], m["yaw"])
        np.testing.assert_allclose(rotate_core(*q, 0.0, 0.0, 1.0), c["thrust_axis"], atol=1e-12)


def test_the_body_rate_that_the_cascade_would_ask_for_stands_beside_the_set_point():
    """Its own levels below make the same angular acceleration of it, turning set-points included."""
    rng, vehicle = np.random.default_rng(0), load_vehicle("hummingbird")
    whole, above = Controller(vehicle, 2).records
    for c in (whole, above):
        c["gains"]["rate_integral"] = c["gains"]["yaw_rate_integral"] = 0.0
    gain = np.array([whole["gains"]["rate"]] * 2 + [whole["gains"]["yaw_rate"]])
    u, m = np.zeros(1, SET_POINT)[0], np.zeros(1, MEASURED)[0]
    for _ in range(5):
        u["acceleration"] += rng.normal(0, 0.1, 3)
        u["yaw_rate"], m["gyro"], m["roll_pitch"] = rng.normal(), rng.normal(0, 1, 3), rng.normal(0, 0.3, 2)
        control(0, u, m, whole)
        attitude_set_point(0, u, m, above, np.zeros(4))
        np.testing.assert_allclose(gain * (above["rate_cmd"] - m["gyro"]), whole["ang_acc_cmd"], rtol=1e-12)


class Bad:
    def __init__(self, action):
        self.action = action

    def reset(self, n):
        pass

    def update(self, set_point, gyro, accel, roll_pitch):
        if isinstance(self.action, BaseException):
            raise self.action
        return self.action


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (np.zeros(3), r"shape \(3,\)"),
        (np.full((2, 4), np.nan), "not finite"),
        (np.zeros((2, 4), complex), "complex128 array"),
        (np.ma.masked_array(np.zeros((2, 4)), True), "masked array"),
        (KeyError("x"), "KeyError"),
        (SystemExit(0), "SystemExit: 0"),
    ],
)
def test_a_controller_that_fails_is_named(action, text):
    with pytest.raises(ValueError, match=f"^controller Bad: update .*{text}"):
        begun(lambda rate_hz, vehicle: Bad(action)).step()


def test_a_factory_that_makes_no_controller_is_named():
    with pytest.raises(ValueError, match="no reset and no update"):
        begun(lambda rate_hz, vehicle: 3)


def test_a_controller_without_restart_is_said_so():
    mission = begun(lambda *_: Bad(np.zeros((2, 4))))
    with pytest.raises(ValueError, match="no restart"):
        mission.restart(np.array([0]), SEEDS[:1])


def test_a_controller_may_return_the_speeds_of_the_rotors():
    controller, speeds = Bad(np.full((2, 4), 450.0)), np.full((2, 4), 450.0)
    controller.rotor_speeds = True
    mission = begun(lambda *_: controller)
    mission.step()
    np.testing.assert_array_equal(mission.plant.rotor_vel_cmd, speeds)
    controller.action = speeds[:, :3]
    with pytest.raises(ValueError, match=r"shape \(2, 3\); speeds of rotors \[rad/s\].*\(2, 4\)"):
        mission.step()
