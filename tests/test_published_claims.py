"""Scripts that publish a comparison raise where it does not hold."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from estimators import create
from estimators.evaluation.flights import load_flights


@pytest.fixture(scope="module")
def flight(make_flights):
    flights = make_flights(flights=1, seconds=2.0)
    return SimpleNamespace(gyro=flights.gyro.values, accel=flights.accel.values)


@pytest.mark.parametrize("value", [2.0, np.nan])
def test_a_number_beyond_its_claim_is_an_error_that_says_it(script, value):
    with pytest.raises(ValueError, match=rf"outputs that differ: {value:g}, should be at most 1"):
        script("pages").confirmed("outputs that differ", value, 1)
    assert script("pages").confirmed("outputs that differ", 1, 1) == 1


def test_the_page_of_microcontrollers_refuses_outputs_that_are_not_the_emulators(script, flight, monkeypatch):
    deploy = script("cortex")
    gyro, accel = flight.gyro[0, :50], flight.accel[0, :50]
    ours = deploy.emulated("att-snn", gyro, accel)
    found = iter((ours, np.nextafter(ours, 2.0)))
    monkeypatch.setattr(deploy, "networks", lambda: ["att-snn"])
    monkeypatch.setattr(deploy, "samples", lambda data: (gyro, accel))
    monkeypatch.setattr(
        deploy,
        "measure_on_core",
        lambda *given: (deploy.Size(1, 1, 1), deploy.ProgramRun(next(found), np.ones((50, 3), np.int64))),
    )
    rows = deploy.instruction_counts(Path())
    assert next(rows)[-1] == "0 of 150"
    with pytest.raises(ValueError, match=r"att-snn on Cortex-M7: outputs.*: 150, should be at most 0"):
        next(rows)


def test_the_page_of_training_compares_floats_with_the_chip(script, make_flights, monkeypatch):
    pytest.importorskip("rotorpy")
    page = script("layers")
    flights = load_flights([make_flights(flights=1, seconds=2.0)])
    assert page.cost_of_rounding(flights) < 1.0
    monkeypatch.setattr(page, "create", lambda name, **_: page.without_rounding(page.NAME))
    assert page.cost_of_rounding(flights) == 0.0
    made = iter((create("att-rnn-paper"), create("att-snn-paper")))
    monkeypatch.setattr(page, "create", lambda name, **_: next(made))
    with pytest.raises(ValueError, match="att-snn-paper: estimates that differ on the emulated chip"):
        page.cost_of_rounding(flights)
