"""Rank contenders that flew the same flights: survival first, errors only where all compared ones survived.

A flight that crashes early has a small error until then, so errors of different flights are never compared.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

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


def mean_over_scenarios(errors: Mapping[Flight, float]) -> float:
    """Mean over scenarios of the mean over their flights."""
    by_scenario: dict[str, list[float]] = {}
    for (scenario, _), error in errors.items():
        by_scenario.setdefault(scenario, []).append(error)
    return float(np.mean([np.mean(each) for each in by_scenario.values()]))


def ranked(
    flown: Mapping[str, Flown],
    planned: Collection[Flight],
    metric: str = "error_deg",
    average: Callable[[Mapping[Flight, float]], float] = mean_over_scenarios,
) -> list[Place]:
    """Contenders from best to worst: by the share of flights survived, the time to the crash, the error.

    Args:
        flown: The flights of each contender.
        planned: The flights that every contender was to fly.
        metric: What counts as the error, a field of `FlightRow` [deg].
        average: Of the errors of several flights.
    """
    alike: dict[tuple[int, float], list[str]] = {}
    for name, rows in flown.items():
        seconds = sum(rows[flight].flown_s for flight in planned if flight in rows) / max(len(planned), 1)
        count = sum(survives(rows, flight) for flight in planned)
        alike.setdefault((count, round(seconds, 3)), []).append(name)
    places = []
    for (count, seconds), names in sorted(alike.items(), reverse=True):
        common = [flight for flight in planned if all(survives(flown[name], flight) for name in names)]
        places += sorted(
            (
                Place(
                    name,
                    len(planned),
                    count,
                    sum(flight not in flown[name] for flight in planned),
                    seconds,
                    _error(flown[name], common, metric, average),
                )
                for name in names
            ),
            key=lambda place: place.error,
        )
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


def _error(
    rows: Flown, common: Collection[Flight], metric: str, average: Callable[[Mapping[Flight, float]], float]
) -> float:
    known = {flight: value for flight in common if (value := getattr(rows[flight], metric)) is not None}
    return average(known) if known and len(known) == len(common) else np.inf
