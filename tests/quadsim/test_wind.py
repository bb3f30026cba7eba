import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, signal

from quadsim.seeding import vehicle_seeds
from quadsim.wind import (
    Constant,
    Dryden,
    Gust,
    Sinusoid,
    _turbulence,
    dryden,
    dryden_scales,
    wind_series,
)

AIRSPEED, ALTITUDE, WIND_20FT = 6.0, 20.0, 15.0
BANDS_HZ = [(0.01, 0.05), (0.05, 0.5), (0.5, 5.0)]


def theory(axis: int, frequency: np.ndarray) -> np.ndarray:
    """One-sided spectral density of MIL-F-8785C [m²/s²/Hz]."""
    length_u, length_w, sigma_u, sigma_w = dryden_scales(ALTITUDE, WIND_20FT)
    T = (length_u, length_u, length_w)[axis] / AIRSPEED
    sigma = (sigma_u, sigma_u, sigma_w)[axis]
    x = (2.0 * np.pi * frequency * T) ** 2
    return sigma**2 * (4.0 * T / (1.0 + x) if axis == 0 else 2.0 * T * (1.0 + 3.0 * x) / (1.0 + x) ** 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_dryden_spectrum_matches_the_specification(axis):
    wind = dryden(40, 100_000, 50.0, AIRSPEED, ALTITUDE, WIND_20FT, seed=3)
    frequency, density = signal.welch(wind[..., axis], 50.0, nperseg=2**14, detrend=False, axis=-1)
    for low, high in BANDS_HZ:
        band = (frequency >= low) & (frequency < high)
        ratio = density.mean(axis=0)[band].sum() / theory(axis, frequency[band]).sum()
        assert abs(10.0 * np.log10(ratio)) < 0.5


def test_dryden_scales_at_20_metres():
    assert dryden_scales(20.0, 15.0) == pytest.approx((116.06, 20.0, 2.6955, 1.5), rel=1e-4)


@pytest.mark.parametrize("rate_hz", [0.5, 5.0, 50.0, 500.0])
def test_standard_deviation_does_not_depend_on_dt(rate_hz):
    seeds = 4000
    wind = dryden(seeds, 20, rate_hz, AIRSPEED, ALTITUDE, WIND_20FT, seed=5)
    expected = np.array([2.6955, 2.6955, 1.5])
    assert np.std(wind[:, -1], axis=0) == pytest.approx(expected, rel=4.0 / np.sqrt(2 * seeds))


@pytest.mark.parametrize("tau", [1e-7, 1e-4, 0.02, 1.0, 3.0])
def test_one_step_is_exact_by_van_loan(tau):
    p = _turbulence(np.full((1, 3), tau))[0]
    A = np.array([[0.0, 1.0], [-1.0, -2.0]])
    Q = np.diag([0.0, 4.0])  # gives the stationary covariance 1
    van_loan = linalg.expm(np.block([[-A, Q], [np.zeros((2, 2)), A.T]]) * tau)
    transition = van_loan[2:, 2:].T
    covariance = transition @ van_loan[:2, 2:]
    factor = np.array([[p["l11"][1], 0.0], [p["l21"][1], p["l22"][1]]])
    assert factor @ factor.T == pytest.approx(covariance, rel=1e-6, abs=1e-18)
    assert p["decay"][0] ** 2 + p["l11"][0] ** 2 == pytest.approx(1.0, abs=1e-12)


def test_airspeed_and_altitude_are_held_in_the_range_of_the_model():
    for asked, taken in (((0.0, 0.0), (1.0, 3.048)), ((2.0, 9e9), (2.0, 304.8))):
        assert np.array_equal(dryden(1, 9, 9.0, *asked, 5.0, seed=0), dryden(1, 9, 9.0, *taken, 5.0, seed=0))


@settings(max_examples=60, deadline=None)
@given(
    airspeed=st.floats(0.0, 1e6),
    altitude=st.floats(0.0, 1e6),
    strength=st.floats(0.0, 1e3),
    rate_hz=st.floats(1e-3, 1e5),
    seed=st.integers(0, 2**64),
)
def test_no_parameters_make_the_wind_infinite(airspeed, altitude, strength, rate_hz, seed):
    wind = dryden(2, 20, rate_hz, airspeed, altitude, strength, seed)
    assert np.isfinite(wind).all()
    assert np.abs(wind).max() <= 10.0 * strength


def test_gust_rises_holds_and_falls():
    time = np.array([0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0])
    wind = Gust(velocity=(8.0, 0.0, -4.0), start=1.0, rise=1.0, hold=1.0).series(time)
    assert wind[:, 0] == pytest.approx([0.0, 0.0, 4.0, 8.0, 8.0, 8.0, 4.0, 0.0, 0.0])
    assert wind[:, 2] == pytest.approx(-wind[:, 0] / 2.0)

    stays = Gust(velocity=(8.0, 0.0, 0.0), start=1.0, rise=1.0)  # as the specification has it
    assert stays.series(np.array([1e6])).tolist() == [[8.0, 0.0, 0.0]]


SPECS = [
    Constant(velocity=(1.0, 2.0, 0.0)),
    Gust(velocity=(0.0, 5.0, 0.0), start=0.1, rise=0.2),
    Dryden(airspeed=5.0, altitude=10.0, wind_20ft=8.0),
    Dryden(airspeed=5.0, altitude=10.0, wind_20ft=8.0),
]


def test_winds_add_up():
    total = wind_series(SPECS[:3], 4, 100, 200.0, seed=3)
    parts = [wind_series([spec], 4, 100, 200.0, seed=3) for spec in SPECS[:3]]
    assert total == pytest.approx(sum(parts))
    assert total.shape == (4, 100, 3)
    assert np.array_equal(wind_series([], 4, 100, 200.0, seed=3), np.zeros((4, 100, 3)))


def test_two_turbulences_of_one_flight_are_independent():
    first = wind_series(SPECS[2:3], 1, 50, 200.0, seed=3)
    assert not np.allclose(wind_series(SPECS[2:], 1, 50, 200.0, seed=3), 2.0 * first)


def test_seed_sequences_choose_the_vehicles():
    parents = np.random.SeedSequence(8).spawn(3)
    series = wind_series(SPECS, 3, 10, 200.0, seed=8)
    assert np.array_equal(series[1:], wind_series(SPECS, 2, 10, 200.0, seed=parents[1:]))
    assert np.array_equal(series[:1], wind_series(SPECS, 1, 10, 200.0, seed=8))
    assert not np.array_equal(series[0], series[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n": 0}, "n=0"),
        ({"steps": -1}, "steps=-1"),
        ({"rate_hz": 0.0}, "rate_hz = 0"),
        ({"airspeed": -1.0}, "airspeed is -1"),
        ({"altitude": float("inf")}, "altitude is inf"),
        ({"wind_20ft": float("nan")}, "wind_20ft is nan"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    good = {"n": 1, "steps": 5, "rate_hz": 9.0, "airspeed": 5.0, "altitude": 9.0, "wind_20ft": 8.0, "seed": 0}
    with pytest.raises(ValueError, match=message):
        dryden(**(good | change))


def test_sinusoids_have_their_amplitude_and_periods_and_each_flight_its_own():
    time = np.arange(0, 400, 0.05)
    spec = Sinusoid(amplitude=(3.0, 2.0, 0.0), period_s=(2.0, 5.0))
    wind = spec.flights(time, 20.0, vehicle_seeds(4, 20))
    np.testing.assert_allclose(np.abs(wind).max(1), [[3.0, 2.0, 0.0]] * 20, atol=0.01)
    frequency = np.fft.rfftfreq(time.size, 0.05)[np.abs(np.fft.rfft(wind[:, :, :2], axis=1)).argmax(1)]
    assert ((1 / frequency > 1.95) & (1 / frequency < 5.1)).all()
    assert np.unique(frequency).size > 20
    np.testing.assert_array_equal(wind[3], spec.flights(time, 20.0, vehicle_seeds(4, 4))[3])


def test_a_sinusoid_beside_turbulence_draws_from_a_stream_of_its_own():
    rough = Dryden(airspeed=5.0, altitude=10.0, wind_20ft=5.0)
    swing = Sinusoid(amplitude=(1.0, 1.0, 0.0), period_s=(2.0, 5.0))
    both = wind_series([rough, swing], 2, 500, 200.0, 3)
    alone = wind_series([rough], 2, 500, 200.0, 3)
    rest = both - alone
    assert np.abs(rest[..., :2]).max() <= 1.0
    np.testing.assert_allclose(rest[..., 2], 0.0, atol=1e-12)
