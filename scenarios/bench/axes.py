"""Axes: what varies around a scenario, a designed fraction of all combinations, and the effect of each.

A design is a Latin hypercube over the axes (McKay, Beckman & Conover 1979), of which scipy keeps the one that
covers pairs of axes most evenly: every level is flown equally often, beside every level of the others about
equally often, so that the mean over the flights of a level is its main effect.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from quadsim.flight.scenario import Scenario, changed, load_scenario

from .flight_metrics import FlightRow, wilson
from .ranking import Flight, Flown, Place, by_contender, listed, ranked, winners
from .recommendation import recommendation
from .runner import Results, identical
from .statistics import (
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
    stratified_interval,
)
from .verdict import on_truth, recommended

CELLS = 72
"""Combinations of the designed fraction: whole multiples of three levels and of four."""
SCENARIOS = ("hover", "figure-8", "dryden-moderate", "wind-8")
"""What is flown at each combination, unless others are asked for."""
VIBRATION = {"kind": "vibration", "frequency_hz": 87.0, "accel": 1.5, "gyro_deg": 1.0}
LEVER_ARM = {"kind": "lever-arm", "position": (0.03, -0.02, 0.01)}
RAW_BIAS = {"kind": "gyro-bias-step", "bias_deg": (2.5, -2.5, 1.87), "at_s": 0.0}
"""4 °/s in all, from the first sample on."""

AXES: dict[str, dict[str, dict[str, Any]]] = {
    "initial attitude": {
        "given": {"start": {"known_attitude": True}},
        "given, 4° wrong": {"start": {"known_attitude": True, "attitude_error_deg": 4.0}},
        "unknown": {"start": {"known_attitude": False}},
    },
    "motion": {
        "rest": {"start": {"speed": 0.0, "tilt_deg": 0.0, "rate_deg": 0.0}},
        "4 m/s": {"start": {"speed": 4.0, "tilt_deg": 0.0, "rate_deg": 0.0}},
        "hand launch": {"start": {"speed": 2.0, "tilt_deg": 40.0, "rate_deg": 200.0}},
    },
    "drag": {
        "known": {},
        "half of what is known": {"drag_factor": 0.5},
        "twice what is known": {"drag_factor": 2.0},
        "not known": {"vehicle_known": False},
    },
    "airframe": {name: {"vehicle": name} for name in ("hummingbird", "px4-quad", "crazyflie", "hexarotor")},
    "IMU": {
        "ADIS16448": {"imu": "adis16448"},
        "px4-mini": {"imu": "px4-mini"},
        "rough, vibration, lever arm": {"imu": "rough", "faults": (VIBRATION, LEVER_ARM)},
        "bias of 4 °/s": {"imu": "px4-mini", "faults": (RAW_BIAS,)},
    },
}
"""For each axis its levels, and the fields of a scenario that they set; faults are added."""


@dataclass(frozen=True)
class Combination:
    """One cell of a design: a level of each axis, and what it is flown in."""

    name: str
    scenario: str
    levels: dict[str, str]
    """Axis to level."""


@dataclass(frozen=True)
class Effect:
    """An estimator at one level of one axis, or (`ALL`) over all."""

    axis: str
    level: str
    estimator: str
    flights: int
    """0: it flies at none of them."""
    crashes: int
    crash_low: float
    """Ends of the 95 % Wilson interval of the crash rate."""
    crash_high: float
    error_deg: float | None
    """Interquartile mean of the flights' errors; None without a flight."""
    low: float | None
    """Ends of its 95 % interval, bootstrapped within each combination."""
    high: float | None
    failed: int
    """Combinations at which it did not fly."""
    lost: float
    """Share of the planned flights that crashed or did not run."""
    unranked: str
    """Why it is not ranked, to follow its name in a sentence; empty if it is."""

    @property
    def crash_rate(self) -> float:
        """Share of the flights that crashed; 1 without any."""
        return self.crashes / self.flights if self.flights else 1.0


ALL = "all"
HELD_OUT = "held-out-"
"""What the names of the held-out suite's scenarios begin with."""


def table(combinations: Sequence[Combination]) -> list[dict[str, str]]:
    """The design as rows of a table."""
    return [{"name": each.name, "scenario": each.scenario, **each.levels} for each in combinations]


def read_table(path: Path) -> list[Combination]:
    """The design from the file that `table` was written to; none where there is no such file.

    Raises:
        ValueError: It is no table of a design.
    """
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        return [Combination(r["name"], r["scenario"], {axis: r[axis] for axis in AXES}) for r in rows]
    except KeyError as error:
        raise ValueError(f"{path}: not the table of a design: it has no column {error}") from None


def design(
    scenarios: Sequence[str] = SCENARIOS, cells: int = CELLS, seed: int = 0, full: bool = False
) -> list[Combination]:
    """Combinations of the levels of `AXES` and of scenarios.

    Args:
        scenarios: An axis too: each combination is flown in one of them.
        cells: How many combinations; with `full` every one of them.
        seed: Of the design.
        full: Every combination, in every scenario.

    Raises:
        ValueError: Fewer combinations than an axis has levels.
    """
    axes = {name: list(levels) for name, levels in AXES.items()}
    most = max(map(len, (*axes.values(), scenarios)))
    if full:
        places = list(product(*(range(len(levels)) for levels in axes.values()), range(len(scenarios))))
    elif cells < most:
        raise ValueError(f"cells: {cells}, an axis has {most} levels; give {most} or more")
    else:
        sampler = qmc.LatinHypercube(len(axes) + 1, optimization="random-cd", rng=np.random.default_rng(seed))
        counts = np.array([len(levels) for levels in axes.values()] + [len(scenarios)])
        places = np.floor(sampler.random(cells) * counts).astype(int).tolist()
    width = len(str(len(places) - 1))
    return [
        Combination(
            f"axes-{number:0{width}}",
            scenarios[place[-1]],
            {axis: levels[k] for (axis, levels), k in zip(axes.items(), place, strict=False)},
        )
        for number, place in enumerate(places)
    ]


def scenario_of(combination: Combination) -> Scenario:
    """The scenario of a combination.

    Raises:
        ValueError: No such scenario, or one that a level does not fit.
    """
    return with_levels(load_scenario(combination.scenario), combination.levels)


def with_levels(base: Scenario, levels: Mapping[str, str]) -> Scenario:
    """A scenario with what levels of the axes set; faults are added to its own.

    Raises:
        ValueError: A level that does not fit.
    """
    fields = base.model_dump()
    for axis, level in levels.items():
        for name, value in AXES[axis][level].items():
            if name == "faults":
                fields[name] = (*fields[name], *value)
            elif isinstance(value, Mapping):
                fields[name] = {**fields[name], **value}
            else:
                fields[name] = value
    said = "; ".join(f"{axis}: {level}" for axis, level in levels.items())
    return changed(base, fields | {"description": f"{base.description.rstrip('.')}; {said}."})


def effects(combinations: Sequence[Combination], results: Results, seed: int = 0) -> list[Effect]:
    """Every estimator at every level of every axis, scenarios among them, and over all.

    Flights that crash with the true attitude are excluded for every estimator. Estimators that flew exactly
    as another have no rows.

    Args:
        combinations: The design.
        results: Of `bench` on its scenarios.
        seed: Of the bootstrap.
    """
    flown: dict[tuple[str, str], list[FlightRow]] = {}
    for flight in counted(results):
        flown.setdefault((flight.scenario, flight.estimator), []).append(flight)
    failed = {(cell.scenario, cell.estimator) for cell in results.cells if cell.reason}
    same, unranked = identical(results), results.unranked
    estimators = [name for name in results.estimators if name not in same]
    survivable = truth_survives(results)
    by_axis = {axis: list(levels) for axis, levels in AXES.items()}
    by_axis["scenario"] = list(dict.fromkeys(each.scenario for each in combinations))
    rows = []
    for axis, level in [(ALL, ALL), *((axis, level) for axis, levels in by_axis.items() for level in levels)]:
        names = [each.name for each in combinations if axis == ALL or _level(each, axis) == level]
        planned = sum(scenario in names for scenario, _ in survivable)
        for estimator in estimators:
            cells = [flown.get((name, estimator), []) for name in names]
            flights = [flight for cell in cells for flight in cell]
            crashes = sum(bool(flight.cause) for flight in flights)
            known = [values for cell in cells if (values := _errors(cell)).size]
            middle, low, high = None, None, None
            if known:
                middle = float(interquartile_mean(np.concatenate(known)))
                if max(map(len, known)) > 1:  # one flight of each scenario says nothing of its scatter
                    low, high = stratified_interval(known, interquartile_mean, seed)
            rows.append(
                Effect(
                    axis, level, estimator, len(flights), crashes, *wilson(crashes, len(flights)),
                    middle, low, high, sum((name, estimator) in failed for name in names),
                    1.0 - (len(flights) - crashes) / planned if planned else 0.0, unranked.get(estimator, ""),
                )
            )  # fmt: skip
    return rows


def truth_survives(results: Results) -> list[Flight]:
    """The planned flights that do not crash with the true attitude."""
    lost = {(f.scenario, f.seed) for f in results.flights if on_truth(f.estimator) and f.cause}
    return [flight for flight in results.planned if flight not in lost]


def counted(results: Results) -> list[FlightRow]:
    """The flights that do not crash with the true attitude."""
    kept = {*truth_survives(results)}
    return [flight for flight in results.flights if (flight.scenario, flight.seed) in kept]


def ranking(effects: Sequence[Effect]) -> list[str]:
    """Estimators from best to worst: by the share of flights survived, then the error; unranked ones last."""
    whole = [each for each in effects if each.axis == ALL]
    return [each.estimator for each in sorted(whole, key=lambda each: (bool(each.unranked), *_cost(each)))]


def profiles(results: Results, thresholds: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Share of the flights with an error of at most each threshold [deg], by estimator.

    Flights that crashed, and those that the estimator cannot fly, are of the flights but below no threshold.
    """
    flights = counted(results)
    same, flown = identical(results), len({(flight.scenario, flight.seed) for flight in flights})
    found = {}
    for name in (each for each in results.estimators if each not in same):
        known = _errors([flight for flight in flights if flight.estimator == name])
        errors = np.concatenate([known, np.full(flown - len(known), np.inf)])
        found[name] = performance_profile(errors, thresholds) if flown else np.zeros(len(thresholds))
    return found


class Choice(NamedTuple):
    """What to fly on a condition."""

    condition: str
    where: str  #: the condition in the headline
    best: list[Place]  #: the best and those that are not significantly worse; empty where none flew
    text: str


CONDITIONS = {
    "With the airframe's drag known": ("where the airframe's drag is known", ("known",)),
    "With drag that is half or twice what is known": (
        "where it is half or twice that", ("half of what is known", "twice what is known"),
    ),
    "On an airframe whose drag is not known": ("where it is not known", ("not known",)),
}  # fmt: skip
"""For each condition its words in the headline, and its levels of drag."""


def choices(combinations: Sequence[Combination], results: Results, seed: int = 0) -> list[Choice]:
    """What to fly on each condition: the airframe's drag known, wrong, and not known.

    Ranked by the flights survived, then by the interquartile mean of the errors. Named beside the best are
    those that survived as many flights and of which the chance that a flight with the best has the smaller
    error (probability of improvement) does not exceed one half significantly.
    """
    parts = {
        condition: [each for each in combinations if each.levels["drag"] in levels]
        for condition, (_, levels) in CONDITIONS.items()
    }
    return [
        Choice(condition, CONDITIONS[condition][0], *_best(part, results, seed))
        for condition, part in parts.items()
    ]


def headline(found: Sequence[Choice], combinations: Sequence[Combination]) -> str:
    """The choices in one sentence, which says on which flights unless these are of the held-out suite."""
    fly = "Fly" if is_held_out(combinations) else f"On these {len(combinations)} combinations fly"
    chosen = [each for each in found if each.best]
    names = list(dict.fromkeys(_named(each) for each in chosen))
    if not names:
        return "No estimator is fit to fly on these conditions."
    if len(names) == 1 and len(chosen) == len(CONDITIONS):
        return f"{fly} {names[0]}, whether the airframe's drag is known or not."
    return f"{fly} {', '.join(f'{_named(each)} {each.where}' for each in chosen)}."


def is_held_out(combinations: Sequence[Combination]) -> bool:
    """Whether these are the flights of the held-out suite, which make the recommendation."""
    return all(each.name.startswith(HELD_OUT) for each in combinations)


def _named(choice: Choice) -> str:
    """The estimators of a choice, with their crashes."""
    first, names = choice.best[0], listed([place.name for place in choice.best], "or")
    crashed = "" if first.whole else f" ({first.lost})"
    return names + crashed


def advice(combinations: Sequence[Combination], results: Results, seed: int = 0) -> list[str]:
    """`choices` as sentences, the smallest loss at a worst level, and what to fly elsewhere."""
    lines = [f"{each.condition}: {each.text}" for each in choices(combinations, results, seed)]
    found = effects(combinations, results, seed)
    able = {each.estimator for each in found if each.axis == ALL and not each.unranked and not each.failed}
    worst = {name: each for name in sorted(able) if (each := worst_level(found, name))}
    safest = min(worst, key=lambda name: _cost(worst[name]), default=None)
    if safest is not None:
        lines.append(f"Smallest loss at its worst level: {safest}, {described(worst[safest])}.")
    if not is_held_out(combinations):
        lines.append(recommendation().elsewhere)
    return lines


def worst_level(found: Sequence[Effect], estimator: str) -> Effect | None:
    """The level at which most flights crash, or the error is largest; None where it did not fly."""
    own = [each for each in found if each.estimator == estimator and each.axis != ALL and each.flights]
    return max(own, key=_cost, default=None)


def _cost(effect: Effect) -> tuple[float, float]:
    return effect.lost, np.inf if effect.error_deg is None else effect.error_deg


def described(effect: Effect | None) -> str:
    """A level with its crashes and error."""
    if effect is None:
        return "no flight"
    error = "" if effect.error_deg is None else f", error {effect.error_deg:.2f}°"
    return f"{effect.axis} = {effect.level}, {effect.crashes} of {effect.flights} crashed{error}"


def _best(combinations: Sequence[Combination], results: Results, seed: int) -> tuple[list[Place], str]:
    names, left_out = {each.name for each in combinations}, {*results.unranked, *identical(results)}
    planned = [flight for flight in truth_survives(results) if flight[0] in names]
    flown = {
        name: rows
        for name, rows in by_contender(counted(results)).items()
        if name not in left_out and any(flight in rows for flight in planned)
    }
    if not flown:
        return [], "no estimator flew."
    places = ranked(flown, planned, average=_middle)

    def worse(first: str, other: str) -> bool:
        own, others = _strata(flown[first], planned), _strata(flown[other], planned)
        return probability_of_improvement(own, others, seed)[1] > 0.5

    best = winners(places, worse)
    text = recommended(best, places)
    if not best[0].fit:
        return [], text
    worst = worst_level(effects(combinations, results, seed), best[0].name)
    return best, f"{text} The worst level of {best[0].name} is {described(worst)}."


def _middle(errors: Mapping[Flight, float]) -> float:
    return float(interquartile_mean(np.array(list(errors.values()))))


def _errors(flights: Sequence[FlightRow]) -> NDArray[np.float64]:
    """Errors of the flights that did not crash."""
    return np.array([f.error_deg for f in flights if not f.cause and f.error_deg is not None], float)


def _strata(flown: Flown, planned: Sequence[Flight]) -> list[NDArray[np.float64]]:
    """Errors by scenario, infinite where a flight crashed or did not run."""
    found: dict[str, list[float]] = {}
    for flight in planned:
        row = flown.get(flight)
        error = None if row is None or row.cause else row.error_deg
        found.setdefault(flight[0], []).append(np.inf if error is None else error)
    return [np.array(each) for each in found.values()]


def _level(combination: Combination, axis: str) -> str:
    return combination.scenario if axis == "scenario" else combination.levels[axis]
