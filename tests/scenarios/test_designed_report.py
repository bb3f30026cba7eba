"""The report of a designed benchmark, in a browser."""

import pytest
from accessibility import findings
from flown import benchmark, crash

from quadsim.runs.record import RunRecord
from scenarios.bench.experiment import load_experiment
from scenarios.report.page import write_report


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """Four levels of drag, which vqf flies worse and worse; the truth, and one that needs the vehicle."""
    axes = load_experiment("axes")
    levels = {
        f"axes-{k}": {axis: list(of)[k % len(of)] for axis, of in axes.axes.items()} | {"scenario": "hover"}
        for k in range(4)
    }
    outcomes = {
        "truth": [[0.0, 0.0]] * 4,
        "imm": [[1.0, 1.1]] * 4,
        "vqf": [[2.0, crash(5.0)], [3.0, 3.1], [4.0, 4.1], [5.0, 5.1]],
        "ekf-drag": [[0.5, 0.6], [0.5, 0.6], [0.5, 0.6], "needs a vehicle"],
    }
    flown = {name: dict(zip(levels, own, strict=True)) for name, own in outcomes.items()}
    results = benchmark(flown, experiment=axes, levels=levels)
    record = RunRecord("9.9.9", "abc1234", "quadsim bench", "2031-01-01 00:00:00", 3600.0)
    path = tmp_path_factory.mktemp("axes") / "report.html"
    return write_report(path, results, record=record)


def test_every_axis_has_a_table_that_shows_its_levels(browser, designed):
    page, noise = browser.new_page(viewport={"width": 390, "height": 844}), []
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.goto(designed.as_uri())
    assert page.locator("#map table").count() == 6
    assert page.locator("#map table").nth(2).locator("thead th").all_inner_texts()[2:] == list(
        load_experiment("axes").axes["drag"]
    )
    rows = page.locator("#map table").nth(2).locator('td[data-level][data-estimator="vqf"]')
    shown = [text.split() for text in rows.all_inner_texts()]
    assert shown == [["2.00", "✕", "1/2"], ["3.05"], ["4.05"], ["5.05"]]
    failed = page.locator('#map td[data-level="drag|not known|ekf-drag"]')
    assert (failed.inner_text().strip(), failed.get_attribute("title")) == ("failed", "needs a vehicle")
    assert page.locator("#standings tbody tr").last.locator("th").inner_text() == "truth"
    for part in ("quadsim 9.9.9, commit abc1234", "2031-01-01 00:00:00 UTC, after 60.0 min"):
        assert part in page.locator("#provenance").inner_text()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for _ in ("light", "dark"):
        assert findings(page) == []
        page.locator("#theme").click()
    assert noise == []
    page.close()
