"""Breaking points: the least level of a sweep at which a flight crashes, by bisection."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from quadsim.flight.scenario import Scenario

from .cell import Cell
from .experiment import Sweep

FlyCells = Callable[[Sequence[tuple[str, Scenario, str]]], Sequence[Cell]]
"""Flies cells: name and scenario, and the contender."""


@dataclass(frozen=True)
class BreakingPoint:
    """Where a contender breaks: between `flies_at` and `crashes_at`."""

    sweep: str
    estimator: str
    flies_at: float | None = None
    """Largest level without a crash; None if it crashes at level 0."""
    crashes_at: float | None = None
    """Least level with a crash; None if the largest level has none."""
    cause: str = ""
    """Of the first crash."""
    reason: str = ""
    """Why it did not run; empty if it did."""

    @property
    def text(self) -> str:
        """The least level that crashes, in words."""
        if self.reason:
            return "did not run"
        return f"> {self.flies_at:.3g}" if self.crashes_at is None else f"{self.crashes_at:.3g}"


Bracket = tuple[float | None, float | None]


def bisection(most: float, tolerance: float) -> Generator[float, bool, Bracket]:
    """Yield levels from 0 to `most`, be sent whether each crashes, and return the bracket (no crash, crash).

    It is of the least level that crashes; None where an end is open.
    """
    if (yield 0.0):
        return None, 0.0
    if not (yield most):
        return most, None
    low, high = 0.0, most
    while high - low > tolerance * (1 + 1e-9):
        middle = 0.5 * (low + high)
        if (yield middle):
            high = middle
        else:
            low = middle
    return low, high


def breaking_points(
    sweeps: Mapping[str, Sweep], names: Sequence[str], changes: Mapping[str, Any], fly: FlyCells
) -> list[BreakingPoint]:
    """The breaking point of every contender in every sweep; all brackets are halved together.

    Raises:
        ValueError: A level that the scenario cannot have.
    """
    pairs = [(sweep, name) for sweep in sweeps for name in names]
    searches = {(s, n): bisection(sweeps[s].most, sweeps[s].tolerance) for s, n in pairs}
    levels = {pair: next(search) for pair, search in searches.items()}
    found: dict[tuple[str, str], BreakingPoint] = {}
    causes: dict[tuple[str, str], str] = {}
    while levels:
        jobs = [(f"{s}={level:g}", sweeps[s].at(level, changes), n) for (s, n), level in levels.items()]
        for pair, cell in zip(list(levels), fly(jobs), strict=True):
            del levels[pair]
            if cell.reason:
                found[pair] = BreakingPoint(*pair, reason=cell.reason)
                continue
            first = min((f for f in cell.flights if f.cause), key=lambda f: f.flown_s, default=None)
            causes[pair] = first.cause if first else causes.get(pair, "")
            try:
                levels[pair] = searches[pair].send(first is not None)
            except StopIteration as end:
                found[pair] = BreakingPoint(*pair, *end.value, cause=causes[pair])
    return [found[pair] for pair in pairs]
