"""The estimators on flights that were not used for tuning or training."""

from argparse import Namespace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from errors import on_flights, with_silenced
from pages import Part, Row, Values, span
from simulated import DURATION_S, PLAN, PLANS, ROTORPY_S, SETS, rotorpy_sets, simulated

from estimators import create, names
from estimators.evaluation.comparison import Evaluation, behind_the_best, evaluate
from estimators.evaluation.error_figures import settling, violins
from estimators.evaluation.flights import load_flights, vehicle_of
from estimators.metrics import attitude_error, inclination_error
from estimators.registry import FILTERPY
from estimators.running import run_quietly
from quadsim.estimator import AttitudeEstimator, Readings
from quadsim.vehicle import Vehicle, with_drag
from scenarios.bench.cell import tuning_of

DOMAINS = {"hummingbird-adis16448": "test", "px4-quad-px4-mini": "test-px4"}
"""Domain to its test flights."""
LEFT_OUT = ("truth", "att-snn")
"""The truth has no error, and att-snn is att-snn-loihi in floats."""
SLOW_FLIGHTS = 2
PIECES = 4
"""Pieces into which flights are cut, so that they start in motion."""
ELSEWHERE = {
    "val": ("still air, aggressive", "hummingbird-adis16448"),
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


def tuned_estimators(domain: str, vehicle: Vehicle | None) -> dict[str, AttitudeEstimator]:
    """All estimators, filters with the parameters of a domain."""
    return {
        name: create(name, tuning=tuning_of(name, domain), vehicle=vehicle)
        for name in names()
        if name not in LEFT_OUT
    }


def evaluated(part: Part, domain: str, dataset: xr.Dataset) -> Evaluation:
    """All estimators on the domain's test flights; draws the figures."""
    done = evaluate(dataset, tuned_estimators(domain, vehicle_of(dataset)), slow_flights=SLOW_FLIGHTS)
    for name, figure in {"violins": violins(done), "convergence": settling(done)}.items():
        part.save(figure, f"filters-{name}-{domain}.png", dpi=110)
    return done


def result_rows(done: Evaluation, domain: str, data: Path) -> list[Row]:
    """The table, unknown starts first, best first; beside it RotorPy's flights with the domain's IMU."""
    imu, starts = SETS[DOMAINS[domain]].config().imu, ("unknown", "known")
    slow = SLOW_FLIGHTS // len(PLANS)
    abroad = on_flights(
        lambda each: tuned_estimators(domain, each),
        rotorpy_sets(data, imu),
        initial=starts,
        slow_flights=slow,
    )
    rows = []
    for each in sorted(done.rows, key=lambda each: (each.initial != "unknown", each.mean_deg)):
        name = each.estimator + ("*" if each.flights < done.table["flights"].max() else "")
        mean = f"{each.mean_deg:.2f} ({span(each.mean_low_deg, each.mean_high_deg)})"
        numbers = each.median_deg, mean, each.sd_deg, each.silenced_deg, behind_the_best(each)
        rotorpy = with_silenced(abroad.loc[each.estimator, each.initial])
        settled = [f"{s:.1f}" if np.isfinite(s) else "never" for s in (each.settle_20_s, each.settle_45_s)]
        rows.append((name, each.initial, *numbers, each.inclination_rmse_deg, rotorpy, *settled))
    return rows


def other_flights(data: Path) -> list[Row]:
    """Errors on other kinds of flight, started in motion, with the drag right, wrong and absent."""
    sets = [(what, domain, simulated(name, data)) for name, (what, domain) in ELSEWHERE.items()]
    for airframe, dataset in zip(PLANS, rotorpy_sets(data), strict=True):
        for wind, what in ROTORPY_WINDS.items():
            chosen = dataset.isel(flight=np.flatnonzero(dataset["wind_model"] == wind))
            sets.append((f"RotorPy's {airframe}, {what}", next(iter(DOMAINS)), chosen))
    rows = []
    for what, domain, dataset in sets:
        flights, vehicle = load_flights([dataset]).pieces(PIECES), vehicle_of(dataset)
        given = [("ekf-drag", with_drag(vehicle, k)) for k in (1.0, 0.5, 2.0, 0.01)]
        errors = []
        for name, airframe in [*given, ("vqf", None), ("eskf", None)]:
            est = create(name, flights.rate_hz, tuning=tuning_of(name, domain), vehicle=airframe)
            estimate = run_quietly(est, Readings(flights.gyro, flights.accel), flights.start)
            errors.append(attitude_error(estimate, flights.truth).mean)
        rows.append((what, *errors))
    return rows


def spoilt(dataset: xr.Dataset, domain: str) -> pd.DataFrame:
    """Angle to the run on undisturbed readings, some time after bad samples and a gap."""
    flights, vehicle = load_flights([dataset]), vehicle_of(dataset)
    at, end = (round(s * flights.rate_hz) for s in (SPOILT_AT_S, SPOILT_AT_S + RECOVERED_S + 0.5))
    second = round(flights.rate_hz)
    clean = flights.gyro[:, :end], flights.accel[:, :end]
    rows = []
    for name, est in tuned_estimators(domain, vehicle).items():
        if name in FILTERPY:
            continue
        wanted, row = run_quietly(est, Readings(*clean)), {"estimator": name}
        for title, (sensor, samples, reading) in SPOILT.items():
            gyro, accel = (each.copy() for each in clean)
            for kind, values in (("gyro", gyro), ("accel", accel)):
                if sensor in (kind, "both"):
                    values[:, at : at + samples] = reading
            found = run_quietly(est, Readings(gyro, accel))
            error = inclination_error(found, wanted)[:, -second:].mean(axis=1)
            row[title] = f"{np.median(error):.2f} / {error.max():.2f}"
        rows.append(row)
    return pd.DataFrame(rows)


def filters(part: Part, given: Namespace) -> Values:
    """Measure everything, and draw."""
    tables = {"elsewhere": other_flights(given.data)}
    sets = {domain: simulated(name, given.data) for domain, name in DOMAINS.items()}
    for domain, dataset in sets.items():
        done = evaluated(part, domain, dataset)
        tables |= {
            f"results:{domain}": result_rows(done, domain, given.data),
            f"spoilt:{domain}": spoilt(dataset, domain),
        }
    return tables | {
        "flights": str(next(iter(sets.values())).sizes["flight"]),
        "slow": str(SLOW_FLIGHTS),
        "pieces": str(PIECES),
        "piece_s": f"{DURATION_S / PIECES:g}",
        "foreign_piece_s": f"{ROTORPY_S / PIECES:g}",
        "rotorpy": PLAN,
        "recovered": f"{RECOVERED_S:g}",
    }
