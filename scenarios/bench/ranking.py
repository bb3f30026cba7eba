"""Ranking of contenders, and paired comparison of two contenders on the same flights.

Contenders are ranked by survival first. Errors are compared only on flights that all compared contenders
survived, because a flight that crashes early can have a small error. Start, wind, sensor noise and faults of
seed i are the same for every estimator, so they cancel in paired differences.

`flights` is a table with a row per flight and the columns `flight_metrics.KEYS` and `FLIGHT`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

FIT = 0.5
"""Smallest share of survived flights of a recommended contender."""


class Place(NamedTuple):
    """Rank of a contender."""

    name: str
    flights: int  #: that were to be flown
    survived: int  #: of these
    missing: int  #: that did not run, and count as lost
    error: float  #: on flights that it and all with the same survival survived [deg]; infinite without any

    @property
    def whole(self) -> bool:
        """Whether the contender survived every flight."""
        return self.survived == self.flights

    @property
    def fit(self) -> bool:
        """Whether the contender survived enough flights to be recommended."""
        return self.survived >= FIT * self.flights

    @property
    def fate(self) -> str:
        """The result of the flights in words, such as "crashed in 3 of 20 flights"."""
        flights = f"{self.flights} flight{'s' if self.flights > 1 else ''}"
        counts = {"crashed": self.flights - self.survived - self.missing, "did not run": self.missing}
        lost = listed([f"{what} in {count}" for what, count in counts.items() if count])
        return f"{lost} of {flights}" if lost else f"no crash in {flights}"


def ranked(flights: pd.DataFrame, planned: Sequence[tuple[str, int]], metric: str) -> list[Place]:
    """Rank contenders by share of survived flights, then time to the crash, then error.

    Args:
        flights: Flights of the contenders.
        planned: Scenario and seed of all planned flights of a contender.
        metric: Column of the error [deg].
    """
    if flights.empty:
        return []
    wide: Any = flights.set_index(["scenario", "seed", "estimator"])[["cause", "flown_s", metric]]
    wide = wide.unstack("estimator", sort=False).reindex(pd.MultiIndex.from_tuples(planned))
    survived, seconds = wide["cause"] == "", wide["flown_s"].sum() / max(len(planned), 1)
    table = pd.DataFrame({"survived": survived.sum(), "flown_s": seconds.round(3), "error": np.inf})
    for _, alike in table.groupby(["survived", "flown_s"]):
        common = wide[metric][survived[alike.index].all(axis=1)][alike.index].fillna(np.inf)
        table.loc[alike.index, "error"] = common.groupby(level=0).mean().mean().fillna(np.inf)
    table = table.sort_values(["survived", "flown_s", "error"], ascending=[False, False, True])
    missing = wide["cause"].isna().sum()
    return [
        Place(str(name), len(planned), int(survived[name].sum()), int(missing[name]), float(error))
        for name, error in table["error"].to_dict().items()
    ]


class Difference(NamedTuple):
    """Difference of a metric from that of another contender on the same flights."""

    mean: float  #: NaN without a flight that both survived
    half: float  #: half the 95 % interval; NaN with fewer than two seeds


def paired_difference(flights: pd.DataFrame, other: str, first: str, metric: str) -> Difference:
    """Return the metric of `other` minus that of `first` on flights that both survived.

    The interval is Student's t over seeds. The difference of each seed is first averaged over scenarios,
    because flights with the same seed have the same sensor noise.
    """
    both = flights.query("cause == '' and estimator in [@other, @first]")
    wide: Any = both.pivot(index=["scenario", "seed"], columns="estimator", values=metric)
    wide = wide.reindex(columns=[other, first])
    seeds = (wide[other] - wide[first]).dropna().groupby("seed").mean()
    return Difference(float(seeds.mean()), float(stdtrit(len(seeds) - 1, 0.975) * seeds.sem()))


def listed(names: Sequence[str], last: str = "and") -> str:
    """Join names in words, such as "a, b and c"."""
    return f" {last} ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
