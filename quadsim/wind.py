"""Wind: constant, 1−cosine gusts, sinusoids, Dryden turbulence, a recording, and any sum of them.

All are velocities of the air in world axes [m/s].

Dryden turbulence is that of MIL-F-8785C at low altitude, driven by white noise and discretised exactly: it
has the standard deviation and the spectrum of the continuous process at any rate, from the first sample on.
"""

import csv
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.special import gammainc

from .config.ranges import SAMPLE_RATE, WIND, Between, Duration, Heading, Instant, Rising, Speed, Wind
from .config.toml import Strict, read_text
from .runs.compiled import njit
from .seeding import Seed, child, vehicle_seeds

Array = NDArray[np.float64]

FOOT = 0.3048
LOW_ALTITUDE = (10.0 * FOOT, 1000.0 * FOOT)
"""Altitudes between which the low-altitude model holds [m]; those outside are moved to the nearest end."""
MIN_AIRSPEED = 1.0
"""Floor of the airspeed [m/s]: at rest relative to the air, turbulence would never change."""


class Constant(Strict):
    """Wind that does not change."""

    kind: Literal["constant"] = "constant"
    velocity: Wind
    """Velocity of the air in world axes [m/s]."""


class Gust(Strict):
    """A 1−cosine gust (MIL-F-8785C 3.7.3): up, hold, and down again as it came."""

    kind: Literal["gust"] = "gust"
    velocity: Wind
    """Velocity of the air at the peak, in world axes [m/s]."""
    start: Instant = 0.0
    """When it begins [s]."""
    rise: Duration
    """Time from nothing to the peak [s]: the gust length d_m over the airspeed."""
    hold: Instant | None = None
    """Time at the peak [s]; left out, the gust stays, as in the specification."""


class Dryden(Strict):
    """Dryden turbulence at low altitude (MIL-F-8785C), with zero mean."""

    kind: Literal["dryden"] = "dryden"
    airspeed: Speed
    """Speed of the vehicle through the air [m/s]; in hover, the mean wind speed. At least 1 m/s is used."""
    altitude: Annotated[float, Between(0.0, 2e4, "m")]
    """Height above ground [m]; 3.05 m to 304.8 m are used."""
    wind_20ft: Speed
    """Wind speed at 20 ft [m/s], the strength: 7.7 light, 15.4 moderate, 23.2 severe."""
    heading_deg: Heading = 0.0
    """Direction of flight through the air, counter-clockwise from world x [deg]."""


class Sinusoid(Strict):
    """A sinusoid of zero mean on each axis; each flight draws its three periods and phases."""

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Wind
    """Largest velocity of the air on each axis [m/s]."""
    period_s: Annotated[tuple[Duration, Duration], Rising]
    """Range of the periods [s], which are drawn log-uniformly."""


class WindRecording(Strict):
    """Wind measured over time: a CSV file with the header `t,x,y,z` [s, m/s], linear between its rows."""

    kind: Literal["file"] = "file"
    path: str
    """The file; before its first row and after its last one these hold."""


WindSpec: TypeAlias = Annotated[
    Constant | Gust | Dryden | Sinusoid | WindRecording, Field(discriminator="kind")
]
"""Any wind of a TOML file, by its `kind`: "constant", "gust", "dryden", "sinusoid" or "file"."""


def gust_one_minus_cosine(
    time: ArrayLike, velocity: ArrayLike, start: float, rise: float, hold: float | None = None
) -> Array:
    """A 1−cosine gust, V_m / 2 (1 − cos(π (t − start) / rise)) while it rises (MIL-F-8785C 3.7.3).

    Args:
        time: Any shape (...) [s].
        velocity: Velocity at the peak V_m, shape (3,) [m/s].
        start: When it begins [s].
        rise: Time from nothing to the peak [s].
        hold: Time at the peak, after which it falls as it rose [s]; None for ever.

    Returns:
        Velocity of the air, shape (..., 3) [m/s].
    """
    elapsed = np.asarray(time, dtype=np.float64) - start
    strength = 0.5 * (1.0 - np.cos(np.pi * np.clip(elapsed / rise, 0.0, 1.0)))
    if hold is not None:
        strength *= 0.5 * (1.0 + np.cos(np.pi * np.clip((elapsed - rise - hold) / rise, 0.0, 1.0)))
    return strength[..., None] * np.asarray(velocity, dtype=np.float64)


def dryden_scales(altitude: ArrayLike, wind_20ft: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Lengths L_u = L_v, L_w [m] and standard deviations σ_u = σ_v, σ_w [m/s] (MIL-F-8785C 3.7.3.4).

    With k = 0.177 + 0.000823 h: L_w = h, L_u = h / k^1.2, σ_w = 0.1 W20, σ_u = σ_w / k^0.4, h in feet.

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
        ("direction", "f8", 2),  # cosine and sine of the heading
        ("state", "f8", 5),  # u, v₁, v₂, w₁, w₂ of the next sample
    ],
    align=True,
)


@njit(cache=True)
def _add_turbulence(random, vehicles, vehicle, out):
    """Add the turbulence of one vehicle to `out` (steps, 3) [m/s].

    Along the flight path H_u = σ √(2L/πV) / (1 + T s): x ← e^{−τ} x + √(1 − e^{−2τ}) n, output σ x. Across it
    H_v,w = σ √(L/πV) (1 + √3 T s) / (1 + T s)²: with x = (y, T ẏ) the transition over one step is
    Φ = e^{−τ} [[1 + τ, τ], [−τ, 1 − τ]] and the stationary covariance I (output σ/2 (x₁ + √3 x₂)), so the
    noise of one step has the covariance I − Φ Φᵀ, which is what Van Loan's integral gives.
    """
    p = vehicles[vehicle]
    x = p.state
    along, across = p.direction[0], p.direction[1]
    for step in range(out.shape[0]):
        u = p.scale[0] * x[0]
        v = p.scale[1] * (x[1] + 1.7320508075688772 * x[2])
        out[step, 0] += along * u - across * v
        out[step, 1] += across * u + along * v
        out[step, 2] += p.scale[2] * (x[3] + 1.7320508075688772 * x[4])
        x[0] = p.decay[0] * x[0] + p.l11[0] * random.standard_normal()
        for axis in range(1, 3):
            i = 2 * axis - 1
            x1, x2, tau = x[i], x[i + 1], p.tau[axis]
            n1, n2 = random.standard_normal(), random.standard_normal()
            x[i] = p.decay[axis] * ((1.0 + tau) * x1 + tau * x2) + p.l11[axis] * n1
            x[i + 1] = p.decay[axis] * ((1.0 - tau) * x2 - tau * x1) + p.l21[axis] * n1 + p.l22[axis] * n2


def _turbulence(tau: Array) -> NDArray[np.void]:
    """Records (n,) with transition and noise of one step, tau = dt / T (n, 3)."""
    p, decay = np.zeros(len(tau), _TURBULENCE), np.exp(-tau)
    p["tau"], p["decay"] = tau, decay  # nothing below cancels where tau is small
    p["l11"] = np.sqrt(gammainc(3.0, 2.0 * tau))  # 1 − e^{−2τ} (1 + 2τ + 2τ²)
    p["l21"] = 2.0 * (tau * decay) ** 2 / p["l11"]
    p["l22"] = np.sqrt(-np.expm1(-2.0 * tau) + 2.0 * tau * (1.0 - tau) * decay**2 - p["l21"] ** 2)
    p["l11"][:, 0] = np.sqrt(-np.expm1(-2.0 * tau[:, 0]))
    return p


def dryden(
    n: int,
    steps: int,
    rate_hz: float,
    airspeed: ArrayLike,
    altitude: ArrayLike,
    wind_20ft: ArrayLike,
    seed: Seed,
    heading: ArrayLike = 0.0,
) -> Array:
    """Dryden turbulence of zero mean, exact at any rate and stationary from the first sample (MIL-F-8785C).

    Args:
        n: Number of vehicles.
        steps: Number of samples.
        rate_hz: Samples per second.
        airspeed: Speed through the air, one or (n,) [m/s]; at least 1 m/s is used.
        altitude: Height above ground, one or (n,) [m]; 3.05 m to 304.8 m are used.
        wind_20ft: Wind speed at 20 ft, one or (n,) [m/s].
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
        heading: Direction of flight through the air, counter-clockwise from world x, one or (n,) [rad].

    Returns:
        Velocity of the air in world axes, shape (n, steps, 3) [m/s].

    Raises:
        ValueError: An argument is out of range.
    """
    if n < 1 or steps < 0:
        raise ValueError(f"n={n}, steps={steps}; need n ≥ 1 and steps ≥ 0")
    SAMPLE_RATE.of("rate_hz", rate_hz)
    speed = np.maximum(_per_vehicle("airspeed", airspeed, n), MIN_AIRSPEED)
    height, strength = _per_vehicle("altitude", altitude, n), _per_vehicle("wind_20ft", wind_20ft, n)
    length_u, length_w, sigma_u, sigma_w = dryden_scales(height, strength)
    lengths = np.stack([length_u, length_u, length_w], axis=-1)
    angle = _per_vehicle("heading", heading, n, lowest=-np.inf)
    vehicles = _turbulence(speed[:, None] / (lengths * rate_hz))
    vehicles["scale"] = np.stack([sigma_u, sigma_u / 2.0, sigma_w / 2.0], axis=-1)
    vehicles["direction"] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    wind = np.zeros((n, steps, 3))
    for vehicle, parent in enumerate(vehicle_seeds(seed, n)):
        random = np.random.default_rng(child(parent, 0))
        vehicles["state"][vehicle] = random.standard_normal(5)
        _add_turbulence(random, vehicles, vehicle, wind[vehicle])
    return wind


def sinusoid(time: Array, amplitude: ArrayLike, period_s: tuple[float, float], seed: Seed, n: int) -> Array:
    """Sinusoids A sin(2π t / T + φ) of n vehicles, T drawn log-uniformly and φ uniformly on each axis.

    Args:
        time: Shape (T,) [s].
        amplitude: A on each axis, shape (3,) [m/s].
        period_s: Range of T [s].
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
        n: Number of vehicles.

    Returns:
        Velocity of the air in world axes, shape (n, T, 3) [m/s].
    """
    randoms = [np.random.default_rng(child(each, 0)) for each in vehicle_seeds(seed, n)]
    low, high = np.log(period_s)
    period = np.exp([random.uniform(low, high, 3) for random in randoms])
    phase = np.array([random.uniform(0.0, 2.0 * np.pi, 3) for random in randoms])
    angle = 2.0 * np.pi * time[:, None] / period[:, None] + phase[:, None]
    return np.asarray(amplitude, dtype=np.float64) * np.sin(angle)


def wind_series(specs: Sequence[WindSpec], n: int, steps: int, rate_hz: float, seed: Seed) -> Array:
    """The sum of several winds from time 0 on, world axes, shape (n, steps, 3) [m/s]; none is still air.

    Args:
        specs: Winds to add up.
        n: Number of vehicles.
        steps: Number of samples.
        rate_hz: Samples per second.
        seed: Whole number, seed sequence, or one seed sequence per vehicle.
    """
    wind, time = np.zeros((n, steps, 3)), np.arange(steps) / rate_hz
    parents, drawn = vehicle_seeds(seed, n), 0
    for spec in specs:
        if not isinstance(spec, Dryden | Sinusoid):
            wind += _function_of_time(spec)(time)
            continue
        seeds, drawn = [child(each, drawn) for each in parents], drawn + 1
        if isinstance(spec, Sinusoid):
            wind += sinusoid(time, spec.amplitude, spec.period_s, seeds, n)
            continue
        heading = np.radians(spec.heading_deg)
        wind += dryden(
            n, steps, rate_hz, spec.airspeed, spec.altitude, spec.wind_20ft, seed=seeds, heading=heading
        )
    return wind


def read_recording(path: str | Path) -> tuple[Array, Array]:
    """Time (rows,) [s] and wind (rows, 3) [m/s] of a CSV file with the header `t,x,y,z`.

    Raises:
        ValueError: The file or one of its rows is not as described; the line is named.
    """
    try:
        text = read_text(Path(path), most_mb=100.0)
        rows = [(line, row) for line, row in enumerate(csv.reader(text.splitlines()), start=1) if row]
    except csv.Error as error:
        raise ValueError(f"{path}: cannot be read: {error}") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    if header != ["t", "x", "y", "z"]:
        raise ValueError(f'{path}: the first line is "{",".join(header)}"; it must be "t,x,y,z"')
    table = np.array([_numbers(path, line, row) for line, row in rows[1:]]).reshape(-1, 4)
    if len(table) < 2:
        raise ValueError(f"{path}: {len(table)} rows of wind; at least 2 are needed")
    strongest = int(np.argmax(np.abs(table[:, 1:]).max(axis=1)))
    for speed in table[strongest, 1:]:
        WIND.of(f"{path}, line {rows[strongest + 1][0]}: wind", speed)
    for row in np.flatnonzero(np.diff(table[:, 0]) <= 0.0) + 1:
        raise ValueError(
            f"{path}, line {rows[row + 1][0]}: time {table[row, 0]:g} s does not come after the line before"
        )
    return table[:, 0], table[:, 1:]


def _numbers(path: str | Path, line: int, row: list[str]) -> list[float]:
    try:
        numbers = [float(cell) for cell in row]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not np.all(np.isfinite(numbers)):
        raise ValueError(f'{path}, line {line}: "{",".join(row)}" is not four finite numbers t,x,y,z')
    return numbers


def _function_of_time(spec: Constant | Gust | WindRecording) -> Callable[[Array], Array]:
    """Wind (..., 3) [m/s] at times (...) [s] of a wind that is the same for every seed."""
    match spec:
        case Constant():
            return lambda time: np.broadcast_to(spec.velocity, (*time.shape, 3))
        case Gust():
            return partial(
                gust_one_minus_cosine,
                velocity=spec.velocity,
                start=spec.start,
                rise=spec.rise,
                hold=spec.hold,
            )
        case WindRecording():
            times, winds = read_recording(spec.path)
            return lambda time: np.stack([np.interp(time, times, column) for column in winds.T], axis=-1)


def _per_vehicle(name: str, value: ArrayLike, n: int, lowest: float = 0.0) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (1,), (n,)) or not np.all(np.isfinite(array) & (array >= lowest)):
        raise ValueError(
            f"{name} is {value}; it must be one finite number or {n} of them, from {lowest:g} up"
        )
    return np.broadcast_to(array, (n,))
