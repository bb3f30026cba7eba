"""One scenario with one estimator in detail: report, samples as CSV, video and files for viewers."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.analysis.raster import spikes_of
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import changed, load_scenario
from quadsim.pictures.film import Marks, film
from quadsim.pictures.timeline import Timeline, Trace, attitudes, axes_of
from quadsim.rotation import quat_from_euler
from quadsim.runs.files import write_csv
from quadsim.runs.fingerprint import content_digest

from .bench.cell import FlightSettings, make_cell, mission_of
from .bench.flight_log import Flown, fly_mission
from .bench.flight_series import decimation
from .bench.results import Results
from .bench.runner import NO_CHANGES, Changes
from .report.page import write_report

COLUMNS = ("t", "x", "y", "z", "roll", "pitch", "yaw", "roll_est", "pitch_est", "x_ref", "y_ref", "z_ref")
"""Columns of the CSV file, in SI units and radians."""
ONE_FLIGHT = FlightSettings()
BIASES = {"": "bias", " estimated": "bias_est"}
"""Labels of the curves of the gyroscope bias, and their signals."""


def file_name(name: str) -> str:
    """Convert a name to a part of a file name; for a path, the stem and a digest."""
    plain = re.sub(r"[^\w.-]", "-", Path(name).stem)
    return name if re.fullmatch(r"[\w-]+", name) else f"{plain}-{content_digest(name)[:8]}"


class SingleFlight(NamedTuple):
    """Results of a single scenario and estimator, with the written files."""

    results: Results
    report: Path
    samples: Path  #: CSV file of the first flight
    video: Path | None


def fly_scenario(
    source: str | Path,
    estimator: str,
    out: str | Path,
    settings: FlightSettings = ONE_FLIGHT,
    changes: Changes = NO_CHANGES,
    *,
    flight: int = 0,
    video: bool = False,
    progress: Callable[[int, int], object] | None = None,
    show: Callable[[Timeline], object] | None = None,
) -> SingleFlight:
    """Simulate a scenario with one estimator, and write report, samples and video.

    Args:
        source: A shipped scenario or the path of a TOML file.
        estimator: Name of an estimator; with another controller "ESTIMATOR @ CONTROLLER".
        out: Folder for `report.html`, `flight.csv` and `flight.mp4`.
        settings: Seeds, sample rate, tuning; the files show the first flight.
        changes: Fields that replace those of the scenario.
        flight: Number of the first flight, as in the flights.parquet of a benchmark of the same seed.
        video: Whether to make a video of the first flight.
        progress: Called after each frame of the video with the number of frames done and of all.
        show: Called with what viewers show of the first flight.

    Raises:
        ValueError: An argument or the scenario file is invalid.
        OSError: A file cannot be written.
        RuntimeError: A video is required, but headless OpenGL is not available. The other files have been
            written.
    """
    scenario, name = changed(load_scenario(source), changes), Path(source).name.removesuffix(".toml")
    mission = mission_of(scenario, estimator, settings)
    flown = fly_mission(mission, settings.seed, flight, every_sample=show is not None)
    if show is not None:
        show(timeline_of(flown, mission, estimator))
        every = decimation(mission.rate_hz)
        flown = flown._replace(signals={name: each[::every] for name, each in flown.signals.items()})
    cell = make_cell(name, estimator, mission, flown)
    results = Results({name: scenario}, [estimator], settings, [cell])
    out = Path(out).expanduser()
    out.mkdir(parents=True, exist_ok=True)
    first = flown.log[0, : max(flown.end[0], 1)]
    time = np.arange(len(first)) / mission.rate_hz
    table = np.column_stack([time, *(first[key] for key in ("position", "euler", "estimate", "target"))])
    write_csv(out / "flight.csv", [dict(zip(COLUMNS, row, strict=True)) for row in table.tolist()])
    title = f"{name} with attitude from {estimator}"
    write = partial(
        write_report, out / "report.html", results, title=title, files=["flight.csv"], focus=estimator
    )
    report = write()
    film_path = None
    if video:  # which may fail: the report is there by then
        quat = quat_from_euler(*first["euler"].T)
        marks = marks_of(first, flown, mission.rate_hz)
        film_path = out / "flight.mp4"
        film(film_path, mission.vehicle, time, first["position"], quat, marks, progress)
        write(film=film_path)
    return SingleFlight(results, report, out / "flight.csv", film_path)


def marks_of(flight: NDArray[np.void], flown: Flown, rate_hz: float) -> Marks:
    """Return the estimate (with the true yaw), set-point and wind of a log (T,), for the video."""
    roll, pitch = flight["estimate"].T
    wind = np.stack([flown.signals[f"wind_{axis}"] for axis in "xyz"], axis=-1)
    wind = np.repeat(wind, decimation(rate_hz), axis=0)[: len(flight)]
    return Marks(quat_from_euler(roll, pitch, flight["euler"][:, 2]), flight["target"], np.nan_to_num(wind))


def timeline_of(flown: Flown, mission: Mission, name: str) -> Timeline:
    """Return the timeline of a mission's first flight, whose signals were recorded at every sample."""
    first = flown.log[0, : max(flown.end[0], 1)]
    signals = {key: each[: len(first)] for key, each in flown.signals.items()}

    def vector(key: str) -> NDArray[np.float64]:
        return np.stack([signals[f"{key}_{axis}"] for axis in "xyz"], axis=1)

    gyro, accel, sigma = np.radians(vector("gyro")), vector("accel"), {}
    if np.isfinite(signals["roll_sigma"]).any():
        sigma[name] = np.radians(np.stack([signals["roll_sigma"], signals["pitch_sigma"]], axis=1))
    poses, traces = attitudes(first["euler"], {name: first["estimate"]}, sigma)
    places = {"": first["position"], " set-point": first["target"]}
    curves = {f"{axis}{which}": each[:, k] for k, axis in enumerate("xyz") for which, each in places.items()}
    bias = {
        f"{axis}{which}": vector(key)[:, k] for k, axis in enumerate("xyz") for which, key in BIASES.items()
    }
    rotors = {f"rotor {k}": speed for k, speed in enumerate(first["rotor_vel"].T)}
    traces |= {
        "position": Trace("m", curves),
        "gyroscope": axes_of("rad/s", gyro),
        "accelerometer": axes_of("m/s²", accel),
        "gyroscope bias": Trace(
            "deg/s", {label: each for label, each in bias.items() if np.isfinite(each).any()}
        ),
        "wind": axes_of("m/s", vector("wind")),
        "rotor speed": Trace("rad/s", rotors),
    }
    time = np.arange(len(first)) / mission.rate_hz
    return Timeline(
        time, mission.vehicle, first["position"], poses, gyro, accel, traces,
        target=first["target"], wind=vector("wind"), spikes=spikes_of(mission.estimator, gyro, accel),
    )  # fmt: skip
