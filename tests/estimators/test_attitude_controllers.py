"""Controllers that read an attitude in place of the accelerometer: inputs, files, exports."""

import numpy as np
import pytest
from controllers import CONFIG, random_tensors, readings
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimators.control import create_controller
from estimators.control.controller import gravity_of
from estimators.control.weights import ControllerWeights, load_controller, save_controller
from estimators.export.formats import export_weights
from estimators.networks.weights_file import load_network
from quadsim.vehicle import GRAVITY


@pytest.fixture
def file(tmp_path):
    weights = ControllerWeights(CONFIG, random_tensors(), "attitude")
    save_controller(tmp_path / "attitude.safetensors", weights)
    return tmp_path / "attitude.safetensors"


def stream(controller, wanted, gyro, accel, roll_pitch):
    controller.reset(len(gyro))
    steps = range(gyro.shape[1])
    return np.stack(
        [controller.update(wanted[:, t], gyro[:, t], accel[:, t], roll_pitch[:, t]) for t in steps], 1
    )


@given(roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5))
@settings(max_examples=50, deadline=None)
def test_gravity_of_an_attitude_is_the_specific_force_at_rest(roll, pitch):
    wanted = Rotation.from_euler("ZYX", [0.7, pitch, roll]).inv().apply([0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(gravity_of([roll, pitch]), wanted, atol=1e-12)


def test_a_file_says_what_a_controller_reads_and_keeps_its_weights(file):
    loaded = load_controller(file)
    assert loaded.reads == "attitude"
    assert loaded.config == CONFIG
    assert all(np.array_equal(loaded.tensors[name], each) for name, each in random_tensors().items())
    assert load_network(file)[0] == CONFIG  # other readers need not know


def test_it_reads_the_attitude_and_not_the_accelerometer(file):
    wanted, gyro, accel = readings(2, 60)
    roll_pitch = np.random.default_rng(3).normal(size=(2, 60, 2)) * 0.3
    whole = create_controller(file)
    whole.reset(2)
    out = stream(create_controller(file), wanted, gyro, np.full_like(accel, np.nan), roll_pitch)
    assert np.array_equal(out, whole.sequence(wanted, gyro, gravity_of(roll_pitch)))
    assert not np.array_equal(out, stream(create_controller(file), wanted, gyro, accel, 0.0 * roll_pitch))


def test_the_emulated_chip_gives_the_same_outputs(file):
    wanted, gyro, accel = readings(2, 100)
    roll_pitch = np.random.default_rng(3).normal(size=(2, 100, 2)) * 0.3
    plain, chip = (
        stream(create_controller(name), wanted, gyro, accel, roll_pitch) for name in (file, f"{file}-loihi")
    )
    assert np.array_equal(plain, chip)


def test_a_missing_attitude_keeps_the_last_valid_one(file):
    wanted, gyro, accel = readings(1, 30)
    roll_pitch = np.full((1, 30, 2), [0.2, -0.1])
    missing = roll_pitch.copy()
    missing[:, 10:20] = np.nan
    gyro[:, 10:20] = gyro[:, 9:10]
    assert np.array_equal(
        stream(create_controller(file), wanted, gyro, accel, roll_pitch),
        stream(create_controller(file), wanted, gyro, accel, missing),
    )


def test_without_an_attitude_it_says_what_is_missing(file):
    with pytest.raises(ValueError, match="reads an attitude: roll_pitch is required"):
        create_controller(file).update(np.zeros((1, 4)), np.zeros((1, 3)), np.zeros((1, 3)))


def test_an_unknown_reading_in_a_file_is_refused(file):
    content = file.read_bytes()
    assert content.count(b"attitude") == 1
    file.write_bytes(content.replace(b"attitude", b"rotorrpm"))
    with pytest.raises(ValueError, match="another version of quadsim"):
        load_controller(file)


def test_exports_say_that_it_reads_an_attitude(file, tmp_path):
    header = (export_weights(file, tmp_path / "c", "c99") / "snn_control.h").read_text()
    assert "a gyroscope and an estimate of roll and pitch" in header
    assert "This network reads an attitude" in header
    nir = pytest.importorskip("nir")
    assert nir.read(export_weights(file, tmp_path / "c.nir", "nir")).metadata["reads"] in (
        "attitude",
        b"attitude",
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (2, 2), (2,)])
def test_an_attitude_of_another_shape_is_refused(file, shape):
    with pytest.raises(ValueError, match=r"roll_pitch: shape .*, should be \(1, 2\)"):
        create_controller(file).update(np.zeros((1, 4)), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(shape))
    with pytest.raises(ValueError, match="roll_pitch: shape"):
        gravity_of(np.zeros((4, 3)))
