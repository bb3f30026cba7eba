"""Breaking points: the least wind, gyro bias or loss of samples at which a flight crashes, by bisection."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadsim.flight.faults import Dropout, GyroBiasStep
from quadsim.flight.scenario import Scenario, load_scenario
from quadsim.runs.files import read_json, write_json
from quadsim.runs.fingerprint import fingerprint
from quadsim.runs.pool import run_all
from quadsim.wind import Constant

from .cell import digest_if_there, file_name, fly_cell, weights_digest
from .runner import NO_CHANGES, Progress, suite_digest
from .settings import FlightSettings, ScenarioChanges

log = logging.getLogger(__name__)


class Disturbance(NamedTuple):
    """A disturbance with a level."""

    label: str
    unit: str
    most: float  #: largest level
    tolerance: float  #: width of the bracket at which the bisection ends
    scenario: str  #: shipped scenario that it is added to
    change: Callable[[Scenario, float], Scenario]  #: the scenario at a level
    help: str


def _wind(scenario: Scenario, level: float) -> Scenario:
    return scenario.model_copy(update={"wind": (Constant(velocity=(level, 0.0, 0.0)),)})


def _bias(scenario: Scenario, level: float) -> Scenario:
    first = next(fault for fault in scenario.faults if isinstance(fault, GyroBiasStep))
    x, y, z = level * np.array(first.bias_deg) / np.linalg.norm(first.bias_deg)
    return scenario.model_copy(update={"faults": (first.model_copy(update={"bias_deg": (x, y, z)}),)})


def _dropout(scenario: Scenario, level: float) -> Scenario:
    return scenario.model_copy(update={"faults": (Dropout(kind="dropout", probability=level),)})


DISTURBANCES = {
    "wind": Disturbance(
        "Constant wind", "m/s", 64.0, 0.25, "wind-8", _wind,
        "Wind that sets in at once on a vehicle in hover.",
    ),
    "bias": Disturbance(
        "Step of the gyro bias", "deg/s", 64.0, 0.5, "gyro-bias-step", _bias,
        "Bias of the gyroscope that sets in at once in a figure of eight, in the plane of roll and pitch.",
    ),
    "dropout": Disturbance(
        "Lost samples", "", 1.0, 0.01, "dropouts", _dropout,
        "Share of single IMU samples that are lost in a figure of eight.",
    ),
}  # fmt: skip
"""Disturbances by their name on the command line."""


@dataclass(frozen=True)
class BreakingPoint:
    """Where an estimator breaks: between `flies_at` and `crashes_at`."""

    disturbance: str
    estimator: str
    unit: str
    flies_at: float | None  #: largest level without a crash; None if it crashes at level 0
    crashes_at: float | None  #: least level with a crash; None if the largest level has none
    cause: str  #: of the first crash
    seeds: int
    reason: str  #: why it did not run; empty if it did

    @property
    def text(self) -> str:
        """The least level that crashes, in words."""
        if self.reason:
            return "did not run"
        return f"> {self.flies_at:.3g}" if self.crashes_at is None else f"{self.crashes_at:.3g}"


def chosen(names: Sequence[str], duration_s: float | None = None) -> list[str]:
    """Names of disturbances, "all" for every one of them, in flights of a length [s], or their own.

    Raises:
        ValueError: For an unknown disturbance, or one that begins after the end of the flights.
    """
    if unknown := [name for name in names if name not in (*DISTURBANCES, "all")]:
        raise ValueError(f'unknown breaking point "{unknown[0]}"; valid: {", ".join(DISTURBANCES)}, all')
    valid = list(DISTURBANCES) if "all" in names else list(dict.fromkeys(names))
    for name in valid:
        faults = load_scenario(DISTURBANCES[name].scenario).faults
        begins = max((fault.at_s for fault in faults if isinstance(fault, GyroBiasStep)), default=0.0)
        if duration_s is not None and duration_s <= begins:
            raise ValueError(
                f"breaking point {name}: it begins at {begins:g} s, and flights last {duration_s:g} s; "
                "give a longer duration"
            )
    return valid


def breaking_points(
    disturbances: Sequence[str],
    names: Sequence[str],
    out: str | Path,
    settings: FlightSettings,
    changes: ScenarioChanges = NO_CHANGES,
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[BreakingPoint]:
    """Find the breaking point of every estimator under every disturbance; finished ones are stored.

    Args:
        disturbances: Keys of `DISTURBANCES`, or "all".
        names: Names of estimators.
        out: Folder of the results; files go to `out/breaking`.
        settings: Seeds, sample rate, tuning; flights of all estimators and levels have the same seeds.
        changes: Fields that replace those of the scenarios.
        workers: Processes, as for `bench`; so are `executor` and `progress`.
        executor: Where to run.
        progress: Called with the points done and their total.

    Raises:
        ValueError: For an unknown disturbance, or one that begins after the end of the flights.
        OSError: If the results cannot be written.
    """
    disturbances = chosen(disturbances, changes.duration_s)
    jobs = [(d, e, settings, changes) for d in disturbances for e in names]
    folder = Path(out).expanduser() / "breaking"
    folder.mkdir(parents=True, exist_ok=True)
    sources = (changes.vehicle, changes.imu, changes.external, settings.tuning)
    run = [suite_digest(), asdict(settings), asdict(changes), [digest_if_there(s) for s in sources if s]]
    prints = [fingerprint(d, e, weights_digest(e), run) for d, e, *_ in jobs]
    files = [folder / f"{d}--{file_name(e)}.json" for d, e, *_ in jobs]
    stored = map(_load, files, prints)
    points = {i: point for i, point in enumerate(stored) if point}
    missing = [i for i in range(len(jobs)) if i not in points]
    if progress:
        progress(len(points), len(jobs))
    for at, point in run_all(break_point, [jobs[i] for i in missing], workers, executor):
        i = missing[at]
        if isinstance(point, BaseException):  # the worker itself died
            point = _nothing(*jobs[i][:3], f"{type(point).__name__}: {point}")
        if point.reason:
            log.warning("%s under %s did not run: %s", point.estimator, point.disturbance, point.reason)
        else:
            write_json(files[i], {"fingerprint": prints[i], "point": asdict(point)})
        points[i] = point
        if progress:
            progress(len(points), len(jobs))
    return [points[i] for i in range(len(jobs))]


def break_point(
    disturbance: str, estimator: str, settings: FlightSettings, changes: ScenarioChanges
) -> BreakingPoint:
    """Find one breaking point; an estimator that fails is one with its reason."""
    kind = DISTURBANCES[disturbance]
    base = changes.of(load_scenario(kind.scenario))
    causes: dict[float, str] = {}
    reasons: list[str] = []

    def crashes(level: float) -> bool:
        cell = fly_cell(disturbance, kind.change(base, level), estimator, settings)
        reasons.extend([cell.reason] * bool(cell.reason))
        first = min((f for f in cell.flights if f.cause), key=lambda f: f.flown_s, default=None)
        causes[level] = first.cause if first else ""
        return bool(cell.reason or first)

    low, high = bisect(crashes, kind.most, kind.tolerance)
    if reasons:
        return _nothing(disturbance, estimator, settings, reasons[0])
    cause = "" if high is None else causes[high]
    return BreakingPoint(disturbance, estimator, kind.unit, low, high, cause, settings.seeds, "")


def bisect(
    crashes: Callable[[float], bool], most: float, tolerance: float
) -> tuple[float | None, float | None]:
    """The bracket (no crash, crash) of the least level that crashes, 0 to most; None where an end is open."""
    if crashes(0.0):
        return None, 0.0
    if not crashes(most):
        return most, None
    low, high = 0.0, most
    while high - low > tolerance * (1 + 1e-9):
        middle = 0.5 * (low + high)
        if crashes(middle):
            high = middle
        else:
            low = middle
    return low, high


def _nothing(disturbance: str, estimator: str, settings: FlightSettings, reason: str) -> BreakingPoint:
    unit = DISTURBANCES[disturbance].unit
    return BreakingPoint(disturbance, estimator, unit, None, None, "", settings.seeds, reason)


def load_points(out: str | Path) -> list[BreakingPoint]:
    """The breaking points stored in a folder, in the order of `DISTURBANCES`."""
    points = map(_load, sorted((Path(out).expanduser() / "breaking").glob("*--*.json")))
    order = list(DISTURBANCES)
    return sorted((each for each in points if each), key=lambda each: order.index(each.disturbance))


def _load(file: Path, fingerprint: str | None = None) -> BreakingPoint | None:
    try:
        content = read_json(file)
        point = BreakingPoint(**content["point"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return point if fingerprint in (None, content["fingerprint"]) else None
