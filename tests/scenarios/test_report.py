"""The report, as text and in a browser."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from accessibility import findings
from flown import WINDY, crash, flight, unpack_series

import estimators
from estimators.appearance import look
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario
from scenarios.bench.cell import Cell, FlightSettings, make_cell
from scenarios.bench.flight_log import SHARED, fly_mission
from scenarios.bench.results import Results
from scenarios.report.page import OfflineSection, page_flights, write_report

OFFLINE = [
    {"estimator": "truth", "start": "known", "mean [°]": 0.0, "note": ""},
    {"estimator": "mahony", "start": "known", "mean [°]": 2.5, "note": ""},
    {"estimator": "ekf", "start": "known", "mean [°]": None, "note": "no weights <here>"},
]


@pytest.fixture(scope="module")
def results():
    """Two scenarios, three estimators: one flies, one crashes half the time, one did not run."""
    scenario = WINDY.model_copy(update={"description": "Hold a place & <stay> there."})
    mission = Mission(scenario, estimators.create("eskf"), 2)
    flown = fly_mission(mission, 0)
    cells = []
    for name in ("calm", "storm"):
        for estimator in ("truth", "mahony"):
            cell = make_cell(name, estimator, mission, flown)
            cells.append(replace(cell, receives_truth=estimator == "truth"))
        flights = [flight(0, crash(1.0, 9.0)), flight(1, 1.0)]
        cells.append(Cell(name, "ekf", "", flights, cells[0].histogram, cells[0].series))
        cells.append(Cell(name, "vqf", "no weights <here>"))
    names = ["truth", "mahony", "ekf", "vqf"]
    scenarios = {"calm": scenario, "storm": scenario}
    return Results(scenarios, names, FlightSettings(2), cells)


@pytest.fixture(scope="module")
def report(results, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    offline = OfflineSection(OFFLINE, headline="On recorded flights mahony is best.")
    return write_report(path, results, offline, files=["results.csv"], focus="ekf")


def test_report_fetches_nothing_and_text_of_users_is_escaped(report):
    text = report.read_text()
    assert not re.search(r"(@import|url\(|fetch\(|XMLHttpRequest|https?://)", text)
    assert not re.search(r"<(img|script|iframe|source|video|audio|link)[^>]*(src|href)=\"(?!data:)", text)
    assert "Hold a place &amp; &lt;stay&gt; there." in text
    assert "<stay>" not in text
    assert "no weights <here>" not in text


def test_report_of_recorded_flights_alone(tmp_path):
    section = OfflineSection(OFFLINE, headline="On recorded flights mahony is best.")
    text = write_report(tmp_path / "r.html", offline=section).read_text()
    assert "On recorded flights mahony is best." in text
    assert "<canvas" not in text


def test_signals_are_left_out_where_there_is_no_room(results, monkeypatch):
    monkeypatch.setattr("scenarios.report.page.DETAILED", 2)  # one estimator in each of two scenarios
    cells, shared = page_flights(results, ["truth", "mahony", "ekf", "vqf"])
    detailed = [series is not None and "gyro_x" in series.channels for series in cells]
    assert detailed == [False, True, False, False] * 2
    assert set(shared) == {"calm", "storm"}
    assert set(shared["calm"].channels) == set(SHARED)


def test_report_of_nothing_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nothing to report"):
        write_report(tmp_path / "r.html")


@pytest.fixture
def page(browser, report):
    """The report, open; errors and requests are looked at afterwards."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    noise, requests = [], []
    page.on("console", lambda message: noise.append(message.text))
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.on("request", lambda each: requests.append(each.url))
    page.goto(report.as_uri())
    page.wait_for_function("state.unpacked")
    yield page
    assert noise == []
    assert [url for url in requests if not url.startswith("data:")] == [report.as_uri()]
    page.close()


def column(page, number, table="#results"):
    return page.locator(f"{table} tbody tr td:nth-child({number})").all_inner_texts()


def painted(page, selector):
    """How many pixels of a canvas are not empty."""
    return page.evaluate(
        """selector => {
            const canvas = document.querySelector(selector);
            const image = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            return image.data.filter((value, i) => i % 4 == 3 && value).length;
        }""",
        selector,
    )


def test_everything_is_there(page):
    for part in ("verdict", "map", "series", "replay", "spread", "table", "offline", "method"):
        assert page.locator(f"#{part}").is_visible()
    assert page.locator("#verdict h2").inner_text().startswith("In calm and storm, fly mahony (no crash in 4")
    assert page.locator(".heat td[data-scenario]").count() == 8
    assert page.locator(".heat tbody td.mean").count() == 4
    assert page.locator("#violins polygon").count() == 2
    assert painted(page, "#plot canvas") > 1000
    assert painted(page, "#stage") > 1000


def test_flights_in_the_page_are_those_of_the_cells(page, results):
    for cell in results.cells:
        found = page.evaluate(
            """name => data.cells[name].flight && Object.fromEntries(
                Object.entries(data.cells[name].flight).map(([k, v]) => [k, k == "dt" ? v : [...v]]))""",
            f"{cell.scenario}|{cell.estimator}",
        )
        if cell.series is None:
            assert found is None
            continue
        expected = unpack_series(cell.series)
        shared = page.evaluate("name => Object.entries(data.shared[name].flight)", cell.scenario)
        found |= {name: values for name, values in shared if name in SHARED}
        assert found["dt"] == pytest.approx(expected.pop("time")[1])
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values.astype(np.float32), err_msg=name)


def test_headings_sort_both_ways_with_empty_cells_last(page):
    for descending in (False, True):
        page.locator("#results th button").nth(2).click()
        numbers = [float(text) for text in column(page, 3) if "did not run" not in text]
        assert numbers == sorted(numbers, reverse=descending)
        assert "did not run" in column(page, 3)[-1]
    assert page.locator("#results th").nth(2).get_attribute("aria-sort") == "descending"
    page.select_option("#table-scenario", "storm")
    assert page.locator("#results tbody tr:visible td:first-child").all_inner_texts() == ["storm"] * 4


def test_map_ranks_estimators_with_the_truth_last_and_has_their_mean_first(page, results):
    names = page.locator(".heat tbody th").all_inner_texts()
    assert [name.strip() for name in names] == ["mahony", "ekf", "vqf", "truth"]
    errors = [row.error_deg for row in results.rows if row.estimator == "mahony"]
    cells = page.locator('.heat td[data-estimator="mahony"] b').all_inner_texts()
    assert cells == [f"{value:.2f}" for value in (np.mean(errors), *errors)]
    assert page.locator('.heat td.mean[data-estimator="ekf"] small').inner_text() == "✕ 2/4"
    assert page.locator('.heat td.mean[data-estimator="vqf"] small').all_inner_texts()[-1] == "failed in 2"
    first, scroll = page.locator(".heat tbody th").first, page.locator("#map .scroll")
    before = first.bounding_box()["x"]
    scroll.evaluate("each => { each.scrollLeft = 80; }")
    assert first.bounding_box()["x"] == pytest.approx(before, abs=3)
    page.select_option("#map-metric", "crash_rate")
    assert page.locator('.heat td[data-estimator="ekf"] b').all_inner_texts() == ["0.50"] * 3
    assert page.locator(".heat td.crashed[data-scenario]").count() == 2
    assert page.locator(".heat td.crashed.mean").count() == 1


def test_a_cell_of_the_map_chooses_the_flight(page):
    page.locator('.heat td[data-scenario="storm"][data-estimator="ekf"]').click()
    assert page.locator("#series select.scenario").input_value() == "storm"
    assert page.locator('#chips button[data-estimator="ekf"]').get_attribute("aria-pressed") == "true"


def test_cursor_clock_and_replay_move_together(page):
    page.evaluate("document.getElementById('plot').scrollIntoView({behavior: 'instant'})")
    box = page.locator("#plot .u-over").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 60)
    assert re.search(r"mahony:?\s*\d", page.locator("#plot .u-legend").inner_text())
    assert page.evaluate("state.time") == pytest.approx(0.995, abs=0.02)
    cursors = page.evaluate("PLOTS.map((plot) => plot.posToVal(plot.cursor.left, 'x'))")
    assert cursors == pytest.approx([page.evaluate("state.time")] * 9, abs=0.02)
    assert page.locator("#clock-text").inner_text() == "1.0 s"
    page.locator("#clock").fill("0.5")
    cursors = page.evaluate("PLOTS.map((plot) => plot.posToVal(plot.cursor.left, 'x'))")
    assert cursors == pytest.approx([0.5] * 9, abs=0.01)


def test_a_click_into_a_panel_moves_the_playing_clock(page):
    page.evaluate("document.getElementById('speed').value = '0.25'")  # and no scrolling to it
    page.evaluate("document.getElementById('plot').scrollIntoView({behavior: 'instant'})")
    page.evaluate("document.getElementById('play').click()")
    page.wait_for_function("state.time > 0.02")
    box = page.locator("#plot .u-over").bounding_box()
    page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 100)
    assert page.evaluate("state.playing && state.time") == pytest.approx(1.25, abs=0.1)


def test_panels_show_the_signals_with_units_and_the_fault(page):
    titles = page.locator("#panels h3").all_inner_texts()
    assert [title.split(";")[0] for title in titles] == [
        "gyroscope [°/s]", "accelerometer [m/s²]", "gyroscope bias [°/s]", "wind, world axes [m/s]",
        "rotor commands [rad/s]", "roll [°]", "pitch [°]", "inclination error [°]",
    ]  # fmt: skip
    assert "± σ" in page.locator("#inside-note").inner_text()
    assert page.evaluate("data.faults.calm") == [["bias", 1.0, 2.0]]
    page.select_option("#inside", "ekf")
    page.evaluate("delete cell('calm', 'ekf').flight.gyro_x; redraw()")
    assert "quadsim fly calm --estimator ekf" in page.locator("#inside-note").inner_text()
    page.select_option("#inside", "vqf")
    assert page.locator("#inside-note").inner_text() == "No flight is stored for this choice."


def test_dragging_zooms_all_panels_and_double_click_shows_all(page):
    page.evaluate("document.getElementById('plot').scrollIntoView({behavior: 'instant'})")
    box = page.locator("#plot .u-over").bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 100)
    page.mouse.up()
    page.wait_for_function("PLOTS[0].scales.x.min > 0")
    ranges = page.evaluate("PLOTS.map((plot) => [plot.scales.x.min, plot.scales.x.max])")
    assert ranges == [ranges[0]] * 9
    assert 0 < ranges[0][0] < ranges[0][1] < page.evaluate("state.end")
    page.locator("#plot .u-over").dblclick()
    page.wait_for_function("PLOTS.every((p) => p.scales.x.min === 0 && p.scales.x.max === state.end)")


def test_everyone_can_use_the_page_in_both_themes_on_a_phone_too(page):
    before = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#chips button").first.click()  # one that is not shown
    assert findings(page) == []
    page.locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != before
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 844})
        assert findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_an_estimator_has_its_look_in_the_page(page):
    for place, name in product(["#chips button", "#map tbody th"], ["truth", "mahony", "ekf"]):
        path = page.locator(place, has_text=re.compile(f"^{name}$")).locator("path").first
        assert path.get_attribute("fill") == look(name).colour
        assert path.get_attribute("d") == page.evaluate("(marker) => MARKERS[marker]", look(name).marker)


HOSTILE = (
    "<img src=x onerror=hurt()>.safetensors",
    "<script>hurt()</script>",
    '"><svg onload=hurt()>',
    "' onmouseover='hurt()",
    "</script><script>hurt()</script>",
    "__proto__",
    "{{ 7 * 7 }}",
)


def test_names_of_users_run_nothing(browser, results, tmp_path):
    cells, names = [], list(HOSTILE)
    for scenario in HOSTILE[:3]:
        for name in names:
            unlike = {"cause": HOSTILE[0], "error_deg": 1.0 + len(cells)}
            flights = [each | unlike for each in results.cells[1].flights]
            cells.append(replace(results.cells[1], scenario=scenario, estimator=name, flights=flights))
        cells[-1] = Cell(scenario, names[-1], HOSTILE[0])
    described = Scenario(description=HOSTILE[1], duration_s=2.0)
    scenarios = dict.fromkeys(HOSTILE[:3], described)
    hostile = Results(scenarios, names, FlightSettings(2), cells)
    recorded = [{"estimator": name, "note": name, "start": name, "mean_deg": 1.0} for name in names]
    texts = {"title": HOSTILE[4], "files": [HOSTILE[2]], "focus": names[0], "footer": HOSTILE[4]}
    path = write_report(tmp_path / "report.html", hostile, OfflineSection(recorded, HOSTILE[0]), **texts)
    page = browser.new_page()
    hurt, noise = [], []
    page.expose_function("hurt", lambda: hurt.append(True))
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.goto(path.as_uri())
    for chip in page.locator("#chips button").all():
        chip.click()
    page.locator("#plot").hover()
    for select in page.locator("select").all():
        for k in range(select.locator("option").count()):
            select.select_option(index=k)
    page.wait_for_timeout(300)
    assert (hurt, noise) == ([], [])
    assert page.locator("main img[src=x], main script, main svg[onload]").count() == 0
    assert page.locator("#chips button").all_inner_texts() == names
    assert names[0] in page.locator("#violins text").all_text_contents()
    page.close()
