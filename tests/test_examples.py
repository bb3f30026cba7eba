"""The examples, at a tiny size."""

import importlib.util
from pathlib import Path

import pandas as pd
import pytest
from PIL import Image

from quadsim.env.policy import load_policy


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
    ppo.main(["--steps", "512", "--recipe", "control", "--out", str(tmp_path)])
    rows = pd.read_csv(tmp_path / "ppo.csv")
    assert rows["who"].tolist() == [*ppo.BASELINES, "PPO, seed 0", "PPO, seed 0"]
    assert rows["decisions"].tolist() == [0, 0, 0, 512]
    assert rows["return"][1] > 2 * rows["return"][0]
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(rows) + 1
    with Image.open(tmp_path / "ppo.png") as image:
        assert image.size == (880, 440)
    policy = load_policy(tmp_path / "seed-0.safetensors")
    assert policy.spec.training == {"example": "ppo.py", "seed": 0, "steps": 512, "recipe": "control"}
    assert ppo.judge(ppo.scenario_of("control"), policy)[0] == pytest.approx(rows["return"].iloc[-1])
