"""The verdict of a designed benchmark: a clause for each condition; the whole suite recommends."""

from dataclasses import replace

from flown import benchmark, crash

from scenarios.bench.experiment import load_experiment
from scenarios.bench.recommendation import recommendation
from scenarios.bench.verdict import verdict

AXES = load_experiment("axes")
DRAG = list(AXES.axes["drag"])


def designed(outcomes, experiment=AXES, **options):
    first = {axis: next(iter(levels)) for axis, levels in AXES.axes.items()} | {"scenario": "hover"}
    levels = {f"axes-{k}": first | {"drag": level} for k, level in enumerate(DRAG)}
    flown = {name: dict(zip(levels, own, strict=True)) for name, own in outcomes.items()}
    return benchmark(flown, experiment=experiment, levels=levels, **options)


def test_the_headline_has_a_clause_for_each_condition():
    good, poor = [1.0, 1.1, 1.0, 1.1], [3.0, 3.1, 3.0, 3.1]
    found = verdict(designed({"drag": [good, poor, poor, "no vehicle"], "imm": [poor, good, good, good]}))
    assert found.headline == (
        "On these 4 combinations, fly drag where the airframe's drag is known, imm where it is half or twice "
        "that, imm where it is not known."
    )
    assert found.lines[:3] == [
        "With the airframe's drag known: fly drag (no crash in 4 flights, error 1.05°).",
        "With drag that is half or twice what is known: fly imm (no crash in 8 flights, error 1.05°).",
        "On an airframe whose drag is not known: fly imm, the only one that ran "
        "(no crash in 4 flights, error 1.05°).",
    ]
    assert found.lines[-1] == recommendation().elsewhere
    alone = verdict(designed({"imm": [good] * 4, "vqf": [poor] * 4}))
    assert alone.headline == (
        "On these 4 combinations, fly imm, whether the airframe's drag is known or not (no crash in 16 "
        "flights)."
    )
    at_worst = verdict(designed({"drag": [good, poor, poor, good], "imm": [good] * 4})).standings[1]
    assert at_worst.texts["at worst"] == "drag: half of what is known, 3.05°"


def test_the_headline_names_what_is_recommended_on_every_condition_with_its_crashes():
    good, close, poor = [1.0, 1.1, 1.0, 1.1], [1.1, 1.0, 1.1, 1.0], [3.0, 3.1, 3.0, 3.1]
    one_lost = [1.0, crash(5.0), 1.0, 1.1]
    drag, imm = [one_lost, poor, poor, poor], [one_lost, good, good, good]
    found = verdict(designed({"drag": drag, "imm": imm, "vqf": [poor] * 4}))
    assert found.lines[0].startswith("With the airframe's drag known: fly vqf (no crash")
    assert "fly vqf where the airframe's drag is known, imm where it is half" in found.headline
    found = verdict(designed({"drag": [one_lost, close, poor, poor], "imm": imm}))
    assert found.lines[0].startswith("With the airframe's drag known: fly drag or imm (crashed in 1 of 4")
    assert found.headline == (
        "On these 4 combinations, fly imm, whether the airframe's drag is known or not (crashed in 1 of 16 "
        "flights)."
    )


def test_no_estimator_that_crashes_in_most_flights_is_recommended_on_any_condition():
    lost = [crash(5.0)] * 4
    results = designed({"imm": [lost] * 4, "vqf": [lost] * 4})
    assert verdict(results).headline == "No estimator is fit to fly on these conditions."
    results = designed({"imm": [[1.0, 1.0, crash(5.0), 1.0], lost, lost, lost], "vqf": [lost] * 4})
    assert verdict(results).headline == (
        "No estimator survives axes-1, axes-2 and axes-3; elsewhere on these 4 combinations, fly imm "
        "(crashed in 1 of 4 flights) where the airframe's drag is known; no estimator is fit to fly where it "
        "is half or twice that or where it is not known."
    )


def test_a_part_of_the_held_out_suite_is_not_the_recommendation(monkeypatch):
    suite = load_experiment("held-out")
    cases = suite.cases()
    monkeypatch.setattr("scenarios.bench.results.default_estimators", lambda: ["imm", "vqf"])
    flown = {"imm": {name: [1.0] * 4 for name in cases}, "vqf": {name: [2.0, 2.1] * 2 for name in cases}}
    whole = benchmark(
        flown,
        scenarios={name: case.scenario for name, case in cases.items()},
        experiment=suite,
        levels={name: case.levels for name, case in cases.items()},
    )
    found = verdict(whole)
    assert found.headline == "Fly imm, whether the airframe's drag is known or not (no crash in 192 flights)."
    assert not any("recommendation" in line or "In general" in line for line in found.lines)
    only_imm = [cell for cell in whole.cells if cell.estimator == "imm"]
    shorter = {k: s.model_copy(update={"duration_s": 1.0}) for k, s in whole.scenarios.items()}
    for part, missing in (
        (replace(whole, estimators=["imm"], cells=only_imm), "1 of its 2 estimators"),
        (replace(whole, settings=replace(whole.settings, seeds=1)), "1 of its 4 flights in each scenario"),
        (replace(whole, scenarios=shorter), "0 of its 48 scenarios"),
    ):  # fmt: skip
        found = verdict(part)
        assert found.headline.startswith(f"On a part of the held-out suite ({missing}), fly imm")
        assert f"This is not the recommendation of the release: {missing} were flown." in found.lines
        assert found.lines[-1] == recommendation().elsewhere
