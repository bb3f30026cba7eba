"""Errors on flights of RotorPy, as pages show them."""

from functools import partial

import numpy as np
import pytest

from estimators import create

pytest.importorskip("rotorpy")


def test_the_truth_has_no_error_and_a_level_guess_none_in_hover(script, tmp_path, monkeypatch):
    from rotorpy.trajectories.hover_traj import HoverTraj
    from rotorpy.wind.default_winds import NoWind

    import scenarios.task.rotorpy_flights as rotorpy

    simulated, errors = script("simulated"), script("errors")
    monkeypatch.setattr(rotorpy, "lissajous", lambda rng: HoverTraj(np.array([0.0, 0.0, 2.0])))
    monkeypatch.setattr(rotorpy, "wind_of", lambda plan, rng: NoWind())
    fly = partial(rotorpy.fly_plan, warmup_s=0.0)
    monkeypatch.setattr(rotorpy, "fly_plan", lambda plan, duration_s: fly(plan, 0.5))
    plan = rotorpy.RotorpyPlan("hummingbird", "lissajous", "dryden", 0.0, 1)
    monkeypatch.setattr(simulated, "PLANS", {"hummingbird": (plan,)})
    made = {name: create(name, 200.0) for name in ("truth", "att-rnn")}
    found = errors.on_flights(lambda vehicle: made, simulated.rotorpy_sets(tmp_path), settle_s=0.1)
    assert found.mean_deg["truth", "unknown"] == 0.0
    cell = errors.with_silenced(found.loc["att-rnn", "unknown"])
    assert cell.endswith("(silenced 0.00)")
    assert float(cell.split()[0]) > 0.0
