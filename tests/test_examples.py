"""The examples, at a tiny size."""

import csv
import importlib.util
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from controllers import ATTITUDE, CONFIG, random_tensors
from PIL import Image

from estimators.networks.network import real_weights
from estimators.networks.weights_file import Network, load_network, save_network


def example(name):
    pytest.importorskip("stable_baselines3")
    path = Path(__file__).parents[1] / "examples" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def ppo():
    return example("ppo")


@pytest.fixture(scope="module")
def ppo_controller():
    return example("ppo_controller")


def test_ppo_trains_is_judged_and_drawn(ppo, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(ppo, "EPISODES", 2)
    monkeypatch.setattr(ppo, "VEHICLES", 4)
    monkeypatch.setattr(ppo, "DECISIONS", 64)
    ppo.main(["--steps", "512", "--out", str(tmp_path)])
    with (tmp_path / "ppo.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["who"] for row in rows] == [*ppo.BASELINES, "PPO, seed 0", "PPO, seed 0"]
    assert [row["decisions"] for row in rows] == ["0", "0", "0", "512"]
    assert float(rows[1]["return"]) > 2 * float(rows[0]["return"])
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


def test_ppo_changes_the_output_layer_of_a_controller_alone(ppo_controller, capsys, monkeypatch, tmp_path):
    for name, value in {"VEHICLES": 4, "STEPS": 50, "EVERY": 1, "EPISODES": 2, "STEP": 10.0}.items():
        monkeypatch.setattr(ppo_controller, name, value)
    begun = random_tensors()
    save_network(tmp_path / "begun.safetensors", ATTITUDE, begun)
    ppo_controller.main(
        ["--controller", str(tmp_path / "begun.safetensors"), "--updates", "1", "--out", str(tmp_path)]
    )
    tuned = load_network(tmp_path / "tuned.safetensors")
    changed = {name for name, each in tuned.tensors.items() if not np.array_equal(each, begun[name])}
    assert changed == {"w_out"}
    assert tuned.config.reads == "attitude"
    with (tmp_path / "ppo.csv").open() as file:
        assert [row["updates"] for row in csv.DictReader(file)] == ["0", "1"]
    assert "tuned.safetensors" in capsys.readouterr().out


def test_what_the_agent_observes_times_the_output_weights_is_what_the_controller_asks_for(ppo_controller):
    weights = Network(ATTITUDE, random_tensors())
    flights = ppo_controller.Flights(3, 0)
    flights.begin()
    hidden, alone = ppo_controller.Filtered(weights, 3), ppo_controller.Filtered(weights, 3).controller
    alone.reset(3)
    scale = CONFIG.output_scale * real_weights(*weights).w_out
    for _ in range(40):
        arrived, asked = hidden.update(flights.readings), alone.update(*flights.readings)
        bounded = np.clip(arrived @ scale.T, -CONFIG.set_point.bound, CONFIG.set_point.bound)
        np.testing.assert_allclose(asked[:, :3], bounded, atol=0.1)  # integers are truncated
        flights.fly(asked[:, :3])
    assert np.abs(asked[:, :3]).max() > 1.0
