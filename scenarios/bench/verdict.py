"""The verdict of a benchmark in words: the best estimator, and how the others compare."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .flight_metrics import CellRow
from .pairs import ALL, PairRow

TRUTH = "truth"
"""The estimator that returns the true attitude: the reference, not a candidate."""


class Standing(NamedTuple):
    """One estimator of the ranking."""

    estimator: str
    grade: str  #: "flies" or "crashes"
    text: str


class Verdict(NamedTuple):
    """The answer, in words."""

    headline: str
    lines: list[str]
    standings: list[Standing]  #: from best to worst
    doubt: str = ""  #: estimators that do not differ significantly from the best; empty: none


class Total(NamedTuple):
    """An estimator over all its scenarios."""

    flights: int
    crashes: int
    error: float  #: mean over scenarios of the estimation error [deg]
    attitude: float  #: mean over scenarios of the attitude tracking [deg]
    failed: int  #: cells that did not run

    @property
    def rank(self) -> tuple[bool, float, float]:
        """What to sort by: fewest crashes first, then the smallest error in thousandths of a degree."""
        return (not self.flights, self.crashes / max(self.flights, 1), round(self.error, 3))


def verdict(rows: Sequence[CellRow], focus: str = "", pairs: Sequence[PairRow] = ()) -> Verdict:
    """Rank the estimators of a benchmark; describe the best, then `focus` if it ran.

    `pairs`, paired differences, decide which estimators do not differ significantly from the best.
    """
    names = list(dict.fromkeys(row.estimator for row in rows))
    totals = {name: total([row for row in rows if row.estimator == name]) for name in names}
    ranked = sorted((name for name in names if name != TRUTH), key=lambda name: totals[name].rank)
    references = [name for name in names if name == TRUTH]
    standings = [_standing(name, totals[name], rows) for name in [*ranked, *references]]
    simulated = [name for name in ranked if totals[name].flights]
    if not simulated:
        only = "Only the truth ran." if TRUTH in names and totals[TRUTH].flights else "No estimator ran."
        return Verdict(only, [], standings)
    best, truth = totals[simulated[0]], totals.get(TRUTH)
    lines = []
    if truth and truth.attitude > 0:
        ratio = best.attitude / truth.attitude
        lines.append(f"Its attitude tracking error is {ratio:.2f} × that with the true attitude.")
    equals = [name for name in simulated[1:] if totals[name].crashes == best.crashes]
    tied = [name for name in equals if _is_tied(simulated[0], name, pairs)]
    doubt = ""
    if tied:
        others = " and ".join(filter(None, [", ".join(tied[:-1]), tied[-1]]))
        doubt = f"Its error is not significantly different from that of {others} (paired 95 % CI includes 0)."
        lines.append(doubt)
    if focus in simulated[1:]:
        lines.append(_sentence(focus, totals[focus], truth))
    least = min(round(totals[name].error, 3) for name in simulated)
    return Verdict(_headline(simulated[0], best, least), lines, standings, doubt)


def offline_verdict(rows: Sequence[Mapping[str, object]]) -> Verdict:
    """The verdict on recorded flights alone: the smallest error from an unknown initial attitude."""
    rows = [row for row in rows if row.get("start") != "known"] or rows
    for key in ("mean_deg", "median_deg"):
        rated = {
            str(row["estimator"]): value for row in rows if isinstance(value := row.get(key), int | float)
        }
        rated.pop(TRUTH, None)
        if rated:
            best = min(rated, key=lambda name: rated[name])
            return Verdict(f"Smallest error on recorded flights: {best}, {rated[best]:.2f}°.", [], [])
    return Verdict("Recorded flights", [], [])


def total(rows: Sequence[CellRow]) -> Total:
    """Add up an estimator's rows."""
    simulated = [row for row in rows if not row.reason]
    error, attitude = (
        float(np.mean([v for row in simulated if (v := getattr(row, key)) is not None] or [0.0]))
        for key in ("error_deg", "attitude_deg")
    )
    flights, crashes = (sum(getattr(row, key) or 0 for row in simulated) for key in ("flights", "crashes"))
    return Total(flights, crashes, error, attitude, len(rows) - len(simulated))


def _headline(name: str, best: Total, least: float) -> str:
    """The best estimator; `least` is the smallest error of any, which may be of one that crashed."""
    if best.crashes:
        crashes = f"in {best.crashes} of {best.flights} flights"
        return f"Fly {name}: it crashed least, {crashes}, with an error of {best.error:.2f}°."
    flights = f"{best.flights} flight{'s' if best.flights > 1 else ''}"
    of_those = "" if round(best.error, 3) <= least else " of those without one"
    return f"Fly {name}: no crash in {flights}, and the smallest error{of_those}, {best.error:.2f}°."


def _is_tied(best: str, other: str, pairs: Sequence[PairRow]) -> bool:
    """Whether two estimators' errors over all scenarios are not significantly different."""
    return any(
        row.is_tied
        for row in pairs
        if (row.scenario, row.metric) == (ALL, "error_deg") and {row.estimator, row.versus} == {best, other}
    )


def _sentence(name: str, each: Total, truth: Total | None) -> str:
    crashes = f"{each.crashes} crash{'es' if each.crashes > 1 else ''}" if each.crashes else "no crash"
    text = f"{name}: {crashes} in {each.flights} flights, error {each.error:.2f}°"
    if truth and truth.attitude > 0:
        ratio = each.attitude / truth.attitude
        text += f", attitude tracking error {ratio:.2f} × that with the true attitude"
    return text + "."


def _standing(name: str, each: Total, rows: Sequence[CellRow]) -> Standing:
    own = [row for row in rows if row.estimator == name and row.crashes]
    crashed = [f"{row.scenario} ({row.crashes} of {row.flights})" for row in own]
    if not each.flights:
        return Standing(name, "crashes", "did not run")
    text = f"crashed in {', '.join(crashed)}" if crashed else f"no crash in {each.flights} flights"
    text += " · the reference" if name == TRUTH else f" · error {each.error:.2f}°"
    if each.failed:
        text += f" · {each.failed} scenario{'s' if each.failed > 1 else ''} did not run"
    return Standing(name, "crashes" if crashed or each.failed else "flies", text)
