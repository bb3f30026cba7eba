"""The closed loop: controller, plant and IMU together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from level import Level

from quadsim.config.toml import preset_names
from quadsim.control.cascade import IDLE, Controller, apply_action, control
from quadsim.control.gains import loop_margins
from quadsim.control.records import LEVELS, MEASURED
from quadsim.flight.loop import FlightLoop
from quadsim.flight.recipe import AttitudeError, Recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.imu.spec import load_imu
from quadsim.rotation import quat_conjugate, quat_from_euler, quat_multiply, roll_pitch_from_quat
from quadsim.seeding import vehicle_seeds
from quadsim.trajectory.specs import Hover, Mix
from quadsim.vehicle import GRAVITY, Randomisation, load_vehicle
from quadsim.wind import Constant, Dryden

HUMMINGBIRD = load_vehicle("hummingbird")
HOVER = np.array([[0, 0, 2.0, 0, 0, 0, 0, 0, 0, 0, 0]])


def config(**changes):
    return Recipe(vehicle=HUMMINGBIRD, imu=load_imu("adis16448"), **changes)


@pytest.mark.parametrize("name", preset_names("vehicles"))
def test_hover_holds_a_point_from_any_start(name):
    loop, n, rng = FlightLoop(load_vehicle(name), 5), 5, np.random.default_rng(0)
    loop.reset(
        position=rng.uniform((-1, -1, 1), (1, 1, 3), (n, 3)),
        quat=quat_from_euler(rng.uniform(-0.7, 0.7, n), rng.uniform(-0.7, 0.7, n), rng.uniform(-3, 3, n)),
        ang_vel=rng.normal(0, 1, (n, 3)),
    )
    for _ in range(2000):
        loop.step("position", np.repeat(HOVER, n, axis=0))
    assert loop.plant.position == pytest.approx(np.tile([0, 0, 2.0], (n, 1)), abs=0.02)


def test_integral_action_holds_position_against_12_metres_per_second():
    loop = FlightLoop(HUMMINGBIRD, 1)
    loop.reset(position=(0, 0, 2.0))
    wind = np.array([[12.0, 0, 0]])
    for _ in range(6000):
        loop.step("position", HOVER, wind)
    assert loop.plant.position[0] == pytest.approx([0, 0, 2.0], abs=0.05)
    assert np.degrees(loop.plant.roll_pitch[0, 1]) < -10  # nose down into a wind from the front


def test_small_attitude_step_crosses_as_fast_as_the_design_says():
    """Time to 63 % of a 3° step is about 1 / crossover of the designed loop, plus the rotor lag."""
    loop = FlightLoop(HUMMINGBIRD, 1)
    loop.reset()
    target, roll = np.radians(3.0), []
    for _ in range(200):
        loop.step("attitude", np.array([[target, 0.0, 0.0, GRAVITY]]))
        roll.append(loop.plant.roll_pitch[0, 0])
    reached = (np.argmax(np.array(roll) > 0.63 * target) + 1) / 200
    crossover = loop_margins(HUMMINGBIRD, loop.controller.gains)["attitude"].crossover
    assert reached == pytest.approx(1 / crossover + 0.05, abs=0.05)
    assert max(roll) < 1.25 * target


@pytest.mark.parametrize(
    ("level", "command", "read", "wanted"),
    [
        ("velocity", [1.0, -0.5, 0.2, 0.3], lambda loop: loop.plant.velocity[0], [1.0, -0.5, 0.2]),
        ("attitude", [0.1, -0.05, 0.4, GRAVITY], lambda loop: loop.plant.roll_pitch[0], [0.1, -0.05]),
        ("attitude", [0.1, -0.05, 0.4, GRAVITY], lambda loop: loop.plant.yaw, [0.4]),
        ("rate", [0.0, 0.0, 0.6, GRAVITY], lambda loop: loop.plant.ang_vel[0], [0.0, 0.0, 0.6]),
        ("rotor", [450.0] * 4, lambda loop: loop.plant.rotor_vel[0], [450.0] * 4),
    ],
)
def test_a_command_is_followed_at_every_level(level, command, read, wanted):
    loop = FlightLoop(HUMMINGBIRD, 1)
    loop.reset(position=(0, 0, 50))
    for _ in range(800):
        loop.step(level, np.array([command]))
    assert read(loop) == pytest.approx(wanted, abs=0.02)


@given(st.lists(st.floats(-1e9, 1e9), min_size=11, max_size=11), st.sampled_from(LEVELS))
@settings(max_examples=60, deadline=None)
def test_rotor_commands_stay_within_the_rotors(numbers, level):
    controller = Controller(HUMMINGBIRD, 1)
    command = np.array([numbers])[:, : 11 if level == "position" else 4]
    set_points = controller.accept(level, command)
    control(LEVELS.index(level), set_points[0], np.zeros(1, MEASURED)[0], controller.records[0])
    out = controller.rotor_vel_cmd
    assert np.all((out >= 0) & (out <= HUMMINGBIRD.motor.omega_max))


def allocated(vehicle, action):
    """Thrust and torques (4,) of the rotors for angular accelerations and a thrust per mass; rotor speeds."""
    controller = Controller(vehicle, 1)
    apply_action(np.zeros(1, MEASURED)[0], controller.records[0], np.array(action))
    speed = controller.rotor_vel_cmd[0]
    return vehicle.allocation @ speed**2, speed


@pytest.mark.parametrize("name", ["hummingbird", "hexarotor"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotors_that_saturate_give_up_yaw_first_and_then_thrust(name, sign):
    vehicle = load_vehicle(name)
    inertia, fastest = np.array(vehicle.inertia), vehicle.motor.omega_max
    roll_pitch = np.array([20.0, -30.0])
    torque = inertia[:2] * roll_pitch

    wrench, speed = allocated(vehicle, [*roll_pitch, sign * 1.0, GRAVITY])
    wanted = [vehicle.mass * GRAVITY, *torque, sign * inertia[2]]
    np.testing.assert_allclose(wrench, wanted, rtol=1e-9)  # everything fits

    wrench, speed = allocated(vehicle, [*roll_pitch, sign * 1e6, GRAVITY])
    np.testing.assert_allclose(wrench[:3], wanted[:3], rtol=1e-9)  # all but yaw
    assert sign * wrench[3] > inertia[2]
    assert min(fastest - speed.max(), speed.min() - IDLE * fastest) == pytest.approx(0.0, abs=1e-6)

    for thrust, limit in ((1e3, fastest), (0.0, IDLE * fastest)):
        wrench, speed = allocated(vehicle, [*roll_pitch, sign * 1e6, thrust])
        np.testing.assert_allclose(wrench[1:3], torque, rtol=1e-9)  # thrust too
        assert np.abs(speed - limit).min() == pytest.approx(0.0, abs=1e-6)
        assert abs(wrench[0] - vehicle.mass * thrust) > 0.1 * vehicle.mass * GRAVITY


def test_the_gyro_sample_is_aligned_with_the_state():
    """The mean of gyro samples k and k + 1 turns quat k into quat k + 1, and no other pair does."""
    flown = simulate_flights(Recipe(vehicle=HUMMINGBIRD, imu=load_imu("perfect")), vehicle_seeds(0, 2), 2000)
    quat, gyro = flown["quat"], flown["gyro"]
    assert np.array_equal(gyro, flown["ang_vel"])
    change = quat_multiply(quat_conjugate(quat[:, :-1]), quat[:, 1:])
    turned = 2 * change[..., 1:] * np.sign(change[..., :1]) * 200
    aligned = turned - (gyro[:, :-1] + gyro[:, 1:]) / 2
    late = turned[:, 1:] - (gyro[:, :-2] + gyro[:, 1:-1]) / 2
    assert np.sqrt(np.mean(aligned**2)) < 0.02
    assert np.sqrt(np.mean(late**2)) > 3 * np.sqrt(np.mean(aligned**2))


def test_a_flight_does_not_depend_on_its_batch():
    spread, breeze = Randomisation(mass=0.1, rotor_drag=0.2), Constant(velocity=(2, 0, 0))
    varied = config(randomisation=spread, wind=(breeze,))
    together = simulate_flights(varied, vehicle_seeds(0, 5), 300)
    alone = simulate_flights(varied, vehicle_seeds(0, 5)[3:4], 300)
    for name, values in together.items():
        assert np.array_equal(np.asarray(values)[3:4], np.asarray(alone[name])), name


def test_adding_wind_does_not_change_the_imu_noise():
    calm, windy = (
        simulate_flights(config(trajectory=Hover(), wind=wind), vehicle_seeds(0, 2), 400)
        for wind in ((), (Constant(velocity=(3, 0, 0)),))
    )
    assert np.array_equal(calm["gyro_bias"], windy["gyro_bias"])
    noise = [flown["gyro"] - flown["ang_vel"] for flown in (calm, windy)]
    assert noise[0] == pytest.approx(noise[1], abs=1e-12)


def test_a_vehicle_that_cannot_fly_ends_with_a_reason_and_finite_numbers():
    """An inertia a thousandth of the designed one: the rate loop is unstable and the vehicle tumbles."""
    gains = HUMMINGBIRD.controller.model_copy(update={"rate": 2e4, "rate_integral": 0.0})
    broken = HUMMINGBIRD.model_copy(update={"inertia": (7e-6, 7e-6, 1.2e-5), "controller": gains})
    flown = simulate_flights(Recipe(vehicle=broken, imu=load_imu("adis16448")), vehicle_seeds(0, 2), 400)
    assert np.all(flown["end_step"] < 400)
    assert all("diverged after" in reason for reason in flown["end_reason"])
    assert all(np.all(np.isfinite(v)) for k, v in flown.items() if k != "end_reason")
    assert np.linalg.norm(flown["quat"], axis=-1) == pytest.approx(np.ones((2, 400)))


def test_attitude_error_is_stationary_with_the_given_spread_and_correlation():
    error = np.degrees(AttitudeError(sd_deg=3.0, time_s=0.3).series(4000, 200.0, vehicle_seeds(0, 60)))
    assert error.std((0, 2))[[0, 100, -1]] == pytest.approx([3.0] * 3, rel=0.25)
    later = (error[:, 60:] * error[:, :-60]).mean() / (error**2).mean()  # 0.3 s apart
    assert later == pytest.approx(np.exp(-1), abs=0.05)


def test_flights_flown_on_a_wrong_attitude_swing_and_are_otherwise_recorded_truly():
    still = config(trajectory=Hover(position=(0.0, 0.0, 5.0)))
    right, wrong = (
        simulate_flights(still.model_copy(update={"attitude_error": error}), vehicle_seeds(0, 2), 1000)
        for error in (AttitudeError(), AttitudeError(sd_deg=3.0))
    )
    tilt = [np.degrees(np.abs(roll_pitch_from_quat(f["quat"]))).max() for f in (right, wrong)]
    assert tilt[0] < 0.01
    assert 1.0 < tilt[1] < 20.0
    assert wrong["end_reason"] == ["", ""]
    bias = right["gyro"] - right["ang_vel"], wrong["gyro"] - wrong["ang_vel"]
    assert bias[0] == pytest.approx(bias[1], abs=1e-9)  # the sensor errors are the same


class Listening(Level):
    """An estimator that keeps the rotor speeds it is given."""

    def update(self, gyro, accel, *, rotor_vel=None):
        self.rotor_vel = rotor_vel
        return super().update(gyro, accel)


def test_the_estimator_is_given_the_rotor_speeds_of_the_sample():
    loop = FlightLoop(HUMMINGBIRD, 2, imu=load_imu("adis16448"), estimator=Listening())
    loop.reset(position=(0, 0, 2.0))
    for _ in range(5):
        loop.step("position", np.repeat(HOVER + 1.0, 2, axis=0))
        np.testing.assert_array_equal(loop.estimator.rotor_vel, loop.plant.rotor_vel)


class Writes(Listening):
    """It changes every array that it is given."""

    def observe(self, quat):
        quat[:] = (1.0, 0.0, 0.0, 0.0)

    def update(self, gyro, accel, *, rotor_vel=None):
        gyro[:], accel[:], rotor_vel[:] = 5.0, -5.0, 0.0
        return np.zeros((self.n, 2))


@pytest.mark.parametrize("imu", [None, load_imu("adis16448")])
@pytest.mark.parametrize("faults", [False, True])
def test_an_estimator_and_faults_that_change_arrays_in_place_change_nothing_but_the_readings(imu, faults):
    def reset_count(readings, k):
        k[:] = 99

    corrupt = reset_count if faults else None
    calm, wild = (
        FlightLoop(HUMMINGBIRD, 2, imu=imu, estimator=each, corrupt=corrupt if each else None)
        for each in (Listening(), Writes())
    )
    for loop in (calm, wild):
        loop.reset(position=(0, 0, 2.0))
    for _ in range(10):
        for loop in (calm, wild):
            loop.step("position", np.repeat(HOVER + 1.0, 2, axis=0))
        for field in ("position", "ang_vel", "specific_force", "rotor_vel", "quat"):
            np.testing.assert_array_equal(getattr(calm.plant, field), getattr(wild.plant, field))
        np.testing.assert_array_equal(calm.readings.gyro, wild.readings.gyro)
        np.testing.assert_array_equal(calm.readings.accel, wild.readings.accel)
    assert wild.k.tolist() == [10, 10]


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.floats(0, 40), st.floats(1, 55))
def test_no_seed_wind_or_set_point_records_a_number_that_is_not_finite(seed, gale, tilt):
    storm = Dryden(airspeed=max(gale, 1.0), altitude=20.0, wind_20ft=gale)
    rough = config(trajectory=Mix(max_tilt_deg=tilt), wind=(Constant(velocity=(gale, 0.0, 0.0)), storm))
    flown = simulate_flights(rough, vehicle_seeds(seed, 2), 600)
    for name, values in flown.items():
        if name != "end_reason":
            assert np.all(np.isfinite(values)), name
