"""Wind: constant wind, 1−cosine gusts, sinusoids, Dryden turbulence, and sums of these.

A wind is the velocity of the air in world axes [m/s].

Dryden turbulence is that of MIL-F-8785C at low altitude. The filters of white noise are discretised exactly:
at any sample rate and from the first sample on, standard deviation and spectrum are those of the continuous
process.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.special import gammainc

from .config.ranges import SAMPLE_RATE, Between, Duration, Instant, Rising, Speed, Wind
from .config.toml import Strict
from .runs.compiled import njit
from .seeding import Seed, child, vehicle_seeds

Array = NDArray[np.float64]
Seeds = Sequence[np.random.SeedSequence]

FOOT = 0.3048
LOW_ALTITUDE = (10.0 * FOOT, 1000.0 * FOOT)
"""Range of altitudes for the low-altitude model [m]; altitudes outside are clipped."""
MIN_AIRSPEED = 1.0
"""Smallest airspeed [m/s]; without airspeed, the turbulence would be constant."""


@runtime_checkable
class Drawn(Protocol):
    """A random wind, drawn for each flight.

    Other winds have the method `series` and are the same in all flights.
    """

    def flights(self, time: Array, rate_hz: float, seeds: Seeds) -> Array:
        """Return the velocity of the air (n, T, 3) at times (T,) [s], for one flight per seed."""
        ...


class Constant(Strict):
    """Constant wind."""

    kind: Literal["constant"] = "constant"
    velocity: Wind
    """Velocity of the air in world axes [m/s]."""

    def series(self, time: Array) -> Array:
        """Velocity of the air (T, 3) at times (T,) [s]."""
        return np.broadcast_to(self.velocity, (*time.shape, 3))


class Gust(Strict):
    """A 1−cosine gust (MIL-F-8785C 3.7.3) that rises, stays at its peak, and falls."""

    kind: Literal["gust"] = "gust"
    velocity: Wind
    """Velocity of the air at the peak, in world axes [m/s]."""
    start: Instant = 0.0
    """Start time [s]."""
    rise: Duration
    """Time from zero to the peak [s]: the gust length d_m divided by the airspeed."""
    hold: Instant | None = None
    """Time at the peak [s]; default: the gust stays, as in the specification."""

    def series(self, time: Array) -> Array:
        """Velocity V_m / 2 (1 − cos(π (t − start) / rise)) while it rises (T, 3) at times (T,) [s]."""
        elapsed = time - self.start
        strength = 0.5 * (1.0 - np.cos(np.pi * np.clip(elapsed / self.rise, 0.0, 1.0)))
        if self.hold is not None:
            fallen = np.clip((elapsed - self.rise - self.hold) / self.rise, 0.0, 1.0)
            strength *= 0.5 * (1.0 + np.cos(np.pi * fallen))
        return strength[..., None] * np.array(self.velocity)


class Dryden(Strict):
    """Dryden turbulence at low altitude (MIL-F-8785C), with zero mean."""

    kind: Literal["dryden"] = "dryden"
    airspeed: Speed
    """Airspeed of the vehicle [m/s]; in hover, the mean wind speed. Values below 1 m/s count as 1 m/s."""
    altitude: Annotated[float, Between(0.0, 2e4, "m")]
    """Height above ground [m]; values are clipped to 3.05 m to 304.8 m."""
    wind_20ft: Speed
    """Wind speed at 20 ft, which sets the strength [m/s]: 7.7 light, 15.4 moderate, 23.2 severe."""

    def flights(self, time: Array, rate_hz: float, seeds: Seeds) -> Array:
        """Return the velocity of the air (n, T, 3), for one flight per seed."""
        numbers = self.airspeed, self.altitude, self.wind_20ft
        return dryden(len(seeds), time.size, rate_hz, *numbers, seed=seeds)


class Sinusoid(Strict):
    """A sinusoid with zero mean on each axis. Periods and phases are drawn for each flight."""

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Wind
    """Largest velocity of the air on each axis [m/s]."""
    period_s: Annotated[tuple[Duration, Duration], Rising]
    """Range of the periods, drawn log-uniformly [s]."""

    def flights(self, time: Array, rate_hz: float, seeds: Seeds) -> Array:
        """Return the velocity A sin(2π t / T + φ) (n, T, 3), for one flight per seed, with uniform φ."""
        randoms = [np.random.default_rng(child(each, 0)) for each in seeds]
        low, high = np.log(self.period_s)
        period = np.exp([random.uniform(low, high, 3) for random in randoms])
        phase = np.array([random.uniform(0.0, 2.0 * np.pi, 3) for random in randoms])
        angle = 2.0 * np.pi * time[:, None] / period[:, None] + phase[:, None]
        return np.array(self.amplitude) * np.sin(angle)


WindSpec: TypeAlias = Annotated[Constant | Gust | Dryden | Sinusoid, Field(discriminator="kind")]
"""Wind of a TOML file, selected by `kind`: "constant", "gust", "dryden" or "sinusoid"."""


def dryden_scales(altitude: ArrayLike, wind_20ft: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Return scales L_u = L_v, L_w [m] and standard deviations σ_u = σ_v, σ_w [m/s] (MIL-F-8785C 3.7.3.4).

    With k = 0.177 + 0.000823 h and h in feet, L_w = h, L_u = h / k^1.2, σ_w = 0.1 W20 and σ_u = σ_w / k^0.4.

    Args:
        altitude: Height above ground [m].
        wind_20ft: Wind speed at 20 ft [m/s].
    """
    feet = np.clip(np.asarray(altitude, dtype=np.float64), *LOW_ALTITUDE) / FOOT
    base = 0.177 + 0.000823 * feet
    sigma_w = 0.1 * np.asarray(wind_20ft, dtype=np.float64)
    return feet / base**1.2 * FOOT, feet * FOOT, sigma_w / base**0.4, sigma_w


_TURBULENCE = np.dtype(
    [
        ("scale", "f8", 3),  # of the output, for u, v, w
        ("tau", "f8", 3),  # dt / T with T = L / V
        ("decay", "f8", 3),  # e^−tau
        ("l11", "f8", 3),  # Cholesky factor of the noise that one step adds
        ("l21", "f8", 3),
        ("l22", "f8", 3),
        ("state", "f8", 5),  # u, v₁, v₂, w₁, w₂ of the next sample
    ],
    align=True,
)


@njit(cache=True)
def _add_turbulence(random, turbulence, out):
    """Add turbulence, a record (1,), to `out` (steps, 3) [m/s], flying along x.

    Along the flight path H_u = σ √(2L/πV) / (1 + T s): x ← e^{−τ} x + √(1 − e^{−2τ}) n, output σ x. Across it
    H_v,w = σ √(L/πV) (1 + √3 T s) / (1 + T s)²: with x = (y, T ẏ) the transition over one step is
    Φ = e^{−τ} [[1 + τ, τ], [−τ, 1 − τ]] and the stationary covariance I (output σ/2 (x₁ + √3 x₂)), so the
    noise of one step has the covariance I − Φ Φᵀ, which is what Van Loan's integral gives.
    """
    p = turbulence[0]
    x = p.state
    for step in range(out.shape[0]):
        out[step, 0] += p.scale[0] * x[0]
        out[step, 1] += p.scale[1] * (x[1] + 1.7320508075688772 * x[2])
        out[step, 2] += p.scale[2] * (x[3] + 1.7320508075688772 * x[4])
        x[0] = p.decay[0] * x[0] + p.l11[0] * random.standard_normal()
        for axis in range(1, 3):
            i = 2 * axis - 1
            x1, x2, tau = x[i], x[i + 1], p.tau[axis]
            n1, n2 = random.standard_normal(), random.standard_normal()
            x[i] = p.decay[axis] * ((1.0 + tau) * x1 + tau * x2) + p.l11[axis] * n1
            x[i + 1] = p.decay[axis] * ((1.0 - tau) * x2 - tau * x1) + p.l21[axis] * n1 + p.l22[axis] * n2


def _turbulence(tau: Array) -> NDArray[np.void]:
    """Record (1,) with transition and noise of one step, tau = dt / T (1, 3)."""
    p, decay = np.zeros(len(tau), _TURBULENCE), np.exp(-tau)
    p["tau"], p["decay"] = tau, decay  # nothing below cancels where tau is small
    p["l11"] = np.sqrt(gammainc(3.0, 2.0 * tau))  # 1 − e^{−2τ} (1 + 2τ + 2τ²)
    p["l21"] = 2.0 * (tau * decay) ** 2 / p["l11"]
    p["l22"] = np.sqrt(-np.expm1(-2.0 * tau) + 2.0 * tau * (1.0 - tau) * decay**2 - p["l21"] ** 2)
    p["l11"][:, 0] = np.sqrt(-np.expm1(-2.0 * tau[:, 0]))
    return p


def dryden(
    n: int, steps: int, rate_hz: float, airspeed: float, altitude: float, wind_20ft: float, seed: Seed
) -> Array:
    """Simulate Dryden turbulence with zero mean (MIL-F-8785C), exact at any rate and stationary.

    Args:
        n: Number of vehicles.
        steps: Number of samples.
        rate_hz: Samples per second.
        airspeed: Airspeed along world x [m/s]; values below 1 m/s count as 1 m/s.
        altitude: Height above ground [m]; values are clipped to 3.05 m to 304.8 m.
        wind_20ft: Wind speed at 20 ft [m/s].
        seed: Whole number, seed sequence, or one seed sequence per vehicle.

    Returns:
        Velocity of the air in world axes, shape (n, steps, 3) [m/s].

    Raises:
        ValueError: An argument is out of range.
    """
    if n < 1 or steps < 0:
        raise ValueError(f"n={n}, steps={steps}; need n ≥ 1 and steps ≥ 0")
    SAMPLE_RATE.of("rate_hz", rate_hz)
    for name, value in (("airspeed", airspeed), ("altitude", altitude), ("wind_20ft", wind_20ft)):
        if not 0.0 <= value < np.inf:
            raise ValueError(f"{name} is {value}; it must be a finite number from 0 up")
    length_u, length_w, sigma_u, sigma_w = dryden_scales(altitude, wind_20ft)
    lengths = np.array([[length_u, length_u, length_w]])
    turbulence = _turbulence(max(airspeed, MIN_AIRSPEED) / (lengths * rate_hz))
    turbulence["scale"] = sigma_u, sigma_u / 2.0, sigma_w / 2.0
    wind = np.zeros((n, steps, 3))
    for vehicle, parent in enumerate(vehicle_seeds(seed, n)):
        random = np.random.default_rng(child(parent, 0))
        turbulence["state"] = random.standard_normal(5)
        _add_turbulence(random, turbulence, wind[vehicle])
    return wind


def wind_series(specs: Sequence[WindSpec], n: int, steps: int, rate_hz: float, seed: Seed) -> Array:
    """Return the sum of several winds from time 0, world axes, shape (n, steps, 3) [m/s].

    Args:
        specs: Winds to add. An empty sequence gives still air.
        n: Number of vehicles.
        steps: Number of samples.
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """
    wind, time = np.zeros((n, steps, 3)), np.arange(steps) / rate_hz
    parents, drawn = vehicle_seeds(seed, n), 0
    for spec in specs:
        if isinstance(spec, Drawn):
            wind += spec.flights(time, rate_hz, [child(each, drawn) for each in parents])
            drawn += 1
        else:
            wind += spec.series(time)
    return wind
