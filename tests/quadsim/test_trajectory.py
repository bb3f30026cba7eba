import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadsim.trajectory.reference import reference
from quadsim.trajectory.specs import Lissajous, Mix, Move, OwnFunction, Step, Waypoints
from quadsim.vehicle import GRAVITY

RATE = 200.0
EIGHTS = Mix(eight_share=1.0, circle_share=0.0, pause_share=0.0)
SMOOTH = [Mix(cruise_share=0.5), Lissajous(), Move(), Waypoints(), Mix(), EIGHTS]


def fly(spec, seconds=60.0, n=2, seed=0):
    return reference(spec, int(seconds * RATE), RATE, np.random.SeedSequence(seed).spawn(n))


def tilt_deg(path):
    acceleration = path["acceleration"] + [0, 0, GRAVITY]
    return np.degrees(np.arctan2(np.linalg.norm(acceleration[..., :2], axis=-1), acceleration[..., 2]))


@pytest.mark.parametrize("spec", SMOOTH, ids=lambda spec: spec.kind)
def test_velocity_and_acceleration_are_the_derivatives_of_position(spec):
    path = fly(spec)
    middle = path[:, 1:-1]
    slope, bend = (np.gradient(path[name], 1 / RATE, axis=1)[:, 1:-1] for name in ("position", "velocity"))
    assert slope == pytest.approx(middle["velocity"], abs=2e-3)
    assert bend == pytest.approx(middle["acceleration"], abs=2e-2)


def test_yaw_rate_is_the_derivative_of_yaw():
    path = fly(Mix())
    slope = np.gradient(path["yaw"], 1 / RATE, axis=1)[:, 1:-1]
    assert slope == pytest.approx(path["yaw_rate"][:, 1:-1], abs=1e-3)


def test_mix_fills_the_envelope_to_45_degrees():
    """Roll and pitch of the reference spread over about 0.25 rad, the paper's distribution."""
    path = fly(Mix(), seconds=200, n=8)
    per_axis = np.sqrt(np.mean(np.radians(tilt_deg(path)) ** 2) / 2)
    assert 0.2 < per_axis < 0.3
    assert np.percentile(tilt_deg(path), 99.8) > 41
    assert 44 < tilt_deg(path).max() <= 45
    assert path["position"][..., 2].min() > 5


def test_eights_sweep_twice_across_for_once_along_and_keep_to_the_largest_tilt():
    path = fly(EIGHTS, seconds=200, n=8)
    assert 40 < tilt_deg(path).max() <= 45
    one = fly(EIGHTS.model_copy(update={"eight_s": (4.0, 4.0)}), seconds=12, n=4)["position"][..., :2]
    lap = one[:, int(4 * RATE) : int(8 * RATE)]  # the window is open in the middle of the shortest
    spectrum = np.abs(np.fft.rfft(lap - lap.mean(1, keepdims=True), axis=1)) ** 2
    assert spectrum[:, 1:3].sum() > 0.99 * spectrum.sum()


def test_cruises_hold_a_constant_velocity_between_two_ramps():
    shares = {"cruise_share": 1.0, "circle_share": 0.0, "pause_share": 0.0}
    path = fly(Mix(**shares, cruise_s=(3.0, 3.0), cruise_speed=(4.0, 6.0)), seconds=60, n=4)
    speed = np.linalg.norm(path["velocity"], axis=-1)
    steady = np.linalg.norm(path["acceleration"], axis=-1) < 1e-9
    assert np.all((speed[steady] < 1e-9) | ((speed[steady] > 3.99) & (speed[steady] < 6.01)))
    assert 0.3 < np.mean(steady & (speed > 1.0)) < 0.9
    assert tilt_deg(path).max() <= 45
    away = np.linalg.norm(path["position"][..., :2], axis=-1)
    assert away.max() < 15 + 6 * 6 + 1  # beyond 15 m they lead back


def test_minimum_snap_passes_the_waypoints_and_rests_at_both_ends():
    points = ((0.0, 0.0, 2.0), (3.0, 0.0, 2.0), (3.0, 3.0, 3.0), (0.0, 3.0, 2.0), (0.0, 0.0, 2.0))
    path = fly(Waypoints(points=points), seconds=40)[0]
    assert [*path["velocity"][0], *path["acceleration"][0]] == pytest.approx([0.0] * 6, abs=1e-9)
    assert path["acceleration"][1] == pytest.approx([0.0] * 3, abs=2e-3)  # nor a jerk
    for point in points:
        assert np.linalg.norm(path["position"] - point, axis=-1).min() < 0.05


def test_step_goes_there_and_back():
    path = fly(Step(offset=(2.0, 0.0, 0.0), at_s=1.0, hold_s=3.0), seconds=8)[0]
    assert path["position"][int(0.9 * RATE), 0] == 0
    assert path["position"][int(2.0 * RATE), 0] == 2
    assert path["position"][int(4.5 * RATE), 0] == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.floats(1, 55), *[st.floats(0, 1)] * 3, st.floats(0, 3))
def test_no_draw_makes_a_reference_that_is_not_finite(seed, tilt, circles, pauses, cruises, yaw_rate):
    rest = (1.0 - circles) * pauses
    shares = {"circle_share": circles, "pause_share": rest, "cruise_share": (1.0 - circles - rest) * cruises}
    spec = Mix(max_tilt_deg=tilt, max_yaw_rate=yaw_rate, **shares)
    path = fly(spec, seconds=20, n=1, seed=seed)
    assert np.all(np.isfinite(path.view(np.float64)))
    assert np.abs(path["yaw_rate"]).max() <= yaw_rate + 1e-9


def test_move_goes_from_rest_to_rest_and_stays():
    path = fly(Move(position=(1.0, 0.0, 0.0), offset=(0.0, 2.0, 3.0), at_s=1.0, length_s=2.0), 5.0)[0]
    np.testing.assert_array_equal(path["position"][:200], [[1.0, 0.0, 0.0]] * 200)
    np.testing.assert_allclose(path["position"][600:], [[1.0, 2.0, 3.0]] * 400)
    np.testing.assert_allclose(path["velocity"][[200, 600]], 0.0, atol=1e-9)
    np.testing.assert_allclose(path["acceleration"][[200, 600]], 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["dash_s", "circle_s", "eight_s", "jump_m", "pause_s"])
def test_a_range_that_runs_backwards_is_refused(name):
    with pytest.raises(ValueError, match="least and then the largest"):
        Mix(**{name: (3.0, 1.0)})


FLY = """
import numpy as np

def fly(t):
    return np.column_stack([np.cos(t), np.sin(t), 2.0 + 0 * t, t])

def short(t):
    return np.zeros(3)

def fast(t):
    return np.full((t.size, 3), 1e300)

def broken(t):
    return t["x"]
"""


@pytest.fixture
def functions(tmp_path):
    path = tmp_path / "fly.py"
    path.write_text(FLY)
    return path


def test_a_function_of_ones_own_is_flown_with_its_derivatives(functions):
    flown = fly(OwnFunction(function=f"{functions}:fly"), seconds=6)[0]
    t = np.arange(flown.size) / RATE
    middle = slice(200, -200)  # the spline is at rest at its ends
    wanted = np.column_stack([-np.sin(t), np.cos(t), 0 * t])
    np.testing.assert_allclose(flown["position"][:, :2], np.column_stack([np.cos(t), np.sin(t)]), atol=1e-9)
    np.testing.assert_allclose(flown["velocity"][middle], wanted[middle], atol=1e-6)
    np.testing.assert_allclose(flown["yaw_rate"][middle], 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "text"),
    [("short", r"shape \(3,\)"), ("fast", "z|x|y"), ("broken", "IndexError"), ("none", "has no none")],
)
def test_a_function_that_fails_is_named(functions, name, text):
    with pytest.raises(ValueError, match=text) as error:
        fly(OwnFunction(function=f"{functions}:{name}"))
    assert "\n" not in str(error.value)
