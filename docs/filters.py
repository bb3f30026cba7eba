"""The estimators on flights that were not used for tuning or training."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from foreign import AIRFRAMES, DESCRIPTION, foreign, foreign_cell
from foreign import DURATION_S as FOREIGN_S
from numpy.typing import NDArray
from pages import Part, Values, row
from simulated import DURATION_S, SETS, simulated

from estimators import create, names
from estimators.evaluation.comparison import Evaluation, behind_the_best, evaluate
from estimators.evaluation.error_figures import settling, violins
from estimators.evaluation.flights import Flights, load_flights, vehicle_of
from estimators.metrics import attitude_error, inclination_error
from estimators.registry import FILTERPY
from estimators.running import run_quietly
from estimators.tuned import load_tuning
from quadsim.estimator import Readings
from quadsim.flight.recipe import load_recipe
from quadsim.runs.console import progress_bar
from quadsim.vehicle import Vehicle, with_drag

Array = NDArray[np.float64]
DOMAINS = {
    "hummingbird-adis16448": "test",
    "px4-quad-px4-mini": "test-px4",
}
"""Domain to its test flights."""
LEFT_OUT = ("truth", "att-snn")
"""The truth has no error, and att-snn is att-snn-loihi in floats."""
SLOW_FLIGHTS = 2
PIECES = 4
"""Pieces into which flights are cut, so that they start in motion."""
ELSEWHERE = {
    "val": ("still air, aggressive", "hummingbird-adis16448"),
    "val-windy": ("steady wind, drag off by up to 20 %", "hummingbird-adis16448"),
    "val-gusty": ("1−cosine gusts", "hummingbird-adis16448"),
    "val-turbulent": ("Dryden turbulence", "hummingbird-adis16448"),
    "val-rough": ("rough IMU: vibration, mounting, large biases", "hummingbird-adis16448"),
    "val-px4": ("px4-quad, still air, aggressive", "px4-quad-px4-mini"),
}
"""Dataset to what its flights are, and the domain of the tuned parameters."""
ROTORPY_WINDS = {"sinusoid": "sinusoidal wind of 3 m/s, up to 0.3 Hz", "dryden": "its Dryden turbulence"}
"""RotorPy's winds, in words."""
SPOILT = {
    "one rate of 1e30 rad/s": ("gyro", 1, 1e30),
    "one rate of 60 rad/s": ("gyro", 1, 60.0),
    "one force of 1000 m/s²": ("accel", 1, 1000.0),
    "one force of 300 m/s²": ("accel", 1, 300.0),
    "nothing for 0.5 s": ("both", 100, np.nan),
}
"""Sensor, samples and their reading on every axis."""
SPOILT_AT_S, RECOVERED_S = 20.0, 10.0
"""When that is, and how much later the estimate is compared with that of the undisturbed readings [s]."""


def tuning_of(name: str, domain: str) -> str | None:
    """The domain whose tuned parameters a filter has; None where it has its defaults."""
    return domain if name in load_tuning(domain) else None


def compared(part: Part, domain: str, dataset: xr.Dataset) -> Evaluation:
    """All estimators on the domain's test flights; draws the figures."""
    vehicle, rate_hz = vehicle_of(dataset), float(dataset.attrs["rate_hz"])
    made = {
        name: create(name, rate_hz, tuning=tuning_of(name, domain), vehicle=vehicle)
        for name in names()
        if name not in LEFT_OUT
    }
    with progress_bar(domain, "runs") as bar:
        done = evaluate(dataset, made, slow_flights=SLOW_FLIGHTS, progress=bar)
    for name, figure in {"violins": violins(done), "convergence": settling(done)}.items():
        part.save(figure, f"filters-{name}-{domain}.png", dpi=110)
    return done


def rotorpy_cell(name: str, start: str, domain: str, data: Path) -> str:
    """The error on RotorPy's flights with the domain's IMU; slow filters run on a few of them."""
    return foreign_cell(
        name,
        lambda vehicle: create(name, tuning=tuning_of(name, domain), vehicle=vehicle),
        data,
        load_recipe(SETS[DOMAINS[domain]].recipe).imu,
        known=start == "known",
        count=SLOW_FLIGHTS // len(AIRFRAMES) if name in FILTERPY else None,
    )


def result_rows(done: Evaluation, domain: str, data: Path) -> list[str]:
    """The table, unknown starts first, best first."""
    rows = []
    for each in sorted(done.rows, key=lambda each: (each.initial != "unknown", each.mean_deg)):
        settled = [f"{s:.1f}" if np.isfinite(s) else "never" for s in (each.settle_20_s, each.settle_45_s)]
        name = each.estimator + ("*" if each.flights < max(other.flights for other in done.rows) else "")
        mean = f"{each.mean_deg:.2f} ({each.mean_low_deg:.2f}–{each.mean_high_deg:.2f})"
        silenced = f"{each.silenced_deg:.2f}" if np.isfinite(each.silenced_deg) else "–"
        numbers = [f"{each.median_deg:.2f}", mean, f"{each.sd_deg:.2f}", silenced, behind_the_best(each)]
        rotorpy = rotorpy_cell(each.estimator, each.initial, domain, data)
        rows.append(row(name, each.initial, *numbers, f"{each.inclination_rmse_deg:.2f}", rotorpy, *settled))
    return rows


def mean_error(name: str, flights: Flights, domain: str, vehicle: Vehicle | None) -> float:
    """Mean over flights of the mean absolute error [deg]."""
    est = create(name, flights.rate_hz, tuning=tuning_of(name, domain), vehicle=vehicle)
    estimate = run_quietly(est, Readings(flights.gyro, flights.accel), flights.start)
    return attitude_error(estimate, flights.truth).mean


def elsewhere(data: Path) -> Iterator[tuple[str, str, xr.Dataset]]:
    """Other kinds of flight: what they are, the domain of the tuned parameters, and the dataset."""
    for name, (what, domain) in ELSEWHERE.items():
        yield what, domain, simulated(name, data)
    for airframe in AIRFRAMES:
        dataset = foreign(airframe, data)
        for wind, what in ROTORPY_WINDS.items():
            chosen = np.flatnonzero(dataset["wind_model"] == wind)
            yield f"RotorPy's {airframe}, {what}", next(iter(DOMAINS)), dataset.isel(flight=chosen)


def elsewhere_rows(data: Path) -> list[str]:
    """Errors on other kinds of flight, started in motion, with the drag right, wrong and absent."""
    rows = []
    for what, domain, dataset in elsewhere(data):
        flights, vehicle = load_flights([dataset]).pieces(PIECES), vehicle_of(dataset)
        assert vehicle is not None
        errors = [
            mean_error("ekf-drag", flights, domain, with_drag(vehicle, k)) for k in (1.0, 0.5, 2.0, 0.01)
        ]
        errors += [mean_error(each, flights, domain, None) for each in ("vqf", "eskf")]
        rows.append(row(what, *(f"{error:.2f}" for error in errors)))
    return rows


def spoilt_rows(dataset: xr.Dataset, domain: str) -> list[str]:
    """Angle to the run on undisturbed readings, some time after bad samples and a gap."""
    flights, vehicle = load_flights([dataset]), vehicle_of(dataset)
    at, end = (round(s * flights.rate_hz) for s in (SPOILT_AT_S, SPOILT_AT_S + RECOVERED_S + 0.5))
    second = round(flights.rate_hz)
    clean = flights.gyro[:, :end], flights.accel[:, :end]
    rows = []
    for name in names():
        if name in (*LEFT_OUT, *FILTERPY):
            continue
        est = create(name, flights.rate_hz, tuning=tuning_of(name, domain), vehicle=vehicle)
        wanted, cells = run_quietly(est, Readings(*clean)), []
        for sensor, samples, reading in SPOILT.values():
            gyro, accel = (each.copy() for each in clean)
            for kind, values in (("gyro", gyro), ("accel", accel)):
                if sensor in (kind, "both"):
                    values[:, at : at + samples] = reading
            error = inclination_error(run_quietly(est, Readings(gyro, accel)), wanted)[:, -second:].mean(
                axis=1
            )
            cells.append(f"{np.median(error):.2f} / {error.max():.2f}")
        rows.append(row(name, *cells))
    return rows


def values(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    tables = {"elsewhere": elsewhere_rows(given.data)}
    sets = {domain: simulated(name, given.data) for domain, name in DOMAINS.items()}
    for domain, dataset in sets.items():
        done = compared(part, domain, dataset)
        tables |= {
            f"results:{domain}": result_rows(done, domain, given.data),
            f"spoilt:{domain}": spoilt_rows(dataset, domain),
        }
    return tables | {
        "flights": str(next(iter(sets.values())).sizes["flight"]),
        "slow": str(SLOW_FLIGHTS),
        "pieces": str(PIECES),
        "piece_s": f"{DURATION_S / PIECES:g}",
        "foreign_piece_s": f"{FOREIGN_S / PIECES:g}",
        "rotorpy": DESCRIPTION,
        "recovered": f"{RECOVERED_S:g}",
        "spoilt": row("estimator", *SPOILT),
    }
