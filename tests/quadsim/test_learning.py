"""The environment in Stable-Baselines3, and policies."""

from functools import partial
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from safetensors.numpy import save_file

import quadsim  # noqa: F401  registers the environment
from quadsim.env.policy import Policy, PolicySpec, load_policy, policy_names, save_policy
from quadsim.flight.scenario import Start, changed, load_scenario

ID = "quadsim/Quadrotor-v0"
SHORT = changed(load_scenario("hover"), {"duration_s": 0.1, "start": Start(offset=(0.5, 0.0, 0.0))})


@pytest.fixture(scope="module")
def sb3():
    pytest.importorskip("stable_baselines3")
    from quadsim.env import sb3

    return sb3


@pytest.mark.parametrize("repeat", [1, 5])
def test_a_batch_for_stable_baselines3_flies_as_single_environments_do(sb3, repeat):
    """Actions hold for some samples. The step that ends an episode returns the next one's observation."""
    batch = sb3.SB3VecEnv(3, repeat, estimator="mahony", scenario=SHORT, randomisation={"mass": 0.2})
    batch.seed(5)
    seen = batch.reset()
    single = gymnasium.make(ID, estimator="mahony", scenario=SHORT, randomisation={"mass": 0.2})
    first, _ = single.reset(seed=6)
    np.testing.assert_array_equal(seen[1], first)
    random, done = np.random.default_rng(0), np.zeros(3, bool)
    while not done.any():
        action = random.uniform(-0.01, 0.01, (3, 4))
        seen, earned, done, infos = batch.step(action)
        taken = [single.step(action[1])[:4] for _ in range(repeat)]
        np.testing.assert_allclose(earned[1], np.mean([reward for _, reward, *_ in taken]))
        if not done.any():
            np.testing.assert_array_equal(seen[1], taken[-1][0])
    assert done.all()
    np.testing.assert_array_equal(infos[1]["terminal_observation"], taken[-1][0])
    assert infos[1]["TimeLimit.truncated"]
    np.testing.assert_array_equal(seen[1], single.reset()[0])


def test_a_crash_within_a_step_ends_one_episode_and_the_others_continue(sb3):
    batch = sb3.SB3VecEnv(2, 10, scenario="hover", level="rotor")
    batch.seed(0)
    batch.reset()
    done = np.zeros(2, bool)
    while not done.any():
        _, earned, done, infos = batch.step(np.array([[-1.0] * 4, [0.0] * 4]))
    assert done.tolist() == [True, False]
    assert earned[0] < 0.15 < 0.9 < earned[1] <= 1.1  # a sample more if the crash was in the last
    assert infos[1] == {}
    assert not infos[0]["TimeLimit.truncated"]
    assert infos[0]["cause"] == "hit the ground"
    assert infos[0]["terminal_observation"][2] > 1.5
    assert not batch.batch.actions[0].any()


def test_options_reach_the_next_reset_and_no_other(sb3):
    batch = sb3.SB3VecEnv(2, scenario=SHORT)
    batch.set_options({"wind": (1.0, 2.0, 0.0)})
    batch.reset()
    np.testing.assert_array_equal(batch.batch.mission.air[0], [1.0, 2.0, 0.0])
    batch.set_options({"wind": "x"})
    with pytest.raises(ValueError, match="wind"):
        batch.reset()
    batch.reset()
    assert not batch.batch.mission.air.any()


@pytest.mark.parametrize("repeat", [0, 1.5, True, 10**9])
def test_a_repeat_that_is_no_number_of_samples_is_refused(sb3, repeat):
    with pytest.raises(ValueError, match=f"repeat = {repeat}"):
        sb3.SB3VecEnv(1, repeat)


def test_a_policy_file_acts_as_the_agent_that_it_was_made_of(sb3, tmp_path):
    from stable_baselines3 import A2C, PPO

    batch = sb3.SB3VecEnv(4, 2, scenario=SHORT)
    agent = PPO("MlpPolicy", batch, n_steps=8, batch_size=8, policy_kwargs={"net_arch": [8, 8, 8]})
    agent.learn(32)
    spec = PolicySpec(level="attitude", repeat=2, training={"seed": 0})
    policy = load_policy(save_policy(tmp_path / "p.safetensors", sb3.policy_of(agent, spec)))
    assert policy.spec == spec
    seen = 3.0 * np.random.default_rng(0).normal(size=(50, 17)).astype(np.float32)
    expected, _ = agent.predict(seen, deterministic=True)
    np.testing.assert_allclose(policy(seen), expected, atol=1e-5)
    np.testing.assert_allclose(policy(seen[0]), expected[0], atol=1e-5)
    from torch.nn import ReLU

    with pytest.raises(ValueError, match="layers Linear, ReLU, Linear"):
        sb3.policy_of(A2C("MlpPolicy", batch, policy_kwargs={"net_arch": [4], "activation_fn": ReLU}), spec)


@pytest.mark.parametrize("name", policy_names())
def test_a_policy_that_ships_flies_to_the_set_point_and_stays(name):
    policy = load_policy(name)
    spec = policy.spec
    start = Start(offset=(0.8, -0.6, 0.5), speed=1.0)
    given = {"scenario": changed(load_scenario("hover"), {"start": start}), "duration_s": 8.0}
    batch = gymnasium.make_vec(
        ID, 4, level=spec.level, estimator=spec.estimator, rate_hz=spec.rate_hz, **given
    )
    seen, info = batch.reset(seed=77)
    assert (info["position_cost"] > 1.0).all()
    for step in range(round(8.0 * spec.rate_hz)):
        if step % spec.repeat == 0:
            action = policy(seen)
        seen, _, crashed, _, info = batch.step(action)
        assert not crashed.any()
    assert (info["position_cost"] < 0.2**2).all()


def test_a_policy_that_ships_is_small_and_has_a_card():
    from quadsim.config.toml import shipped_folder

    assert policy_names()
    for name in policy_names():
        file = shipped_folder("policies") / f"{name}.safetensors"
        assert file.stat().st_size < 100_000
        assert file.with_suffix(".md").read_text().startswith(f"# {name}\n")


def layers(*sizes):
    return [(np.ones((b, a), np.float32), np.ones(b, np.float32)) for a, b in pairwise(sizes)]


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        (layers(16, 4), r"weights \(4, 16\); they must be \(4, 17\)"),
        (layers(17, 8) + layers(9, 4), r"weights \(4, 9\); they must be \(4, 8\)"),
        ([(np.full((4, 17), np.nan), np.ones(4))], "not a finite number"),
        ([], "no layers"),
    ],
)
def test_a_network_that_is_no_policy_is_refused(parts, text):
    with pytest.raises(ValueError, match=text):
        Policy(PolicySpec(level="attitude"), parts)


def test_a_file_that_is_no_policy_is_refused_in_one_line(tmp_path):
    with pytest.raises(ValueError, match='unknown policy "hovr"; did you mean "hover"'):
        load_policy("hovr")
    file = tmp_path / "p.safetensors"
    written = [None, *({"policy": text} for text in ('{"level": "x"}', "{}", "[1]", "nonsense"))]
    writes = [partial(save_file, {"a": np.ones(3)}, file, metadata=about) for about in written]
    for write in (lambda: file.write_bytes(b"x" * 50), *writes):
        write()
        with pytest.raises(ValueError, match=r"p.safetensors: not a policy \([^\n]*\)$"):
            load_policy(file)
    with pytest.raises(ValueError, match=r"shape \(3,\); it must be \(..., 17\)"):
        Policy(PolicySpec(level="attitude"), layers(17, 4))(np.zeros(3))


def test_a_specification_that_is_not_valid_is_one_line():
    with pytest.raises(ValueError, match=r'^level = "x": [^\n]*rotor[^\n]*$'):
        PolicySpec(level="x")
