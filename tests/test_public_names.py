"""The names that other people's code imports: each is used once as its documentation shows."""

import gymnasium
import numpy as np
import pytest
import torch

import estimators
from estimators import create, run, run_batch
from estimators.loihi import LoihiLayer, LoihiNetwork
from estimators.spiking import superspike
from quadsim.dataset import generate, open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.imu import ImuStream, load_imu, simulate_imu
from quadsim.plant import Plant
from quadsim.vehicle import load_vehicle
from quadsim.wind import dryden
from training.optim import Lookahead

NAMES = (
    "truth complementary complementary-adaptive mahony madgwick ekf eskf ekf-drag imm "
    "ekf-filterpy ukf-filterpy vqf att-rnn att-snn att-snn-loihi"
)
GYRO = np.zeros((2, 5, 3))
ACCEL = np.tile([0.0, 0.0, 9.81], (2, 5, 1))


def test_every_estimator_has_its_name():
    assert set(NAMES.split()) <= set(estimators.names())
    with pytest.raises(ValueError, match="madgwick"):
        create("madgwik", rate_hz=200.0)


def test_an_estimator_updates_as_it_runs():
    est = create("madgwick", rate_hz=200.0, beta=0.05)
    est.reset(n=2, roll_pitch=np.full((2, 2), 0.1))
    updated = [est.update(GYRO[:, t], ACCEL[:, t]) for t in range(5)]
    assert est.quat.shape == (2, 4)
    ran = run(est, GYRO, ACCEL, roll_pitch=np.full((2, 2), 0.1))
    np.testing.assert_allclose(ran, np.stack(updated, 1), atol=1e-12)
    drag = create("ekf-drag", rate_hz=200.0, vehicle="hummingbird")
    drag.reset(n=2, quat=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    assert drag.update(GYRO[:, 0], ACCEL[:, 0], rotor_vel=np.full((2, 4), 453.0), mag=None).shape == (2, 2)
    assert drag.gyro_bias.shape == (2, 3)
    assert callable(run_batch)


def test_a_plant_in_turbulence_hovers_and_is_measured():
    plant = Plant(load_vehicle("hummingbird"), 2, rate_hz=200.0, integrator="RK4")
    plant.reset(position=np.zeros((2, 3)))
    wind = dryden(2, 1, 200.0, airspeed=5.0, altitude=20.0, wind_20ft=5.0, seed=0)
    state = plant.step(np.full((2, 4), 453.2), wind=wind[:, 0])
    for name in ("position", "velocity", "ang_vel", "specific_force"):
        assert getattr(state, name).shape == (2, 3)
    assert state.quat.shape == state.rotor_vel.shape == (2, 4)
    imu = load_imu("adis16448")
    gyro, accel = simulate_imu(imu, GYRO, ACCEL, rate_hz=200.0, seed=0)
    stream = ImuStream(imu, 2, 200.0, 0)
    streamed = [stream.sample(GYRO[:, t], ACCEL[:, t]) for t in range(5)]
    np.testing.assert_array_equal(gyro, np.stack([each[0] for each in streamed], 1))
    np.testing.assert_array_equal(accel, np.stack([each[1] for each in streamed], 1))


def test_a_dataset_has_its_variables(tmp_path):
    data = open_dataset(generate(load_recipe("hummingbird"), 1, 1.0, tmp_path / "flights.zarr", workers=1))
    names = "gyro accel ang_vel specific_force quat position velocity rotor_vel rotor_vel_cmd wind gyro_bias"
    assert {*names.split(), "accel_bias"} <= set(data)
    assert set(data.dims) == {"flight", "time", "axis", "quat_axis", "rotor"}


def test_the_environment_takes_an_estimator_by_name():
    env = gymnasium.make("quadsim/Quadrotor-v0", estimator="mahony", scenario="hover")
    env.reset(seed=0)
    assert len(env.step(env.action_space.sample())) == 5
    many = gymnasium.make_vec("quadsim/Quadrotor-v0", num_envs=2, estimator="mahony")
    assert many.reset(seed=0)[0].shape[0] == 2


def test_spikes_of_a_step_enter_the_currents_in_the_next():
    layer = LoihiLayer(w_in=[[2]], w_rec=None, du=4096, dv=4096, vth=1, bias_mant=0, bias_exp=0)
    net = LoihiNetwork([layer])
    net.reset(n=1)
    net.step(np.ones((1, 1)))
    assert net.u[0].tolist() == [[0]]
    net.step(np.zeros((1, 1)))
    assert (net.u[0].tolist(), net.v[0].tolist(), net.s[0].tolist()) == ([[128]], [[0]], [[1]])


def test_the_surrogate_and_the_optimiser_are_there():
    x = torch.tensor([0.1], requires_grad=True)
    superspike(x).backward()
    np.testing.assert_allclose(x.grad, 1 / 9)
    Lookahead(torch.optim.SGD([x], lr=0.9)).step()
    np.testing.assert_allclose(x.detach(), 0.0, atol=1e-7)
