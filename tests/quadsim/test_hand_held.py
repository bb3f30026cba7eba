"""An IMU in the hand: motion in closed form."""

import numpy as np
import pytest

from quadsim.flight.hand_held import PACE_HZ, SHIFT_HZ, HandHeld, move_by_hand
from quadsim.flight.recipe import load_recipe
from quadsim.flight.simulate import simulate_flights
from quadsim.rotation import quat_conjugate, quat_multiply, quat_rotate
from quadsim.seeding import vehicle_seeds
from quadsim.vehicle import GRAVITY

RATE = 2000.0


@pytest.fixture(scope="module")
def motion():
    return move_by_hand(HandHeld(move_s=(2.0, 4.0), rest_s=(1.0, 2.0)), 40_000, RATE, vehicle_seeds(0, 3))


def test_velocity_force_and_body_rate_are_those_of_one_motion(motion):
    slopes = (np.gradient(motion[name], 1 / RATE, axis=1)[:, 1:-1] for name in ("position", "velocity"))
    velocity, acceleration = slopes
    np.testing.assert_allclose(velocity, motion["velocity"][:, 1:-1], atol=2e-4)
    np.testing.assert_allclose(world_acceleration(motion)[:, 1:-1], acceleration, atol=0.02)
    turn = quat_multiply(quat_conjugate(motion["quat"][:, :-1]), motion["quat"][:, 1:])
    rate = 2.0 * RATE * turn[..., 1:] * np.sign(turn[..., :1])
    middle = 0.5 * (motion["ang_vel"][:, :-1] + motion["ang_vel"][:, 1:])
    np.testing.assert_allclose(rate, middle, atol=5e-3)


def test_rests_are_still_at_any_attitude(motion):
    still = np.linalg.norm(motion["ang_vel"], axis=-1) == 0.0
    assert 0.1 < still.mean() < 0.6
    np.testing.assert_allclose(np.linalg.norm(motion["specific_force"][still], axis=-1), GRAVITY, rtol=1e-12)
    tilt = np.arccos(quat_rotate(motion["quat"][still], [0.0, 0.0, 1.0])[:, 2])
    assert tilt.max() > 0.5


@pytest.fixture(scope="module")
def long_move():
    spec = HandHeld(rate_deg_s=(50.0, 50.0), acceleration=(1.0, 1.0), move_s=(900.0, 900.0))
    return move_by_hand(spec, 50_000, 100.0, vehicle_seeds(0, 8))


def world_acceleration(motion):
    return quat_rotate(motion["quat"], motion["specific_force"]) - [0.0, 0.0, GRAVITY]


def test_size_of_the_motion_is_the_one_asked_for(long_move):
    assert world_acceleration(long_move).std() == pytest.approx(1.0, rel=0.1)
    assert np.degrees(long_move["ang_vel"].std()) == pytest.approx(50.0, rel=0.2)


def test_spectrum_of_the_acceleration_is_of_white_noise_behind_three_lags(long_move):
    acceleration = world_acceleration(long_move)
    window = np.hanning(acceleration.shape[1])[:, None]
    power = np.sum(np.abs(np.fft.rfft(acceleration * window, axis=1)) ** 2, axis=(0, 2))
    hz = np.fft.rfftfreq(acceleration.shape[1], 1 / 100.0)
    grid = np.linspace(*SHIFT_HZ, 10_000)
    paces = np.geomspace(*PACE_HZ, 100)[:, None]
    expected = grid**4 / (grid**2 + paces**2) ** 3
    expected /= expected.sum(axis=1, keepdims=True)
    for below in (1.0, 2.0, 4.0):
        share = expected[:, grid < below].sum(axis=1).mean()
        assert power[hz < below].sum() / power.sum() == pytest.approx(share, rel=0.3)
    assert power[hz < 0.1].sum() < 1e-5 * power.sum()


def test_a_motion_of_a_minute_peaks_at_four_times_its_root_mean_square(long_move):
    size = np.linalg.norm(world_acceleration(long_move), axis=-1)[:, :48_000].reshape(-1, 6_000)
    crest = size.max(axis=1) / np.sqrt(np.mean(size**2, axis=1))
    assert 3.5 < crest.mean() < 5.0


def test_a_recipe_of_the_hand_has_no_rotors_and_one_seed_a_flight():
    config = load_recipe("hand-held")
    both, one = (simulate_flights(config, vehicle_seeds(0, 2)[k:], 400) for k in (0, 1))
    np.testing.assert_array_equal(both["gyro"][1], one["gyro"][0])
    assert not np.any(both["rotor_vel"])
    assert list(both["end_step"]) == [400, 400]
