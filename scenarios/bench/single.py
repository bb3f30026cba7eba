"""One scenario on one estimator, looked at closely: a report, every sample as CSV, and a video."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import estimators
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import changed, load_scenario
from quadsim.render import film, replay
from quadsim.rotation import quat_from_euler

from ..report.page import write_report
from .cell import fly, make_cell
from .runner import Results, Settings, write_csv

COLUMNS = ("t", "x", "y", "z", "roll", "pitch", "yaw", "roll_est", "pitch_est", "x_ref", "y_ref", "z_ref")
"""Columns of the CSV file: SI units and radians."""


class Flown(NamedTuple):
    """What came of it, and where it is."""

    results: Results
    report: Path
    samples: Path  #: CSV file of the first flight
    video: Path | None


def fly_scenario(
    source: str | Path,
    estimator: str,
    out: str | Path,
    *,
    seeds: int = 1,
    seed: int = 0,
    flight: int = 0,
    duration_s: float | None = None,
    vehicle: str | None = None,
    imu: str | None = None,
    tuning: str | None = None,
    rate_hz: float = 200.0,
    video: bool = False,
    view: bool = False,
) -> Flown:
    """Fly a scenario on an estimator and write what happened.

    Args:
        source: A shipped scenario or the path of a TOML file.
        estimator: Name of an estimator.
        out: Folder for `report.html`, `flight.csv` and `flight.mp4`.
        seeds: Number of flights; the files show the first.
        seed: Seed of everything random.
        flight: Number of the first flight, as in the flights.csv of a benchmark of the same seed.
        duration_s: Length, instead of the scenario's [s].
        vehicle: Another vehicle than the scenario's, as in `runner.bench`.
        imu: Another IMU.
        tuning: Tuned parameters in place of the shipped ones.
        rate_hz: Samples per second.
        video: Whether to make a video of the first flight.
        view: Whether to show the first flight in MuJoCo's viewer, in real time, until it is closed.

    Raises:
        ValueError: For a bad argument or scenario file.
        OSError: If a file cannot be written.
        RuntimeError: If a video is wanted and there is no headless OpenGL, or a view and no screen; the other
        files are written by then.
    """
    if seeds < 1:
        raise ValueError(f"seeds is {seeds}; at least one flight is needed")
    if flight < 0:
        raise ValueError(f"flight is {flight}; flights count from 0")
    scenario, name = load_scenario(source), Path(source).name.removesuffix(".toml")
    changes = {"duration_s": duration_s, "vehicle": vehicle, "imu": imu}
    scenario = changed(scenario, {key: value for key, value in changes.items() if value is not None})
    made = estimators.create(estimator, rate_hz, tuning=tuning, vehicle=scenario.vehicle, imu=scenario.imu)
    mission = Mission(scenario, made, seeds, rate_hz)
    log, end = fly(mission, seed, flight)
    cell = make_cell(name, estimator, "", mission, log, end)
    results = Results(Settings({name: scenario}, [estimator], seeds, seed, rate_hz, tuning), [cell])
    out = Path(out).expanduser()
    out.mkdir(parents=True, exist_ok=True)
    first = log[0, : max(end[0], 1)]
    time = np.arange(len(first)) / rate_hz
    table = np.column_stack([time, *(first[name] for name in ("position", "euler", "estimate", "target"))])
    write_csv(out / "flight.csv", [dict(zip(COLUMNS, row, strict=True)) for row in table.tolist()])
    report = write_report(
        out / "report.html", results, title=f"{name} on {estimator}", csv=["flight.csv"], focus=estimator
    )
    film_path, seen = None, (time, first["position"], quat_from_euler(*first["euler"].T))
    if video:
        film_path = film(out / "flight.mp4", mission.vehicle, *seen)
    if view:
        replay(mission.vehicle, *seen)
    return Flown(results, report, out / "flight.csv", film_path)
