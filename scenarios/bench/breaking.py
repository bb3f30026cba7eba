"""Breaking points: how much wind, bias or loss of samples an estimator stands, found by bisection.

A level of disturbance counts as flown if none of the flights crashes; the breaking point is the least level
at which one does, to within a tolerance, if more is worse.
"""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadsim.flight.faults import Dropout, GyroBiasStep
from quadsim.flight.scenario import Scenario, changed, load_scenario
from quadsim.runs.files import read_json, write_json
from quadsim.runs.fingerprint import fingerprint
from quadsim.runs.spread import spread
from quadsim.wind import Constant

from .cell import digest_if_there, file_name, fly_cell, weights_digest

log = logging.getLogger(__name__)


class Disturbance(NamedTuple):
    """Something that there can be more and more of."""

    label: str
    unit: str
    most: float  #: largest level that is tried
    tolerance: float  #: width of the bracket at which the bisection ends
    scenario: str  #: shipped scenario that it happens in
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
"""What can be searched for a breaking point, by the name of the command line."""


@dataclass(frozen=True)
class Breaking:
    """Where an estimator breaks: between `flies_at` and `crashes_at`."""

    disturbance: str
    estimator: str
    unit: str
    flies_at: float | None  #: largest level found to be flown; None if it crashes without any
    crashes_at: float | None  #: least level found to crash; None if it flies at the most that is tried
    cause: str  #: how the first crash came about
    seeds: int
    reason: str  #: why there is nothing; empty if all is well

    @property
    def text(self) -> str:
        """The least level that crashes, in words."""
        if self.reason:
            return "did not run"
        if self.crashes_at is None:
            return f"> {self.flies_at:.3g}"
        return f"{self.crashes_at:.3g}"


def chosen(names: Sequence[str], duration_s: float | None = None) -> list[str]:
    """Names of disturbances, "all" for every one of them, in flights of a length [s], or their own.

    Raises:
        ValueError: For a disturbance that there is not, or that sets in after the end of the flights.
    """
    for name in names:
        if name not in (*DISTURBANCES, "all"):
            raise ValueError(f'unknown breaking point "{name}"; valid: {", ".join(DISTURBANCES)}, all')
    found = list(DISTURBANCES) if "all" in names else list(dict.fromkeys(names))
    for name in found:
        faults = load_scenario(DISTURBANCES[name].scenario).faults
        sets_in = max((fault.at_s for fault in faults if isinstance(fault, GyroBiasStep)), default=0.0)
        if duration_s is not None and duration_s <= sets_in:
            raise ValueError(
                f"breaking point {name}: it sets in at {sets_in:g} s, and flights last {duration_s:g} s; "
                "give a longer duration"
            )
    return found


def breaking_points(
    disturbances: Sequence[str],
    names: Sequence[str],
    seeds: int,
    out: str | Path,
    *,
    code: str,
    seed: int = 0,
    rate_hz: float = 200.0,
    vehicle: str | None = None,
    imu: str | None = None,
    external: str | None = None,
    tuning: str | None = None,
    duration_s: float | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Breaking]:
    """Find the breaking point of every estimator under every disturbance; finished ones are kept.

    Args:
        disturbances: Keys of `DISTURBANCES`, or "all".
        names: Names of estimators.
        seeds: Flights at each level; those of all estimators and levels have the same seeds.
        out: Folder of the results; files go to `out/breaking`.
        code: Digest of the code, so that points of other code are not taken for these.
        seed: Seed of everything random.
        rate_hz: Samples per second.
        vehicle: Another vehicle, as in `runner.bench`.
        imu: Another IMU.
        tuning: Tuned parameters in place of the shipped ones.
        external: External sensor instead of the scenarios' own.
        duration_s: Length of the flights, instead of the scenarios' [s].
        workers: Processes, as in `spread`.
        executor: Where to run in place of processes of our own.
        progress: Called with the points done and their total.

    Raises:
        ValueError: For a disturbance that there is not, or that sets in after the end of the flights.
        OSError: If the results cannot be written.
    """
    disturbances = chosen(disturbances, duration_s)
    changes = {"vehicle": vehicle, "imu": imu, "external": external, "duration_s": duration_s}
    changes = {key: value for key, value in changes.items() if value is not None}
    jobs = [(d, e, seeds, seed, rate_hz, changes, tuning) for d in disturbances for e in names]
    folder = Path(out).expanduser() / "breaking"
    folder.mkdir(parents=True, exist_ok=True)
    prints = [
        fingerprint(
            job,
            code,
            weights_digest(job[1]),
            [digest_if_there(each) for each in (vehicle, imu, external, tuning) if each],
        )
        for job in jobs
    ]
    files = [folder / f"{disturbance}--{file_name(name)}.json" for disturbance, name, *_ in jobs]
    found: dict[int, Breaking] = {}
    for i, (file, print_) in enumerate(zip(files, prints, strict=True)):
        kept = _load(file, print_)
        if kept:
            found[i] = kept
    missing = [i for i in range(len(jobs)) if i not in found]
    if progress:
        progress(len(found), len(jobs))
    for at, point in spread(break_point, [jobs[i] for i in missing], workers, executor):
        i = missing[at]
        if isinstance(point, BaseException):  # the worker itself died
            point = _nothing(jobs[i][0], jobs[i][1], seeds, f"{type(point).__name__}: {point}")
        if point.reason:
            log.warning("%s under %s did not run: %s", point.estimator, point.disturbance, point.reason)
        else:
            write_json(files[i], {"fingerprint": prints[i], "point": asdict(point)})
        found[i] = point
        if progress:
            progress(len(found), len(jobs))
    return [found[i] for i in range(len(jobs))]


def break_point(
    disturbance: str,
    estimator: str,
    seeds: int,
    seed: int,
    rate_hz: float,
    changes: dict[str, object],
    tuning: str | None = None,
) -> Breaking:
    """Find one breaking point; an estimator that fails is one with its reason."""
    kind = DISTURBANCES[disturbance]
    base = changed(load_scenario(kind.scenario), changes)
    causes: dict[float, str] = {}
    reasons: list[str] = []

    def crashes(level: float) -> bool:
        cell = fly_cell(disturbance, kind.change(base, level), estimator, seeds, seed, rate_hz, "", tuning)
        if cell.reason:
            reasons.append(cell.reason)
            return True
        first = min((f for f in cell.flights if f["cause"]), key=lambda f: f["flown_s"] or 0.0, default=None)
        causes[level] = str(first["cause"]) if first else ""
        return first is not None

    low, high = bisect(crashes, kind.most, kind.tolerance)
    if reasons:
        return _nothing(disturbance, estimator, seeds, reasons[0])
    cause = "" if high is None else causes[high]
    return Breaking(disturbance, estimator, kind.unit, low, high, cause, seeds, "")


def bisect(
    crashes: Callable[[float], bool], most: float, tolerance: float
) -> tuple[float | None, float | None]:
    """The bracket (flown, crashed) of the least level that crashes, 0 to most; None where an end is open."""
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


def _nothing(disturbance: str, estimator: str, seeds: int, reason: str) -> Breaking:
    return Breaking(disturbance, estimator, DISTURBANCES[disturbance].unit, None, None, "", seeds, reason)


def load_points(out: str | Path) -> list[Breaking]:
    """The breaking points found earlier in a folder, in the order of `DISTURBANCES`."""
    found = [_load(file) for file in sorted((Path(out).expanduser() / "breaking").glob("*--*.json"))]
    order = list(DISTURBANCES)
    return sorted((each for each in found if each), key=lambda each: order.index(each.disturbance))


def _load(file: Path, fingerprint: str | None = None) -> Breaking | None:
    try:
        content = read_json(file)
        point = Breaking(**content["point"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return point if fingerprint in (None, content["fingerprint"]) else None
