"""The simulator against theory, and how well vehicles and IMUs are identified."""

from argparse import Namespace
from pathlib import Path

import allantools
import numpy as np
from numpy.typing import NDArray
from pages import Part, Row, Values, reduce_colours
from scipy.signal import welch

from quadsim.control.gains import loop_margins
from quadsim.dataset.figures import plot
from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import load_recipe
from quadsim.identify import Flight, Identified, identify, signals_of
from quadsim.identify.fit_report import draw_fit
from quadsim.identify.model import UNITS, constant, with_constants
from quadsim.imu.spec import ImuSpec, Sensor, load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs.allan import calibrate, draw_allan, model_variance
from quadsim.logs.recording import Recording
from quadsim.plant import Plant
from quadsim.rotation import quat_conjugate, quat_multiply
from quadsim.vehicle import load_vehicle
from quadsim.wind import dryden, dryden_scales

Array = NDArray[np.float64]
RATE_HZ = 200.0
HOUR = round(3600 * RATE_HZ)
"""Samples."""
IMUS = ("adis16448", "px4-mini")
AIRFRAMES = ("hummingbird", "px4-quad", "crazyflie")
FLIGHTS, DURATION_S, SEED = 2, 60.0, 78
"""Of each kind of flight of each airframe that is identified."""
GUESSES = (0.75, 1.3)
"""What each constant is multiplied by before the fit, at random."""


def allan() -> list[Row]:
    """Allan deviation of one hour of both IMUs over the formula."""
    rows, taus = [], np.array([0.1, 0.3, 1, 3, 10, 30, 100, 300])
    zero = np.zeros((8, HOUR, 3))
    for preset in IMUS:
        spec = load_imu(preset)
        gyro, accel = (
            Sensor(noise=each.noise, random_walk=each.random_walk, time_constant=each.time_constant)
            for each in (spec.gyro, spec.accel)
        )
        readings = simulate_imu(ImuSpec(gyro=gyro, accel=accel), zero, zero, RATE_HZ, seed=1)
        for name, sensor, reading in zip(("gyro", "accel"), (gyro, accel), readings, strict=True):
            each = reading.transpose(0, 2, 1).reshape(-1, HOUR)
            found = [
                [allantools.oadev(one, RATE_HZ, "freq", taus=[t])[1][0] ** 2 for t in taus] for one in each
            ]
            theory = model_variance(taus, sensor.noise, sensor.random_walk, sensor.time_constant)
            over = np.sqrt(np.mean(found, axis=0) / theory)
            rows.append((f"{preset} {name}", *(f"{each:.3f}" for each in over)))
    return rows


def turbulence() -> list[Row]:
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
        deviations = f"{series[..., k].std():.3f}", f"{sigma:.3f}"
        rows.append((name, *(f"{error:+.2f}" for error in errors), *deviations))
    return rows


def engines() -> list[Row]:
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
        rows.append((f"{integrator}, {1e3 / rate_hz:g} ms", f"{angle:.1e}", f"{1e3 * shift:.1e}"))
    return rows


def margins() -> list[Row]:
    """Margins of every shipped vehicle's loops."""
    rows = []
    for name in AIRFRAMES:
        vehicle = load_vehicle(name)
        assert vehicle.controller is not None
        for loop, found in loop_margins(vehicle, vehicle.controller).items():
            margins = f"{found.phase_deg:.1f}", f"{found.gain_db:.1f}", f"{found.delay_ms:.0f}"
            rows.append((name, loop, found.crossover, *margins))
    return rows


def theory(part: Part, given: Namespace) -> Values:
    """Compare the simulator with theory, and draw flights."""
    flights = part.root / "docs" / "img" / "flights.png"
    plot(generate(load_recipe("hummingbird"), 8, 100.0, given.data / "docs-flights.zarr", seed=0), flights)
    reduce_colours(flights, 48)
    return {"allan": allan(), "dryden": turbulence(), "engine": engines(), "margins": margins()}


# --- identification -------------------------------------------------------------------------------


def identified(airframe: str, data: Path) -> Identified:
    """The fit to aggressive and to fast flights in still air, from a vehicle with every constant wrong."""
    true, flights = load_vehicle(airframe), list[Flight]()
    for k, name in enumerate(("hummingbird", "cruise")):
        changes = {"vehicle": true, "trajectory": load_recipe(name).trajectory}
        recipe, path = load_recipe("hummingbird"), data / f"identify-{airframe}-{name}.zarr"
        generate(recipe.model_copy(update=changes), FLIGHTS, DURATION_S, path, seed=SEED + k)
        flights += signals_of(open_dataset(path))
    rng = np.random.default_rng(SEED)
    wrong = {name: constant(true, name) * float(rng.choice(GUESSES)) for name in UNITS}
    return identify(flights, with_constants(true, wrong))


def identified_constants(found: dict[str, Identified]) -> list[Row]:
    """Error of each constant and its 95 % interval, for each airframe."""

    def cell(airframe: str, name: str) -> str:
        each, true = found[airframe].constants.loc[name], constant(load_vehicle(airframe), name)
        if not true:
            return f"{each.fitted:.1g} (is 0)"
        used = "" if each.identified else ", not used"
        return f"{100 * (each.fitted / true - 1):+.1f} % (± {100 * each.half_width / true:.1f} %{used})"

    return [(f"`{name}`", *(cell(airframe, name) for airframe in found)) for name in UNITS]


def calibration(part: Part) -> list[Row]:
    """An hour at rest of two sensors, calibrated."""
    rows = []
    force = np.tile([0.0, 0.0, 9.81], (1, HOUR, 1))
    for preset in IMUS:
        imu = load_imu(preset)
        gyro, accel = simulate_imu(imu, np.zeros_like(force), force, RATE_HZ, seed=1)
        found = calibrate(Recording(preset, "", np.arange(HOUR) / RATE_HZ, gyro[0], accel[0]))
        if preset == IMUS[0]:
            part.save(draw_allan(found), "calibration.png", dpi=100, colours=48)
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            tau = mine.time_constant / (true.time_constant or np.nan)
            ratio = mine.random_walk / true.random_walk
            shown = f"{'' if mine.resolved else '> '}{tau:.2f}"
            rows.append((preset, name, f"{mine.noise / true.noise:.3f}", ratio, shown))
    return rows


def identification(part: Part, given: Namespace) -> Values:
    """Identify vehicles and IMUs, and draw the fits."""
    found = {airframe: identified(airframe, given.data) for airframe in AIRFRAMES}
    part.save(draw_fit(found["hummingbird"]), "identify-fit.png")
    least = min(result.explained.min() for result in found.values())
    return {
        "calibration": calibration(part),
        "constants": identified_constants(found),
        "explained": f"{100 * least:.1f} %",
        "flights": str(FLIGHTS),
        "duration": f"{DURATION_S:g}",
    }
