"""The examples, at a tiny size."""

import importlib.util
from pathlib import Path

import pytest


def test_ppo_trains_and_is_judged(capsys, monkeypatch):
    pytest.importorskip("stable_baselines3")
    spec = importlib.util.spec_from_file_location("ppo", Path(__file__).parents[1] / "examples" / "ppo.py")
    ppo = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(ppo)
    monkeypatch.setattr(ppo, "EPISODES", 1)
    ppo.main(4)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [row[0] for row in rows] == ["none", "loops", "0", "2048"]
    assert float(rows[1][1]) > 2 * float(rows[0][1])
