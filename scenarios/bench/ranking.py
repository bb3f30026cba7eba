"""Rank contenders that flew the same flights, and compare two of them on the very same flights.

Survival ranks first, and errors only count where all compared ones survived: a flight that crashes early has
a small error until then. Seed i of a scenario is the same start, wind, sensor noise and faults for every
estimator, so that paired differences cancel them.

`flights` is a table with a row for each flight and the columns `flight_metrics.KEYS` and `FLIGHT`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

FIT = 0.5
"""Least share of the flights that a contender which is recommended survives."""


class Place(NamedTuple):
    """A contender among others."""

    name: str
    flights: int  #: that were to be flown
    survived: int  #: of these
    missing: int  #: that did not run, and count as lost
    error: float  #: on flights that it and all with the same survival survived [deg]; infinite without any

    @property
    def whole(self) -> bool:
        """Whether it survived every flight."""
        return self.survived == self.flights

    @property
    def fit(self) -> bool:
        """Whether it survived enough flights to be recommended."""
        return self.survived >= FIT * self.flights

    @property
    def fate(self) -> str:
        """What became of its flights, in words: "crashed in 3 of 20 flights"."""
        flights = f"{self.flights} flight{'s' if self.flights > 1 else ''}"
        counts = {"crashed": self.flights - self.survived - self.missing, "did not run": self.missing}
        lost = listed([f"{what} in {count}" for what, count in counts.items() if count])
        return f"{lost} of {flights}" if lost else f"no crash in {flights}"


def ranked(flights: pd.DataFrame, planned: Sequence[tuple[str, int]], metric: str) -> list[Place]:
    """Contenders from best to worst: by the share of flights survived, the time to the crash, the error.

    Args:
        flights: Of the contenders.
        planned: Scenario and seed of the flights that every contender was to fly.
        metric: What counts as the error [deg].
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
    """How much larger a metric is than that of another contender, on the same flights."""

    mean: float  #: NaN without a flight that both survived
    half: float  #: half the 95 % interval; NaN with fewer than two seeds


def paired_difference(flights: pd.DataFrame, other: str, first: str, metric: str) -> Difference:
    """The metric of `other` minus that of `first` on the flights that both survived.

    The interval is Student's over seeds; a seed's difference is first averaged over scenarios, for its
    flights share their sensor noise.
    """
    both = flights.query("cause == '' and estimator in [@other, @first]")
    wide: Any = both.pivot(index=["scenario", "seed"], columns="estimator", values=metric)
    wide = wide.reindex(columns=[other, first])
    seeds = (wide[other] - wide[first]).dropna().groupby("seed").mean()
    return Difference(float(seeds.mean()), float(stdtrit(len(seeds) - 1, 0.975) * seeds.sem()))


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names in words: "a, b and c"."""
    return f" {last} ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
