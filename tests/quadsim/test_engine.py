"""The compiled engine against MuJoCo, which defines the physics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadsim.flight.recipe import load_recipe
from quadsim.flight.scenario import changed
from quadsim.flight.simulate import simulate_flights
from quadsim.motion.free_body import advance_body
from quadsim.plant import Plant
from quadsim.runs.compiled import njit
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import load_vehicle

HUMMINGBIRD = load_vehicle("hummingbird")
PX4 = {"vehicle": "px4-quad", "imu": "px4-mini", "trajectory": {"kind": "mix", "dash_s": (1.3, 3.0)}}
STATE = ("position", "velocity", "quat", "ang_vel")


@njit(cache=True)
def advance_all(vehicles):
    for i in range(vehicles.shape[0]):
        advance_body(vehicles[i])


def random_bodies(rng, n):
    """Masses from 10 g to 10 kg, any inertia that a rigid body can have, spins to 40 rad/s."""
    vehicles = []
    for _ in range(n):
        mass, radius = float(10 ** rng.uniform(-2, 1)), rng.uniform(0.02, 0.2)
        a, b = rng.uniform(0.5, 2.0, 2)
        inertia = np.array([a, b, rng.uniform(1.05 * abs(a - b), 0.95 * (a + b))]) * mass * radius**2
        motor = HUMMINGBIRD.motor.model_copy(update={"k_f": HUMMINGBIRD.motor.k_f * mass / HUMMINGBIRD.mass})
        numbers = {"mass": mass, "inertia": tuple(inertia.tolist()), "motor": motor}
        vehicles.append(HUMMINGBIRD.model_copy(update=numbers))
    spin = rng.normal(size=(n, 3))
    spin *= rng.uniform(0, 40, (n, 1)) / np.linalg.norm(spin, axis=1, keepdims=True)
    start = {"quat": rng.normal(size=(n, 4)), "velocity": 5 * rng.normal(size=(n, 3)), "ang_vel": spin}
    return vehicles, start


def difference(plant, other):
    """Largest difference of each body's state, relative to its size where that is above 1."""
    worst = np.zeros(plant.n)
    for name in STATE:
        x, y = plant.vehicles["state"][name], other.vehicles["state"][name]
        worst = np.maximum(worst, np.abs(x - y).max(1) / np.maximum(1.0, np.linalg.norm(x, axis=1)))
    return worst


def test_a_step_of_any_body_is_mujocos_to_round_off():
    rng = np.random.default_rng(0)
    vehicles, start = random_bodies(rng, 64)
    plant, engine = Plant(vehicles, 64, engine="auto"), Plant(vehicles, 64, engine="mujoco")
    mass, inertia = plant.vehicles["mass"][:, None], plant.vehicles["inertia"]
    engine.reset(**start)
    for _ in range(200):
        engine.vehicles["force"] = 5.0 * mass * rng.normal(size=(64, 3))
        engine.vehicles["moment"] = 10.0 * inertia * rng.normal(size=(64, 3))
        plant.vehicles[:] = engine.vehicles
        advance_all(plant.vehicles)
        engine.engine.step()
        assert difference(engine, plant).max() < 2e-14


@pytest.mark.parametrize(
    ("recipe", "changes", "seconds", "tolerance"),
    [
        *[(recipe, {}, 20, 1e-12) for recipe in ("hummingbird", "robust", "turbulent")],
        ("hummingbird", PX4, 20, 1e-12),
        ("hummingbird", {}, 120, 1e-9),
    ],
)
def test_flights_agree(recipe, changes, seconds, tolerance):
    config = changed(load_recipe(recipe), changes)
    by_engine = [
        simulate_flights(config.model_copy(update={"engine": each}), vehicle_seeds(0, 2), 200 * seconds)
        for each in ("mujoco", "auto")
    ]
    for name in (*STATE, "specific_force", "gyro", "accel"):
        assert_allclose(*(f[name] for f in by_engine), rtol=tolerance, atol=tolerance, err_msg=name)


def test_auto_is_compiled_in_free_flight_and_mujoco_on_the_ground():
    assert Plant(HUMMINGBIRD).engine is None
    assert Plant(HUMMINGBIRD, contact=True, integrator="implicitfast").engine is not None
    assert Plant(HUMMINGBIRD, integrator="Euler").engine is not None


@pytest.mark.parametrize("quat", [(0, 0, 0, 0), (2, 0.4, 0, 0)])
def test_a_quaternion_of_another_length_is_what_it_is_to_mujoco(quat):
    plants = [Plant(HUMMINGBIRD, engine=each) for each in ("mujoco", "auto")]
    for plant in plants:
        plant.quat[:] = quat
        plant.vehicles["force"], plant.vehicles["moment"] = (1.0, 2.0, 3.0), (0.1, 0.0, 0.0)
    plants[0].engine.step()
    advance_all(plants[1].vehicles)
    assert difference(*plants)[0] < 1e-14
