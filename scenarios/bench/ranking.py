"""Rank contenders that flew the same flights, and compare two of them on the very same flights.

Survival ranks first, and errors only count where all compared ones survived: a flight that crashes early has
a small error until then. Seed i of a scenario is the same start, wind, sensor noise and faults for every
estimator, so that paired differences cancel them.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from .flight_metrics import FlightRow

Flight = tuple[str, int]
"""Scenario and seed."""
Flown = Mapping[Flight, FlightRow]
"""The flights of one contender."""
FIT = 0.5
"""Least share of the flights that a contender which is recommended survives."""


class Place(NamedTuple):
    """A contender among others."""

    name: str
    flights: int  #: that were to be flown
    survived: int  #: of these
    missing: int  #: that did not run, and count as lost
    flown_s: float  #: mean time until the crash or the end [s]
    error: (
        float  #: on the flights that it and all with the same survival survived [deg]; infinite without any
    )

    @property
    def whole(self) -> bool:
        """Whether it survived every flight."""
        return self.survived == self.flights

    @property
    def fit(self) -> bool:
        """Whether it survived enough flights to be recommended."""
        return self.survived >= FIT * self.flights

    @property
    def lost(self) -> str:
        """What it did not survive, in words: "crashed in 3 of 20 flights"."""
        crashed = self.flights - self.survived - self.missing
        counts = {"crashed": crashed, "did not run": self.missing}
        parts = listed([f"{what} in {count}" for what, count in counts.items() if count])
        return f"{parts} of {self.flights} flight{'s' if self.flights > 1 else ''}"


def by_contender(flights: Sequence[FlightRow]) -> dict[str, dict[Flight, FlightRow]]:
    """Flights by contender, then by scenario and seed."""
    found: dict[str, dict[Flight, FlightRow]] = {}
    for row in flights:
        found.setdefault(row.estimator, {})[row.scenario, row.seed] = row
    return found


def ranked(flown: Mapping[str, Flown], planned: Collection[Flight], metric: str = "error_deg") -> list[Place]:
    """Contenders from best to worst: by the share of flights survived, the time to the crash, the error.

    Args:
        flown: The flights of each contender.
        planned: The flights that every contender was to fly.
        metric: What counts as the error, a field of `FlightRow` [deg].
    """
    alike: dict[tuple[int, float], list[str]] = {}
    for name, rows in flown.items():
        seconds = sum(rows[flight].flown_s for flight in planned if flight in rows) / max(len(planned), 1)
        count = sum(survives(rows, flight) for flight in planned)
        alike.setdefault((count, round(seconds, 3)), []).append(name)
    places = []
    for (count, seconds), names in sorted(alike.items(), reverse=True):
        common = [flight for flight in planned if all(survives(flown[name], flight) for name in names)]
        found = []
        for name in names:
            missing = sum(flight not in flown[name] for flight in planned)
            error = _mean_over_scenarios(flown[name], common, metric)
            found.append(Place(name, len(planned), count, missing, seconds, error))
        places += sorted(found, key=lambda place: place.error)
    return places


def survives(rows: Flown, flight: Flight) -> bool:
    """Whether a flight ran and did not crash."""
    return flight in rows and not rows[flight].cause


def winners(places: Sequence[Place], worse: Callable[[str, str], bool]) -> list[Place]:
    """The best contender and those after it that survived as many flights and are not significantly worse.

    The list ends at the first that is worse, so every contender in it ranks above those left out.

    Args:
        places: From best to worst.
        worse: Whether the second of two contenders has a significantly larger error than the first.
    """
    found = list(places[:1])
    for place in places[1:]:
        if place.survived != places[0].survived or worse(places[0].name, place.name):
            break
        found.append(place)
    return found


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names in words: "a, b and c"."""
    return f" {last} ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def _mean_over_scenarios(rows: Flown, common: Collection[Flight], metric: str) -> float:
    """Mean over scenarios of the mean over their flights; infinite without any, or where one is not known."""
    by_scenario: dict[str, list[float]] = {}
    for flight in common:
        value = getattr(rows[flight], metric)
        by_scenario.setdefault(flight[0], []).append(np.inf if value is None else value)
    return float(np.mean([np.mean(each) for each in by_scenario.values()])) if by_scenario else np.inf


class Difference(NamedTuple):
    """How much larger a metric is than that of another contender, on the same flights."""

    mean: float | None  #: None without a flight that both survived
    low: float | None = None  #: ends of the interval; None with fewer than two seeds
    high: float | None = None


def paired_difference(other: Flown, first: Flown, metric: str, level: float = 0.95) -> Difference:
    """The metric of `other` minus that of `first` on the flights that both survived.

    The interval of a `level` is Student's over seeds; a seed's difference is first averaged over scenarios,
    for its flights share their sensor noise.
    """
    by_seed: dict[int, list[float]] = {}
    for flight in other:
        if survives(other, flight) and survives(first, flight):
            values = getattr(other[flight], metric), getattr(first[flight], metric)
            if None not in values:
                by_seed.setdefault(flight[1], []).append(values[0] - values[1])
    found = np.array([np.mean(each) for each in by_seed.values()])
    if found.size < 2:
        return Difference(float(found[0]) if found.size else None)
    half = float(stdtrit(found.size - 1, 0.5 + 0.5 * level) * found.std(ddof=1)) / math.sqrt(found.size)
    mean = float(found.mean())
    return Difference(mean, mean - half, mean + half)
