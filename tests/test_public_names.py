"""The names that other people's code imports, with the arguments that their documentation shows."""

import inspect

import pytest

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
ARGUMENTS = {
    create: "name rate_hz", run: "est gyro accel roll_pitch", run_batch: "name params gyro accel",
    Plant: "vehicle n rate_hz integrator", Plant.reset: "position velocity quat ang_vel rotor_vel",
    Plant.step: "rotor_vel_cmd wind", load_vehicle: "source", load_imu: "source",
    simulate_imu: "spec ang_vel specific_force rate_hz seed", ImuStream: "spec n rate_hz seed",
    ImuStream.sample: "ang_vel specific_force",
    dryden: "n steps rate_hz airspeed altitude wind_20ft seed", open_dataset: "path",
    generate: "config flights duration_s out seed workers",
    LoihiLayer: "w_in w_rec du dv vth bias_mant bias_exp", LoihiNetwork: "layers",
    LoihiNetwork.reset: "n", LoihiNetwork.step: "spikes_in bias_mant", superspike: "x",
    Lookahead: "optimizer",
}  # fmt: skip


@pytest.mark.parametrize(("call", "names"), ARGUMENTS.items(), ids=lambda each: getattr(each, "__name__", ""))
def test_every_call_has_its_arguments(call, names):
    assert set(names.split()) <= inspect.signature(call).parameters.keys()


def test_every_estimator_has_its_name():
    assert set(NAMES.split()) <= set(estimators.names())


def test_a_dataset_has_its_variables(tmp_path):
    data = open_dataset(generate(load_recipe("hummingbird"), 1, 1.0, tmp_path / "flights.zarr", workers=1))
    names = "gyro accel ang_vel specific_force quat position velocity rotor_vel rotor_vel_cmd wind gyro_bias"
    assert {*names.split(), "accel_bias"} <= set(data)
    assert set(data.dims) == {"flight", "time", "axis", "quat_axis", "rotor"}
