import copy
import pickle
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from environments import ID, make
from gymnasium.utils.env_checker import check_env

import estimators
from quadsim.control.records import LEVELS
from quadsim.env.single import QuadrotorEnv
from quadsim.env.spaces import ACTION_SCALE, OBSERVATION_LIMIT
from quadsim.flight.scenario import Crash, Scenario, Start, changed, load_scenario
from quadsim.pictures.render import Scene
from quadsim.trajectory.specs import Hover
from quadsim.vehicle import Randomisation, load_vehicle

SHORT = Scenario(
    description="",
    duration_s=0.1,
    trajectory=Hover(position=(0.0, 0.0, 2.0)),
    start=Start(known_attitude=True),
)
TILTING = SHORT.model_copy(update={"start": Start(tilt_deg=60.0), "crash": Crash(tilt_deg=50.0)})


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    ("library", "options"),
    [("gymnasium.utils", {"skip_render_check": True}), ("stable_baselines3.common", {})],
)
def test_passes_the_checkers_of_others_at_every_action_level(library, options, level):
    check = pytest.importorskip(f"{library}.env_checker").check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(make(1, estimator="mahony", level=level), **options)


def test_passes_the_checker_with_pictures():
    try:
        Scene(load_vehicle("hummingbird"), width=64, height=64).close()
    except RuntimeError as error:
        pytest.skip(str(error))
    env = gymnasium.make(ID, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=0)
    assert env.render().shape == (540, 960, 3)
    env.close()


def test_zero_action_at_level_position_holds_the_set_point():
    env = gymnasium.make(ID, estimator="mahony", scenario="hover", duration_s=8.0, level="position")
    observation, _ = env.reset(seed=5)
    done = False
    while not done:
        observation, reward, crashed, done, _ = env.step(np.zeros(4))
        assert not crashed
    assert np.linalg.norm(observation[:3]) < 0.1
    assert reward > 0.98


GUSTY = changed(load_scenario("wind-gust"), {"duration_s": 0.1, "start": {"tilt_deg": 20.0}})
HEXAROTOR = changed(GUSTY, {"vehicle": "hexarotor"})
RANDOM = {"mahony": {name: 0.4 for name in Randomisation.model_fields}, "truth": None}


@pytest.mark.parametrize(
    ("name", "scenario", "level", "width"),
    [
        ("truth", GUSTY, "rate", 4),
        ("mahony", GUSTY, "rate", 4),
        ("mahony", HEXAROTOR, "rotor", 6),
        ("mahony", HEXAROTOR, "attitude", 4),
    ],
)
def test_batched_twin_gives_the_numbers_of_single_environments_through_restarts(name, scenario, level, width):
    n, seed = 3, 11
    given = {"estimator": estimators.create(name), "scenario": scenario, "level": level}
    given["randomisation"] = RANDOM[name]
    batch, singles = make(n, **given), [gymnasium.make(ID, **given) for _ in range(n)]
    assert batch.single_action_space.shape == singles[0].action_space.shape == (width,)
    random = np.random.default_rng(0)
    observations, _ = batch.reset(seed=seed)
    expected = np.stack([env.reset(seed=seed + i)[0] for i, env in enumerate(singles)])
    np.testing.assert_array_equal(observations, expected)
    for step in range(50):
        action = random.uniform(-0.5, 0.5, (n, width)).astype(np.float32)
        observations, rewards, _, truncated, info = batch.step(action)
        if step % 21 == 20:  # the step after the 20th is the restart
            expected = [env.reset()[0] for env in singles]
            assert not rewards.any()
        else:
            results = [env.step(a) for env, a in zip(singles, action, strict=True)]
            expected = [result[0] for result in results]
            np.testing.assert_array_equal(rewards, [result[1] for result in results])
            np.testing.assert_array_equal(truncated, [result[3] for result in results])
        np.testing.assert_array_equal(observations, np.stack(expected))
    assert info["rotor_vel"].shape == (n, len(load_vehicle(scenario.vehicle).rotors))


def test_one_vehicle_of_a_batch_restarts_alone():
    batch = make(2, scenario="hover", level="rotor")
    batch.reset(seed=0)
    fall = np.array([[-1.0, -1.0, -1.0, -1.0], [0.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    crashed = np.zeros(2, dtype=bool)
    while not crashed.any():
        _, rewards, crashed, _, info = batch.step(fall)
    assert crashed.tolist() == [True, False]
    assert rewards[0] == 0.0
    assert info["cause"][0] > 0
    observations, _, crashed, truncated, _ = batch.step(fall)
    assert not crashed.any()
    assert not truncated.any()
    np.testing.assert_allclose(observations[0, :3], 0.0, atol=5e-3)  # motion capture is off by 1 mm


def test_a_crash_terminates_with_its_cause():
    env = gymnasium.make(ID, scenario=TILTING)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.zeros(4))
    assert (reward, terminated, truncated, info["cause"]) == (0.0, True, False, "tilted over")


def test_time_truncates_and_only_a_reset_begins_another_episode():
    env = make(1, scenario=SHORT)
    with pytest.raises(ValueError, match="before reset"):
        env.step(np.zeros(4))
    env.reset(seed=0)
    ends = [env.step(np.zeros(4))[2:4] for _ in range(20)]
    assert ends == [(False, False)] * 19 + [(False, True)]
    with pytest.raises(ValueError, match="the episode is over"):
        env.step(np.zeros(4))
    env.reset()
    env.step(np.zeros(4))


def test_observation_never_leaves_its_space():
    env = gymnasium.make(ID, scenario=TILTING.model_copy(update={"duration_s": 5.0}), level="rate")
    env.reset(seed=0)
    for _ in range(200):
        observation, _, crashed, over, _ = env.step(np.ones(4, dtype=np.float32))
        assert env.observation_space.contains(observation)
        if crashed or over:
            env.reset()
    assert OBSERVATION_LIMIT.shape == env.observation_space.shape
    assert set(ACTION_SCALE) == set(LEVELS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"level": "moment"}, 'unknown level "moment"; valid: position, velocity'),
        ({"scenario": "hoover"}, 'unknown scenario "hoover"; did you mean "hover"'),
        ({"render_mode": "ansi"}, "unknown render_mode"),
        ({"estimator": "mahoni"}, 'did you mean "mahony"'),
        ({"scenario": None}, "scenario = None: should be a name, a file or a Scenario"),
        ({"estimator": 3}, "estimator = 3: should be a name"),
        ({"duration_s": 0.0}, "duration_s = 0.0: should be"),
        ({"rate_hz": 1e9}, "rate_hz = 1000000000.0: should be 0.001 to 100000 Hz"),
        ({"estimator": estimators.create("mahony", rate_hz=100.0)}, "runs at 100 Hz and the loop at 200 Hz"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        gymnasium.make(ID, **arguments).reset(seed=0)


SHAPE, REAL, FINITE = "an action has shape", "must be real numbers", "not a finite number"


@pytest.mark.parametrize(
    ("n", "action", "said"),
    [
        *((1, np.zeros(shape), SHAPE + r".*; it must be \(4,") for shape in [(2, 2), (3,), (1, 4), ()]),
        (2, np.zeros((4, 2)), SHAPE + r".*; it must be \(2, 4"),
        *((1, [value] * 4, REAL) for value in (10**400, 1j, np.timedelta64(0, "s"), "0", None)),
        *((1, [0.0, value, 0.0, 0.0], FINITE) for value in (np.nan, np.inf, -np.inf)),
        (3, np.full((3, 4), np.inf), FINITE),
    ],
)
def test_an_action_of_another_shape_or_without_finite_real_numbers_is_refused(n, action, said):
    env = make(n)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        env.step(action)


@pytest.mark.parametrize("seed", [1.5, -1, "a"])
@pytest.mark.parametrize("n", [1, 2])
def test_a_seed_that_is_no_whole_number_is_refused(n, seed):
    env = make(n)
    with pytest.raises(ValueError, match="a whole number from 0 on"):
        env.reset(seed=seed)


def test_a_number_of_environments_is_no_truth_value():
    with pytest.raises(ValueError, match="num_envs = True"):
        gymnasium.make_vec(ID, True)


def test_copies_and_pickles_of_an_environment_are_refused_with_the_reason():
    env = gymnasium.make(ID).unwrapped
    env.reset(seed=0)
    for way in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="make another one with the same arguments"):
            way(env)


INFO = {
    "attitude": (3,), "estimate": (2,), "attitude_error": (), "position": (3,), "velocity": (3,),
    "wind": (3,), "rotor_vel": (4,), "position_cost": (), "velocity_cost": (),
}  # fmt: skip


def test_information_holds_the_truth_the_estimate_and_the_terms_of_the_reward():
    env = gymnasium.make(ID, estimator="mahony", scenario="wind-5", level="position").unwrapped
    _, first = env.reset(seed=1)
    assert {key: np.shape(value) for key, value in first.items()} == INFO
    info = first
    for _ in range(200):
        for key in ("position", "velocity", "attitude", "rotor_vel"):
            info[key][:] = 1e6  # an agent has copies
        observation, reward, _, _, info = env.step(np.zeros(4))
    np.testing.assert_allclose(observation[9:11], info["estimate"], atol=1e-6)
    assert info["attitude_error"] == pytest.approx(np.abs(info["attitude"][:2] - info["estimate"]).mean())
    assert reward == pytest.approx(1 / (1 + info["position_cost"] + info["velocity_cost"]))
    assert np.linalg.norm(info["wind"]) == pytest.approx(5.0)


def test_information_of_a_batch_has_a_row_and_a_mask_for_every_vehicle():
    _, info = make(3).reset(seed=0)
    _, one = make(1).reset(seed=2)
    assert set(info) == {*INFO, *(f"_{key}" for key in INFO)}
    for key, shape in INFO.items():
        assert info[key].shape == (3, *shape)
        assert info[f"_{key}"].all()
        np.testing.assert_array_equal(info[key][2], one[key])


def test_an_action_means_the_speeds_of_the_vehicle_that_flies():
    """Also after a reset to another vehicle with as many rotors."""
    other = changed(load_scenario("hover"), {"vehicle": "crazyflie"})
    moved, made = (QuadrotorEnv(None, each, level="rotor") for each in ("hover", other))
    moved.reset(seed=0)
    moved.reset(seed=np.int64(1), options={"scenario": other})
    made.reset(seed=1)
    for _ in range(3):
        ours, theirs = (env.step(np.full(4, 0.5))[0] for env in (moved, made))
    np.testing.assert_array_equal(ours, theirs)


def test_reset_flies_another_scenario_or_wind_until_the_next_reset():
    env = gymnasium.make(ID, scenario="hover", level="position")
    _, before = env.reset(seed=3)
    env.reset(seed=3, options={"scenario": "step", "wind": (4.0, 0.0, 0.0)})
    np.testing.assert_array_equal(env.step(np.zeros(4))[4]["wind"], [4.0, 0.0, 0.0])
    _, after = env.reset(seed=3)
    for key in INFO:
        np.testing.assert_array_equal(before[key], after[key])


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"scenarios": "hover"}, 'no option "scenarios"; did you mean "scenario"'),
        ({"scenario": "hovr"}, 'unknown scenario "hovr"; did you mean "hover"'),
        ({"scenario": 3}, "should be a name"),
        ({"wind": 4.0}, r"shape \(\)"),
        ({"wind": "x"}, r"wind = 'x': should be three numbers \[m/s\]"),
        ({"wind": (1e9, 0, 0)}, "wind"),
        *((each, "a dictionary is allowed") for each in ([1], "hover", 3)),
    ],
)
def test_a_wrong_option_is_named_and_the_environment_lives_on(options, text):
    env = gymnasium.make(ID, scenario="hover").unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=text):
        env.reset(options=options)
    env.reset(seed=0)
    env.step(np.zeros(4))


@pytest.mark.parametrize("n", [1, 2])
def test_pictures_of_every_step_play_in_real_time(n):
    assert make(n, rate_hz=100.0).metadata["render_fps"] == 100.0


def test_a_controller_of_ones_own_flies_in_the_environment():
    make = f"{Path(__file__).parents[2] / 'examples' / 'my_controller.py'}:make"
    env = gymnasium.make(ID, scenario="hover", level="position", controller=make)
    env.reset(seed=0)
    for _ in range(400):
        _, reward, over, *_ = env.step(np.zeros(4))
    assert not over
    assert reward > 0.9
    with pytest.raises(ValueError, match="below the attitude controller"):
        gymnasium.make(ID, level="rate", controller=make)
