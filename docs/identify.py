"""Measure how well vehicles and IMUs are identified: `python docs/pages.py identify`."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pages import Part, Values, row

from quadsim.dataset.generation import generate
from quadsim.dataset.reading import open_dataset
from quadsim.flight.recipe import Recipe, load_recipe
from quadsim.identify import Flight, Identified, flights_of, identify
from quadsim.identify.fit_report import draw_fit
from quadsim.identify.model import UNITS, constant, with_constants
from quadsim.imu.spec import load_imu
from quadsim.imu.stream import simulate_imu
from quadsim.logs.allan import calibrate, draw
from quadsim.logs.recording import Recording
from quadsim.vehicle import Vehicle, load_vehicle

AIRFRAMES = ("hummingbird", "px4-quad", "crazyflie")
FLIGHTS, DURATION_S, SEED = 2, 60.0, 78
"""Of each kind of flight of each airframe."""
RATE_HZ = 200.0
GUESSES = (0.75, 1.3)
"""What each constant is multiplied by before the fit, at random."""


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


def calibration_rows(part: Part) -> list[str]:
    """An hour at rest of two sensors, calibrated."""
    lines = []
    steps = int(3600 * RATE_HZ)
    force = np.tile([0.0, 0.0, 9.81], (1, steps, 1))
    for preset in ("adis16448", "px4-mini"):
        imu = load_imu(preset)
        gyro, accel = simulate_imu(imu, np.zeros_like(force), force, RATE_HZ, seed=1)
        found = calibrate(Recording(preset, "", np.arange(steps) / RATE_HZ, gyro[0], accel[0]))
        if preset == "adis16448":
            part.save(draw(found), "calibration.png", dpi=100, colours=48)
        for name, mine, true in (("gyro", found.gyro, imu.gyro), ("accel", found.accel, imu.accel)):
            tau = mine.time_constant / (true.time_constant or np.nan)
            ratios = f"{mine.noise / true.noise:.3f}", f"{mine.random_walk / true.random_walk:.2f}"
            lines.append(row(preset, name, *ratios, f"{'' if mine.resolved else '> '}{tau:.2f}"))
    return lines


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    found = {airframe: identified(airframe, given.data) for airframe in AIRFRAMES}
    part.save(draw_fit(found["hummingbird"]), "identify-fit.png")
    least = min(result.explained.min() for result in found.values())
    return {
        "calibration": calibration_rows(part),
        "constants": list(constant_rows(found)),
        "explained": f"{least:.1%}",
        "flights": str(FLIGHTS),
        "duration": f"{DURATION_S:g}",
    }
