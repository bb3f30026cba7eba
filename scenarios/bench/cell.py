"""One cell of the benchmark: a scenario flown on an estimator with many seeds, and the file it is kept in."""

import base64
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

import estimators
from estimators.custom import own_source
from estimators.registry import is_weights
from estimators.tuned import load_tuning
from quadsim.flight.mission import CAUSES, Mission
from quadsim.flight.scenario import Scenario
from quadsim.runs.files import read_json, write_json
from quadsim.runs.fingerprint import content_digest
from quadsim.seeding import vehicle_seeds

from .flight_metrics import Log, error_histogram, flight_metrics, log_dtype, summarise, write_row

Array = NDArray[np.float64]
Row = dict[str, float | int | str | None]

SERIES_HZ = 25.0
"""Samples per second of the time series that are kept for plots."""
BOUNDLESS = 1e100
"""What no number of a flight reaches that means something, in any unit."""


class Channel(TypedDict):
    """Numbers of one kind in time: 16-bit integers in base64, times a scale."""

    scale: float
    data: str


class Series(TypedDict):
    """One flight in time."""

    dt: float
    channels: dict[str, Channel]


@dataclass(frozen=True)
class Cell:
    """What came of one cell. `reason` tells why there is nothing, and is empty when all is well."""

    scenario: str
    estimator: str
    fingerprint: str
    reason: str
    flights: list[Row]
    """One row per seed."""
    histogram: list[int]
    """Counts of the errors, as in `metrics.error_histogram`."""
    series: Series | None
    """The first seed in time."""

    @property
    def row(self) -> Row:
        """The cell as one row of the table."""
        head: Row = {"scenario": self.scenario, "estimator": self.estimator, "reason": self.reason}
        return head | (summarise(self.flights) if self.flights else {})

    def save(self, path: Path) -> None:
        """Write the cell, whole or not at all."""
        write_json(path, asdict(self))


def file_name(name: str) -> str:
    """A name as a part of a file's: of what is a path, or no plain name, its stem and a digest."""
    plain = re.sub(r"[^\w.-]", "-", Path(name).stem)
    return name if re.fullmatch(r"[\w-]+", name) else f"{plain}-{content_digest(name)[:8]}"


def weights_digest(estimator: str) -> str:
    """Digest of the weights, or of the user's module, that an estimator's name stands for; none of others."""
    source = estimator if is_weights(estimator) else own_source(estimator)
    return digest_if_there(source) if source else ""


def digest_if_there(path: str | Path) -> str:
    """Digest of a file that a cell reads; none where it cannot be read, of which the cell will tell."""
    try:
        return content_digest(Path(path).read_bytes())
    except OSError:
        return ""


def load_cell(path: Path) -> Cell | None:
    """A cell from its file; None where there is no whole one."""
    try:
        return Cell(**read_json(path))
    except (OSError, ValueError, TypeError):
        return None


def fly_cell(
    name: str,
    scenario: Scenario,
    estimator: str,
    seeds: int,
    seed: int,
    rate_hz: float,
    fingerprint: str,
    tuning: str | None = None,
) -> Cell:
    """Fly a scenario with seeds 0 … seeds − 1 of `seed`, all at once; a failure is a cell with its reason."""
    try:
        made = estimators.create(
            estimator,
            rate_hz,
            tuning=tuning_of(estimator, tuning),
            vehicle=scenario.vehicle,
            imu=scenario.imu,
        )
        mission = Mission(scenario, made, seeds, rate_hz)
        log, end = fly(mission, seed)
        return make_cell(name, estimator, fingerprint, mission, log, end)
    except Exception as error:  # whatever an estimator does, the other cells go on
        kind = "" if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: "
        return Cell(name, estimator, fingerprint, f"{kind}{error}", [], [], None)


def tuning_of(estimator: str, tuning: str | None) -> str | None:
    """The tuning that holds for an estimator: the file that was given, where it has a table for it.

    Raises:
        ValueError: The file cannot be read.
    """
    return tuning if tuning is not None and estimator in load_tuning(tuning) else None


def make_cell(
    name: str, estimator: str, fingerprint: str, mission: Mission, log: Log, end: NDArray[np.int64]
) -> Cell:
    """The cell of a mission that has been flown.

    Raises:
        ValueError: If numbers of the flight grew beyond all bounds.
    """
    flown = np.arange(mission.steps) < end[:, None]
    if not np.isfinite(log["estimate"][flown]).all():
        raise ValueError(f"{estimator} estimated a roll or pitch that is no finite number")
    if not (np.abs(log[flown].view(np.float64)) < BOUNDLESS).all():
        raise ValueError("numbers of the flight grew beyond all bounds; is one of the scenario too large?")
    metrics = flight_metrics(log, end, mission.rate_hz, mission.vehicle)
    flights = [
        {"scenario": name, "estimator": estimator, "seed": i, "cause": CAUSES[mission.cause[i]]}
        | {"flown_s": float(end[i] / mission.rate_hz)}
        | {key: None if np.isnan(values[i]) else float(values[i]) for key, values in metrics.items()}
        for i in range(mission.n)
    ]
    series = pack_series(log[0, : max(end[0], 1)], mission.rate_hz)
    return Cell(name, estimator, fingerprint, "", flights, error_histogram(log, end).tolist(), series)


def fly(mission: Mission, seed: int, first: int = 0) -> tuple[Log, NDArray[np.int64]]:
    """Fly a mission to its end: its log (n, T) and how many samples each flight lasted (n,).

    Its flights are those with the numbers `first`, `first` + 1, ... of the seed.
    """
    mission.begin(vehicle_seeds(seed, first + mission.n)[first:])
    loop, plant, controller = mission.loop, mission.loop.plant, mission.loop.controller
    log = np.zeros((mission.steps, mission.n), log_dtype(len(mission.vehicle.rotors)))
    end = np.full(mission.n, mission.steps)
    command = controller.rotor_vel_cmd.copy()
    for k in range(mission.steps):
        mission.step()
        row, measured = log[k], loop.measured_state
        write_row(plant.vehicles, plant.pose, controller.records, measured, mission.target, command, row)
        end[(mission.cause > 0) & (end > k)] = k
    return log.swapaxes(0, 1), end


def pack_series(log: Log, rate_hz: float) -> Series:
    """One flight (T,), thinned to `SERIES_HZ`: angles [deg], positions and set-points [m]."""
    every = max(round(rate_hz / SERIES_HZ), 1)
    thin = log[::every]
    angles = np.degrees(np.hstack([thin["euler"], thin["estimate"]]))
    names = ["roll", "pitch", "yaw", "roll_est", "pitch_est", "x", "y", "z", "x_ref", "y_ref", "z_ref"]
    columns = np.hstack([angles, thin["position"], thin["target"]])
    return {"dt": every / rate_hz, "channels": dict(zip(names, map(_pack, columns.T), strict=True))}


def _pack(values: Array) -> Channel:
    scale = max(float(np.abs(values).max()), 1e-6) / 32767
    data = base64.b64encode(np.round(values / scale).astype("<i2").tobytes()).decode()
    return {"scale": scale, "data": data}
