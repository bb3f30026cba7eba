"""The examples, at a tiny size."""

import csv
import importlib.util
from pathlib import Path

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
    with (tmp_path / "ppo.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["who"] for row in rows] == [*ppo.BASELINES, "PPO, seed 0", "PPO, seed 0"]
    assert [row["decisions"] for row in rows] == ["0", "0", "0", "512"]
    assert float(rows[1]["return"]) > 2 * float(rows[0]["return"])
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(rows) + 1
    with Image.open(tmp_path / "ppo.png") as image:
        assert image.size == (880, 440)
    policy = load_policy(tmp_path / "seed-0.safetensors")
    assert policy.spec.training == {"example": "ppo.py", "seed": 0, "steps": 512, "recipe": "control"}
    assert ppo.judge(ppo.scenario_of("control"), policy)[0] == pytest.approx(float(rows[-1]["return"]))
