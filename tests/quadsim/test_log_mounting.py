"""How an IMU sits in the body: every way of writing it is the same rotation, and logs become the body's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadsim.logs import read_recording
from quadsim.logs.mounting import mount_matrix, mount_text, mounted
from quadsim.logs.recording import Recording
from quadsim.rotation import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)

GRAVITY = np.array([0.0, 0.0, 9.81])
EULER_DEG = (10.0, -20.0, 130.0)
BODY_FROM_IMU = Rotation.from_euler("ZYX", EULER_DEG[::-1], degrees=True).as_matrix()


def test_angles_a_quaternion_a_matrix_and_numbers_are_the_same_rotation():
    x, y, z, w = Rotation.from_matrix(BODY_FROM_IMU).as_quat()
    for written in (
        "rpy 10 -20 130",
        "rpy 10, -20, 130",
        f"{w} {x} {y} {z}",
        (w, x, y, z),
        BODY_FROM_IMU.tolist(),
        " ".join(str(each) for each in BODY_FROM_IMU.ravel()),
    ):
        np.testing.assert_allclose(mount_matrix(written), BODY_FROM_IMU, atol=1e-12)


def test_axes_are_rows_and_a_pitch_of_90_degrees_has_its_x_axis_down():
    np.testing.assert_array_equal(mount_matrix("z,-y,x") @ [1.0, 2.0, 3.0], [3.0, -2.0, 1.0])
    np.testing.assert_allclose(mount_matrix("rpy 0 90 0") @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], atol=1e-12)


def test_a_matrix_of_rounded_numbers_is_made_a_rotation():
    matrix = mount_matrix(np.round(BODY_FROM_IMU, 3).tolist())
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix, BODY_FROM_IMU, atol=1e-3)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=50, deadline=None)
def test_what_is_printed_is_read_back_to_a_hundredth_of_a_degree(q):
    matrix = mount_matrix(tuple(np.array(q) / np.linalg.norm(q)))
    again = mount_matrix(mount_text(matrix))
    assert np.degrees(Rotation.from_matrix(again @ matrix.T).magnitude()) < 0.02


def test_permutations_of_axes_are_printed_as_axes():
    for written in ("z,-y,x", "x,y,z", "-x,-y,z"):
        assert mount_text(mount_matrix(written)) == written


@pytest.mark.parametrize(
    ("mount", "message"),
    [
        ("z,y,x", "mirror image"),
        ("x,x,z", "three different axes"),
        ("x,y", "three different axes"),
        ("roll 20", "should be body axes as IMU axes"),
        ("", "should be body axes as IMU axes"),
        ("rpy 0 20", "roll, pitch and yaw"),
        ("rpy 0 nan 0", "roll, pitch and yaw"),
        ("0 20 90", "3 numbers"),
        ("1 1 0 0", "a quaternion of length 1.41"),
        ("nan 0 0 0", "a quaternion of length nan"),
        ("1 0 0 0 1 0 0 0 -1", "mirror image"),
        ("1 0 0 0 1 0 0 0.5 1", "no rotation"),
        ("1 0 0 0 1 0 0 0 inf", "no rotation"),
    ],
)
def test_what_is_no_rotation_is_one_line(mount, message):
    with pytest.raises(ValueError, match=message) as error:
        mount_matrix(mount)
    assert "\n" not in str(error.value)


COLUMNS = 'file = "x.csv"\n'
TABLES = """
time = {column = "t"}
gyro = {columns = ["p", "q", "r"]}
accel = {columns = ["x", "y", "z"]}
quat = {columns = ["a", "b", "c", "d"]}
"""


def tilting(seconds: float = 10.0) -> tuple[np.ndarray, ...]:
    """Time, body rates, specific force and attitude of a body that rolls, pitches and yaws about hover."""
    time = np.arange(round(seconds * 200)) / 200
    quat = quat_from_euler(0.3 * np.sin(2 * time), 0.2 * np.sin(3 * time), 0.4 * time)
    turn = quat_multiply(quat_conjugate(quat[:-1]), quat[1:])
    rate = np.concatenate([2 * turn[:, 1:] * 200, [[0.0, 0.0, 0.4]]])
    return time, rate, quat_rotate_inverse(quat, GRAVITY), quat


@pytest.mark.parametrize("truth_axes", ["body", "imu"])
def test_a_mount_rotates_the_attitude_only_where_it_is_the_imus(truth_axes):
    time, gyro, accel, quat = tilting()
    recorded = quat
    if truth_axes == "imu":
        recorded = quat_multiply(quat, quat_from_matrix(BODY_FROM_IMU))
    log = mounted(
        Recording(
            "x", "x", time, gyro @ BODY_FROM_IMU, accel @ BODY_FROM_IMU, "x", time, recorded, truth_axes
        ),
        "rpy 10 -20 130",
    )
    np.testing.assert_allclose(log.gyro, gyro, atol=1e-12)
    np.testing.assert_allclose(matrix_from_quat(log.quat), matrix_from_quat(quat), atol=1e-12)
    np.testing.assert_allclose(quat_rotate(log.quat, log.accel), np.tile(GRAVITY, (len(time), 1)), atol=1e-9)


@pytest.mark.parametrize(
    "written", ['"rpy 10 -20 130"', str(np.round(BODY_FROM_IMU, 9).tolist()), None], ids=str
)
def test_a_column_map_takes_any_mount(tmp_path, written):
    time, gyro, accel, quat = tilting(2.0)
    rows = np.column_stack([time, gyro @ BODY_FROM_IMU, accel @ BODY_FROM_IMU, quat])
    np.savetxt(tmp_path / "x.csv", rows, "%.12g", delimiter=",", header="t,p,q,r,x,y,z,a,b,c,d", comments="")
    (tmp_path / "x.toml").write_text(COLUMNS + ("" if written is None else f"mount = {written}\n") + TABLES)
    log = read_recording(tmp_path / "x.toml", mount="rpy 10 -20 130" if written is None else None)
    np.testing.assert_allclose(log.gyro, gyro, atol=1e-7)
    np.testing.assert_allclose(log.accel, accel, atol=1e-7)
    np.testing.assert_allclose(log.quat, quat, atol=1e-9)


def test_a_column_map_whose_mount_is_no_rotation_is_one_line(tmp_path):
    (tmp_path / "x.toml").write_text(f'{COLUMNS}mount = "z,y,x"\n{TABLES}')
    with pytest.raises(ValueError, match="mirror image") as error:
        read_recording(tmp_path / "x.toml")
    assert "\n" not in str(error.value)
