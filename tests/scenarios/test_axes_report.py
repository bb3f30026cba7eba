"""The report of a designed benchmark: its tables, and its charts in a browser."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from accessibility import findings

from quadsim.cli.options import headline
from quadsim.flight.scenario import Scenario
from quadsim.runs.record import RunRecord
from scenarios.bench.axes import AXES, Combination, choices, effects, profiles, ranking
from scenarios.bench.axes import headline as headline_of
from scenarios.bench.breaking import BreakingPoint
from scenarios.bench.cell import Cell, failed_cell
from scenarios.bench.flight_metrics import FlightMetrics, FlightRow
from scenarios.bench.runner import Results
from scenarios.bench.settings import FlightSettings
from scenarios.report.axes_page import write_axes_report
from scenarios.report.publish import designed, publish, publish_axes
from scenarios.report.terminal import axes_tables

SEEDS = 6
LEVELS = {axis: list(levels) for axis, levels in AXES.items()}
COMBINATIONS = [
    Combination(f"axes-{k:02}", "hover", {axis: levels[k % len(levels)] for axis, levels in LEVELS.items()})
    for k in range(12)
]
RECORD = RunRecord("9.9.9", "abc1234", "quadsim bench --axes", "2031-01-01 00:00:00", 3600.0)
ERRORS = {"truth": 0.0, "vqf": 3.0, "imm": 1.0, "att-snn": 4.0, "att-snn-loihi": 4.0, "ekf-drag": 0.5}


def cell_of(combination, estimator):
    """Six flights: vqf crashes in the second, ekf-drag cannot fly an airframe that is not known."""
    if estimator == "ekf-drag" and combination.levels["drag"] == "not known":
        return failed_cell(combination.name, estimator, "", "needs a vehicle")
    rng = np.random.default_rng([*combination.name.encode()])
    known = dict.fromkeys(each.name for each in fields(FlightMetrics))
    flights = [
        FlightRow(
            combination.name, estimator, seed, "tilted over" if (estimator, seed) == ("vqf", 1) else "", 20.0,
            **known | {"error_deg": ERRORS[estimator] * (1 + 0.1 * rng.random())},
        )
        for seed in range(SEEDS)
    ]  # fmt: skip
    reference, cost = estimator == "truth", ERRORS[estimator]
    return Cell(combination.name, estimator, "", "", flights, [], None, reference, cpu_s=cost)


@pytest.fixture(scope="module")
def results():
    scenarios = {each.name: Scenario(description=each.name) for each in COMBINATIONS}
    cells = [cell_of(each, name) for each in COMBINATIONS for name in ERRORS]
    return Results(scenarios, list(ERRORS), FlightSettings(SEEDS), cells)


@pytest.fixture(scope="module")
def report(results, tmp_path_factory):
    path = tmp_path_factory.mktemp("axes") / "report.html"
    found = effects(COMBINATIONS, results)
    return write_axes_report(path, COMBINATIONS, results, found, csv=["effects.csv"], record=RECORD)


def test_the_ranking_has_the_truth_last_and_an_estimator_that_flew_as_another_not_at_all(results):
    assert ranking(effects(COMBINATIONS, results)) == ["imm", "att-snn", "vqf", "ekf-drag", "truth"]


def test_a_profile_counts_flights_that_crashed_or_could_not_be_flown_as_below_no_error(results):
    found = profiles(results, np.array([0.4, 2.0, 90.0]))
    assert found["imm"].tolist() == [0.0, 1.0, 1.0]
    assert found["vqf"].tolist() == pytest.approx([0.0, 0.0, 5 / 6])
    assert found["ekf-drag"].tolist() == pytest.approx([0.0, 0.75, 0.75])
    assert "att-snn-loihi" not in found


def test_the_headline_names_one_estimator_for_each_condition(results):
    assert headline_of(choices(COMBINATIONS, results), COMBINATIONS) == (
        "On these 12 combinations fly ekf-drag where the airframe's drag is known, ekf-drag where it is half "
        "or twice that, imm where it is not known."
    )
    alone = replace(
        results,
        estimators=["truth", "imm"],
        cells=[each for each in results.cells if each.estimator in ("truth", "imm")],
    )
    assert headline("r.html", alone, COMBINATIONS) == (
        "r.html: On these 12 combinations fly imm, whether the airframe's drag is known or not."
    )


def test_the_foot_has_version_commit_command_date_and_cost(report):
    text = re.sub(r"<[^>]+>", " ", report.read_text())
    for part in ("quadsim 9.9.9, commit abc1234", RECORD.command, "2031-01-01 00:00:00 UTC, after 60.0 min"):
        assert part in text
    flights = 12 * SEEDS * 6 - 3 * SEEDS
    assert f"{flights} flights, {flights * 20 / 3600:.1f} h in the air; 2.5 min of processor time" in text
    assert f"{100 * 48 / 148.5:.0f} % of it with att-snn, {flights / 148.5:.1f} flights per second" in text


def test_a_folder_has_the_tables_of_its_last_run_alone(results, tmp_path):
    page = publish_axes(tmp_path, results, COMBINATIONS)
    assert {each.name for each in tmp_path.iterdir()} == {"axes.csv", "effects.csv", "axes.png", page.name}
    assert designed(tmp_path, results) == COMBINATIONS
    few = replace(results, scenarios={"a": Scenario(description="")})
    assert designed(tmp_path, few) == []
    publish(tmp_path, results, [BreakingPoint("wind", "imm", "m/s", 1.0, 2.0, "", 2, "")])
    assert {each.name for each in tmp_path.glob("*.csv")} == {"pairs.csv", "breaking.csv"}
    assert not (tmp_path / "axes.png").exists()


def test_the_terminal_has_the_truth_last(results):
    assert str(list(axes_tables(effects(COMBINATIONS, results))[0].columns[0].cells)[-1]) == "truth"


def test_nothing_flown_is_refused(tmp_path):
    empty = Results({}, [], FlightSettings(), [])
    with pytest.raises(ValueError, match="nothing to report"):
        write_axes_report(tmp_path / "r.html", [], empty, [])


# --- in a browser ---------------------------------------------------------------------------------


def opened(browser, path, width=1280):
    """A page, with a list of what it said and fetched."""
    page, noise = browser.new_page(viewport={"width": width, "height": 900}), []
    page.on("console", lambda message: noise.append(message.text))
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.on("request", lambda each: noise.append(each.url) if not each.url.startswith("data:") else None)
    page.goto(path.as_uri())
    return page, noise


@pytest.fixture(params=[1280, 390], ids=["desktop", "phone"])
def page(request, browser, report):
    page, noise = opened(browser, report, request.param)
    yield page
    assert noise == [report.as_uri()]
    page.close()


def test_every_axis_has_a_table_and_a_chart(page):
    assert (
        page.locator("#verdict h2")
        .inner_text()
        .startswith("On these 12 combinations fly ekf-drag where the airframe's drag is known")
    )
    assert page.locator("section .beside").count() == len(AXES) + 1
    for k, levels in enumerate([*LEVELS.values(), ["hover"]]):
        assert page.locator(f"#axis-{k} td b, #axis-{k} td span").count() == 4 * len(levels)
        assert page.locator(f"#axis-{k} svg g").count() == page.locator(f"#axis-{k} td b").count()
    assert page.locator("#axis-2 td.none").inner_text() == "cannot fly"
    assert page.locator("#axis-2 td.crashed").count() == 4  # vqf, at every level
    assert page.locator("#axis-2 td.crashed small").first.inner_text() == "✕ 3/18"


def test_standings_have_intervals_and_the_worst_level(page):
    row = page.locator("#standings tbody tr").nth(2)
    assert row.locator("td").nth(1).inner_text() == "12 of 72"
    assert row.locator("td").nth(2).inner_text() == "10–27 %"
    assert "3 of 18 crashed" in row.locator("td").last.inner_text()
    assert page.locator("#standings tbody tr").last.locator("td").first.inner_text() == "truth"


def test_profiles_rise_to_the_share_that_was_flown(page):
    curves = page.locator("#profile .curve")
    assert curves.count() == 4
    data = json.loads(page.locator("#data").text_content())
    assert data["profiles"]["vqf"][-1] == pytest.approx(5 / 6, abs=1e-4)
    assert all(np.diff(each).min() >= 0 for each in data["profiles"].values())
    page.locator('#chips button[data-estimator="vqf"]').click()
    assert curves.count() == 3
    assert page.locator('#chips button[data-estimator="vqf"]').get_attribute("aria-pressed") == "false"


def test_combinations_are_listed_when_asked_for(page):
    assert not page.locator("#combinations table").is_visible()
    page.locator("#combinations summary").click()
    assert page.locator("#combinations tbody tr").count() == len(COMBINATIONS)
    page.locator("#combinations th button").nth(5).click()
    assert page.locator("#combinations tbody tr td:nth-child(6)").first.inner_text() == "crazyflie"


def test_page_is_no_wider_than_its_window(page):
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_theme_switches(page):
    before = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != before


def test_everyone_can_use_the_page(page):
    page.locator("#combinations summary").click()
    page.locator("#chips button").first.click()
    for _ in ("light", "dark"):
        assert findings(page) == []
        page.locator("#theme").click()


def test_names_of_users_run_nothing(browser, results, tmp_path):
    name = "</script><img src=x onerror=alert(1)>"
    cells = [
        replace(each, estimator=name, flights=[replace(flight, estimator=name) for flight in each.flights])
        for each in results.cells
        if each.estimator == "vqf"
    ]
    hostile = replace(results, estimators=[name], cells=cells)
    found = effects(COMBINATIONS, hostile)
    path = write_axes_report(tmp_path / "r.html", COMBINATIONS, hostile, found, title=name)
    page, noise = opened(browser, path)
    assert noise == [path.as_uri()]
    assert page.locator("#standings td").first.inner_text() == name
    assert page.locator("img").count() == 0
    page.close()
