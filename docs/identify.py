"""Measure what the page on identification says: `python docs/pages.py identify`."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pages import Page, Parts, row

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.identify import Flight, Identified, flights_of, identify
from quadsim.identify.model import UNITS, constant, with_constants
from quadsim.identify.noise import spectra_at_rest, spectra_in_flight
from quadsim.identify.report import SENSORS, draw_fit, draw_noise
from quadsim.vehicle import Vehicle, load_vehicle

AIRFRAMES = ("hummingbird", "px4-quad", "crazyflie")
FLIGHTS, DURATION_S, SEED = 2, 60.0, 78
"""Of each kind of flight of each airframe."""
GUESSES = (0.75, 1.3)
"""What each constant is multiplied by before the fit, at random."""
LOGS = ("log10", "log15", "log16")
DRAWN = "log15"


def config_of(airframe: str, trajectory: str) -> Recipe:
    """Still air and the ADIS16448, on the trajectory of a recipe."""
    config = load_recipe("hummingbird")
    changes = {
        "vehicle": load_vehicle(airframe),
        "trajectory": load_recipe(trajectory).trajectory,
    }
    return config.model_copy(update=changes)


def guess(vehicle: Vehicle, seed: int) -> Vehicle:
    """The vehicle with every constant wrong."""
    rng = np.random.default_rng(seed)
    return with_constants(
        vehicle, {name: constant(vehicle, name) * float(rng.choice(GUESSES)) for name in UNITS}
    )


def identified(airframe: str, data: Path) -> Identified:
    """The fit to aggressive and to fast flights."""
    flights: list[Flight] = []
    for k, trajectory in enumerate(("hummingbird", "cruise")):
        path = data / f"identify-{airframe}-{trajectory}.zarr"
        generate(config_of(airframe, trajectory), FLIGHTS, DURATION_S, path, seed=SEED + k)
        flights += flights_of(open_dataset(path))
    return identify(flights, guess(load_vehicle(airframe), SEED))


def constant_rows(found: dict[str, Identified]) -> Iterator[str]:
    """Error of each constant and its 95 % interval, for each airframe."""
    for name in UNITS:
        cells = []
        for airframe, result in found.items():
            each, true = result.constants.loc[name], constant(load_vehicle(airframe), name)
            used = "" if each.identified else ", not used"
            error = f"{each.fitted / true - 1:+.1%} (± {each.half_width / true:.1%}{used})" if true else ""
            cells.append(error or f"{each.fitted:.1g} (is 0)")
        yield row(f"`{name}`", *cells)


def real(path: Path) -> Flight:
    """A recording of the Crazyflie at 1 kHz: its IMU alone, for the motors' commands are no speeds."""
    with np.load(path) as log:
        grid = np.arange(log["t"][0], log["t"][-1], 1e-3)
        columns = [np.interp(grid, log["t"], column) for name in ("gyro", "acc") for column in log[name].T]
    signals = np.stack(columns, axis=1)
    return Flight(1000.0, signals[:, :3], signals[:, 3:])


def recording_rows(folder: Path, page: Page) -> Iterator[str]:
    """Noise at rest, noise and vibration in flight, of each recording."""
    for name in LOGS:
        flight = real(folder / "crazyflie-imu" / f"{name}.npz")
        still, shaken = spectra_at_rest(flight), spectra_in_flight(flight)
        if still is None:
            raise SystemExit(f"{name}: no rest")
        for (sensor, unit), a, b in zip(SENSORS, still, shaken, strict=True):
            line = f"{b.line.max():.2g} {unit} at {b.line_hz:.0f} Hz" if np.isfinite(b.line_hz) else "none"
            at_rest, flying = (f"{np.sqrt((each.noise**2).mean()):.2g}" for each in (a, b))
            noise = f"{at_rest} → {flying} {unit}/√Hz"
            yield row(name, sensor, noise, f"{b.shaking.max():.2g} {unit}", line)
        if name == DRAWN:
            page.save(draw_noise(shaken, still), "identify-noise.png")


def values(page: Page, given: Namespace) -> Parts:
    """Measure everything, and draw."""
    found = {airframe: identified(airframe, given.data) for airframe in AIRFRAMES}
    page.save(draw_fit(found["hummingbird"]), "identify-fit.png")
    least = min(result.explained.min() for result in found.values())
    return {
        "constants": list(constant_rows(found)),
        "explained": f"{least:.1%}",
        "flights": str(FLIGHTS),
        "duration": f"{DURATION_S:g}",
        "recordings": list(recording_rows(given.recordings, page)),
        "drawn": DRAWN,
    }
