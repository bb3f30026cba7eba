"""The filters against independent software, and the facts that hold for every one of them."""

import copy
import pickle

import ahrs
import numpy as np
import pytest
from filter_cases import CLASSICAL, COMPILED, arrays, make
from hypothesis import given, settings
from hypothesis import strategies as st
from level import Level

from estimators import create, names, parameters, run, run_batch
from estimators.filters.inline_math import atan2_core, exp_core, sincos_core
from estimators.metrics import inclination_error
from estimators.registry import tuning_misfit
from quadsim.rotation import (
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate_inverse,
    roll_pitch_from_quat,
)
from quadsim.vehicle import load_vehicle

QUATERNION = [name for name in CLASSICAL if not name.startswith("complementary")]
VQF_DEFAULTS = {
    "tauAcc": 3.0,
    "biasForgettingTime": 100.0,
    "biasSigmaInit": 0.5,
    "biasSigmaMotion": 0.1,
    "biasSigmaRest": 0.03,
}
START = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])


SETTLED = {
    "complementary": {"gamma": 0.97},
    "complementary-adaptive": {"gamma": 0.97, "k_a": 0.01},
    "mahony": {"k_p": 1.0, "k_i": 0.05},
    "madgwick": {"beta": 0.05},
    "ekf": {"gyro_noise": 0.05, "accel_noise": 0.05},
    "eskf": {"gyro_noise": 0.05, "accel_noise": 0.05, "bias_sigma": 0.01},
    "imm": {"gyro_noise": 1e-3, "accel_bias_sigma": 2e-3, "accel_bias_noise": 0.0, "bias_noise": 3e-4},
    "vqf": VQF_DEFAULTS,
}
"""Gains in which a rest of some minutes at 20 Hz is long for every filter."""


@pytest.mark.parametrize(
    ("reference", "est"),
    [
        (ahrs.filters.Mahony(frequency=200.0, k_P=0.8, k_I=0.2), create("mahony", k_p=0.8, k_i=0.2)),
        (ahrs.filters.Madgwick(frequency=200.0, gain=0.05), create("madgwick", beta=0.05)),
    ],
)
def test_mahony_and_madgwick_equal_ahrs(flights, reference, est):
    gyro, accel, _ = arrays(flights, 1)
    est.reset(quat=START)
    quat = START.copy()
    for t in range(gyro.shape[1]):
        quat = reference.updateIMU(quat, gyro[0, t], accel[0, t])
        est.update(gyro[:, t], accel[:, t])
        np.testing.assert_allclose(est.quat[0], quat, atol=1e-9)
        if isinstance(reference, ahrs.filters.Mahony):
            np.testing.assert_allclose(est.gyro_bias[0], reference.b, atol=1e-9)


def test_complementary_equals_ahrs(flights):
    gyro, accel, _ = arrays(flights, 1)
    start = np.array([0.1, -0.2, 0.0])
    reference = ahrs.filters.Complementary(gyro[0], accel[0], frequency=200.0, gain=0.98, w0=start)
    est = create("complementary", 200.0, gamma=0.98)
    out = run(est, gyro[:, 1:], accel[:, 1:], roll_pitch=start[:2])
    np.testing.assert_allclose(out[0], reference.W[1:, :2], atol=1e-9)


@pytest.mark.parametrize(("rate", "slow"), [(0.09, True), (0.11, False)])
def test_the_adaptive_weight_grows_with_the_difference_while_the_vehicle_hardly_turns(rate, slow):
    accel = quat_rotate_inverse(quat_from_euler(0.5, -0.3, 0.0), [0.0, 0.0, 9.81])
    est = create("complementary-adaptive", 200.0, gamma=0.98, k_a=0.05)
    out = run(est, np.tile([rate, 0.0, 0.0], (1, 5, 1)), np.tile(accel, (1, 5, 1)), roll_pitch=[0.0, 0.0])
    angles = np.zeros(2)
    for found in out[0]:
        angles = angles + np.array([rate, 0.0]) / 200.0
        difference = np.array([0.5, -0.3]) - angles
        angles = angles + (0.02 + slow * 0.05 * np.abs(difference)) * difference
        np.testing.assert_allclose(found, angles, atol=1e-12)


def test_ekf_equals_filterpy_s_and_nearly_its_unscented_one(flights):
    gyro, accel, quat = arrays(flights, 2, 400)
    start = roll_pitch_from_quat(quat[:, 0])
    ours, theirs, unscented = (create(name) for name in ("ekf", "ekf-filterpy", "ukf-filterpy"))
    out = run(ours, gyro, accel, start)
    np.testing.assert_allclose(out, run(theirs, gyro, accel, start), atol=1e-9)
    np.testing.assert_allclose(ours.quat, theirs.quat, atol=1e-9)
    assert np.degrees(np.abs(out - run(unscented, gyro, accel, start))).max() < 0.1


def test_vqf_runs_as_its_authors_package(flights):
    from vqf import VQF

    gyro, accel, _ = arrays(flights, 1)
    theirs = VQF(1.0 / 200.0).updateBatch(gyro[0], accel[0])["quat6D"]
    ours = run(create("vqf", 200.0, **VQF_DEFAULTS), gyro, accel)
    np.testing.assert_array_equal(ours[0], roll_pitch_from_quat(theirs))


def test_inline_functions_of_angles_equal_the_library_s():
    angles = np.concatenate([np.linspace(-20.0, 20.0, 4001), [0.0, -0.0, 1e-9, np.pi, -np.pi, np.pi / 2]])
    for x in angles:
        np.testing.assert_allclose(sincos_core(x), (np.sin(x), np.cos(x)), rtol=0.0, atol=3e-16)
        rotation = x * np.array([0.6, 0.0, -0.8])
        np.testing.assert_allclose(exp_core(*rotation), quat_from_rotvec(rotation), rtol=0.0, atol=3e-16)
        y, z = np.sin(x), np.cos(x)
        np.testing.assert_allclose(atan2_core(y, z), np.arctan2(y, z), rtol=4e-16)


@pytest.mark.parametrize("name", [*COMPILED, "vqf"])
def test_run_batch_is_run_for_each_parameter_set(flights, name):
    gyro, accel, quat = arrays(flights, 2, 200)
    start = roll_pitch_from_quat(quat[:, 0])
    key, parameter = next((k, p) for k, p in parameters(name).items() if p.searched)
    values = parameter.at([0.3, 0.7])
    batch = run_batch(name, {key: values}, gyro, accel, 200.0, start, vehicle="hummingbird")
    assert batch.shape == (2, 2, 200, 2)
    for value, out in zip(values, batch, strict=True):
        np.testing.assert_array_equal(out, run(make(name, **{key: value}), gyro, accel, start))


@pytest.mark.parametrize("name", QUATERNION)
def test_roll_and_pitch_do_not_depend_on_heading(flights, name):
    gyro, accel, quat = arrays(flights, 2, 200)
    est = make(name)
    turned = quat_multiply(quat_from_euler(0.0, 0.0, 1.2), quat[:, 0])
    est.reset(2, quat=quat[:, 0])
    plain = np.stack([est.update(gyro[:, t], accel[:, t]) for t in range(200)])
    before = est.quat
    est.reset(2, quat=turned)
    again = np.stack([est.update(gyro[:, t], accel[:, t]) for t in range(200)])
    # imm's models differ in heading, of which their covariances do not know
    np.testing.assert_allclose(again, plain, atol=1e-6 if name == "imm" else 1e-7)
    expected = quat_multiply(quat_from_euler(0.0, 0.0, 1.2), before)
    assert np.abs(np.sum(est.quat * expected, axis=-1)) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(est.quat, axis=-1), 1.0, atol=1e-12)


@pytest.mark.parametrize("name", SETTLED)
@settings(max_examples=20, deadline=None)
@given(
    tilt=st.floats(0.0, 160.0),
    start_tilt=st.floats(0.0, 60.0),
    direction=st.floats(-180.0, 180.0),
    yaw=st.floats(-180.0, 180.0),
)
def test_at_rest_every_attitude_is_found_from_every_start(name, tilt, start_tilt, direction, yaw):
    angles = np.radians([tilt, start_tilt, direction, yaw])
    axis = np.array([np.cos(angles[2]), np.sin(angles[2]), 0.0])
    if name.startswith("complementary"):
        angles[0] = min(angles[0], np.radians(70.0))  # Euler angles; at 90° of pitch there is no roll
    truth = quat_multiply(quat_from_euler(0.0, 0.0, angles[3]), quat_from_rotvec(angles[0] * axis))
    start = roll_pitch_from_quat(quat_from_rotvec(-0.3 * angles[1] * axis))
    accel = np.tile(quat_rotate_inverse(truth, [0.0, 0.0, 9.81]), (1, 8000, 1))
    out = run(make(name, 20.0, **SETTLED[name]), np.zeros_like(accel), accel, roll_pitch=start)
    assert inclination_error(out[0, -1], roll_pitch_from_quat(truth)) < 0.5


@pytest.mark.parametrize("name", ["mahony", "eskf", "vqf"])
def test_gyroscope_bias_is_found_at_rest(name):
    bias = np.array([0.01, -0.008, 0.0])
    accel = np.tile([0.0, 0.0, 9.81], (1, 200 * 120, 1))
    slow = {"gyro_noise": 1e-3} if name == "eskf" else {}
    est = make(name, 200.0, **SETTLED[name] | slow)
    run(est, np.broadcast_to(bias, accel.shape), accel)
    np.testing.assert_allclose(est.gyro_bias[0, :2], bias[:2], atol=1e-3)


@pytest.mark.parametrize("name", CLASSICAL)
def test_tilt_is_about_the_same_at_any_sample_rate(make_flights, name):
    steps = {}
    for rate in (100.0, 400.0):
        data = make_flights(1, 4.0, rate, noise=0.0)
        truth = roll_pitch_from_quat(data.quat.values)
        gyro, accel = data.gyro.values, data.accel.values
        out = run(make(name, rate), gyro[:, 1:], accel[:, 1:], truth[:, 0])
        steps[rate] = out[0, :: int(rate // 100)][:390]
    assert np.degrees(np.abs(steps[100.0] - steps[400.0])).max() < 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: create("mahonny"), 'unknown estimator "mahonny"; did you mean "mahony"'),
        (lambda: create("mahony", kp=1.0), 'mahony has no parameter "kp"; did you mean "k_p"'),
        (lambda: create("mahony", k_p=float("nan")), "k_p = nan is not a finite number"),
        (lambda: create("ekf-drag"), "ekf-drag needs the drag of the airframe"),
        (lambda: create("ekf-drag", drag_time=4.9), "or frame_drag"),
        (lambda: create("ekf-drag", vehicle=3), "vehicle = 3: should be a name"),
        (lambda: create("ekf-drag", vehicle="hummingbrid"), 'did you mean "hummingbird"'),
        (lambda: create("complementary", gamma=1.2), "gamma = 1.2 is outside 0 to 1"),
        (lambda: create("ekf", rate_hz=0.0), "rate_hz = 0.0: should be 0.001 to 100000 Hz"),
        (lambda: run(create("truth"), np.zeros((1, 2, 3)), np.zeros((1, 2, 3))), "observes the truth"),
        (lambda: run(create("ekf"), np.zeros((1, 2, 3)), np.zeros((1, 3, 3))), "must both have one shape"),
        (lambda: create("ekf").update(np.zeros((2, 3)), np.zeros((2, 3))), "as in reset"),
        (lambda: create("ekf").reset(2, roll_pitch=np.zeros((3, 2))), "roll_pitch has shape"),
        (lambda: create("ekf").reset(0), "needs at least one vehicle"),
    ],
)
def test_mistakes_are_named(call, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        call()


@pytest.mark.parametrize("name", [name for name in names() if name != "truth"])
def test_copies_and_pickles_of_an_estimator_go_on_from_its_state(name):
    est = make(name)
    est.reset(2)
    gyro, accel = np.full((2, 3), 0.2), np.array([[0.5, -0.2, 9.7], [1.0, 2.0, 9.0]])
    for _ in range(30):
        est.update(gyro, accel)
    copied, pickled = copy.deepcopy(est), pickle.loads(pickle.dumps(est))
    wanted = est.update(accel, gyro)
    np.testing.assert_array_equal(copied.update(accel, gyro), wanted)
    np.testing.assert_array_equal(pickled.update(accel, gyro), wanted)


def test_shipped_parameters_are_those_of_the_vehicle_and_the_imu():
    px4 = load_vehicle("px4-quad")
    assert create("vqf", vehicle="px4-quad").values == create("vqf", tuning="px4-quad-px4-mini").values
    assert create("vqf", vehicle=px4, imu="rough").values == create("vqf", vehicle=px4).values
    assert create("vqf", vehicle="crazyflie").values == create("vqf").values
    assert create("vqf", vehicle="px4-quad").values != create("vqf").values


def test_a_tuning_for_another_vehicle_or_imu_is_named():
    assert tuning_misfit("vqf", None, "hummingbird", "adis16448") == ""
    assert tuning_misfit("vqf", None, "px4-quad", "px4-mini") == ""
    assert tuning_misfit("vqf", None, "crazyflie", "adis16448") == "the hummingbird"
    assert tuning_misfit("vqf", None, "hummingbird", "rough") == "the IMU adis16448"
    assert "hummingbird and the IMU" in tuning_misfit("vqf", "hummingbird-adis16448", "px4-quad", "px4-mini")
    assert tuning_misfit("att-snn", None, "crazyflie", "rough") == ""


class Keeps(Level):
    """It keeps its readings beside the IMU's; `update` is made of `keep`."""

    def __init__(self, update):
        super().__init__()
        self.given, self.update = [], update(self.keep)

    def keep(self, **sensors):
        self.given.append(sensors)
        return np.zeros((self.n, 2))


def test_estimators_are_given_the_sensors_that_they_accept():
    gyro, rotor_vel, mag = np.zeros((2, 5, 3)), np.ones((2, 5, 4)), np.full((2, 5, 3), 2e-5)
    sensors = {"rotor_vel": rotor_vel, "mag": mag}
    plain = Keeps(lambda keep: lambda gyro, accel: keep())
    magnetic = Keeps(lambda keep: lambda gyro, accel, mag=None: keep(mag=mag))
    everything = Keeps(lambda keep: lambda gyro, accel, **sensors: keep(**sensors))
    assert run(plain, gyro, gyro, **sensors).shape == (2, 5, 2)
    run(magnetic, gyro, gyro, **sensors)
    np.testing.assert_array_equal(np.stack([each["mag"] for each in magnetic.given], axis=1), mag)
    run(everything, gyro, gyro, rotor_vel=rotor_vel)
    np.testing.assert_array_equal(np.stack([each["rotor_vel"] for each in everything.given], 1), rotor_vel)
    assert everything.given[0]["mag"] is None
    with pytest.raises(ValueError, match="mag has shape"):
        run(plain, gyro, gyro, mag=mag[:1])


@pytest.mark.parametrize("name", names())
def test_every_estimator_accepts_further_sensors(name):
    est = make(name)
    est.reset(1)
    assert est.update(np.zeros((1, 3)), np.ones((1, 3)), rotor_vel=np.ones((1, 4)), mag=None).shape == (1, 2)
