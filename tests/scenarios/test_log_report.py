"""The report of estimators on recorded logs, as text and in a browser."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from accessibility import findings

from estimators import create
from estimators.evaluation.beliefs import Beliefs, Coverage
from estimators.evaluation.logs import RAW, LogScores, score_logs
from quadsim.logs.log_faults import SensorFault
from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample
from quadsim.rotation import quat_from_roll_pitch
from quadsim.vehicle import GRAVITY
from scenarios.log_report.log_page import MOST_SAMPLES, write_log_report
from scenarios.log_report.log_verdict import log_verdict


def log(name: str, bias: float | np.ndarray = 0.0, seconds: float = 40.0):
    """A slow roll of 20° in still air, with a gyroscope bias about x [rad/s]."""
    time = np.arange(0.0, seconds, 0.005)
    roll = np.radians(20.0) * np.sin(0.8 * time)
    gyro = np.zeros((time.size, 3))
    gyro[:, 0] = np.radians(20.0) * 0.8 * np.cos(0.8 * time) + bias
    accel = GRAVITY * np.stack([0.0 * roll, np.sin(roll), np.cos(roll)], axis=1)
    quat = quat_from_roll_pitch(np.stack([roll, 0.0 * roll], axis=1))
    return resample(Recording(name, "x", time, gyro, accel, "x", time, quat), 200.0)[0]


@pytest.fixture(scope="module")
def scored():
    logs = [log("calm & <quiet>"), log("biased", math.radians(3.0))]
    scores = score_logs(logs, ["mahony", "eskf", "complementary"], within_deg=90.0)
    zero, probability = np.zeros((1, 1, 2)), np.array([[[0.25, 0.75]]])
    believed = Beliefs(("drag", "hand"), np.array([1000]), zero, zero + 1.0, probability)
    scores.logs["calm & <quiet>"].beliefs["imm"] = believed
    return logs, scores


@pytest.fixture(scope="module")
def report(scored, tmp_path_factory):
    return write_log_report(tmp_path_factory.mktemp("report") / "report.html", scored[1], ["mount `it <so>`"])


def test_verdict_names_the_best_the_bias_and_what_is_believed(scored):
    found = log_verdict(scored[1])
    text = " ".join(found.lines)
    assert found.headline.startswith("Smallest error: ")
    assert re.search(r"2 logs, \d+ s scored", text)
    assert "has a bias of up to 3.0 °/s" in text
    assert "quadsim identify --still" in text
    assert "hand 75 %, drag 25 %" in text


def test_headline_names_estimators_that_do_not_differ_significantly_from_the_best():
    scores = score_logs(
        [log("long", seconds=80.0)], {"a": create("eskf"), "b": create("eskf")}, within_deg=90.0
    )
    assert log_verdict(scores).headline.endswith("RMSE (the difference from b is not significant).")
    one = scores.logs["long"]
    one.estimates["b"] = one.estimates["b"] + np.radians(5.0)
    assert scores.tied == []
    scores.logs["long"] = replace(one, flights=replace(one.flights, truth=one.flights.truth * np.nan))
    assert scores.tied is None  # no block counts
    assert log_verdict(scores).headline.endswith(
        "(too little is scored to say which differences are significant)."
    )


def test_verdict_says_when_nothing_beats_a_level_guess(scored):
    scores = replace(scored[1], table=scored[1].table.assign(inclination_rmse_deg=10.0))
    assert log_verdict(scores).headline.startswith("No estimator is much better than a level guess (10.00°)")


FAULTS = {
    "bias jump": SensorFault("bias jump", "gyroscope", "x", 12.0, 40.0, "the bias jumps by +3.0 °/s"),
    "vibration": SensorFault("vibration", "accelerometer", "xyz", 5.0, 9.0, "it vibrates by 4.0 m/s² RMS"),
}


def with_faults(scores: LogScores, **faults: tuple[SensorFault, ...]) -> LogScores:
    logs = {name: replace(each, faults=faults.get(name, ())) for name, each in scores.logs.items()}
    return replace(scores, logs=logs)


@pytest.mark.parametrize("kind", FAULTS)
def test_means_and_headline_are_without_faulty_logs(scored, kind):
    scores = with_faults(scored[1], biased=(FAULTS[kind],))
    on_log = scores.on_logs()
    alone = on_log["calm & <quiet>"].to_dict()
    assert {name: scores.mean(name, RAW) for name in alone} == pytest.approx(alone)
    found, best = log_verdict(scores), min(alone, key=lambda name: alone[name])
    smallest = f"{best}, {alone[best]:.2f}° inclination RMSE"
    assert found.headline == f"Smallest error: {smallest}, over the logs without a fault."
    assert "1 of 2 logs has a sensor fault. Means and headline exclude biased." in found.lines
    (said,) = [line for line in found.lines if FAULTS[kind].sentence in line]
    smallest = on_log["biased"].drop("level").min()
    assert f"The smallest error on this log is {smallest:.2f}°" in said


def test_a_sensor_that_fails_is_not_to_be_calibrated(scored):
    sound = log_verdict(scored[1])
    failing = dict.fromkeys(scored[1].logs, (FAULTS["bias jump"],))
    faulty = log_verdict(with_faults(scored[1], **failing))
    assert any("Calibrate the sensor" in line for line in sound.lines)
    assert not any("Calibrate the sensor" in line for line in faulty.lines)
    assert any("Calibration does not cure a bias that jumps" in line for line in faulty.lines)
    assert not any("does not cure" in line for line in sound.lines)
    assert faulty.headline.endswith("but all logs have a sensor fault.")
    assert any(line.startswith("A sensor fault begins in every log") for line in faulty.lines)


def test_the_faults_of_a_recording_are_those_of_its_scores_and_table(tmp_path):
    jumped = log("jumped", bias=math.radians(3.0) * (np.arange(8000) > 4000))
    scores = score_logs([jumped], ["mahony"], within_deg=90.0)
    assert [fault.kind for fault in scores.logs["jumped"].faults] == ["bias jump"]
    assert set(scores.table.faults) == {"bias jump, gyroscope x"}
    assert any(line.startswith("One log is not enough") for line in log_verdict(scores).lines)


@pytest.mark.parametrize(
    ("inside", "sigma", "rmse", "said"),
    [
        (1.0, 11.6, 2.5, ", so the interval is too wide"),
        (0.97, 6.0, 2.5, ", so the interval is too wide"),
        (1.0, 2.6, 2.5, ""),
        (0.97, 9.0, 9.0, ""),
    ],
)
def test_an_interval_is_too_wide_by_its_sigma_beside_the_error_alone(inside, sigma, rmse, said):
    covered = f"{100 * inside:.0f} % of the true angles are inside its 95 % interval"
    figures = f"its median σ is {sigma}° at an error of {rmse}° RMS"
    assert Coverage(inside, sigma, rmse).text == f"{covered}; {figures}{said}"


def test_the_error_beside_an_interval_is_of_roll_and_pitch_where_they_count():
    sigma = np.radians([[[4.0, 4.0], [50.0, 50.0]]])
    believed = Beliefs(("one",), np.array([0, 1]), np.zeros((1, 2, 2)), sigma, np.ones((1, 2, 1)))
    truth = np.radians([[[3.0, 3.0], [90.0, 80.0]]])
    assert believed.interval(truth, np.array([[True, False]])) == pytest.approx((1.0, 4.0, 3.0))
    assert np.isnan(believed.interval(truth * np.nan).inside)


def test_page_needs_nothing_else_and_escapes_what_is_the_user_s(report):
    text = report.read_text()
    assert "calm &amp; &lt;quiet&gt;" in text
    assert "mount <code>it &lt;so&gt;</code>" in text
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert "Permission is hereby granted" in text  # uPlot's licence goes with it


def test_a_single_log_has_no_column_beside_the_means_and_no_interval_over_flights(report, tmp_path):
    scores = score_logs([log("only")], ["mahony"])
    page = write_log_report(tmp_path / "r.html", scores).read_text()
    assert re.findall(r'class="num"><button type="button">(.*?)<', page) == [
        "raw",
        "bias removed",
        "silenced",
    ]
    assert len(re.findall(r'class="num"><button', report.read_text())) == 3 + 2
    assert not scores.table.filter(regex="low|high|tied").columns.any()


def test_long_logs_are_decimated(tmp_path):
    logs = [log("long", seconds=(MOST_SAMPLES + 100) / 200.0)]
    page = write_log_report(tmp_path / "r.html", score_logs(logs, ["complementary"]))
    assert "every 2th sample is drawn" not in page.read_text()
    assert "one sample of 2 is drawn" in page.read_text()


@pytest.fixture(scope="module", params=[(1280, 900), (390, 844)], ids=["desktop", "phone"])
def page(request, browser, report):
    """The report, open; errors are looked at afterwards."""
    page = browser.new_page(viewport=dict(zip(("width", "height"), request.param, strict=True)))
    noise = []
    page.on("console", lambda message: noise.append(message.text))
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.goto(report.as_uri())
    page.wait_for_selector(".uplot")
    yield page
    assert noise == []
    page.close()


def test_faults_are_bands_with_a_sentence(browser, scored, tmp_path):
    scores = with_faults(scored[1], biased=tuple(FAULTS.values()))
    page = browser.new_page()
    page.goto(write_log_report(tmp_path / "r.html", scores).as_uri())
    page.wait_for_selector(".uplot")
    page.select_option("#log", "biased")
    assert page.evaluate("log.faults.map((each) => each.slice(1, 3))") == [[12, 40], [5, 9]]
    said = page.inner_text("#faults")
    assert all(fault.evidence in said for fault in FAULTS.values())
    page.close()


def test_traces_are_those_of_the_log(page, scored):
    logs, scores = scored
    found = np.array(page.evaluate("data.logs['biased'].trace['roll|truth']"), float)
    np.testing.assert_allclose(found, np.degrees(scores.logs["biased"].truth[:, 0]), atol=1e-3)
    found = np.array(page.evaluate("data.logs['biased'].trace['gyro x']"), float)
    np.testing.assert_allclose(found, np.degrees(logs[1]["gyro"].to_numpy()[0, :, 0]), atol=2e-3)


def test_panels_have_one_time_axis(page):
    page.evaluate("PLOTS[0].setScale('x', {min: 5, max: 6})")
    assert page.evaluate("PLOTS.map((plot) => [plot.scales.x.min, plot.scales.x.max])") == [[5, 6]] * 6
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    hint = page.get_by_text("Scroll the table sideways").first
    assert hint.is_visible() == page.evaluate(
        "all('.scroll').some((box) => box.scrollWidth > box.clientWidth + 1)"
    )
    assert findings(page) == []


def test_numbers_of_panels_have_a_minus_sign_and_no_negative_zero(page):
    assert page.evaluate("[-2.5, -0.001, 0, null].map(shownValue)") == ["−2.50", "0.00", "0.00", ""]


def test_another_log_and_another_estimator_are_drawn(page, scored):
    page.select_option("#log", "biased")
    assert page.evaluate("PLOTS.length") == 5  # imm was not scored on it
    before = page.evaluate("PLOTS.at(-1).series.length")
    assert page.locator("#chips button").all_inner_texts() == scored[1].ranked
    page.click("#chips button >> nth=0")
    assert abs(page.evaluate("PLOTS.at(-1).series.length") - before) == 1


def test_a_log_without_truth_is_drawn(browser, tmp_path):
    blank = log("blank")
    blank["quat"][:] = np.nan
    scores = score_logs([blank], {name: create(name) for name in ("imm", "mahony", "vqf")})
    page, noise = browser.new_page(), []
    page.on("pageerror", lambda error: noise.append(str(error)))
    page.goto(write_log_report(tmp_path / "r.html", scores).as_uri())
    page.wait_for_selector(".uplot")
    titles = page.evaluate("panels().filter((panel) => panel.lines.length).map((panel) => panel.title)")
    assert titles[2:] == ["roll [°]", "pitch [°]", "probability of imm's models", "standard deviation [°]"]
    assert page.locator("th button").all_inner_texts()[:2] == ["estimator", "horizontal force [m/s²]"]
    assert noise == []
    page.close()
