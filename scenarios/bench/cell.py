"""One cell of the benchmark: a scenario simulated with one estimator and many seeds, and its file."""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

import estimators
from estimators.custom import own_sources
from estimators.metrics import RANGE, flaw_of
from estimators.registry import is_weights
from estimators.tuned import load_tuning
from quadsim.estimator import receives_truth
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario
from quadsim.flight.world import CAUSES
from quadsim.runs.files import read_json
from quadsim.runs.fingerprint import content_digest
from quadsim.seeding import vehicle_seeds

from .controllers import controller_files, controller_of, estimator_of, make_controller
from .flight_metrics import (
    CellRow,
    FlightRow,
    Log,
    error_histogram,
    flight_metrics,
    log_dtype,
    summarise,
    write_row,
)
from .series import FlightSeries, decimation, pack_series
from .settings import FlightSettings
from .signals import SignalLog

BOUNDLESS = 1e100
"""Upper bound for plausible values, in any unit; anything larger is treated as divergence."""


@dataclass(frozen=True)
class Cell:
    """Result of one cell."""

    scenario: str
    estimator: str
    fingerprint: str
    reason: str
    """Why it did not run; empty if it did."""
    flights: list[FlightRow]
    """One row per seed."""
    histogram: list[int]
    """Counts of the errors, as in `flight_metrics.error_histogram`."""
    series: FlightSeries | None
    """The first seed in time."""
    receives_truth: bool = False
    """Whether the estimator was fed the true attitude: a reference, which is not ranked."""
    flaw: str = ""
    """Why its estimates must not be ranked, as `estimators.metrics.flaw_of` says; empty if they may."""
    cpu_s: float = field(default=0.0, compare=False)
    """Processor time that it took [s]."""

    @property
    def row(self) -> CellRow:
        """The cell as one row of the table."""
        return summarise(self.scenario, self.estimator, self.reason, self.flights)


CELL = TypeAdapter(Cell)
"""Reads a cell that was written as JSON."""


def file_name(name: str) -> str:
    """A name as a part of a file's: of what is a path, or no plain name, its stem and a digest."""
    plain = re.sub(r"[^\w.-]", "-", Path(name).stem)
    return name if re.fullmatch(r"[\w-]+", name) else f"{plain}-{content_digest(name)[:8]}"


def weights_digest(estimator: str) -> str:
    """Digest of the weights and the files of the user's that a contender stands for; empty without any."""
    name = estimator_of(estimator)
    sources = [name] if is_weights(name) else own_sources(name)
    return "".join(map(digest_if_there, [*sources, *controller_files(estimator)]))


def digest_if_there(path: str | Path) -> str:
    """Digest of a file that a cell reads; empty where it cannot be read, which is the cell's own error."""
    try:
        return content_digest(Path(path).read_bytes())
    except OSError:
        return ""


def load_cell(path: Path) -> Cell | None:
    """A cell from its file; None where there is no whole one."""
    try:
        return CELL.validate_python(read_json(path))
    except (OSError, ValueError):
        return None


def failed_cell(scenario: str, estimator: str, fingerprint: str, reason: str) -> Cell:
    """A cell that did not run."""
    return Cell(scenario, estimator, fingerprint, reason, [], [], None)


def fly_cell(
    name: str, scenario: Scenario, estimator: str, settings: FlightSettings, fingerprint: str = ""
) -> Cell:
    """Simulate all flights of a cell at once; a failure is a cell with its reason."""
    began = time.thread_time()
    try:
        tuning, rate_hz = tuning_of(estimator, settings.tuning), settings.rate_hz
        vehicle = scenario.vehicle if scenario.vehicle_known else None
        made = estimators.create(
            estimator_of(estimator), rate_hz, tuning=tuning, vehicle=vehicle, imu=scenario.imu
        )
        controller = make_controller(controller_of(estimator))
        mission = Mission(scenario, made, settings.seeds, rate_hz, controller=controller)
        signals = SignalLog(mission, decimation(rate_hz))
        log, end = fly(mission, settings.seed, after_step=signals)
        cell = make_cell(name, estimator, fingerprint, mission, log, end, signals)
        return replace(cell, cpu_s=round(time.thread_time() - began, 3))
    except (Exception, SystemExit) as error:  # whatever an estimator does, the other cells continue
        kind = "" if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: "
        return failed_cell(name, estimator, fingerprint, f"{kind}{error}")


def tuning_of(estimator: str, tuning: str | None) -> str | None:
    """The tuning that holds for an estimator: the file that was given, where it has a table for it.

    Raises:
        ValueError: The file cannot be read.
    """
    return tuning if tuning is not None and estimator_of(estimator) in load_tuning(tuning) else None


def make_cell(
    name: str,
    estimator: str,
    fingerprint: str,
    mission: Mission,
    log: Log,
    end: NDArray[np.int64],
    signals: SignalLog | None = None,
) -> Cell:
    """The cell of a simulated mission, with the signals of its first flight if they were logged.

    Raises:
        ValueError: If an estimate is no angle, or numbers of the flight diverged.
    """
    before = np.arange(mission.steps) < end[:, None]
    valid = log[before]
    flaw = flaw_of(log["estimate"], np.where(before[..., None], log["euler"][..., :2], np.nan))
    wrong = before & ~(np.abs(log["estimate"]) <= RANGE).all(axis=-1)
    if wrong.any():
        first_s = wrong.any(axis=0).argmax() / mission.rate_hz
        raise ValueError(f"the estimator {flaw.partition(' in ')[0]}, first at {first_s:.2f} s")
    if not (np.abs(valid.view(np.float64)) < BOUNDLESS).all():
        raise ValueError("the flight diverged; is a number of the scenario too large?")
    metrics = vars(flight_metrics(log, end, mission.rate_hz, mission.vehicle))
    flights = [
        FlightRow(
            name,
            estimator,
            seed=i,
            cause=CAUSES[mission.cause[i]],
            flown_s=float(end[i] / mission.rate_hz),
            **{key: None if np.isnan(values[i]) else float(values[i]) for key, values in metrics.items()},
        )
        for i in range(mission.n)
    ]
    found = signals and dict(zip(signals.names, signals.rows.T, strict=True))
    series = pack_series(log[0, : max(end[0], 1)], mission.rate_hz, found)
    histogram = error_histogram(log, end).tolist()
    reference = receives_truth(mission.loop.estimator)
    return Cell(name, estimator, fingerprint, "", flights, histogram, series, reference, flaw)


def fly(
    mission: Mission, seed: int, first: int = 0, after_step: Callable[[int], None] | None = None
) -> tuple[Log, NDArray[np.int64]]:
    """Simulate a mission: its log (n, T) of `log_dtype`, and how many samples each flight lasted (n,).

    Its flights are those with the numbers `first`, `first` + 1, ... of the seed. `after_step` is called with
    the number of each sample.
    """
    mission.begin(vehicle_seeds(seed, first + mission.n)[first:])
    log = np.zeros((mission.steps, mission.n), log_dtype(len(mission.vehicle.rotors)))
    last_command = mission.loop.controller.rotor_vel_cmd.copy()
    end = np.full(mission.n, mission.steps)
    for k in range(mission.steps):
        mission.step()
        write_row(mission.records, last_command, log[k])
        if after_step is not None:
            after_step(k)
        if mission.crashed:
            end[(mission.cause > 0) & (end > k)] = k
    return log.swapaxes(0, 1), end
