"""Scripts that publish a comparison raise where it does not hold."""

import shutil
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.evaluation.flights import load_flights
from estimators.networks.weights_file import load_network

DOCS = Path(__file__).parents[1] / "docs"
SCRIPTS = (
    *("loihi", "deploy", "speed", "training_page", "control_page"),
    *("cortex", "simulated", "pages", "foreign", "ppo_controller"),
)


@pytest.fixture(scope="module")
def script():
    """A function that imports a script of docs/."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        yield import_module
    for name in SCRIPTS:
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def loihi(script):
    for name in ("norse.torch", "snntorch", "onnxruntime", "nir"):
        pytest.importorskip(name)
    return script("loihi")


@pytest.fixture(scope="module")
def flight(make_flights):
    flights = make_flights(flights=1, seconds=2.0)
    return SimpleNamespace(gyro=flights.gyro.values, accel=flights.accel.values)


@pytest.mark.parametrize("value", [2.0, np.nan])
def test_a_number_beyond_its_claim_is_an_error_that_says_it(script, value):
    with pytest.raises(ValueError, match=rf"outputs that differ: {value:g}, should be at most 1"):
        script("pages").confirmed("outputs that differ", value, 1)
    assert script("pages").confirmed("outputs that differ", 1, 1) == 1


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_exports_on_the_page_of_the_chip_are_the_networks(loihi, flight):
    found = loihi.export_rows(flight)
    assert [row.split("|")[2].split()[0].strip("`") for row in found] == ["cc", "Norse", "snnTorch", "ONNX"]
    assert all("| 0 differ" in row for row in found[:3])


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_page_of_the_chip_refuses_c_code_of_another_network(loihi, flight, monkeypatch, tmp_path):
    emulated = loihi.emulated
    monkeypatch.setattr(loihi, "emulated", lambda *given: np.add(emulated(*given), [0.0, 0.0, 1e-12]))
    with pytest.raises(ValueError, match=r"C99.*: \d+, should be at most 0"):
        loihi.export_rows(flight)


def test_the_page_of_the_chip_refuses_an_onnx_graph_of_another_network(loihi, flight, monkeypatch, tmp_path):
    sequence = loihi.roll_pitch_of_up
    monkeypatch.setattr(loihi, "roll_pitch_of_up", lambda up: sequence(np.add(up, [0.0, 0.0, 1.0])))
    with pytest.raises(ValueError, match=r"ONNX"):
        loihi.onnx_row(tmp_path, flight.gyro, flight.accel)


def test_the_page_of_the_chip_refuses_spikes_of_another_network(loihi, flight, monkeypatch, tmp_path):
    config, tensors = load_network("att-snn")
    monkeypatch.setattr(
        loihi, "shipped_network", lambda name: (config, tensors | {"w_ff": np.roll(tensors["w_ff"], 1, 0)})
    )
    with pytest.raises(ValueError, match="Norse: share of spikes that differ"):
        loihi.nir_rows(tmp_path, flight.gyro, flight.accel)


def test_the_page_of_the_chip_refuses_states_that_are_not_lavas(loihi, monkeypatch):
    load = np.load

    def changed(path):
        found = dict(load(path))
        if "golden" in Path(path).name:
            found["L0_v"] = found["L0_v"] + 1
        return found

    monkeypatch.setattr(loihi.np, "load", changed)
    with pytest.raises(ValueError, match=r"a_single_bias.*should be at most 0"):
        loihi.golden_rows()


def test_the_page_of_microcontrollers_refuses_outputs_that_are_not_the_emulators(script, flight, monkeypatch):
    deploy = script("deploy")
    gyro, accel = flight.gyro[0, :50], flight.accel[0, :50]
    ours = deploy.emulated("att-snn", gyro, accel)
    found = iter((ours, np.nextafter(ours, 2.0)))
    monkeypatch.setattr(deploy, "networks", lambda: ["att-snn"])
    monkeypatch.setattr(deploy, "samples", lambda data: (gyro, accel))
    monkeypatch.setattr(
        deploy,
        "measured",
        lambda *given: (deploy.Size(1, 1, 1), deploy.Run(next(found), np.ones((50, 3), np.int64))),
    )
    rows = deploy.rows(Path())
    assert next(rows).endswith("| 0 of 150 |")
    with pytest.raises(ValueError, match=r"att-snn on Cortex-M7: outputs.*: 150, should be at most 0"):
        next(rows)


def test_the_page_of_speed_measures_how_far_the_engines_are_apart(script, monkeypatch):
    speed = script("speed")
    assert 0.0 < speed.engine_difference(0.5, 2) < 1e-12
    monkeypatch.setattr(speed, "AGREEMENT", 1e-20)
    with pytest.raises(ValueError, match="difference of the engines"):
        speed.engine_difference(0.5, 2)


def test_the_page_of_training_compares_floats_with_the_chip(script, make_flights, monkeypatch):
    pytest.importorskip("rotorpy")
    page = script("training_page")
    flights = load_flights([make_flights(flights=1, seconds=2.0)])
    assert page.cost_of_rounding(flights) < 1.0
    monkeypatch.setattr(page, "create", lambda name: page.without_rounding("att-snn"))
    assert page.cost_of_rounding(flights) == 0.0
    made = iter((page.without_rounding("att-snn-paper"), page.without_rounding("att-snn")))
    monkeypatch.setattr(page, "create", lambda name: next(made))
    with pytest.raises(ValueError, match="estimates that differ from those of att-snn-loihi"):
        page.cost_of_rounding(flights)


def test_the_page_of_controllers_refuses_a_crash_that_it_denies(script):
    pytest.importorskip("stable_baselines3")
    page = script("control_page")
    rows = {("lever-arm", title): SimpleNamespace(crashes=0) for title in page.NAMES}
    assert page.without_crash(rows, "lever-arm", page.NEVER_DISPLACED) == "`lever-arm`"
    rows["lever-arm", "spiking, merged, Att-SNN"].crashes = 1
    with pytest.raises(ValueError, match="spiking, merged, Att-SNN: crashes in lever-arm: 1"):
        page.without_crash(rows, "lever-arm", page.NEVER_DISPLACED)
