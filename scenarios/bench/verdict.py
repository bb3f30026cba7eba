"""The verdict of a benchmark in words: the best estimator, or controller, and how the others compare."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadsim.flight.scenario import Scenario

from .controllers import CASCADED, controller_of, estimator_of
from .flight_metrics import CellRow
from .offline import UNRANKED
from .pairs import ALL, PairRow

TRUTH = "truth"
"""The estimator that returns the true attitude: the reference, not a candidate."""
MOST_LINES = 4
"""Lines below the headline."""


class Measure(NamedTuple):
    """What ranks."""

    key: str
    """Of a `CellRow` [deg]."""
    name: str


ERROR = Measure("error_deg", "error")
TRACKING = Measure("attitude_deg", "tracking error")
"""Between controllers: an estimate's error says nothing of them."""


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
    error: float  #: mean over scenarios of what ranks [deg]; infinite where none was measured
    attitude: float  #: mean over scenarios of the attitude tracking [deg]
    failed: int  #: cells that did not run

    @property
    def rank(self) -> tuple[int, float, float]:
        """What to sort by: scenarios not run, share of crashes, error in thousandths of a degree."""
        return (self.failed, self.crashes / max(self.flights, 1), round(self.error, 3))


def verdict(
    rows: Sequence[CellRow],
    focus: str = "",
    pairs: Sequence[PairRow] = (),
    scenarios: Mapping[str, Scenario] | None = None,
) -> Verdict:
    """Rank the estimators, or controllers, of a benchmark; describe the best, then `focus` if it ran.

    Args:
        rows: A row of each cell.
        focus: An estimator that is described besides the best.
        pairs: Paired differences, which decide what does not differ significantly from the best.
        scenarios: What was flown, by name; a line says on what condition the verdict holds.
    """
    totals, measure = totals_of(rows), measure_of(rows)
    by_rank = sorted(totals, key=lambda name: totals[name].rank)
    references = references_of(totals)
    ranked = [name for name in by_rank if name not in references]
    last = [name for name in by_rank if name in references]
    standings = [_standing(name, totals[name], rows, measure) for name in ranked]
    standings += [_standing(name, totals[name], rows, measure, reference=True) for name in last]
    simulated = [name for name in ranked if totals[name].flights]
    if not simulated:
        ran = any(totals[name].flights for name in references)
        return Verdict("Only the truth ran." if ran else "No estimator ran.", [], standings)
    first, best, truth = said(simulated[0], measure), totals[simulated[0]], totals.get(TRUTH)
    whole = [name for name in simulated if totals[name].failed == best.failed]
    tied = [
        name
        for name in whole[1:]
        if totals[name].crashes == best.crashes and _is_tied(simulated[0], name, pairs, measure)
    ]
    doubt = ""
    if tied:
        doubt = (
            f"The {measure.name} of {first} is not significantly different from that of "
            f"{_listed([said(name, measure) for name in tied])} (paired 95 % CI includes 0)."
        )
    if tied:
        headline = _tie([simulated[0], *tied], totals, measure)
    elif len(ranked) == 1:
        headline = _alone(ranked[0], best, measure)
    else:
        least = min(round(totals[name].error, 3) for name in whole)
        headline = _headline(simulated[0], best, least, measure)
    lines = [conditions(scenarios or {}), _by_worst(whole, rows, measure), doubt]
    if focus in simulated[1:]:
        lines.append(_sentence(focus, totals[focus], truth, measure))
    if truth and simulated[0] != TRUTH and truth.attitude > 0 and len(list(filter(None, lines))) < MOST_LINES:
        ratio = best.attitude / truth.attitude
        whose = f"The attitude tracking error of {first}" if tied else "Its attitude tracking error"
        lines.insert(3, f"{whose} is {ratio:.2f} × that {_reference(measure)}.")
    return Verdict(headline, list(filter(None, lines)), standings, doubt)


def totals_of(rows: Sequence[CellRow]) -> dict[str, Total]:
    """Every estimator over all its scenarios, in the order of the rows."""
    names, measure = dict.fromkeys(row.estimator for row in rows), measure_of(rows)
    return {name: total([row for row in rows if row.estimator == name], measure) for name in names}


def references_of(names: Iterable[str]) -> set[str]:
    """Contenders that are no candidates: those on the true attitude, which no vehicle has.

    Where several controllers are and nothing else, these are what is compared.
    """
    names = set(names)
    those = set(filter(on_truth, names))
    return set() if those == names and those != {TRUTH} else those


def on_truth(name: str) -> bool:
    """Whether a contender flies on the true attitude."""
    return estimator_of(name) == TRUTH


def measure_of(rows: Sequence[CellRow]) -> Measure:
    """What ranks: between controllers, and of one alone, the tracking error, else that of the estimate."""
    names = {row.estimator for row in rows}
    controllers = {controller_of(name) for name in names}
    alone = len({estimator_of(name) for name in names}) == 1 and controllers != {CASCADED}
    return TRACKING if len(controllers) > 1 or alone else ERROR


def said(name: str, measure: Measure) -> str:
    """A contender in words: between controllers "the cascade on mahony"."""
    if measure == ERROR:
        return name
    controller = controller_of(name)
    return f"{'the cascade' if controller == CASCADED else controller} on {estimator_of(name)}"


def worst_row(rows: Sequence[CellRow], estimator: str, measure: Measure = ERROR) -> CellRow | None:
    """The scenario with an estimator's most crashes, or else its largest error; None where it did not fly."""
    own = [row for row in rows if row.estimator == estimator and row.flights]
    return max(own, key=lambda row: _loss(row, measure), default=None)


def conditions(scenarios: Mapping[str, Scenario]) -> str:
    """What the scenarios have in common, and how many differ, in a sentence; empty without scenarios."""
    if not scenarios:
        return ""
    aspects: dict[str, Callable[[Scenario], str]] = {
        "airframe": lambda s: Path(s.vehicle).stem,
        "its drag": _drag,
        "IMU": lambda s: Path(s.imu).stem,
        "initial attitude": _initial,
    }
    found = {
        aspect: Counter(of(scenario) for scenario in scenarios.values()).most_common()
        for aspect, of in aspects.items()
    }
    said = [f"{aspect} {_levels(levels)}" for aspect, levels in found.items()]
    varied = all(len(levels) > 1 for levels in found.values())
    hint = "" if varied else " quadsim bench --axes varies these."
    return f"Conditions: {'; '.join(said)}.{hint}"


def offline_verdict(rows: Sequence[Mapping[str, object]]) -> Verdict:
    """The verdict on recorded flights alone: the smallest error from an unknown initial attitude."""
    rows = [row for row in rows if not row.get(UNRANKED)]
    rows = [row for row in rows if row.get("start") != "known"] or rows
    for key in ("mean_deg", "median_deg"):
        rated = {
            str(row["estimator"]): value for row in rows if isinstance(value := row.get(key), int | float)
        }
        if rated:
            best = min(rated, key=lambda name: rated[name])
            return Verdict(f"Smallest error on recorded flights: {best}, {rated[best]:.2f}°.", [], [])
    return Verdict("Recorded flights", [], [])


def total(rows: Sequence[CellRow], measure: Measure = ERROR) -> Total:
    """Add up an estimator's rows."""
    simulated = [row for row in rows if not row.reason]
    error, attitude = (
        float(np.mean([v for row in simulated if (v := getattr(row, key)) is not None] or [without]))
        for key, without in ((measure.key, np.inf), ("attitude_deg", 0.0))
    )
    flights, crashes = (sum(getattr(row, key) or 0 for row in simulated) for key in ("flights", "crashes"))
    return Total(flights, crashes, error, attitude, len(rows) - len(simulated))


def shown(error_deg: float) -> str:
    """An error in words; an infinite one is none at all."""
    return f"{error_deg:.2f}°" if np.isfinite(error_deg) else "not measured"


def _reference(measure: Measure) -> str:
    return "of the cascade on the true attitude" if measure == TRACKING else "with the true attitude"


def _alone(name: str, own: Total, measure: Measure) -> str:
    """What happened, where there is nothing to compare with."""
    name = said(name, measure)
    if own.flights == 1:
        return f"{name} {'crashed' if own.crashes else 'did not crash'}: {measure.name} {shown(own.error)}."
    crashes = f"crashed in {own.crashes} of" if own.crashes else "no crash in"
    return f"{name}: {crashes} {own.flights} flights, {measure.name} {shown(own.error)}."


def _headline(name: str, best: Total, least: float, measure: Measure) -> str:
    """The best estimator; `least` is the smallest error of any, which may be of one that crashed."""
    name = said(name, measure)
    if best.crashes:
        crashes = f"in {best.crashes} of {best.flights} flights"
        return f"Fly {name}: it crashed least, {crashes}, with {_an(measure.name)} of {shown(best.error)}."
    flights = f"{best.flights} flight{'s' if best.flights > 1 else ''}"
    of_those = "" if round(best.error, 3) <= least else " of those without one"
    return (
        f"Fly {name}: no crash in {flights}, and the smallest {measure.name}{of_those}, {shown(best.error)}."
    )


def _tie(names: Sequence[str], totals: Mapping[str, Total], measure: Measure) -> str:
    """The headline where errors do not tell the best, the first of `names`, from the others."""
    best, errors = totals[names[0]], [totals[name].error for name in names]
    names = [said(name, measure) for name in names]
    others = names[1] if len(names) == 2 else f"one of {len(names) - 1} others"
    crashes = f"{best.crashes} of {best.flights} flights crashed" if best.crashes else "no crash"
    return (
        f"Fly {names[0]} or {others}: {crashes} with each, and {measure.name}s of {shown(min(errors))} to "
        f"{shown(max(errors))} that do not differ significantly."
    )


def _an(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"


def _by_worst(simulated: Sequence[str], rows: Sequence[CellRow], measure: Measure) -> str:
    """What the worst scenario of each says, in place of the mean; empty with a single scenario."""
    worst = {name: each for name in simulated if (each := worst_row(rows, name, measure))}
    if len({row.scenario for row in rows}) < 2 or not worst:
        return ""
    first, best = simulated[0], min(worst, key=lambda name: _loss(worst[name], measure))
    own = said(first, measure)
    if len(worst) == 1:
        return f"Its worst scenario is {described(worst[first], measure)}."
    if best == first:
        best_too = f"{own.replace('the cascade', 'The cascade')} is also the best by its worst scenario"
        return f"{best_too}, {described(worst[first], measure)}."
    return (
        f"By the worst scenario {said(best, measure)} is the best: {described(worst[best], measure)}; of "
        f"{own} it is {described(worst[first], measure)}."
    )


def described(row: CellRow, measure: Measure = ERROR) -> str:
    """A scenario with its crashes and error: "storm, 2 of 10 crashed, 3.10°"."""
    crashes = f"{row.crashes} of {row.flights} crashed, " if row.crashes else ""
    return f"{row.scenario}, {crashes}{shown(_value(row, measure))}"


def _loss(row: CellRow, measure: Measure) -> tuple[float, float]:
    return row.crash_rate or 0.0, round(_value(row, measure), 3)


def _value(row: CellRow, measure: Measure) -> float:
    value = getattr(row, measure.key)
    return np.inf if value is None else value


def _drag(scenario: Scenario) -> str:
    if not scenario.vehicle_known:
        return "not known"
    return "known" if scenario.drag_factor == 1.0 else f"{scenario.drag_factor:g} times what is known"


def _initial(scenario: Scenario) -> str:
    if not scenario.start.known_attitude:
        return "not given"
    error = scenario.start.attitude_error_deg
    return f"given {error:g}° wrong" if error else "given"


def _levels(levels: Sequence[tuple[str, int]]) -> str:
    if len(levels) == 1:
        return levels[0][0]
    return ", ".join(f"{level} in {times} scenario{'s' if times > 1 else ''}" for level, times in levels)


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _is_tied(best: str, other: str, pairs: Sequence[PairRow], measure: Measure) -> bool:
    """Whether two estimators' errors over all scenarios are not significantly different."""
    return any(
        row.is_tied
        for row in pairs
        if (row.scenario, row.metric) == (ALL, measure.key) and {row.estimator, row.versus} == {best, other}
    )


def _sentence(name: str, each: Total, truth: Total | None, measure: Measure) -> str:
    crashes = f"{each.crashes} crash{'es' if each.crashes > 1 else ''}" if each.crashes else "no crash"
    text = f"{said(name, measure)}: {crashes} in {each.flights} flights, {measure.name} {shown(each.error)}"
    if truth and truth.attitude > 0:
        ratio = each.attitude / truth.attitude
        what = "" if measure == TRACKING else "attitude tracking error "
        text += f", {what}{ratio:.2f} × that {_reference(measure)}"
    return text + "."


def _standing(
    name: str, each: Total, rows: Sequence[CellRow], measure: Measure, reference: bool = False
) -> Standing:
    own = [row for row in rows if row.estimator == name and row.crashes]
    crashed = [f"{row.scenario} ({row.crashes} of {row.flights})" for row in own]
    if not each.flights:
        return Standing(name, "crashes", "did not run")
    text = f"crashed in {', '.join(crashed)}" if crashed else f"no crash in {each.flights} flights"
    if reference and name == TRUTH:
        text += " · the reference"
    else:
        text += f" · {measure.name} {shown(each.error)}" + (", on the truth" if reference else "")
    worst = worst_row(rows, name, measure)
    several = len({row.scenario for row in rows}) > 1
    if several and worst and getattr(worst, measure.key) is not None and not crashed and not reference:
        text += f" · at worst {shown(_value(worst, measure))} in {worst.scenario}"
    changes = [row.jitter for row in rows if row.estimator == name and row.jitter]
    if measure == TRACKING and changes:
        text += f" · command jitter {np.mean(changes):.1f} rad/s"
    if each.failed:
        text += f" · {each.failed} scenario{'s' if each.failed > 1 else ''} did not run"
    return Standing(name, "crashes" if crashed or each.failed else "flies", text)
