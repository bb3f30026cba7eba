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


def flown(scenario, controller, seconds=3.0, n=2):
    """Positions (T, n, 3) and causes (n,) of a mission."""
    mission = Mission(load_scenario(scenario), n=n, duration_s=seconds, controller=controller)
    mission.begin(np.random.SeedSequence(1).spawn(n))
    track = []
    for _ in range(mission.steps):
        mission.step()
        track.append(mission.plant.position.copy())
    return np.array(track), mission.cause.copy()


class Cascade:
    """The cascade's own rate level, as a controller: P on tilt, PI on body rate, sample by sample."""

    def __init__(self, rate_hz, vehicle):
        self.inner = Controller(vehicle, 1, rate_hz)
        self.vehicle, self.rate_hz = vehicle, rate_hz

    def reset(self, n):
        self.inner = Controller(self.vehicle, n, self.rate_hz)

    def update(self, set_point, gyro, accel, roll_pitch):
        c = self.inner.records
        measured = np.zeros(len(c), MEASURED)
        measured["gyro"], measured["roll_pitch"] = gyro, roll_pitch
        c["attitude_cmd"][:, :2], c["thrust_cmd"] = set_point[:, :2], set_point[:, 3]
        for k in range(len(c)):
            control(2, np.zeros(1, SET_POINT)[0], measured[k], c[k])
        return np.column_stack([c["ang_acc_cmd"], set_point[:, 3]])


def test_the_cascades_own_inner_levels_as_a_controller_fly_as_the_cascade_does():
    """Without yaw and without the feed-forward of the set-point's tilt rate, which the levels above keep."""
    with_own, cause = flown("hover", Cascade)
    built_in, _ = flown("hover", None)
    assert not cause.any()
    assert np.abs(with_own - built_in).max() < 0.02


def test_the_set_point_is_the_attitude_that_points_the_thrust_where_the_cascade_wants_it():
    rng = np.random.default_rng(0)
    vehicle = load_vehicle("hummingbird")
    for _ in range(50):
        c = Controller(vehicle).records[0]
        u, m, out = np.zeros(1, SET_POINT)[0], np.zeros(1, MEASURED)[0], np.zeros(4)
        u["position"], m["yaw"], m["roll_pitch"] = (
            rng.normal(0, 3, 3),
            rng.uniform(-3, 3),
            rng.normal(0, 0.3, 2),
        )
        attitude_set_point(0, u, m, c, out)
        q = from_euler_core(out[0], out[1], m["yaw"])
        np.testing.assert_allclose(rotate_core(*q, 0.0, 0.0, 1.0), c["thrust_axis"], atol=1e-12)


class Bad:
    """A controller that returns what it is told to."""

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
        flown("hover", lambda rate_hz, vehicle: Bad(action))


def test_a_factory_that_makes_no_controller_is_named():
    with pytest.raises(ValueError, match="no reset and no update"):
        flown("hover", lambda rate_hz, vehicle: 3)


def test_a_controller_without_restart_is_said_so():
    mission = Mission(load_scenario("hover"), n=2, controller=lambda *_: Bad(np.zeros((2, 4))))
    seeds = np.random.SeedSequence(1).spawn(2)
    mission.begin(seeds)
    with pytest.raises(ValueError, match="no restart"):
        mission.restart(np.array([0]), seeds[:1])


def test_a_controller_may_return_the_speeds_of_the_rotors():
    controller, speeds = Bad(np.full((2, 4), 450.0)), np.full((2, 4), 450.0)
    controller.rotor_speeds = True
    mission = Mission(load_scenario("hover"), n=2, controller=lambda *_: controller)
    mission.begin(np.random.SeedSequence(1).spawn(2))
    mission.step()
    np.testing.assert_array_equal(mission.plant.rotor_vel_cmd, speeds)
    controller.action = speeds[:, :3]
    with pytest.raises(ValueError, match=r"shape \(2, 3\); speeds of rotors \[rad/s\].*\(2, 4\)"):
        mission.step()
