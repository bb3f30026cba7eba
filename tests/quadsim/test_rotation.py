import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadsim.rotation import (
    euler_from_quat,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_from_matrix,
    quat_from_roll_pitch,
    quat_from_rotvec,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_rotate_inverse,
    roll_pitch_from_quat,
    roll_pitch_of_up,
    swap_enu_flu_ned_frd,
    swap_enu_ned,
    swap_flu_frd,
    wxyz_from_xyzw,
    xyzw_from_wxyz,
)

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
SHAPES = pytest.mark.parametrize("shape", [(), (1,), (7,), (3, 2), (0,)])
SPREADS = pytest.mark.parametrize("spread", [3.0, 1e-5, 1e-9, 0.0], ids=["any", "small", "tiny", "identity"])


def sample(shape: tuple[int, ...], spread: float = 3.0, seed: int = 0) -> np.ndarray:
    rotvec = np.random.default_rng(seed).normal(scale=spread, size=(*shape, 3))
    return wxyz_from_xyzw(Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_quat().reshape(*shape, 4))


def vectors(shape: tuple[int, ...], seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, 3))


def of_scipy(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(xyzw_from_wxyz(quat).reshape(-1, 4))


def assert_same_rotation(p: np.ndarray, q: np.ndarray, tolerance: float = 1e-14) -> None:
    """A quaternion and its negative are one rotation."""
    assert p.shape == q.shape
    distance = np.minimum(np.abs(p - q).max(axis=-1), np.abs(p + q).max(axis=-1))
    assert np.all(distance <= tolerance)


@SHAPES
@SPREADS
def test_equations_agree_with_scipy(shape, spread):
    p, q, v = sample(shape, spread), sample(shape, spread, seed=2), vectors(shape)
    product = wxyz_from_xyzw((of_scipy(p) * of_scipy(q)).as_quat().reshape(*shape, 4))
    assert_same_rotation(quat_multiply(p, q), product)
    rotated = quat_rotate(q, v)
    assert rotated == pytest.approx(of_scipy(q).apply(v.reshape(-1, 3)).reshape(v.shape), abs=1e-14)
    assert quat_rotate_inverse(q, rotated) == pytest.approx(v, abs=1e-14)
    assert_same_rotation(quat_multiply(q, quat_conjugate(q)), np.broadcast_to(IDENTITY, q.shape))
    matrix = matrix_from_quat(q)
    assert matrix == pytest.approx(of_scipy(q).as_matrix().reshape(*shape, 3, 3), abs=1e-15)
    assert_same_rotation(quat_from_matrix(matrix), q)
    assert np.all(quat_from_matrix(matrix)[..., 0] >= 0.0)
    turned = Rotation.from_rotvec(spread * v.reshape(-1, 3)).as_quat().reshape(*shape, 4)
    assert_same_rotation(quat_from_rotvec(spread * v), wxyz_from_xyzw(turned))
    euler = euler_from_quat(q)
    expected = of_scipy(q).as_euler("ZYX")[:, ::-1].reshape(*shape, 3)  # intrinsic z-y'-x''
    assert euler == pytest.approx(expected, abs=1e-12)
    assert_same_rotation(quat_from_euler(*np.moveaxis(euler, -1, 0)), q)


@pytest.mark.parametrize("angle", [1e-3, 1.0001e-4, 0.9999e-4, 1e-6])
def test_rotation_vector_is_smooth_where_its_series_takes_over(angle):
    assert quat_from_rotvec([0.0, angle, 0.0])[2] == pytest.approx(np.sin(angle / 2.0), rel=1e-15)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-7, 1e-5])
@pytest.mark.parametrize(("roll", "yaw"), [(0.0, 0.0), (0.4, -1.0), (-2.0, 3.0), (1.0, 1.0)])
def test_euler_angles_near_vertical_are_the_same_rotation(pitch, off, roll, yaw):
    q = quat_from_euler(roll, pitch * (1.0 - off), yaw)
    euler = euler_from_quat(q)
    assert_same_rotation(quat_from_euler(*euler), q, 3e-8)
    assert euler[1] == pytest.approx(pitch, abs=2e-5)


@SHAPES
def test_roll_and_pitch_survive_any_yaw(shape):
    angles = np.random.default_rng(5).uniform(-1.5, 1.5, size=(*shape, 2))
    for yaw in (0.0, 2.5):
        assert roll_pitch_from_quat(quat_from_roll_pitch(angles, yaw)) == pytest.approx(angles, abs=1e-14)
    assert quat_from_roll_pitch(angles).shape == (*shape, 4)


@SHAPES
def test_roll_and_pitch_of_up_are_those_of_the_attitude(shape):
    q = sample(shape)
    up = quat_rotate_inverse(q, np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)))
    for length in (1e-3, 1.0, 500.0):
        assert roll_pitch_of_up(length * up) == pytest.approx(roll_pitch_from_quat(q), abs=1e-14)


def test_no_up_is_level_and_its_opposite_is_upside_down():
    for zeros in np.array(np.meshgrid(*[[0.0, -0.0]] * 3)).reshape(3, -1).T:
        np.testing.assert_array_equal(roll_pitch_of_up(zeros), 0.0)
    np.testing.assert_array_equal(roll_pitch_of_up([0.0, 0.0, -1.0]), [np.pi, 0.0])


def test_arguments_broadcast():
    q, v = sample((5,)), vectors((4, 1))
    assert quat_rotate(q, v).shape == (4, 5, 3)
    assert quat_rotate(q[2], v[1, 0]) == pytest.approx(quat_rotate(q, v)[1, 2])
    assert quat_from_euler(np.zeros(3), 0.1, np.zeros((2, 1))).shape == (2, 3, 4)
    assert quat_normalize(5.0 * q) == pytest.approx(q, abs=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: quat_rotate([1, 0, 0], [0, 0, 1]), r"q has shape \(3,\); .* 4 components"),
        (lambda: quat_rotate([1, 0, 0, 0], [0, 0, 1, 0]), r"v has shape \(4,\); .* 3 components"),
        (lambda: euler_from_quat(1.0), r"shape \(\)"),
        (lambda: quat_normalize([0, 0, 0, 0]), "finite and not zero"),
        (lambda: quat_normalize([np.nan, 0, 0, 0]), "finite and not zero"),
    ],
)
def test_wrong_shapes_and_values_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_component_orders_and_axes_convert():
    assert xyzw_from_wxyz([1, 2, 3, 4]).tolist() == [2, 3, 4, 1]
    assert wxyz_from_xyzw([2, 3, 4, 1]).tolist() == [1, 2, 3, 4]
    assert swap_flu_frd([1, 2, 3]).tolist() == [1, -2, -3]
    assert swap_enu_ned([1, 2, 3]).tolist() == [2, 1, -3]  # east 1, north 2, up 3


@SHAPES
def test_attitude_in_other_frames_moves_the_same_vector_and_swaps_back(shape):
    q, v = sample(shape), vectors(shape)
    moved = quat_rotate(swap_enu_flu_ned_frd(q), swap_flu_frd(v))
    assert moved == pytest.approx(swap_enu_ned(quat_rotate(q, v)), abs=1e-14)
    assert np.array_equal(swap_enu_ned(swap_enu_ned(v)), v)
    assert_same_rotation(swap_enu_flu_ned_frd(swap_enu_flu_ned_frd(q)), q)


def test_facing_north_and_level_is_the_identity_in_ned():
    north = quat_from_euler(0.0, 0.0, np.pi / 2)  # x axis along world y, which is north in ENU
    assert_same_rotation(swap_enu_flu_ned_frd(north), IDENTITY)


angle = st.floats(-1e6, 1e6)


@settings(max_examples=200, deadline=None)
@given(roll=angle, pitch=angle, yaw=angle)
def test_any_angles_make_a_unit_quaternion_and_survive(roll, pitch, yaw):
    q = quat_from_euler(roll, pitch, yaw)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    euler = euler_from_quat(q)
    assert np.isfinite(euler).all()
    assert_same_rotation(quat_from_euler(*euler), q, 3e-8)
    assert abs(euler[1]) <= np.pi / 2


def test_each_euler_angle_turns_about_its_axis_the_right_way():
    assert quat_rotate(quat_from_euler(0.1, 0, 0), [0, 1, 0])[2] > 0.0  # roll lifts the left side
    assert quat_rotate(quat_from_euler(0, 0.1, 0), [1, 0, 0])[2] < 0.0  # pitch lowers the nose
    assert quat_rotate(quat_from_euler(0, 0, 0.1), [1, 0, 0])[1] > 0.0  # yaw turns left
