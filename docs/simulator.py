"""The simulator against theory."""

from argparse import Namespace

import allantools
import numpy as np
from numpy.typing import NDArray
from pages import Part, Values, reduce_colours, row
from scipy.signal import welch

from quadsim.control.gains import loop_margins
from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import load_recipe
from quadsim.imu.spec import ImuSpec, Sensor, load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.plant import Plant
from quadsim.rotation import quat_conjugate, quat_multiply
from quadsim.vehicle import load_vehicle
from quadsim.wind import dryden, dryden_scales

Array = NDArray[np.float64]
RATE = 200.0


def allan_theory(sensor: Sensor, t: Array) -> Array:
    """Allan deviation of white noise plus a first-order Gauss-Markov bias at averaging times t [s]."""
    n, sigma, tau = sensor.noise, sensor.random_walk, sensor.time_constant
    decay = 3 - 4 * np.exp(-t / tau) + np.exp(-2 * t / tau)
    return np.sqrt(n**2 / t + sigma**2 * tau**2 / t * (1 - tau / (2 * t) * decay))


def allan_rows() -> list[str]:
    """Allan deviation of one hour of both presets over the formula."""
    rows, steps = [], round(3600 * RATE)
    taus = np.array([0.1, 0.3, 1, 3, 10, 30, 100, 300])
    zero = np.zeros((8, steps, 3))
    for preset in ("adis16448", "px4-mini"):
        spec = load_imu(preset)
        white = (
            Sensor(noise=each.noise, random_walk=each.random_walk, time_constant=each.time_constant)
            for each in (spec.gyro, spec.accel)
        )
        bare = ImuSpec(**dict(zip(("gyro", "accel"), white, strict=True)))
        readings = simulate_imu(bare, zero, zero, RATE, seed=1)
        for name, sensor, reading in zip(("gyro", "accel"), (spec.gyro, spec.accel), readings, strict=True):
            each = reading.transpose(0, 2, 1).reshape(-1, steps)
            found = [
                [allantools.oadev(one, RATE, "freq", taus=[tau])[1][0] ** 2 for tau in taus] for one in each
            ]
            over = np.sqrt(np.mean(found, axis=0)) / allan_theory(sensor, taus)
            rows.append(row(f"{preset} {name}", *(f"{each:.3f}" for each in over)))
    return rows


def dryden_rows() -> list[str]:
    """Simulated turbulence against MIL-F-8785C: error of the power in three bands, standard deviations."""
    airspeed, altitude, wind_20ft = 10.0, 20.0, 15.0
    series = dryden(64, 2**16, 20.0, airspeed, altitude, wind_20ft, seed=2)
    along, up, sigma_along, sigma_up = map(float, dryden_scales(altitude, wind_20ft))
    rows = []
    for k, name in enumerate("uvw"):
        length, sigma = (along, sigma_along) if k < 2 else (up, sigma_up)
        f, power = welch(series[..., k], 20.0, nperseg=2**13)
        w = 2 * np.pi * f * length / airspeed
        shape = 2 / (1 + w**2) if k == 0 else (1 + 3 * w**2) / (1 + w**2) ** 2
        theory = 2 * sigma**2 * length / airspeed * shape
        bands = [(f >= low) & (f < high) for low, high in ((0.01, 0.05), (0.05, 0.5), (0.5, 3.0))]
        errors = [10 * np.log10(power.mean(axis=0)[band].sum() / theory[band].sum()) for band in bands]
        shown = [f"{error:+.2f}" for error in errors]
        rows.append(row(name, *shown, f"{series[..., k].std():.3f}", f"{sigma:.3f}"))
    return rows


def engine_rows() -> list[str]:
    """Attitude error of larger steps against 50 µs over an open-loop 60° manoeuvre."""
    vehicle = load_vehicle("hummingbird")
    command = np.array([440.0, 453.0, 472.0, 450.0])

    def end(rate_hz: float, integrator: str) -> tuple[Array, Array]:
        plant = Plant(vehicle, 1, rate_hz, integrator)
        plant.reset(rotor_vel=vehicle.hover_rotor_vel)
        for _ in range(round(0.6 * rate_hz)):
            state = plant.step(command)
        return state.quat[0], state.position[0]

    exact_quat, exact_position = end(20000.0, "RK4")
    rows = []
    for rate_hz, integrator in ((200.0, "RK4"), (1000.0, "RK4"), (1000.0, "Euler"), (1000.0, "implicitfast")):
        quat, position = end(rate_hz, integrator)
        turn = np.linalg.norm(quat_multiply(quat_conjugate(exact_quat), quat)[1:])
        angle = 2 * np.degrees(np.arcsin(turn))
        shift = np.linalg.norm(position - exact_position)
        rows.append(row(f"{integrator}, {1e3 / rate_hz:g} ms", f"{angle:.1e}", f"{1e3 * shift:.1e}"))
    return rows


def margin_rows() -> list[str]:
    """Margins of every shipped vehicle's loops."""
    rows = []
    for name in ("hummingbird", "px4-quad", "crazyflie"):
        vehicle = load_vehicle(name)
        assert vehicle.controller is not None
        for loop, m in loop_margins(vehicle, vehicle.controller).items():
            values = f"{m.crossover:.2f}", f"{m.phase_deg:.1f}", f"{m.gain_db:.1f}", f"{m.delay_ms:.0f}"
            rows.append(row(name, loop, *values))
    return rows


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    config = load_recipe("hummingbird")
    flights = part.root / "docs" / "img" / "flights.png"
    plot(generate(config, 8, 100.0, given.data / "docs-flights.zarr", seed=0), flights)
    reduce_colours(flights, 48)
    return {
        "allan": allan_rows(),
        "dryden": dryden_rows(),
        "engine": engine_rows(),
        "margins": margin_rows(),
    }
