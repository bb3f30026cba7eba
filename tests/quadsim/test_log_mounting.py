"""How an IMU sits in the body: every way of writing it is the same rotation, and logs become the body's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sensor import GRAVITY, readings, reported, write_csv

from quadsim.logs import read_recording
from quadsim.logs.log_report import UNSCORED
from quadsim.logs.mounting import MountEstimate, estimate_mount
from quadsim.logs.recording import OWN_ESTIMATE, Recording, mount_matrix, mount_text, mounted
from quadsim.logs.resample import resample
from quadsim.rotation import (
    matrix_from_quat,
    quat_from_euler,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
)

EVALUATE = ("evaluate", "--estimator", "mahony", "--out", "out")
EULER_DEG = (10.0, -20.0, 130.0)
BODY_FROM_IMU = Rotation.from_euler("ZYX", EULER_DEG[::-1], degrees=True).as_matrix()


def test_angles_a_quaternion_a_matrix_and_numbers_are_the_same_rotation():
    x, y, z, w = Rotation.from_matrix(BODY_FROM_IMU).as_quat()
    for written in (
        "rpy 10 -20 130",
        "rpy 10, -20, 130",
        f"{w} {x} {y} {z}",
        " ".join(str(each) for each in BODY_FROM_IMU.ravel()),
    ):
        np.testing.assert_allclose(mount_matrix(written), BODY_FROM_IMU, atol=1e-12)


def test_axes_are_rows_and_a_pitch_of_90_degrees_has_its_x_axis_down():
    np.testing.assert_array_equal(mount_matrix("z,-y,x") @ [1.0, 2.0, 3.0], [3.0, -2.0, 1.0])
    np.testing.assert_allclose(mount_matrix("rpy 0 90 0") @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], atol=1e-12)


def test_a_matrix_of_rounded_numbers_is_made_a_rotation():
    matrix = mount_matrix(" ".join(f"{each:.3f}" for each in BODY_FROM_IMU.ravel()))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix, BODY_FROM_IMU, atol=1e-3)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=50, deadline=None)
def test_what_is_printed_is_read_back_to_a_hundredth_of_a_degree(q):
    matrix = matrix_from_quat(np.array(q) / np.linalg.norm(q))
    again = mount_matrix(mount_text(matrix))
    assert np.degrees(Rotation.from_matrix(again @ matrix.T).magnitude()) < 0.02


def test_permutations_of_axes_are_printed_as_axes():
    for written in ("z,-y,x", "x,y,z", "-x,-y,z"):
        assert mount_text(mount_matrix(written)) == written


@pytest.mark.parametrize(
    ("mount", "message"),
    [
        ("z,y,x", "no rotation"),
        ("x,x,z", "no rotation"),
        ("x,y", "should be body axes as IMU axes"),
        ("rpy 0 nan 0", "should be body axes as IMU axes"),
        ("0 20 90", "should be body axes as IMU axes"),
        ("1 1 0 0", "a quaternion of length 1.41"),
        ("nan 0 0 0", "a quaternion of length nan"),
        ("1 0 0 0 1 0 0 0 -1", "no rotation"),
        ("1 0 0 0 1 0 0 0.5 1", "no rotation"),
        ("1 0 0 0 1 0 0 0 inf", "no rotation"),
    ],
)
def test_what_is_no_rotation_is_one_line(mount, message):
    with pytest.raises(ValueError, match=message):
        mount_matrix(mount)


def tilting(seconds: float = 10.0) -> tuple[np.ndarray, ...]:
    """Time, body rates, specific force and attitude of a body that rolls, pitches and yaws about hover."""
    time = np.arange(round(seconds * 200)) / 200
    return time, *readings(time, 0.3 * np.sin(2 * time), 0.2 * np.sin(3 * time), 0.4 * time)


@pytest.mark.parametrize("truth_axes", ["body", "imu"])
def test_a_mount_rotates_the_attitude_only_where_it_is_the_imus(truth_axes):
    time, gyro, accel, quat = tilting()
    seen = quat_multiply(quat, quat_from_matrix(BODY_FROM_IMU)) if truth_axes == "imu" else quat
    turned = gyro @ BODY_FROM_IMU, accel @ BODY_FROM_IMU
    log = mounted(Recording("x", "x", time, *turned, "x", time, seen, truth_axes), BODY_FROM_IMU)
    np.testing.assert_allclose(log.gyro, gyro, atol=1e-12)
    np.testing.assert_allclose(matrix_from_quat(log.quat), matrix_from_quat(quat), atol=1e-12)
    np.testing.assert_allclose(quat_rotate(log.quat, log.accel), np.tile(GRAVITY, (len(time), 1)), atol=1e-9)


@pytest.mark.parametrize(
    "written", ["rpy 10 -20 130", " ".join(f"{each:.9f}" for each in BODY_FROM_IMU.ravel()), None], ids=str
)
def test_a_column_map_takes_any_mount(tmp_path, written):
    time, gyro, accel, quat = tilting(2.0)
    log = Recording("x", "x", time, gyro @ BODY_FROM_IMU, accel @ BODY_FROM_IMU, quat=quat)
    path = write_csv(tmp_path, log, "" if written is None else f'mount = "{written}"')
    log = read_recording(path, mount="rpy 10 -20 130" if written is None else None)
    np.testing.assert_allclose(log.gyro, gyro, atol=1e-7)
    np.testing.assert_allclose(log.accel, accel, atol=1e-7)
    np.testing.assert_allclose(log.quat, quat, atol=1e-9)


def recorded(make_flights, truth_axes="body", seed=0, noise=0.003, late_s=0.02):
    """A flight whose IMU is mounted at `EULER_DEG`, with a noisy, delayed truth of the body or of the IMU."""
    flight = make_flights(1, 20.0, seed=seed)
    gyro, accel, quat = (flight[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    time = np.arange(len(gyro)) / 200
    shake = quat_from_rotvec(np.random.default_rng(seed).normal(0.0, noise, gyro.shape))
    truth = quat_multiply(quat, shake)
    truth = quat_multiply(truth, quat_from_matrix(BODY_FROM_IMU)) if truth_axes == "imu" else truth
    turned = gyro @ BODY_FROM_IMU, accel @ BODY_FROM_IMU
    return Recording("x", "test", time, *turned, "mocap", time + late_s, truth, truth_axes)


def without_truth(table):
    """Remove the attitude from a column map."""
    table.write_text("".join(x for x in table.read_text().splitlines(True) if not x.startswith("quat")))


def estimate(log: Recording, given: str | None = None) -> MountEstimate:
    return estimate_mount(resample(log)[0], given)


def test_the_mounting_is_estimated_from_a_late_truth_within_its_uncertainty(make_flights):
    errors = []
    for seed in range(2):
        found = estimate(recorded(make_flights, seed=seed))
        off = Rotation.from_matrix(found.body_from_imu @ BODY_FROM_IMU.T).as_rotvec(degrees=True)
        errors.append(off / found.sd_deg)
        assert max(found.sd_deg) < 0.5
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_a_truth_of_the_imus_own_axes_says_nothing_of_the_mounting(make_flights):
    found = estimate(recorded(make_flights, "imu"))
    assert found.by == "the mean force of 20 s in motion"
    up = found.body_from_imu @ BODY_FROM_IMU.T @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(up[2])) < 3 * found.sd_deg[0]
    assert found.sd_deg[2] == np.inf


def test_a_hover_gives_roll_and_pitch_and_a_given_mount_the_heading():
    still = np.tile(GRAVITY @ BODY_FROM_IMU, (2000, 1))
    log = Recording("x", "test", np.arange(2000) / 200, 0 * still, still)
    found = estimate(log)
    np.testing.assert_allclose(found.body_from_imu, mount_matrix("rpy 10 -20 0"), atol=1e-9)
    assert found.by == "the mean force of 10 s of hover"
    given = "rpy 0 0 130"
    refined = estimate(mounted(log, mount_matrix(given)), given)
    np.testing.assert_allclose(refined.body_from_imu @ still[0], GRAVITY, atol=1e-9)
    turned = Rotation.from_matrix(refined.body_from_imu @ BODY_FROM_IMU.T)
    assert np.degrees(turned.magnitude()) < 15.0


def test_a_log_that_turns_about_one_axis_alone_gives_no_mounting():
    time = np.arange(4000) / 200
    rate = np.stack([np.zeros(4000), np.zeros(4000), np.cos(time)], axis=1)
    quat = quat_from_euler(0.0, 0.0, np.sin(time))
    noise = np.random.default_rng(0).normal(0.0, 0.005, rate.shape)
    log = Recording("x", "test", time, rate + noise, np.tile(GRAVITY, (4000, 1)), "mocap", time, quat)
    with pytest.raises(ValueError, match="the truth has to turn about two axes"):
        estimate(log)
    with pytest.raises(ValueError, match="turn too little together"):
        estimate(replace(log, gyro=noise, quat=quat[:1] + 0 * quat))


@pytest.mark.parametrize("truth", ["body", "none"])
def test_the_command_that_a_tilted_log_names_prints_the_mount_that_mends_it(
    tmp_path, make_flights, truth, printed
):
    path = write_csv(tmp_path, recorded(make_flights, late_s=0.0))
    if truth == "none":
        without_truth(tmp_path / "x.toml")
    odd = reported(path)[1].warnings
    assert any(f"quadsim report {path} --find-mount best" in line for line in odd)
    mount = printed("report", path, "--find-mount", "best").split('--mount "')[1].split('"')[0]
    log, report = reported(path, mount=mount)
    assert [line for line in report.warnings if line != UNSCORED] == []
    tilt = np.abs(log["accel"].to_numpy()[0].mean(axis=0)[:2])
    assert tilt.max() < 1.0


@pytest.mark.parametrize("truth_axes", ["imu", "none"])
def test_a_log_that_is_far_from_level_names_its_mount_and_the_command(
    tmp_path, make_flights, truth_axes, printed, refused
):
    flight = recorded(make_flights, "imu", noise=0.0, late_s=0.0)
    upright = mounted(flight, mount_matrix("rpy 10 -20 130"))
    path = write_csv(tmp_path, mounted(upright, mount_matrix("rpy 0 -90 0")), 'truth_axes = "imu"')
    if truth_axes == "none":
        without_truth(tmp_path / "x.toml")
    said = refused(*EVALUATE, "--logs", path)
    assert f"`quadsim report {path} --find-mount best` estimates" in said
    mount = said.split('--mount "')[1].split('"')[0]
    found = Rotation.from_matrix(mount_matrix(mount)) * Rotation.from_euler("y", -90, degrees=True)
    assert np.degrees(np.arccos(found.as_matrix()[2, 2])) < 5.0
    printed(*EVALUATE, "--logs", path, "--mount", mount)


@pytest.mark.parametrize("truth_axes", ["body", "imu"])
def test_only_a_truth_of_the_body_asks_for_a_mount_before_the_table(
    tmp_path, make_flights, truth_axes, printed
):
    path = write_csv(tmp_path, recorded(make_flights, truth_axes), f'truth_axes = "{truth_axes}"')
    before, _, _ = printed(*EVALUATE, "--logs", path, "--force").partition("Inclination RMSE")
    assert (f"`quadsim report {path} --find-mount best` estimates" in before) == (truth_axes == "body")


def test_a_truth_that_is_an_estimate_of_the_log_s_own_is_said():
    time, gyro, accel, quat = tilting()
    log = Recording("x", "x", time, gyro, accel).with_truth(
        f"ATT: the autopilot's {OWN_ESTIMATE}", time, quat
    )
    assert resample(log)[1].warnings == [f"{log.truth}: errors are differences from that estimate"]
    assert resample(replace(log, truth="motion capture"))[1].warnings == []


def test_a_heading_of_the_mounting_that_gravity_does_not_show_is_said(make_flights):
    upright = mounted(recorded(make_flights, late_s=0.0), BODY_FROM_IMU)
    assert resample(upright)[1].warnings == []
    turned = resample(mounted(upright, mount_matrix("rpy 0 0 20")))[1].warnings
    assert any("rotated by 20° does" in line for line in turned)
