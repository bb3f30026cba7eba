"""The gyroscope's bias from the rates alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimators.gyro_bias import (
    BIAS_MAX,
    CORRELATED_S,
    EXPECTED_S,
    KEPT,
    RATE_MAX,
    TILT_VARIANCE,
    follow_bias,
)

STEP = 0.005


def found(rates, heading, memory=1e9, spread=0.05):
    """The bias (T, 2) that is believed after each of the readings (T, 3), with the heading (T,) known."""
    kept = np.zeros(KEPT)
    out = np.empty((len(rates), 2))
    for t, (reading, angle) in enumerate(zip(rates, heading, strict=True)):
        follow_bias(reading, np.cos(angle), np.sin(angle), STEP, memory, spread, kept)
        out[t] = kept[-2:]
    return out


def swinging(seconds, seed=0):
    """Rates (T, 3) of a tilt that wanders by about 14°, in a body that yaws, and its heading (T,)."""
    rng = np.random.default_rng(seed)
    steps = round(seconds / STEP)
    t = np.arange(steps) * STEP
    hz, phase = rng.uniform(0.05, 0.6, (2, 5)), rng.uniform(0, 2 * np.pi, (2, 5))
    tilt = 0.11 * np.sin(2 * np.pi * hz[..., None] * t + phase[..., None]).sum(1)
    heading = 0.8 * np.sin(0.3 * t) + 0.1 * t
    turning = (np.gradient(tilt[0], STEP) + 1j * np.gradient(tilt[1], STEP)) * np.exp(-1j * heading)
    return np.stack([turning.real, turning.imag, np.gradient(heading, STEP)], -1), heading


def test_it_is_the_slope_by_least_squares_with_a_prior():
    rates, heading = swinging(20.0)
    spread = 0.03
    b = found(rates + np.array([0.04, -0.02, 0.0]), heading, spread=spread)[-1]
    r = np.exp(1j * heading)
    integral = STEP * np.cumsum(r * ((rates[:, 0] + 0.04) + 1j * (rates[:, 1] - 0.02)))
    of_heading = STEP * np.cumsum(r)
    design = np.stack([of_heading, np.ones_like(of_heading)], -1)
    _, residual, *_ = np.linalg.lstsq(design, integral, rcond=None)
    n, expected = len(rates), EXPECTED_S / STEP
    variance = (0.5 * residual[0].real + expected * TILT_VARIANCE) / (n + expected)
    prior = np.diag([np.sqrt(CORRELATED_S / STEP * variance) / spread, 0.0])
    slope, _ = np.linalg.lstsq(np.vstack([design, prior]), np.append(integral, [0, 0]), rcond=None)[0]
    np.testing.assert_allclose(b, [slope.real, slope.imag], rtol=1e-6)


@given(st.integers(0, 50), st.floats(-0.09, 0.09), st.floats(-0.09, 0.09))
def test_a_bias_is_found_in_flight_within_a_minute(seed, x, y):
    rates, heading = swinging(60.0, seed)
    b = found(rates + np.array([x, y, 0.0]), heading)
    assert np.abs(b[-1] - [x, y]).max() < 0.006  # rad/s


def test_a_vehicle_that_stands_still_shows_its_bias_in_seconds():
    bias = np.radians([4.1, -1.2, -1.6])
    b = found(np.tile(bias, (1600, 1)), bias[2] * STEP * np.arange(1600))
    assert np.abs(b[0]).max() < 1e-3
    np.testing.assert_allclose(b[-1], bias[:2], rtol=0.2)


def test_a_bias_that_has_changed_is_learnt_anew():
    rates, heading = swinging(200.0)
    step = np.where(np.arange(len(rates)) < len(rates) // 2, 0.0, 0.05)
    rates[:, 0] += step
    assert abs(found(rates, heading, memory=4000.0)[-1, 0] - 0.05) < 0.01


def test_one_bad_reading_does_little_and_more_than_a_bias_is_never_believed():
    rates, heading = swinging(60.0)
    clean = found(rates, heading)
    rates[6000] = 1e30
    assert np.abs(found(rates, heading) - clean).max() < 2 * RATE_MAX * STEP / 30
    assert np.abs(found(np.full((4000, 3), 3.0), np.zeros(4000))).max() == BIAS_MAX
