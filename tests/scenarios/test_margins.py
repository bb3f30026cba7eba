"""Margins of attitude controllers: the cascade on its own, scaled and late."""

import numpy as np
import pytest

from quadsim.flight.mission import Mission
from quadsim.flight.scenario import load_scenario
from quadsim.seeding import vehicle_seeds
from scenarios.bench.margins import DELAYS, GAINS, Altered, Cascade, margins

STEP = load_scenario("step")


def flown(make, seconds=3.0):
    mission = Mission(STEP, None, 2, 200.0, duration_s=seconds, controller=make)
    mission.begin(vehicle_seeds(0, 2))
    while mission.k.min() < mission.steps:
        mission.step()
    return mission.loop.plant.position.copy(), mission.loop.plant.quat.copy()


def test_the_cascade_alone_flies_as_the_cascade_does_but_for_what_is_fed_forward():
    (position, quat), (alone, turned) = flown(None), flown(Cascade)
    np.testing.assert_allclose(alone, position, atol=0.05)
    np.testing.assert_allclose(turned, quat, atol=0.02)


def test_a_gain_of_one_without_delay_alters_nothing():
    for ours, theirs in zip(flown(Cascade), flown(lambda *given: Altered(Cascade(*given))), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_an_answer_comes_scaled_and_late():
    class Counts:
        k = 0

        def reset(self, n):
            self.k = 0

        def update(self, set_point, gyro, accel, roll_pitch):
            self.k += 1
            return np.full((1, 4), float(self.k))

    altered = Altered(Counts(), gain=2.0, delay=3)
    altered.reset(1)
    given = np.zeros((1, 4)), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2))
    answers = np.array([altered.update(*given)[0] for _ in range(6)])
    np.testing.assert_array_equal(answers[:, 0], [0, 0, 0, 2, 4, 6])
    np.testing.assert_array_equal(answers[:, 3], [1, 2, 3, 4, 5, 6])


@pytest.mark.slow
def test_the_cascade_falls_at_a_delay_of_some_tens_of_milliseconds():
    found = margins(Cascade, STEP, None, seeds=2)
    assert found.delay_s is not None
    assert DELAYS[0] / 200.0 < found.delay_s < 0.1
    assert found.gain_down is None or found.gain_down < 0.5
    assert found.gain_up is None or GAINS[0] < found.gain_up
