"""The verdict: which estimators are recommended, which are never ranked, and the lines below the headline."""

from dataclasses import fields, replace

import numpy as np

from quadsim.flight.scenario import Scenario, Start
from scenarios.bench.cell import Cell, failed_cell
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.offline import UNRANKED
from scenarios.bench.ranking import by_contender, ranked, winners
from scenarios.bench.recommendation import FILE, Recommendation, recommendation, save_recommendation
from scenarios.bench.runner import Results
from scenarios.bench.settings import FlightSettings
from scenarios.bench.verdict import offline_verdict, shown, verdict
from scenarios.report.terminal import closed_loop_table

WHOLE_S = 20.0


def crash(at_s, error=0.1):
    """A flight that crashes, with a small error until then."""
    return at_s, error


def flight(scenario, name, seed, outcome):
    at_s, error = outcome if isinstance(outcome, tuple) else (None, outcome)
    numbers = dict.fromkeys(each.name for each in fields(FlightMetrics))
    numbers |= {"error_deg": error, "attitude_deg": 2 * error, "jitter": 5.0}
    return FlightRow(scenario, name, seed, "tilted over" * (at_s is not None), at_s or WHOLE_S, **numbers)


def benchmark(outcomes, references=("truth",), flaws=None, scenarios=None):
    """Results with these flights: {contender: {scenario: [error or crash(...) of each seed, or why not]}}."""
    names = list(dict.fromkeys(scenario for each in outcomes.values() for scenario in each))
    cells, seeds = [], 1
    for scenario in names:
        for name, own in outcomes.items():
            if isinstance(flown := own[scenario], str):
                cells.append(failed_cell(scenario, name, "", flown))
                continue
            seeds = len(flown)
            flights = [flight(scenario, name, seed, each) for seed, each in enumerate(flown)]
            reference = name.split(" @ ")[0] in references
            flaw = (flaws or {}).get(name, "")
            cells.append(Cell(scenario, name, "", "", flights, [], None, reference, flaw))
    known = scenarios or {name: Scenario(description="") for name in names}
    return Results(known, list(outcomes), FlightSettings(seeds), cells)


def judged(results, focus=""):
    return verdict(results, focus)


def order(results):
    return [standing.estimator for standing in judged(results).standings]


# --- who is better --------------------------------------------------------------------------------


def test_survival_ranks_first_then_the_time_to_the_crash_then_the_error():
    results = benchmark(
        {
            "early": {"a": [crash(1.0), 9.0]},
            "late": {"a": [crash(15.0), 9.5]},
            "never": {"a": [8.0, 8.0]},
            "better": {"a": [7.0, 8.0]},
            "always": {"a": [crash(19.0), crash(19.0)]},
        }
    )
    assert order(results) == ["better", "never", "late", "early", "always"]


def test_errors_are_compared_on_flights_that_all_compared_survived():
    flown = by_contender(
        [flight("a", "x", k, each) for k, each in enumerate([crash(5.0), 1.0, 3.0])]
        + [flight("a", "y", k, each) for k, each in enumerate([0.1, crash(5.0), 2.0])]
    )
    places = {place.name: place for place in ranked(flown, [("a", seed) for seed in range(3)])}
    assert [places[name].error for name in "xy"] == [3.0, 2.0]  # seed 2 alone
    assert [places[name].survived for name in "xy"] == [2, 2]


def test_a_flight_that_did_not_run_counts_as_lost():
    results = benchmark({"x": {"a": [3.0, 3.0], "b": [3.0, 3.0]}, "y": {"a": [1.0, 1.0], "b": "no weights"}})
    assert order(results) == ["x", "y"]
    found = judged(results)
    assert found.headline == ("In a and b fly x, the only one to survive all 4 flights; its error is 3.00°.")
    assert found.standings[1].text.endswith("1 scenario did not run")


def test_winners_end_at_the_first_that_is_worse():
    flights = [flight("a", name, 0, error) for name, error in zip("wxyz", (1.0, 1.1, 1.2, 1.3), strict=True)]
    places = ranked(by_contender(flights), [("a", 0)])
    assert [each.name for each in winners(places, lambda _, other: other == "y")] == ["w", "x"]


# --- the headline ---------------------------------------------------------------------------------


def test_where_nobody_survives_no_estimator_is_recommended_there():
    """att-snn crashes first, and so has the smallest error until then."""
    lost = {
        "ekf-drag": [crash(9.0, 5.0)] * 4, "imm": [crash(8.0, 4.0)] * 4, "vqf": [crash(8.5, 4.0)] * 4,
        "att-snn": [crash(1.0, 0.01)] * 4,
    }  # fmt: skip
    calm = {"ekf-drag": [0.5, 0.52, 0.51, 0.5], "imm": [0.9] * 4, "vqf": [0.8] * 4, "att-snn": [1.5] * 4}
    results = benchmark({name: {"gyrofail": lost[name], "hover": calm[name]} for name in lost})
    found = judged(results)
    assert found.headline == (
        "No estimator survives gyrofail; in hover fly ekf-drag, with no crash in 4 flights and the smallest "
        "error, 0.51°."
    )
    assert [each.estimator for each in found.standings] == ["ekf-drag", "vqf", "imm", "att-snn"]
    assert "not measured" not in found.standings[0].text
    nowhere = benchmark({name: {"gyrofail": each} for name, each in lost.items()})
    assert judged(nowhere).headline == "No estimator survives gyrofail."
    assert order(nowhere) == ["ekf-drag", "vqf", "imm", "att-snn"]


def test_the_headline_says_that_a_recommended_estimator_crashed():
    results = benchmark(
        {"x": {"a": [crash(5.0), 1.0, 1.0, 2.0]}, "y": {"a": [crash(5.0), crash(9.0), 0.1, 0.1]}}
    )
    assert judged(results).headline == (
        "In a fly x, though it crashed in 1 of 4 flights; no other survived more, and its error is 1.33° in "
        "the others."
    )


def test_an_estimator_that_crashes_in_most_flights_is_not_recommended():
    results = benchmark({"x": {"a": [crash(5.0), crash(5.0), 1.0]}, "y": {"a": [crash(5.0)] * 3}})
    assert judged(results).headline == (
        "In a no estimator is fit to fly: x crashed in 2 of 3 flights, the others in more."
    )


def test_estimators_that_do_not_differ_significantly_from_the_best_are_all_named():
    results = benchmark(
        {"x": {"a": [1.0, 1.0, 1.0, 1.0]}, "y": {"a": [1.4, 0.8, 1.4, 0.8]}, "z": {"a": [1.3, 0.9, 1.3, 1.0]},
         "far": {"a": [3.0, 3.1, 3.0, 3.1]}}
    )  # fmt: skip
    assert judged(results).headline == (
        "In a fly x, y or z; none of them crashed in 4 flights, and the differences in error (1.00° to "
        "1.12°) are not significant. 4 flights of each in a scenario cannot show small differences."
    )


def test_an_estimator_in_a_tie_is_never_worse_than_one_that_is_left_out():
    results = benchmark(
        {
            "best": {"a": [1.0, 1.0, 1.0, 1.0]},
            "steady": {"a": [1.2, 1.21, 1.2, 1.21]},  # significantly worse
            "noisy": {"a": [0.3, 3.0, 0.3, 3.0]},  # worse in the mean, not significantly
        }
    )
    assert judged(results).headline == (
        "In a fly best, with no crash in 4 flights and the smallest error, 1.00°."
    )


def test_only_those_without_a_crash_are_compared_by_their_error():
    results = benchmark(
        {"x": {"a": [1.0, 1.0]}, "y": {"a": [2.0, 2.0]}, "z": {"a": [crash(5.0, 0.01), 0.01]}}
    )
    assert judged(results).headline == (
        "In a fly x, with no crash in 2 flights and the smallest error of the 2 that survived all, 1.00°."
    )


def test_many_scenarios_are_counted_and_few_are_named():
    flown = {name: [1.0, 1.1] for name in "abcde"}
    results = benchmark({"x": flown, "y": {name: [2.0, 2.1] for name in flown}})
    assert judged(results).headline.startswith("In these 5 scenarios fly x, with no crash in 10 flights")
    few = benchmark({"x": {"a": [1.0, 1.1], "b": [1.0, 1.1]}, "y": {"a": [2.0, 2.1], "b": [2.0, 2.1]}})
    assert judged(few).headline.startswith("In a and b fly x")


def test_one_flight_recommends_nothing():
    results = benchmark({"x": {"a": [1.0]}, "y": {"a": [2.0]}, "z": {"a": [crash(5.0)]}})
    assert judged(results).headline == (
        "In a x has the smallest error, 1.00°, of the 2 that did not crash; one flight in each scenario is "
        "too few to recommend it."
    )


def test_who_did_not_run_is_no_rival():
    results = benchmark({"x": {"a": [1.0, 1.1]}, "y": {"a": "no weights"}})
    assert judged(results).headline == (
        "In a fly x, the only one that ran, with no crash in 2 flights; its error is 1.05°."
    )
    alone = benchmark({"x": {"a": [1.0, 1.1], "b": "no idea"}})
    assert judged(alone).headline == "x: no crash in 2 flights, error 1.05°; 1 scenario did not run."


# --- what is never ranked -------------------------------------------------------------------------


def test_what_receives_the_truth_is_a_reference_whatever_its_name():
    results = benchmark(
        {"est.py:Peek": {"a": [0.0, 0.0]}, "mahony": {"a": [1.0, 1.1]}, "vqf": {"a": [2.0, 2.1]}},
        references=("est.py:Peek",),
    )
    found = judged(results)
    assert found.headline.startswith("In a fly mahony")
    assert [each.estimator for each in found.standings] == ["mahony", "vqf", "est.py:Peek"]
    assert found.standings[-1].text.endswith("not ranked: it received the true attitude")
    alone = benchmark({"est.py:Peek": {"a": [0.0]}}, references=("est.py:Peek",))
    assert judged(alone).headline == (
        "Nothing is compared: only estimators that receive the true attitude ran."
    )


def test_an_estimate_that_never_changes_is_not_ranked():
    why = "returned the same roll and pitch at every sample"
    results = benchmark(
        {"level": {"a": [0.1, 0.1]}, "mahony": {"a": [1.0, 1.1]}, "vqf": {"a": [2.0, 2.1]}},
        flaws={"level": why},
    )
    found = judged(results)
    assert found.headline.startswith("In a fly mahony")
    assert found.standings[-1].text.endswith(f"not ranked: it {why}")
    assert f"Not ranked: level {why}." in found.lines


def test_controllers_are_ranked_by_tracking_and_none_on_the_truth_is_a_candidate():
    errors = {"truth": 0.5, "truth @ c": 0.75, "x": 1.5, "x @ c": 1.0}  # tracking is twice as much
    results = benchmark({name: {"a": [error] * 2} for name, error in errors.items()})
    found = judged(results)
    assert found.headline == (
        "In a fly c on x, with no crash in 2 flights and the smallest tracking error, 2.00°."
    )
    assert [each.estimator for each in found.standings] == ["x @ c", "x", "truth", "truth @ c"]
    assert found.standings[-1].text == (
        "no crash in 2 flights · tracking error 1.50° · command jitter 5.0 rad/s · not ranked: it received "
        "the true attitude"
    )
    assert (
        "The attitude tracking error of c on x is 2.00 × that of the cascade on the true attitude."
        in found.lines
    )


def test_on_the_truth_alone_all_controllers_are_compared_and_the_cascade_may_win():
    errors = {"truth": 0.5, "truth @ c": 0.75, "truth @ d": 0.6}
    found = judged(benchmark({name: {"a": [error] * 2} for name, error in errors.items()}))
    assert found.headline.startswith("In a fly the cascade on truth, with no crash in 2 flights")
    assert [each.estimator for each in found.standings] == ["truth", "truth @ d", "truth @ c"]


def test_of_a_controller_alone_the_tracking_error_counts():
    assert judged(benchmark({"truth @ c": {"a": [0.75]}})).headline.endswith("tracking error 1.50°.")
    both = benchmark({"x @ c": {"a": [0.2]}, "y @ c": {"a": [0.1]}})
    assert order(both)[0] == "y @ c"  # two estimators are compared as such


# --- one alone, none at all -----------------------------------------------------------------------


def test_one_estimator_is_described_and_not_compared():
    flown = {"a": [crash(5.0), crash(5.0), 1.0], "b": [2.0, 2.0, 2.0]}
    found = judged(benchmark({"truth": {"a": [0.1] * 3, "b": [0.1] * 3}, "x": flown}))
    assert found.headline == "x: crashed in 2 of 6 flights, error 1.50° in the others."
    assert "Its worst scenario is a, 2 of 3 crashed, 1.00°." in found.lines
    assert judged(benchmark({"x": {"b": [2.0, 2.0]}})).headline == "x: no crash in 2 flights, error 2.00°."
    assert judged(benchmark({"x": {"b": [crash(5.0)]}})).headline == "x crashed."
    assert judged(benchmark({"x": {"b": [2.0]}})).headline == "x did not crash: error 2.00°."


def test_estimators_that_did_not_run_come_last():
    found = judged(benchmark({"x": {"a": "no weights"}, "y": {"a": [crash(5.0)] * 2}}))
    assert [each.text for each in found.standings] == [
        "crashed in a (2 of 2) · error not measured", "did not run",
    ]  # fmt: skip
    assert judged(benchmark({"x": {"a": "no weights"}})).headline == "No estimator ran."


# --- the lines below ------------------------------------------------------------------------------


def test_every_verdict_says_on_what_condition_it_holds_and_what_to_fly_elsewhere():
    given = Scenario(description="", start=Start(known_attitude=True))
    scenarios = {
        "a": given,
        "b": given.model_copy(update={"drag_factor": 2.0}),
        "c": given.model_copy(update={"start": Start(), "vehicle_known": False}),
    }
    line = judged(benchmark({"x": {name: [1.0] for name in "abc"}}, scenarios=scenarios)).lines[0]
    for part in (
        "Conditions: airframe hummingbird; its drag known in 1 scenario, 2 times what is known in 1 "
        "scenario, not known in 1 scenario; IMU adis16448; initial attitude given in 2 scenarios, not given "
        "in 1 scenario.",
        f"In general: {recommendation().sentence} (Held-out suite of release {recommendation().release}",
    ):
        assert part in line


def test_the_worst_scenario_is_named():
    results = benchmark({"x": {"a": [0.5], "b": [4.0]}, "y": {"a": [2.5], "b": [3.0]}})
    found = judged(results)
    assert "By the worst scenario y is the best: b, 3.00°; of x it is b, 4.00°." in found.lines
    assert found.standings[1].text == "no crash in 2 flights · error 2.75° · at worst 3.00° in b"


def test_the_estimator_in_focus_is_described_and_compared_with_the_truth():
    results = benchmark({"truth": {"a": [0.5] * 2}, "x": {"a": [1.0] * 2}, "y": {"a": [crash(5.0), 2.0]}})
    assert judged(results, focus="y").lines[1:] == [
        "The attitude tracking error of x is 2.00 × that with the true attitude.",
        "y: 1 crash in 2 flights, error 2.00°, attitude tracking error 4.00 × that with the true attitude.",
    ]


def test_the_terminal_has_the_tracking_error_beside_that_of_the_estimate():
    few = closed_loop_table(benchmark({"x": {"a": [1.0, 2.0]}, "y": {"a": [crash(5.0), 3.0]}}))
    assert [str(cell) for cell in few.columns[1].cells] == ["1.50 | 3.00", "3.00 | 6.00 ✕ 1/2"]
    names = [f"s{k}" for k in range(8)]
    many = closed_loop_table(benchmark({"x": {n: [1.0] for n in names}, "y": {n: [2.0] for n in names}}))
    columns = {column.header: [str(cell) for cell in column.cells] for column in many.columns}
    assert (columns["error"], columns["tracking"]) == (["1.00", "2.00"], ["2.00", "4.00"])


def test_a_network_on_an_airframe_that_it_was_not_trained_on_is_warned_of():
    scenarios = {"a": Scenario(description="", vehicle="crazyflie")}
    names = ("att-snn", "att-snn-hummingbird", "truth @ control-attitude", "truth @ control-attitude-loihi")
    results = benchmark({name: {"a": [1.0]} for name in names}, scenarios=scenarios)
    trained = [line for line in results.warnings if line.startswith("Trained")]
    assert trained == [
        "Trained on the hummingbird, not on the crazyflie, which was simulated: att-snn-hummingbird, "
        "control-attitude, control-attitude-loihi."
    ]
    at_home = replace(results, scenarios={"a": Scenario(description="")})
    assert [line for line in at_home.warnings if line.startswith("Trained")] == []


def test_the_recommendation_is_read_back_as_it_was_written(monkeypatch, tmp_path):
    monkeypatch.setattr("scenarios.bench.recommendation.FILE", tmp_path / FILE.name)
    found = Recommendation(release="9.9", command="quadsim bench", date="2031-01-01", sentence="Fly “x”.")
    save_recommendation(found)
    assert recommendation() == found
    recommendation.cache_clear()


def test_recorded_flights_have_a_verdict_of_their_own():
    rows = [
        {"estimator": "truth", "start": "known", "mean_deg": 0.0, UNRANKED: "reference"},
        {"estimator": "mahony", "start": "known", "mean_deg": 2.5},
    ]
    assert offline_verdict(rows).headline == "Smallest error on recorded flights: mahony, 2.50°."
    flawed = [{"estimator": "x", "start": "known", "mean_deg": 0.1, UNRANKED: "returned ..."}, *rows]
    assert offline_verdict(flawed).headline == "Smallest error on recorded flights: mahony, 2.50°."
    assert offline_verdict(flawed[:2]).headline == "Recorded flights"
    assert shown(np.inf) == "not measured"


def test_every_page_of_results_states_the_one_recommendation():
    root = FILE.parents[2]
    for page in ("README.md", "docs/verdict.md", "docs/closed-loop.md"):
        text = " ".join((root / page).read_text("utf-8").split())
        assert recommendation().sentence in text, page
