"""The verdict: which estimators are recommended, which are never ranked, and the lines below the headline."""

from dataclasses import replace

import pytest
from flown import benchmark, crash, table

from quadsim.flight.scenario import Scenario, Start
from scenarios.bench.ranking import ranked
from scenarios.bench.recommendation import FILE, Recommendation, recommendation, save_recommendation
from scenarios.bench.verdict import verdict
from scenarios.report.terminal import standings_table


def order(results):
    return [standing.estimator for standing in verdict(results).standings]


def test_survival_ranks_first_then_the_time_to_the_crash_then_the_error():
    flown = {
        "early": [crash(1.0), 9.0],
        "late": [crash(15.0), 9.5],
        "never": [8.0, 8.0],
        "better": [7.0, 8.0],
        "always": [crash(19.0), crash(19.0)],
    }
    results = benchmark({name: {"a": each} for name, each in flown.items()})
    assert order(results) == ["better", "never", "late", "early", "always"]


def test_errors_are_means_over_scenarios_of_flights_that_all_compared_survived():
    flown = {"x": [crash(5.0), 1.0, 3.0], "y": [0.1, crash(5.0), 2.0]}
    flights = [("a", name, k, each) for name, own in flown.items() for k, each in enumerate(own)]
    flights += [("b", name, k, 5.0) for name in flown for k in range(3)]
    planned = [(scenario, seed) for scenario in "ab" for seed in range(3)]
    places = {place.name: place for place in ranked(table(*flights), planned, "error_deg")}
    assert [places[name].error for name in "xy"] == [4.0, 3.5]  # of a seed 2 alone
    assert [places[name].survived for name in "xy"] == [5, 5]


def test_a_flight_that_did_not_run_counts_as_lost():
    results = benchmark({"x": {"a": [3.0, 3.0], "b": [3.0, 3.0]}, "y": {"a": [1.0, 1.0], "b": "no weights"}})
    assert order(results) == ["x", "y"]
    found = verdict(results)
    assert found.headline == "In a and b, fly x (no crash in 4 flights, error 3.00°)."
    assert found.standings[1].texts["note"] == "did not run in 1 scenario: no weights"
    none = verdict(benchmark({"x": {"a": "no weights"}, "y": {"a": [crash(5.0)] * 2}})).standings
    assert [(each.estimator, each.texts["rank"]) for each in none] == [("y", "1"), ("x", "–")]


def test_where_nobody_survives_no_estimator_is_recommended_there():
    """att-snn crashes first, and so has the smallest error until then."""
    lost = {
        "ekf-drag": [crash(9.0, 5.0)] * 4, "imm": [crash(8.0, 4.0)] * 4, "vqf": [crash(8.5, 4.0)] * 4,
        "att-snn": [crash(1.0, 0.01)] * 4,
    }  # fmt: skip
    calm = {"ekf-drag": [0.5, 0.52, 0.51, 0.5], "imm": [0.9] * 4, "vqf": [0.8] * 4, "att-snn": [1.5] * 4}
    results = benchmark({name: {"gyrofail": lost[name], "hover": calm[name]} for name in lost})
    found = verdict(results)
    assert found.headline == (
        "No estimator survives gyrofail; in hover, fly ekf-drag (no crash in 4 flights, error 0.51°)."
    )
    assert [each.estimator for each in found.standings] == ["ekf-drag", "vqf", "imm", "att-snn"]
    assert found.standings[0].texts["error [°]"] == "0.51"
    nowhere = benchmark({name: {"gyrofail": each} for name, each in lost.items()})
    assert verdict(nowhere).headline == "No estimator survives gyrofail."
    assert order(nowhere) == ["ekf-drag", "vqf", "imm", "att-snn"]


FIVE = {name: [1.0, 1.1] for name in "abcde"}
HEADLINES = {
    "a recommended one crashed": (
        {"x": {"a": [crash(5.0), 1.0, 1.0, 2.0]}, "y": {"a": [crash(5.0), crash(9.0), 0.1, 0.1]}},
        "In a, fly x (crashed in 1 of 4 flights, error 1.33° in the others).",
    ),
    "the best crashes in most": (
        {"x": {"a": [crash(5.0), crash(5.0), 1.0]}, "y": {"a": [crash(5.0)] * 3}},
        "In a, no estimator is fit to fly: x crashed in 2 of 3 flights, and the others in more.",
    ),
    "all that do not differ significantly are named": (
        {"x": {"a": [1.0] * 4}, "y": {"a": [1.4, 0.8, 1.4, 0.8]}, "z": {"a": [1.3, 0.9, 1.3, 1.0]},
         "far": {"a": [3.0, 3.1, 3.0, 3.1]}},
        "In a, fly x, y or z (no crash in 4 flights each, error 1.00° to 1.12°; the difference is not "
        "significant). 4 flights of each in a scenario are too few to choose between them.",
    ),
    "none in a tie ranks below one left out": (  # noisy is worse in the mean, steady significantly
        {"best": {"a": [1.0] * 4}, "steady": {"a": [1.2, 1.21] * 2}, "noisy": {"a": [0.3, 3.0] * 2}},
        "In a, fly best (no crash in 4 flights, error 1.00°).",
    ),
    "one flight chooses nothing": (
        {"x": {"a": [1.0]}, "y": {"a": [2.0]}, "z": {"a": [crash(5.0)]}},
        "In a, fly x or y (no crash in 1 flight each, error 1.00° to 2.00°; the difference is not "
        "significant). 1 flight of each in a scenario is too few to choose between them.",
    ),
    "many scenarios are counted": (
        {"x": FIVE, "y": {name: [2.0, 2.1] for name in FIVE}},
        "In these 5 scenarios, fly x (no crash in 10 flights, error 1.05°).",
    ),
    "who did not run is no rival": (
        {"x": {"a": [1.0, 1.1]}, "y": {"a": "no weights"}},
        "In a, fly x, the only one that ran (no crash in 2 flights, error 1.05°).",
    ),
    "one alone is described": (
        {"truth": {"a": [0.1] * 3, "b": [0.1] * 3}, "x": {"a": [crash(5.0)] * 2 + [1.0], "b": [2.0] * 3}},
        "x: crashed in 2 of 6 flights, error 1.50° in the others.",
    ),
    "one alone that did not run everywhere": (
        {"x": {"a": [1.0, 1.1], "b": "no idea"}},
        "x: no crash in 2 flights, error 1.05°; 1 scenario did not run.",
    ),
    "nothing runs": ({"x": {"a": "no weights"}}, "No estimator ran: x did not run (no weights)."),
}  # fmt: skip


@pytest.mark.parametrize(("outcomes", "headline"), HEADLINES.values(), ids=HEADLINES)
def test_the_headline_says_what_to_fly(outcomes, headline):
    assert verdict(benchmark(outcomes)).headline == headline


def test_what_receives_the_truth_is_a_reference_whatever_its_name():
    results = benchmark(
        {"est.py:Peek": {"a": [0.0, 0.0]}, "mahony": {"a": [1.0, 1.1]}, "vqf": {"a": [2.0, 2.1]}},
        references=("est.py:Peek",),
    )
    found = verdict(results)
    assert found.headline.startswith("In a, fly mahony (")
    assert [each.estimator for each in found.standings] == ["mahony", "vqf", "est.py:Peek"]
    assert found.standings[-1].texts["note"] == "not ranked: it received the true attitude"
    alone = benchmark({"est.py:Peek": {"a": [0.0]}}, references=("est.py:Peek",))
    assert verdict(alone).headline == (
        "Nothing is compared: only estimators that receive the true attitude ran."
    )


def test_an_estimator_that_repeats_another_or_flies_exactly_as_it_is_not_ranked_beside_it():
    both = {"ekf-filterpy": {"a": [1.0, 1.1]}, "ekf": {"a": [1.0, 1.1]}, "vqf": {"a": [2.0, 2.1]}}
    results = benchmark(both)
    assert results.unranked == {"ekf-filterpy": "repeats ekf"}
    assert verdict(results).headline.startswith("In a, fly ekf (")
    assert benchmark({name: own for name, own in both.items() if name != "ekf"}).unranked == {}
    found = verdict(benchmark({"a": {"s": [1.0, 2.0]}, "b": {"s": [1.0, 2.0]}, "c": {"s": [1.0, 2.5]}}))
    assert [each.estimator for each in found.standings] == ["a", "c", "b"]
    assert found.standings[-1].texts["note"] == "not ranked: it flew exactly as a"
    failed = benchmark({name: {"s": [1.0, 2.0], "t": why} for name, why in (("a", "x"), ("b", "y"))})
    assert failed.unranked == {}  # they failed for other reasons


def test_controllers_are_ranked_by_tracking_and_none_on_the_truth_is_a_candidate():
    errors = {"truth": 0.5, "truth @ c": 0.75, "x": 1.5, "x @ c": 1.0}  # tracking is twice as much
    results = benchmark({name: {"a": [error] * 2} for name, error in errors.items()})
    found = verdict(results)
    assert found.headline == "In a, fly c on x (no crash in 2 flights, tracking error 2.00°)."
    assert [each.estimator for each in found.standings] == ["x @ c", "x", "truth", "truth @ c"]
    assert found.standings[-1].texts["command change [rad/s]"] == "5.00"
    assert found.standings[-1].texts["note"] == "not ranked: it received the true attitude"


def test_on_the_truth_alone_all_controllers_are_compared_and_the_cascade_may_win():
    errors = {"truth": 0.5, "truth @ c": 0.75, "truth @ d": 0.6}
    found = verdict(benchmark({name: {"a": [error] * 2} for name, error in errors.items()}))
    assert found.headline.startswith("In a, fly the cascade on truth (no crash in 2 flights")
    assert [each.estimator for each in found.standings] == ["truth", "truth @ d", "truth @ c"]


def test_of_a_controller_alone_the_tracking_error_counts():
    assert verdict(benchmark({"truth @ c": {"a": [0.75]}})).headline.endswith("tracking error 1.50°.")
    both = benchmark({"x @ c": {"a": [0.2]}, "y @ c": {"a": [0.1]}})
    assert order(both)[0] == "y @ c"  # two estimators are compared as such


def test_where_no_estimator_is_fit_each_has_its_reason_and_there_is_advice():
    """A constant, one that does not run, and the truth: nothing is left to recommend."""
    why = "returned the same roll and pitch at every sample"
    results = benchmark(
        {"level": {"a": [0.1, 0.1]}, "broken": {"a": "no weights"}, "truth": {"a": [0.0, 0.0]}},
        flaws={"level": why},
    )
    found = verdict(results)
    assert found.headline == f"No estimator is fit: broken did not run (no weights); level {why}."
    assert "--estimator eskf" in found.lines[0]


def test_every_verdict_says_on_what_condition_it_holds_and_what_to_fly_elsewhere():
    given = Scenario(description="", start=Start(known_attitude=True))
    scenarios = {
        "a": given,
        "b": given.model_copy(update={"drag_factor": 2.0}),
        "c": given.model_copy(update={"start": Start(), "vehicle_known": False}),
    }
    line = " ".join(verdict(benchmark({"x": {k: [1.0] for k in "abc"}}, scenarios=scenarios)).lines)
    for part in (
        "The airframe is hummingbird. Its drag is known in 1 scenario, 2 times the known value in 1 scenario "
        "and not known in 1 scenario. The IMU is adis16448. The initial attitude is given in 2 scenarios and "
        "not given in 1 scenario.",
        f"The recommendation of release {recommendation().release} is: {recommendation().sentence} It comes",
    ):
        assert part in line


def test_the_table_has_the_worst_scenario_and_the_paired_difference_from_the_best():
    results = benchmark(
        {
            "x": {"a": [0.5, 0.6], "b": [4.0, 4.1]},
            "y": {"a": [2.5, 2.6], "b": [3.0, 3.1]},
            "z": {"a": [crash(5.0)] * 2, "b": [1.0] * 2},
        }
    )
    x, y, z = (each.texts for each in verdict(results).standings)
    assert [each["error minus that of rank 1 [°]"] for each in (x, y)] == ["–", "+0.50 ± 0.00"]
    assert [each["at worst"] for each in (x, y)] == ["b, 4.05°", "b, 3.05°"]
    assert (z["crashed"], z["at worst"]) == ("2 of 4 (15–85 %)", "a, 2 of 2 crashed, not measured")


def test_console_and_report_have_the_tracking_error_beside_that_of_the_estimate():
    judged = verdict(benchmark({"x": {"a": [1.0, 2.0]}, "y": {"a": [crash(5.0), 3.0]}}))
    shown = [(each.texts["error [°]"], each.texts["attitude tracking [°]"]) for each in judged.standings]
    assert shown == [("1.50", "3.00"), ("3.00", "6.00")]
    columns = {str(c.header): [str(cell) for cell in c.cells] for c in standings_table(judged).columns}
    texts = {key: [each.texts[key] for each in judged.standings] for key in judged.standings[0].texts}
    assert not any(texts.pop("note"))  # without a word, it has no column
    del columns["estimator"]
    assert columns == texts


def test_a_network_on_an_airframe_that_it_was_not_trained_on_is_warned_of():
    scenarios = {"a": Scenario(description="", vehicle="crazyflie")}
    names = ("att-snn", "att-snn-paper", "truth @ control-attitude", "truth @ control-attitude-loihi")
    results = benchmark({name: {"a": [1.0]} for name in names}, scenarios=scenarios)
    trained = [line for line in results.warnings if line.startswith("Trained")]
    assert trained == [
        "Trained on the hummingbird, not on the simulated crazyflie: att-snn-paper, "
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


def test_every_page_of_results_states_the_one_recommendation():
    root = FILE.parents[2]
    for page in ("README.md", "docs/results.md"):
        text = " ".join((root / page).read_text("utf-8").split())
        assert recommendation().sentence in text, page
