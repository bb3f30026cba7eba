"""The plant against closed forms and invariants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadsim.plant import Plant
from quadsim.rotation import quat_from_euler, quat_rotate, quat_rotate_inverse
from quadsim.vehicle import GRAVITY, load_vehicle, with_drag

HUMMINGBIRD = load_vehicle("hummingbird")
VACUUM = with_drag(HUMMINGBIRD, 0.0)
LINEAR = HUMMINGBIRD.model_copy(update={"frame": VACUUM.frame})
BATCHES = pytest.mark.parametrize("n", [1, 7])


def hover(n, vehicle=HUMMINGBIRD):
    return np.full((n, 4), vehicle.hover_rotor_vel)


@pytest.mark.parametrize(("n", "name"), [(1, "hummingbird"), (7, "hummingbird"), (2, "hexarotor")])
def test_hover_speed_holds_still(n, name):
    vehicle = load_vehicle(name)
    plant = Plant(vehicle, n)
    for _ in range(400):
        state = plant.step(vehicle.hover_rotor_vel)
    assert state.position == pytest.approx(np.tile([0, 0, 1.0], (n, 1)), abs=1e-9)
    assert state.specific_force == pytest.approx(np.tile([0, 0, GRAVITY], (n, 1)), abs=1e-9)


@pytest.mark.parametrize("engine", ["auto", "mujoco"])
@pytest.mark.parametrize("area", [(0.02, 0.02, 0.02), (0.01, 0.02, 0.05)])
def test_frame_drag_grows_with_the_airspeed_and_opposes_it(engine, area):
    """−½ ρ C_d A |v| v per body axis: with one area for all axes, antiparallel to the airspeed."""
    vehicle = VACUUM.model_copy(update={"frame": VACUUM.frame.model_copy(update={"drag_area": area})})
    plant, rng = Plant(vehicle, 8, engine=engine), np.random.default_rng(0)
    plant.reset(velocity=rng.normal(0, 8, (8, 3)), quat=rng.normal(size=(8, 4)), rotor_vel=0.0)
    wind = rng.normal(0, 4, (8, 3))
    for _ in range(3):
        state = plant.step(np.zeros((8, 4)), wind)
    air = quat_rotate_inverse(state.quat, state.velocity - wind)
    speed = np.linalg.norm(air, axis=1, keepdims=True)
    assert vehicle.mass * state.specific_force == pytest.approx(-0.5 * 1.225 * speed * air * area)


def test_each_hub_drags_and_rolls_by_its_own_air_velocity():
    """H-force −c |ω| V⊥ and moments r × F − c_r |ω| V⊥ beside thrust, with I ω̇ + ω × I ω = M."""
    motor = LINEAR.motor.model_copy(update={"rolling_moment": 1e-4})  # large enough to show
    vehicle = LINEAR.model_copy(update={"motor": motor})
    velocity, ang_vel = np.array([3.0, -5.0, 2.0]), np.array([4.0, 7.0, -6.0])
    speed = np.array([300.0, 450.0, 520.0, 610.0])
    state = Plant(vehicle).reset(velocity=velocity, ang_vel=ang_vel, rotor_vel=speed)
    hubs = np.array([rotor.position for rotor in vehicle.rotors])
    across = (velocity + np.cross(ang_vel, hubs)) * [1.0, 1.0, 0.0] * speed[:, None]
    thrust, *torque = vehicle.allocation @ speed**2
    force = -motor.rotor_drag * across
    moment = torque + np.sum(np.cross(hubs, force) - motor.rolling_moment * across, axis=0)
    expected = force.sum(axis=0) + np.array([0.0, 0.0, thrust])
    np.testing.assert_allclose(state.specific_force[0] * vehicle.mass, expected)
    inertia = np.array(vehicle.inertia)
    turned = inertia * state.ang_acc[0] + np.cross(ang_vel, inertia * ang_vel)
    np.testing.assert_allclose(turned, moment, atol=1e-12)


@pytest.mark.parametrize("rate_hz", [50, 200, 1000])
def test_rotors_lag_exponentially_and_alike_at_any_rate(rate_hz):
    plant = Plant(HUMMINGBIRD, 2, rate_hz=rate_hz)
    motor = HUMMINGBIRD.motor
    low, high = 300.0, 600.0
    plant.reset(rotor_vel=[[low] * 4, [high] * 4])
    target = np.array([[high] * 4, [low] * 4])
    for k in range(1, rate_hz // 10):
        state = plant.step(target)
        t = k / rate_hz
        assert state.rotor_vel[0] == pytest.approx(high + (low - high) * np.exp(-t / motor.tau_up))
        assert state.rotor_vel[1] == pytest.approx(low + (high - low) * np.exp(-t / motor.tau_down))


def test_wind_is_the_same_as_flying_the_other_way():
    """Galilei: drifting with the wind and flying in still air are one thing."""
    wind = np.array([[6.0, -3.0, 1.0]])
    rng = np.random.default_rng(0)
    still, windy = Plant(HUMMINGBIRD, 1), Plant(HUMMINGBIRD, 1)
    still.reset(velocity=(1.0, 2.0, 0.5), ang_vel=(1, 2, 3))
    windy.reset(velocity=np.array([1.0, 2.0, 0.5]) + wind, ang_vel=(1, 2, 3))
    windy.step(hover(1), wind), still.step(hover(1))  # reset senses in still air
    for _ in range(200):
        command = rng.uniform(300, 600, (1, 4))
        a, b = still.step(command), windy.step(command, wind)
    assert b.velocity - wind == pytest.approx(a.velocity, abs=1e-4)
    assert b.specific_force == pytest.approx(a.specific_force, abs=1e-3)
    assert b.quat == pytest.approx(a.quat, abs=1e-5)


@BATCHES
def test_tumbling_in_vacuum_conserves_angular_momentum_and_energy(n):
    plant = Plant(VACUUM, n)
    rng = np.random.default_rng(1)
    plant.reset(ang_vel=rng.normal(0, 3, (n, 3)), quat=rng.normal(size=(n, 4)), rotor_vel=0.0)

    def momentum_and_energy(state):
        spin = np.asarray(VACUUM.inertia) * state.ang_vel
        return np.column_stack([quat_rotate(state.quat, spin), np.sum(spin * state.ang_vel, axis=-1)])

    before = momentum_and_energy(plant.state())
    for _ in range(1000):
        state = plant.step(np.zeros((n, 4)))
    assert momentum_and_energy(state) == pytest.approx(before, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("axis", "more", "less"),
    [(0, [1], [3]), (1, [2], [0]), (2, [0, 2], [1, 3])],
    ids=["roll", "pitch", "yaw"],
)
def test_differences_of_thrust_turn_the_right_way(axis, more, less):
    """More on the left rolls right, at the back pitches the nose down, on clockwise rotors yaws left."""
    plant, command = Plant(HUMMINGBIRD), hover(1)
    command[0, more] += 20
    command[0, less] -= 20
    for _ in range(5):
        state = plant.step(command)
    assert state.ang_vel[0, axis] > 0.005
    assert np.abs(np.delete(state.ang_vel[0, :2], min(axis, 1))).max() < 1e-2 * state.ang_vel[0, axis]


def test_specific_force_and_angular_acceleration_belong_to_the_same_instant():
    """Differences of velocity and rate between neighbours equal the mean of the two neighbours' values."""
    plant = Plant(HUMMINGBIRD, 1, rate_hz=1000)
    rng = np.random.default_rng(3)
    plant.reset(velocity=(4, 1, 0), ang_vel=(2, -1, 1), quat=quat_from_euler(0.4, -0.3, 1.0))
    command = hover(1) + rng.uniform(-20, 20, (1, 4))
    states = [plant.state()] + [plant.step(command) for _ in range(200)]
    world = np.array([quat_rotate(s.quat, s.specific_force)[0] for s in states]) - [0, 0, GRAVITY]
    change = np.diff([s.velocity[0] for s in states], axis=0) * 1000
    assert change == pytest.approx((world[1:] + world[:-1]) / 2, abs=2e-3)
    assert np.abs(change - world[1:]).max() > 5e-3  # one sample late would show
    turn = np.array([s.ang_acc[0] for s in states])
    change = np.diff([s.ang_vel[0] for s in states], axis=0) * 1000
    assert change == pytest.approx((turn[1:] + turn[:-1]) / 2, abs=2e-2 * np.abs(turn).max())


def test_vehicles_of_one_batch_can_differ_and_change_their_mass():
    plant = Plant([HUMMINGBIRD, HUMMINGBIRD.model_copy(update={"mass": 1.0})], 2)
    plant.reset(rotor_vel=hover(2))
    for _ in range(20):
        state = plant.step(hover(2))
    fall = GRAVITY * (HUMMINGBIRD.mass / 1.0 - 1)
    assert state.velocity[:, 2] == pytest.approx([0.0, 0.1 * fall], rel=0.02, abs=1e-9)
    plant.set_mass([HUMMINGBIRD.mass * 0.9, HUMMINGBIRD.mass])
    radii = plant.vehicles["inertia"][0] / plant.vehicles["mass"][0]
    assert radii == pytest.approx(np.array(HUMMINGBIRD.inertia) / HUMMINGBIRD.mass)
    plant.reset(rotor_vel=hover(2))
    for _ in range(20):
        state = plant.step(hover(2))
    assert state.velocity[:, 2] == pytest.approx([0.1 * GRAVITY * (1 / 0.9 - 1), 0.0], rel=0.02, abs=1e-9)


def test_a_vehicle_rests_on_the_ground_and_feels_it():
    plant = Plant(HUMMINGBIRD, 2, contact=True)
    plant.reset(position=(0, 0, 0.05), rotor_vel=0.0)
    for _ in range(400):
        state = plant.step(np.zeros((2, 4)))
    assert state.position[:, 2] == pytest.approx(HUMMINGBIRD.frame.size[2], abs=2e-3)
    assert state.specific_force == pytest.approx(np.tile([0, 0, GRAVITY], (2, 1)), abs=0.02)


def test_step_returns_copies():
    plant = Plant(HUMMINGBIRD, 1)
    first = plant.step(hover(1) * 1.1)
    kept = first.position.copy()
    plant.step(hover(1) * 1.1)
    assert np.array_equal(first.position, kept)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4),
    st.lists(st.floats(-60, 60), min_size=3, max_size=3),
)
def test_no_command_or_wind_makes_a_state_that_is_not_finite(command, wind):
    plant = Plant(HUMMINGBIRD, 1)
    for _ in range(20):
        state = plant.step(command, np.array(wind)[None])
    assert all(np.all(np.isfinite(part)) for part in state)
    assert np.all(state.rotor_vel <= HUMMINGBIRD.motor.omega_max)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Plant(HUMMINGBIRD, 0), "at least one vehicle"),
        (lambda: Plant(HUMMINGBIRD, 1, rate_hz=float("nan")), "rate_hz"),
        (lambda: Plant(HUMMINGBIRD, 1, integrator="RK5"), "RK4"),
        (lambda: Plant(HUMMINGBIRD, engine="bullet"), "unknown engine 'bullet'; choose one of auto, mujoco"),
        (lambda: Plant(HUMMINGBIRD, 1).step([1, 2, 3]), "shape"),
        (lambda: Plant(HUMMINGBIRD, 1).step([1, 2, 3, np.nan]), "finite"),
        (lambda: Plant(HUMMINGBIRD, 1).reset(quat=(0, 0, 0, 0)), "length zero"),
        (lambda: Plant([HUMMINGBIRD], 2), "n = 2"),
        (lambda: Plant(HUMMINGBIRD, 1).set_mass([-1.0]), "positive"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@BATCHES
def test_free_fall_reads_zero(n):
    plant = Plant(VACUUM, n)
    plant.reset(rotor_vel=0.0, ang_vel=(1.0, -2.0, 3.0))
    for _ in range(100):
        state = plant.step(np.zeros((n, 4)))
        assert np.abs(state.specific_force).max() < 1e-12
    assert state.velocity[:, 2] == pytest.approx(-GRAVITY * 0.5)


@BATCHES
def test_without_drag_the_accelerometer_cannot_see_40_degrees_of_tilt(n):
    plant = Plant(VACUUM, n)
    plant.reset(quat=quat_from_euler(np.radians(40), 0, 0))
    for _ in range(100):
        state = plant.step(hover(n, VACUUM))
    assert state.specific_force == pytest.approx(np.tile([0, 0, GRAVITY], (n, 1)), abs=1e-9)
