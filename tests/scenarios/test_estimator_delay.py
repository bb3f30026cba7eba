import numpy as np
import pytest

from quadsim.vehicle import load_vehicle
from scenarios.bench import estimator_delay as loops

VEHICLE = load_vehicle("hummingbird")


@pytest.fixture(scope="module")
def found():
    assert VEHICLE.controller is not None
    return loops.responses(VEHICLE, VEHICLE.controller, delays_ms=(0.0, 15.0, 60.0))


def test_a_flown_step_is_that_of_the_linear_loop(found):
    for each in found:
        np.testing.assert_allclose(each.step, each.linear, atol=0.3)  # of 10 degrees


def test_delay_costs_the_phase_that_it_takes_at_the_crossover(found):
    first, *others = found
    for each in others:
        lost = np.degrees(first.margins.crossover * each.delay_ms / 1e3)
        assert first.margins.phase_deg - each.margins.phase_deg == pytest.approx(lost, abs=0.1)
        assert first.margins.delay_ms - each.margins.delay_ms == pytest.approx(each.delay_ms, abs=0.1)


def test_steady_disturbances_are_rejected_alike_and_fast_ones_not_at_all(found):
    slow, fast = loops.FREQUENCIES < 1.0, loops.FREQUENCIES > 150.0
    for each in found:
        np.testing.assert_allclose(each.rejection[slow], found[0].rejection[slow], rtol=0.03)
        np.testing.assert_allclose(each.rejection[fast], loops.FREQUENCIES[fast] ** -2.0, rtol=0.2)


def test_gain_for_a_longer_delay_is_slower(found):
    assert found[1].redesigned == pytest.approx(found[1].margins.crossover, rel=0.01)  # the design's delay
    assert found[0].redesigned > found[1].redesigned > found[2].redesigned


def test_delayed_truth_is_the_truth_of_then():
    estimator = loops.DelayedTruth(2, 200.0)
    estimator.reset()
    rolls = np.radians([1.0, 2.0, 3.0, 4.0])
    said = []
    for roll in rolls:
        estimator.observe(np.array([[np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0]]))
        said.append(estimator.update(np.zeros((1, 3)), np.zeros((1, 3)))[0, 0])
    np.testing.assert_allclose(np.degrees(said), [1.0, 1.0, 1.0, 2.0])


def test_picture_and_table_tell_of_every_delay(found, tmp_path):
    path = loops.save(found, tmp_path / "deep" / "loop.png", title="x")
    assert path.stat().st_size > 20_000
    rows = loops.table(found)
    assert [row["delay, ms"] for row in rows] == ["0", "15", "60"]
    assert [row["affordable"] for row in rows] == ["yes", "yes", "barely"]
