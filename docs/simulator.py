"""Validate the simulator against theory: `python docs/simulator.py` writes simulator.md and its figures."""

from collections.abc import Sequence
from pathlib import Path

import allantools
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import Page, load_page, row
from scipy.signal import welch
from simulated import options

from quadsim.control.gains import loop_margins
from quadsim.dataset.figures import LINES, STYLE, plot
from quadsim.dataset.generation import generate
from quadsim.flight.recipe import flight_config, load_recipe
from quadsim.imu.spec import Sensor, load_imu
from quadsim.imu.stream import simulate_imu, simulate_imu_with_bias
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


def allan_figure(page: Page) -> list[str]:
    """Allan deviation of both presets against the formula; returns table rows of the ratio."""
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    axes = figure.subplots(1, 2)
    rows = []
    hours, n = 1.0, 8
    steps = int(hours * 3600 * RATE)
    for preset, (colour, line) in zip(("adis16448", "px4-mini"), LINES, strict=False):
        spec = load_imu(preset)
        noise = spec.only("noise", "random_walk")
        zero = np.zeros((n, steps, 3))
        readings = simulate_imu(noise, zero, zero, RATE, seed=1)
        for axis, name, sensor, reading in zip(
            axes, ("gyro", "accel"), (spec.gyro, spec.accel), readings, strict=True
        ):
            taus = np.array([0.1, 0.3, 1, 3, 10, 30, 100, 300])
            found = np.mean(
                [
                    [allantools.oadev(one, RATE, "freq", taus=[tau])[1][0] ** 2 for tau in taus]
                    for one in reading.transpose(0, 2, 1).reshape(-1, steps)
                ],
                axis=0,
            )
            theory = allan_theory(sensor, taus)
            axis.loglog(taus, theory, color=colour, ls=line, label=f"{preset}, formula")
            axis.loglog(
                taus, np.sqrt(found), "o", ms=4, mfc="none", color=colour, label=f"{preset}, simulated"
            )
            rows.append(row(f"{preset} {name}", *(f"{r:.3f}" for r in np.sqrt(found) / theory)))
    for axis, title, unit in zip(axes, ("Gyroscope", "Accelerometer"), ("rad/s", "m/s²"), strict=True):
        axis.set(title=title, xlabel="averaging time [s]", ylabel=f"Allan deviation [{unit}]")
        axis.legend(fontsize=7)
    page.save(figure, "allan.png", colours=48)
    return rows


def dryden_figure(page: Page) -> list[str]:
    """Spectra of simulated turbulence against MIL-F-8785C; rows: the error in three bands."""
    airspeed, altitude, wind_20ft = 10.0, 20.0, 15.0
    series = dryden(64, 2**16, 20.0, airspeed, altitude, wind_20ft, seed=2)
    lengths = [float(x) for x in dryden_scales(altitude, wind_20ft)]
    along, up, sigma_along, sigma_up = lengths
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    rows = []
    for axis, k, name in zip(figure.subplots(1, 3, sharey=True), range(3), "uvw", strict=True):
        length, sigma = (along, sigma_along) if k < 2 else (up, sigma_up)
        f, power = welch(series[..., k], 20.0, nperseg=2**13)
        power = power.mean(axis=0)
        w = 2 * np.pi * f * length / airspeed
        shape = 2 / (1 + w**2) if k == 0 else (1 + 3 * w**2) / (1 + w**2) ** 2
        theory = 2 * sigma**2 * length / airspeed * shape
        axis.loglog(f[1:], power[1:], color=LINES[0][0], lw=0.8, label="simulated")
        axis.loglog(f[1:], theory[1:], color=LINES[2][0], ls="--", label="MIL-F-8785C")
        axis.set(title=name, xlabel="frequency [Hz]")
        errors = []
        for low, high in ((0.01, 0.05), (0.05, 0.5), (0.5, 3.0)):
            band = (f >= low) & (f < high)
            errors.append(10 * np.log10(power[band].sum() / theory[band].sum()))
        shown = [f"{error:+.2f}" for error in errors]
        rows.append(row(name, *shown, f"{series[..., k].std():.3f}", f"{sigma:.3f}"))
        axis.legend(fontsize=7)
        if k == 0:
            axis.set_ylabel("power [m²/s² / Hz]")
    page.save(figure, "dryden.png", colours=48)
    return rows


def bias_rows() -> list[str]:
    """SD of the turn-on bias over 500 seeds, and of the bias after 0 and 300 s over its stationary value."""
    spec = load_imu("adis16448")
    rows = []
    zero = np.zeros((500, 1, 3))
    on = simulate_imu_with_bias(spec.only("turn_on"), zero, zero, RATE, seed=3)[2:]
    still = np.zeros((500, 3001, 3))
    walk = simulate_imu_with_bias(spec.only("random_walk"), still, still, 10.0, seed=4)[2:]
    for name, sensor, start, path in zip(("gyro", "accel"), (spec.gyro, spec.accel), on, walk, strict=True):
        stationary = sensor.random_walk * np.sqrt(sensor.time_constant / 2)
        first, *_, last = (f"{sd:.3f}" for sd in path.std(axis=(0, 2)) / stationary)
        rows.append(row(name, f"{start.std():.5f}", f"{sensor.turn_on:g}", first, last))
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


def flight_picture(page: Page, data: Path) -> None:
    """Distributions of a few flights."""
    config = flight_config(load_recipe("hummingbird"))
    dataset = generate(config, 8, 100.0, data / "docs-flights.zarr", seed=0)
    path = page.root / "docs" / "img" / "flights.png"
    plot(dataset, path)
    page.sign_image(path, 48)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure everything and write the page."""
    given = options(__doc__, arguments)
    matplotlib.rcParams.update(STYLE)
    page = load_page("simulator")
    flight_picture(page, given.data)
    page.write(
        {
            "allan": allan_figure(page),
            "dryden": dryden_figure(page),
            "bias": bias_rows(),
            "engine": engine_rows(),
            "margins": margin_rows(),
        }
    )


if __name__ == "__main__":
    main()
