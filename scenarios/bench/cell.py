"""A cell of the benchmark: a scenario simulated with one estimator and several seeds."""

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter

import estimators
from estimators.control.controller import make_controller
from estimators.metrics import RANGE, flaw_of
from estimators.tuned import load_tuning
from quadsim.autopilot.flight import AUTOPILOTS, Betaflight
from quadsim.estimator import receives_truth
from quadsim.flight.mission import Mission
from quadsim.flight.scenario import Scenario
from quadsim.flight.world import CAUSES
from quadsim.vehicle import load_vehicle

from .controllers import controller_of, estimator_of
from .flight_log import Flown, fly_mission
from .flight_metrics import error_histogram, flight_metrics
from .flight_series import FlightSeries, pack_series

BOUNDLESS = 1e100
"""Upper bound for plausible values, in any unit; anything larger is treated as divergence."""


@dataclass(frozen=True)
class FlightSettings:
    """Settings for all cells."""

    seeds: int = 1
    """Number of flights in each cell. Flight i uses the i-th child of `seed`."""
    seed: int = 0
    """Seed of all random numbers."""
    rate_hz: float = 200.0
    """Samples per second."""
    tuning: str | None = None
    """Tuned parameters: a shipped domain or a file written by `quadsim tune`. Estimators without a table in
    the file use their default parameters."""

    def __post_init__(self) -> None:
        """Check the number of flights."""
        if self.seeds < 1:
            raise ValueError(f"seeds is {self.seeds}; at least one flight is needed")


@dataclass(frozen=True)
class Cell:
    """Result of a cell."""

    scenario: str
    estimator: str
    reason: str = ""
    """Why the cell did not run; empty if it ran."""
    flights: list[dict[str, Any]] = field(default_factory=list)
    """Columns `flight_metrics.FLIGHT` of each flight; None without a value."""
    histogram: list[int] = field(default_factory=list)
    """Histogram of the errors, as in `flight_metrics.error_histogram`."""
    series: FlightSeries | None = None
    """Time series of the first flight."""
    receives_truth: bool = False
    """Whether the estimator is given the true attitude. Such an estimator is a reference and is not
    ranked."""
    flaw: str = ""
    """Why the estimates must not be ranked, as in `estimators.metrics.flaw_of`; empty if they may be."""
    cpu_s: float = field(default=0.0, compare=False)
    """CPU time [s]."""


CELL = TypeAdapter(Cell)
"""Converts a cell to JSON and back."""


def fly_cell(name: str, scenario: Scenario, estimator: str, settings: FlightSettings) -> Cell:
    """Simulate all flights of a cell; a failure gives a cell with the reason."""
    began = time.thread_time()
    try:
        tuning = tuning_of(estimator, settings.tuning)
        mission = mission_of(scenario, estimator, replace(settings, tuning=tuning))
        cell = make_cell(name, estimator, mission, fly_mission(mission, settings.seed))
        return replace(cell, cpu_s=round(time.thread_time() - began, 3))
    except (Exception, SystemExit) as error:  # whatever an estimator does, the other cells continue
        kind = "" if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: "
        return Cell(name, estimator, f"{kind}{error}")


def tuning_of(estimator: str, tuning: str | None) -> str | None:
    """Return the given tuning file if it has a table for an estimator; None otherwise.

    Raises:
        ValueError: The tuning file cannot be read.
    """
    return tuning if tuning is not None and estimator_of(estimator) in load_tuning(tuning) else None


def mission_of(scenario: Scenario, contender: str, settings: FlightSettings) -> Mission:
    """Make the mission of a scenario with an estimator and a controller.

    Raises:
        ValueError: Estimator or controller cannot be made.
    """
    if (name := estimator_of(contender)) in AUTOPILOTS:
        autopilot = Betaflight(load_vehicle(scenario.vehicle), settings.rate_hz, name)
        return Mission(
            scenario, autopilot, settings.seeds, settings.rate_hz, controller=lambda *_: autopilot.pilot
        )
    vehicle = scenario.vehicle if scenario.vehicle_known else None
    parts = {"tuning": settings.tuning, "vehicle": vehicle, "imu": scenario.imu}
    made = estimators.create(name, settings.rate_hz, **parts)
    controller = make_controller(controller_of(contender))
    return Mission(scenario, made, settings.seeds, settings.rate_hz, controller=controller)


def make_cell(name: str, estimator: str, mission: Mission, flown: Flown) -> Cell:
    """Make the cell of a simulated mission.

    Raises:
        ValueError: An estimate is not an angle, or a flight diverged.
    """
    log, end = flown.log, flown.end
    before = np.arange(mission.steps) < end[:, None]
    flaw = flaw_of(log["estimate"], np.where(before[..., None], log["euler"][..., :2], np.nan))
    wrong = before & ~(np.abs(log["estimate"]) <= RANGE).all(axis=-1)
    if wrong.any():
        first_s = wrong.any(axis=0).argmax() / mission.rate_hz
        raise ValueError(f"the estimator {flaw.partition(' in ')[0]}, first at {first_s:.2f} s")
    if not (np.abs(log[before].view(np.float64)) < BOUNDLESS).all():
        raise ValueError("the flight diverged; is a number of the scenario too large?")
    metrics = flight_metrics(log, end, mission.rate_hz, mission.vehicle)
    flights = [
        {"seed": i, "cause": CAUSES[mission.cause[i]], "flown_s": float(end[i] / mission.rate_hz)}
        | {key: None if np.isnan(values[i]) else float(values[i]) for key, values in metrics.items()}
        for i in range(mission.n)
    ]
    return Cell(
        name,
        estimator,
        flights=flights,
        histogram=error_histogram(log, end).tolist(),
        series=pack_series(log[0, : max(end[0], 1)], mission.rate_hz, flown.signals),
        receives_truth=receives_truth(mission.estimator),
        flaw=flaw,
    )
