"""Designed combinations of the axes, their effects, and the advice that follows."""

from collections import Counter
from dataclasses import fields, replace
from itertools import combinations as pairs_of

import numpy as np
import pytest

from quadsim.flight.scenario import Scenario, load_scenario
from scenarios.bench.axes import (
    ALL,
    AXES,
    Combination,
    advice,
    choices,
    design,
    effects,
    headline,
    scenario_of,
    table,
)
from scenarios.bench.cell import Cell
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.recommendation import recommendation
from scenarios.bench.runner import Results, bench, identical
from scenarios.bench.settings import FlightSettings, ScenarioChanges

LEVELS = {axis: next(iter(levels)) for axis, levels in AXES.items()}


def flight(scenario, estimator, seed, error, cause=""):
    numbers = {each.name: None for each in fields(FlightMetrics)} | {"error_deg": error}
    return FlightRow(scenario, estimator, seed, cause, 20.0, **numbers)


def made(errors, combos, failed=()):
    """Results with these errors: (combination, estimator) to one a seed, None for a crash."""
    names = list(dict.fromkeys(name for _, name in errors))
    cells = []
    for combination in combos:
        for name in names:
            reason = "no vehicle" if (combination.name, name) in failed else ""
            rows = [
                flight(
                    combination.name, name, seed, error or 90.0, "" if error is not None else "tilted over"
                )
                for seed, error in enumerate([] if reason else errors[combination.name, name])
            ]
            cells.append(Cell(combination.name, name, "", reason, rows, [], None, name == "truth"))
    scenarios = {each.name: Scenario(description="") for each in combos}
    return Results(scenarios, names, FlightSettings(max(map(len, errors.values()))), cells)


def test_every_level_is_flown_equally_often_and_beside_every_other():
    found = design()
    assert len(found) >= 60
    axes = {axis: [each.levels[axis] for each in found] for axis in AXES}
    axes["scenario"] = [each.scenario for each in found]
    for levels in axes.values():
        assert len(set(Counter(levels).values())) == 1
    for first, second in pairs_of(axes, 2):
        together = Counter(zip(axes[first], axes[second], strict=True))
        assert len(together) == len(set(axes[first])) * len(set(axes[second]))
    assert found == design()
    assert found != design(seed=1)
    with pytest.raises(ValueError, match="cells: 3, an axis has 4 levels; give 4 or more"):
        design(cells=3)


def test_the_full_design_has_every_combination_once():
    every = design(["hover"], full=True)
    assert len(every) == len({tuple(each.levels.values()) for each in every}) == 3 * 3 * 4 * 4 * 4
    assert [row["name"] for row in table(every)] == [each.name for each in every]


def test_a_combination_is_its_scenario_with_what_the_levels_set():
    levels = LEVELS | {
        "initial attitude": "given, 4° wrong",
        "drag": "twice what is known",
        "airframe": "crazyflie",
    }
    levels |= {"motion": "4 m/s", "IMU": "rough, vibration, lever arm"}
    found, base = scenario_of(Combination("axes-0", "saturation", levels)), load_scenario("saturation")
    assert (found.vehicle, found.imu, found.drag_factor) == ("crazyflie", "rough", 2.0)
    assert (found.start.attitude_error_deg, found.start.speed) == (4.0, 4.0)
    assert [fault.kind for fault in found.faults] == ["saturation", "vibration", "lever-arm"]
    assert found.trajectory == base.trajectory
    assert "crazyflie" in found.description


def test_effects_leave_out_what_the_truth_crashes_on_and_count_the_rest():
    combos = [replace_level(k, "drag", level) for k, level in enumerate(("known", "not known"))]
    errors = {(c.name, "truth"): [0.0, None] for c in combos}
    errors |= {("axes-0", "imm"): [1.0, None], ("axes-1", "imm"): [3.0, None]}
    errors |= {("axes-0", "vqf"): [None, 2.0], ("axes-1", "vqf"): [2.0, 2.0]}
    found = {(e.axis, e.level, e.estimator): e for e in effects(combos, made(errors, combos))}
    assert found[ALL, ALL, "imm"].flights == 2
    assert found[ALL, ALL, "imm"].error_deg == pytest.approx(2.0)
    assert (found["drag", "known", "vqf"].crashes, found["drag", "known", "vqf"].error_deg) == (1, None)
    assert (found["drag", "not known", "vqf"].crashes, found["drag", "not known", "vqf"].error_deg) == (
        0,
        2.0,
    )
    assert found["drag", "half of what is known", "vqf"].flights == 0


def replace_level(number, axis, level):
    return Combination(f"axes-{number}", "hover", LEVELS | {axis: level})


def test_advice_has_a_sentence_for_each_condition_and_says_when_it_cannot_choose():
    combos = [replace_level(k, "drag", level) for k, level in enumerate(AXES["drag"])]
    rng = np.random.default_rng(0)
    errors = {}
    for combination in combos:
        known = combination.levels["drag"] == "known"
        errors[combination.name, "ekf-drag"] = list(rng.normal(1.0 if known else 5.0, 0.1, 20))
        errors[combination.name, "imm"] = list(rng.normal(2.0, 0.1, 20))
        errors[combination.name, "vqf"] = list(rng.normal(2.0, 0.1, 20))
    results = made(errors, combos, failed={("axes-3", "ekf-drag")})
    known, wrong, unknown, safest, elsewhere = advice(combos, results)
    assert "drag known: fly ekf-drag, with no crash in 20 flights and the smallest error, 0.98°." in known
    for line in (wrong, unknown):
        assert (
            "fly imm or vqf; none of them crashed" in line or "fly vqf or imm; none of them crashed" in line
        )
        assert "are not significant" in line
    assert "ekf-drag" not in unknown
    assert "ekf-drag" not in safest
    assert elsewhere.startswith(f"In general: {recommendation().sentence}")


def test_a_crash_weighs_more_than_any_error():
    combos = [replace_level(0, "drag", "known")]
    errors = {("axes-0", "imm"): [9.0] * 12, ("axes-0", "vqf"): [0.1] * 4 + [None] * 8}
    assert (
        "fly imm, the only one to survive all 12 flights; its error is 9.00°."
        in (advice(combos, made(errors, combos))[0])
    )


def test_no_estimator_that_crashes_in_most_flights_is_recommended_on_any_condition():
    combos = [replace_level(k, "drag", level) for k, level in enumerate(AXES["drag"])]
    errors = {(each.name, name): [None] * 4 for each in combos for name in ("imm", "vqf")}
    assert (
        headline(choices(combos, made(errors, combos)), combos)
        == "No estimator is fit to fly on these conditions."
    )
    errors["axes-0", "imm"] = [1.0, 1.0, None, 1.0]
    assert headline(choices(combos, made(errors, combos)), combos) == (
        "On these 4 combinations fly imm (crashed in 1 of 4 flights) where the airframe's drag is known."
    )


def test_a_designed_benchmark_flies_and_an_unknown_vehicle_is_not_flown_with_ekf_drag(tmp_path):
    combos = [replace_level(0, "drag", "known"), replace_level(1, "drag", "not known")]
    results = bench(
        {each.name: scenario_of(each) for each in combos}, ["truth", "ekf-drag"], tmp_path,
        FlightSettings(), ScenarioChanges(duration_s=0.3), workers=1,
    )  # fmt: skip
    reasons = {(cell.scenario, cell.estimator): cell.reason for cell in results.cells}
    assert "ekf-drag needs a vehicle" in reasons["axes-1", "ekf-drag"]
    assert not any(reason for pair, reason in reasons.items() if pair != ("axes-1", "ekf-drag"))
    failed = [e for e in effects(combos, results) if (e.level, e.estimator) == ("not known", "ekf-drag")]
    assert (failed[0].flights, failed[0].failed) == (0, 1)


def test_an_estimator_that_flies_exactly_as_another_is_shown_once():
    combos = [replace_level(0, "drag", "known")]
    errors = {("axes-0", name): [1.0, 2.0] for name in ("att-snn", "att-snn-loihi")} | {
        ("axes-0", "imm"): [1.0, 2.5]
    }
    results = made(errors, combos)
    assert identical(results) == {"att-snn-loihi": "att-snn"}
    assert {each.estimator for each in effects(combos, results)} == {"att-snn", "imm"}
    assert "att-snn-loihi" not in " ".join(advice(combos, results))


def test_estimators_that_failed_for_other_reasons_are_not_the_same():
    combos = [replace_level(0, "drag", "known"), replace_level(1, "drag", "known")]
    errors = {(c.name, name): [1.0, 2.0] for c in combos for name in ("x", "y")}
    results = made(errors, combos, failed={("axes-1", "x"), ("axes-1", "y")})
    assert identical(results) == {"y": "x"}
    cells = [replace(c, reason="no idea") if c.reason and c.estimator == "y" else c for c in results.cells]
    assert identical(replace(results, cells=cells)) == {}


def test_one_flight_of_each_combination_has_no_interval():
    combos = design()
    alone = made({(each.name, "a"): [1.0 + k % 3] for k, each in enumerate(combos)}, combos)
    twice = made({(each.name, "a"): [1.0 + k % 3, 4.0] for k, each in enumerate(combos)}, combos)
    assert {(each.low, each.high) for each in effects(combos, alone)} == {(None, None)}
    whole = effects(combos, twice)[0]
    assert whole.low < whole.error_deg < whole.high
