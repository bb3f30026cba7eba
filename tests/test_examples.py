"""The examples, at a tiny size."""

import importlib.util
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
from PIL import Image


@pytest.fixture(scope="module")
def ppo():
    pytest.importorskip("stable_baselines3")
    path = Path(__file__).parents[1] / "examples" / "ppo.py"
    spec = importlib.util.spec_from_file_location("ppo", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_ppo_trains_is_judged_and_drawn(ppo, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(ppo, "EPISODES", 2)
    monkeypatch.setattr(ppo, "VEHICLES", 4)
    monkeypatch.setattr(ppo, "DECISIONS", 64)
    ppo.main(["--steps", "512", "--out", str(tmp_path)])
    rows = pd.read_csv(tmp_path / "ppo.csv")
    assert rows["who"].tolist() == [*ppo.BASELINES, "PPO, seed 0", "PPO, seed 0"]
    assert rows["decisions"].tolist() == [0, 0, 0, 512]
    assert rows["return"][1] > 2 * rows["return"][0]
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(rows) + 1
    with Image.open(tmp_path / "ppo.png") as image:
        assert image.size == (880, 440)


def test_a_batch_flies_as_single_environments_do(ppo):
    """Actions hold for ten samples. The step that ends an episode returns the next's first observation."""
    batch = ppo.Batch(3)
    batch.seed(5)
    seen = batch.reset()
    single = gymnasium.make(
        "quadsim/Quadrotor-v0", estimator="mahony", scenario=batch.env.unwrapped._scenario
    )
    first, _ = single.reset(seed=6)
    np.testing.assert_array_equal(seen[1], first)
    action = np.random.default_rng(0).uniform(-0.01, 0.01, (3, 4))
    done = np.zeros(3, bool)
    while not done.any():
        seen, earned, done, infos = batch.step(action)
        taken = [single.step(action[1])[:4] for _ in range(ppo.REPEAT)]
        np.testing.assert_allclose(earned[1], np.mean([reward for _, reward, *_ in taken]))
    assert done.all()
    np.testing.assert_array_equal(infos[1]["terminal_observation"], taken[-1][0])
    assert infos[1]["TimeLimit.truncated"]
    np.testing.assert_array_equal(seen[1], single.reset()[0])
