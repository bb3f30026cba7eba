"""The command line: what it says to a newcomer, to a mistake, and at the end of the work."""

import ctypes
import re
import signal
import sys
import time
from types import SimpleNamespace

import pytest
from filelock import FileLock
from typer.main import get_command

from estimators.networks.weights_file import load_network
from quadsim.cli import app, repeat_interrupt
from quadsim.cli.catalogue import HOW
from quadsim.runs.record import load_record
from training.epochs import INTERRUPTED

VERBS = get_command(app).commands


@pytest.fixture
def dataset(printed, tmp_path):
    path = tmp_path / "flights.zarr"
    out = printed("generate", "--flights", 2, "--duration", 2, "--workers", 1, "--out", path)
    assert "2 flights of 2 s at 200 Hz" in out
    return path


@pytest.mark.parametrize(
    "command",
    [
        "bench --scenario hover --estimator mahony",
        "fly hover --estimator mahony",
        "demo",
        "paper --only table2",
        "evaluate --data flights.zarr --estimator mahony",
        "train --data flights.zarr",
        "train --preset control-attitude",
    ],
)
def test_a_folder_that_another_process_writes_is_left_alone(printed, refused, tmp_path, command):
    if "--data" in command:
        printed("generate", "--flights", 4, "--duration", 1, "--workers", 1, "--out", "flights.zarr")
    with FileLock(tmp_path / ".busy.lock"):
        line = refused(*command.split(), "--out", "busy")
    assert line == "quadsim: busy is being written by another process: wait for it, or choose another"
    assert not (tmp_path / "busy").exists()


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself_in_eighty_columns_and_closed_boxes(printed, monkeypatch, verb):
    monkeypatch.setenv("COLUMNS", "80")
    out = printed(verb, "--help")
    assert "Usage: quadsim" in out
    assert len(out.splitlines()) > 8
    for line in out.splitlines():
        assert len(line) <= 80
        if line[:1] in ("╭", "│", "╰"):
            assert (len(line), line[-1]) == (80, {"╭": "╮", "│": "│", "╰": "╯"}[line[0]])


def test_everything_that_ships_can_be_listed_with_a_sentence(printed):
    for kind in HOW:
        names = [row for row in printed("list", kind).splitlines()[1:-1] if not row.startswith(" ")]
        assert names
        assert all(len(row.split()) >= 3 for row in names), kind


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("fly", "Missing argument 'scenario' (see quadsim fly --help)"),
        ("generate --out x.zarr --flights some", "'--flights'"),
        ("flyy hover", "Did you mean 'fly'? (see quadsim --help)"),
        ("generate --out x.zarr --set imu=missing.toml", "missing.toml"),
        ("generate --out /proc/x.zarr --flights 1 --duration 1", "/proc/x.zarr"),
        ("generate --out x.zarr --set vehicel=x", 'did you mean "vehicle"'),
        ("generate --out x.zarr --set rate=3", "50 to 2000 Hz"),
        ("generate --out x.zarr --workers many", "should be a valid integer"),
        ("report missing.zarr --verify", "missing.zarr"),
        ("report missing.zarr --data x.zarr", "--data does not apply to a dataset"),
        ("export missing.safetensors --out x --format c99", "missing.safetensors"),
        ("train --data missing.zarr --out run", "missing.zarr"),
        ("train --data missing.zarr --out run --set epochs", "name=value"),
        ("train --data missing.zarr --out run --set epoch=1", "valid: vectors, gates"),
        ("train --data missing.zarr --out run --set seed=3", "another option sets"),
        ("train --data missing.zarr --out run --set rate_targets=(0.1,0.1)", "a list as [1, 2]"),
        ("tune --estimator mahony --data missing.zarr --out bad.toml", "bad.toml: not valid TOML"),
        ("evaluate --data missing.zarr", "missing.zarr"),
        ("report notes.txt", "notes.txt"),
        (
            "report empty --out x.html",
            "empty: contains no finished entry of a task, no benchmark and no dataset",
        ),
        ("generate --out x.zarr --set vehicle=bad.toml", "bad.toml: not valid TOML: Invalid value (at line"),
        ("identify nowhere.zarr", "nowhere.zarr"),
        ("identify nowhere.zarr --out mine.txt", "ends in .toml"),
        ("list scenario", 'unknown kind "scenario"; did you mean "scenarios"?'),
        ("fly hoover", "hover"),
        ("fly hover --rerun x.mp4", "x.mp4: should end in .rrd"),
        ("fly hover --mcap /proc/x.mcap", "/proc/"),
        ("evaluate --data missing.zarr --mcap x.mcap", "need exactly one --logs"),
        ("evaluate --logs a --logs b --rerun x.rrd", "need exactly one --logs"),
        ("evaluate --data missing.zarr --set tunning=x", 'did you mean "tuning"'),
        ("bench --scenario hover --estimator mahoni", "mahony"),
        ("bench --scenario missing.toml", "missing.toml"),
        ("bench --scenario hover --experiment rain", "breaking-points"),
        ("bench --experiment held-out --seed 1", "its own seed"),
        ("bench --scenario hover --set external=vicon", "vicon"),
        ("paper --out x --only fig12", "fig"),
        ("paper --out x --preset fast", "full and quick"),
        ("report missing.safetensors", "missing.safetensors"),
        ("report att-rnn-paper", "weights of att-snn"),
        ("bench --scenario hover --estimator att-snn --set rate=100 --seeds 1", "200 Hz"),
    ],
)
def test_a_mistake_is_one_clear_line_and_exit_code_2_and_leaves_nothing(refused, tmp_path, command, said):
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.toml").write_text("mass = \n")
    assert said in refused(*command.split())
    assert {each.name for each in tmp_path.iterdir()} <= {"empty", "notes.txt", "bad.toml", "reports"}


def test_tuning_writes_the_whole_command_and_evaluation_reads_the_values(printed, refused, dataset, tmp_path):
    options = ["--particles", 3, "--iterations", 2, "--flights", 1, "--seed", 5]
    tune = ["tune", "--data", dataset, "--out", "mine.toml", "--estimator"]
    assert "madgwick" in printed(*tune, "madgwick", *options)
    text = (tmp_path / "mine.toml").read_text()
    assert "--particles 3 --iterations 2 --flights 1 --seed 5" in text
    refused(*tune, "truth")
    given = ["--data", dataset, "--estimator", "madgwick", "--set", f"tuning={tmp_path / 'mine.toml'}"]
    out = printed("evaluate", *given, "--out", tmp_path / "scores")
    assert "madgwick has the smallest error from an unknown start" in out
    written = {"evaluation.csv", "violins.png", "convergence.png", "report.html"}
    assert {each.name for each in (tmp_path / "scores").iterdir()} == written


def test_a_dataset_is_described_verified_drawn_and_exported(printed, dataset, tmp_path):
    out = printed("report", dataset, "--verify", "--out", "picture.png")
    assert "2 flights match their checksums" in out
    assert "max_tilt_deg" in out
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    printed("export", dataset, "--out", "flights.nc", "--format", "netcdf")


def test_a_report_of_weights_shows_where_the_neurons_go(printed):
    out = printed("report", "att-snn-paper")
    for heading in ("compartments", "synaptic", "formats", "fan-in", "(1048576)"):
        assert heading in out
    config, _ = load_network("att-snn-paper")
    assert f"{config.encoding + config.hidden + config.n_outputs} neurons on 7 of a chip's 128 cores" in out


def test_a_report_of_weights_on_flights_has_spikes_energy_and_error(printed, refused, dataset):
    out = printed("report", "att-snn-paper", "--data", dataset)
    for line in ("encoding layer", "synaptic event, a step", "modelled dynamic energy", "error"):
        assert line in out
    assert re.search(r"of a chip's 128 cores, error \d+\.\d\d°", out)
    refused("report", "control-attitude", "--data", dataset)


def test_a_verb_has_at_most_eight_options_beside_the_common_ones():
    common = {"--out", "--seed", "--set", "--help"}
    assert len(VERBS) <= 14
    for verb, command in VERBS.items():
        options = {each.opts[0] for each in command.params if each.param_type_name == "option"} - common
        assert len(options) <= 8, verb


WIND = """description = "Wind."
scenarios = ["hover"]
[sweeps.wind]
unit = "m/s"
scenario = "hover"
fields = { wind = [{ kind = "constant", velocity = [1.0, 0.0, 0.0] }] }
scaled = "wind.0.velocity"
levels = [2, 4]
"""


def test_bench_flies_an_experiment_of_the_users_and_reports_it_again(printed, tmp_path):
    (tmp_path / "wind.toml").write_text(WIND)
    flown = ["--estimator", "truth", "--seeds", 1, "--duration", 0.5, "--workers", 1, "--out", tmp_path]
    out = printed("bench", "--experiment", tmp_path / "wind.toml", *flown)
    assert "> 4 m/s" in out
    assert {"results.csv", "flights.parquet", "bench.json"} < {path.name for path in tmp_path.iterdir()}
    first = (tmp_path / "report.html").read_text()
    assert "<h2>Estimator × condition</h2>" in first
    printed("report", tmp_path)
    assert (tmp_path / "report.html").read_text() == first
    printed("report", tmp_path, "--out", tmp_path / "else" / "a.html")
    assert 'href="../results.csv"' in (tmp_path / "else" / "a.html").read_text()
    printed("bench", "--scenario", "hover", *flown)
    assert "<h2>Estimator × scenario</h2>" in (tmp_path / "report.html").read_text()


def test_bench_leaves_the_slow_out_and_its_reports_say_how_they_were_made(printed, tmp_path, monkeypatch):
    monkeypatch.setattr("estimators.names", lambda: ["truth", "mahony", "ukf-filterpy"])
    flown = ["--scenario", "hover", "--seeds", 1, "--duration", 0.5, "--workers", 1, "--out", tmp_path]
    out = printed("bench", *flown)
    assert "Not included: ukf-filterpy (ten times as slow as ekf-filterpy), att-snn (the" in out
    assert "2 flights, 1 s in the air; " in out
    assert "The airframe is hummingbird. Its drag is known. The IMU is adis16448." in out
    text = (tmp_path / "report.html").read_text()
    assert "<dt>command</dt>" in text
    assert "--scenario hover --seeds 1" in text
    written = load_record(tmp_path)
    printed("report", tmp_path)
    assert load_record(tmp_path) == written
    assert written.date in (tmp_path / "report.html").read_text()


def test_ctrl_c_exits_as_interrupted_also_where_a_training_ends_in_order(quadsim, monkeypatch):
    best = SimpleNamespace(epoch=0)
    stopped = SimpleNamespace(best=best, weights="run/best.safetensors", reason=INTERRUPTED, before=None)
    monkeypatch.setattr("training.epochs.train_epochs", lambda *_, **__: stopped)
    code, out, err = quadsim("train", "--preset", "paper", "--data", "data.zarr", "--out", "run")
    assert code == 130
    assert "interrupted; finished work is kept" in err
    assert "best.safetensors" in out


@pytest.mark.parametrize("other", [signal.default_int_handler, signal.SIG_IGN])  # ignored in the background
def test_a_signal_in_a_callback_from_c_interrupts_too(monkeypatch, other):
    monkeypatch.setattr(sys, "unraisablehook", repeat_interrupt)
    handlers = {signal.SIGTERM: signal.default_int_handler, signal.SIGINT: other}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGTERM))()  # Python drops this one
        with pytest.raises(KeyboardInterrupt):
            time.sleep(10)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_what_is_refused_before_any_work_shows_one_line_and_no_bar(quadsim):
    code, out, err = quadsim("train", "--model", "att-snn", "--data", "nowhere", "--out", "run")
    assert (code, out, len(err.strip().splitlines())) == (2, "", 1)


def test_a_fault_after_the_end_of_the_flight_is_warned_of(quadsim):
    code, out, err = quadsim("fly", "gyro-bias-step", "--estimator", "mahony", "--duration", 0.5)
    assert code == 0
    assert "gyro-bias-step ends at 0.5 s, before its fault bias at 6 s" in (out + err)


def test_a_flight_and_estimators_on_its_log_are_written_for_viewers(printed, tmp_path):
    pytest.importorskip("mcap")
    flown = ["--estimator", "eskf", "--duration", 4, "--out", "out", "--mcap", "flight.mcap"]
    printed("fly", "wind-gust", *flown)
    said = printed("evaluate", "--logs", "flight.mcap", "--estimator", "eskf", "--mcap", "log.mcap")
    assert "the smallest error" in said or "eskf" in said
    with (tmp_path / "flight.mcap").open("rb") as first, (tmp_path / "log.mcap").open("rb") as second:
        topics = [topics_of(each) for each in (first, second)]
    assert topics[0] - topics[1] == {
        f"/traces/{name}" for name in ("position", "gyroscope_bias", "wind", "rotor_speed")
    }
    assert {"/body", "/frames/eskf", "/imu", "/scene", "/traces/roll"} <= topics[1]
    assert topics[1] < topics[0]


def topics_of(stream):
    from mcap.reader import make_reader

    return {channel.topic for channel in make_reader(stream).get_summary().channels.values()}


@pytest.mark.parametrize(
    ("module", "package", "extra", "command"),
    [
        ("nir", "nir", "export", "export att-snn-paper --format nir --out x"),
        ("pyulog", "pyulog", "logs", "report x.ulg"),
        ("mcap.reader", "mcap", "logs", "report x.mcap"),
        ("rerun", "rerun", "watch", "fly hover --rerun y.rrd"),
    ],
)
def test_a_missing_package_is_one_line_with_its_extra(
    refused, dataset, tmp_path, monkeypatch, module, package, extra, command
):
    for name in ("x.ulg", "x.mcap"):
        (tmp_path / name).touch()
    monkeypatch.delitem(sys.modules, "estimators.export.nir_graph", raising=False)
    monkeypatch.setitem(sys.modules, module, None)
    line = refused(*command.split())
    assert line == f'quadsim: the package {package} is missing: pip install "quadsim[{extra}]"'
    assert not (tmp_path / "x").exists()
