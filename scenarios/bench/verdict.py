"""The verdict of a benchmark in words: which estimator or controller to fly there, and how others compare."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadsim.flight.scenario import Scenario

from .controllers import CASCADED, TRUTH, controller_of, estimator_of
from .flight_metrics import CellRow
from .offline import UNRANKED
from .pairs import ALL, PairRow, paired_differences
from .ranking import Place, by_contender, listed, ranked, winners
from .recommendation import recommendation
from .runner import Results

FEW = 5
"""Flights of each estimator in a scenario below which the headline warns that they are few."""


class Measure(NamedTuple):
    """What ranks."""

    key: str
    """Of a `CellRow` [deg]."""
    name: str


ERROR = Measure("error_deg", "error")
TRACKING = Measure("attitude_deg", "tracking error")
"""Between controllers: an estimate's error says nothing of them."""


class Standing(NamedTuple):
    """One contender of the ranking."""

    estimator: str
    grade: str  #: "flies" or "crashes"
    text: str


class Verdict(NamedTuple):
    """The answer, in words."""

    headline: str
    lines: list[str]
    standings: list[Standing]  #: from best to worst, then those that are not ranked


class Total(NamedTuple):
    """A contender over all its scenarios."""

    flights: int
    crashes: int
    estimate: float  #: mean over scenarios of the estimate's error [deg]; infinite where none was measured
    attitude: float  #: the same of the attitude tracking
    error: float  #: that of both which ranks
    failed: int  #: cells that did not run


def verdict(results: Results, focus: str = "") -> Verdict:
    """Rank the contenders of a benchmark; say which to fly in its scenarios, then describe `focus` if it ran.

    Paired differences on the same seeds decide which errors are not significantly larger than the best.

    Args:
        results: Of `bench`.
        focus: A contender that is described besides the best.
    """
    rows, measure = results.rows, measure_of(results.estimators)
    totals, unranked = totals_of(rows), results.unranked
    lost = lost_scenarios(results)
    places = places_of(results, lost)
    order = [place.name for place in places]
    others = [name for name in results.estimators if name not in order and name not in unranked]
    standings = [
        _standing(name, totals[name], rows, measure, unranked.get(name, ""))
        for name in [*order, *others, *unranked]
    ]
    if not places:
        return Verdict(_nobody(totals, results.references), [], standings)
    best, compared = places[0], [*order, *others]
    headline = (
        _alone(best.name, totals[best.name], measure)
        if len(compared) == 1
        else _headline(places, results, lost, measure)
    )
    kept = [row for row in rows if row.scenario not in lost]
    whole = [place.name for place in places if not totals[place.name].failed]
    truth = totals.get(TRUTH)
    lines = [_elsewhere(results.scenarios), _by_worst(whole, kept, measure)]
    if truth and best.whole and 0 < truth.attitude < np.inf:
        ratio = totals[best.name].attitude / truth.attitude
        lines.append(
            f"The attitude tracking error of {said(best.name, measure)} is {ratio:.2f} × that "
            f"{_reference(measure)}."
        )
    if focus in order[1:]:
        lines.append(_sentence(focus, totals[focus], truth, measure))
    if unranked.keys() - {TRUTH}:
        lines.append(f"Not ranked: {'; '.join(f'{name} {why}' for name, why in unranked.items())}.")
    return Verdict(headline, list(filter(None, lines)), standings)


def places_of(results: Results, lost: Iterable[str] = ()) -> list[Place]:
    """The contenders that are ranked and flew, from best to worst, without the scenarios that all lost."""
    unranked = results.unranked
    flown = {name: rows for name, rows in by_contender(results.flights).items() if name not in unranked}
    planned = [(scenario, seed) for scenario, seed in results.planned if scenario not in lost]
    return ranked(flown, planned or results.planned, measure_of(results.estimators).key)


def lost_scenarios(results: Results) -> list[str]:
    """Scenarios in which no flight of a ranked contender survived."""
    unranked = results.unranked
    safe = {f.scenario for f in results.flights if not f.cause and f.estimator not in unranked}
    return [name for name in results.scenarios if name not in safe]


def totals_of(rows: Sequence[CellRow]) -> dict[str, Total]:
    """Every contender over all its scenarios, in the order of the rows."""
    names = dict.fromkeys(row.estimator for row in rows)
    measure = measure_of(names)
    return {name: total([row for row in rows if row.estimator == name], measure) for name in names}


def on_truth(name: str) -> bool:
    """Whether a contender flies on the attitude of the shipped estimator that returns the truth."""
    return estimator_of(name) == TRUTH


def measure_of(names: Iterable[str]) -> Measure:
    """What ranks: between controllers, and of one alone, the tracking error, else that of the estimate."""
    names = list(names)
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
    return f"Conditions: {'; '.join(f'{aspect} {_levels(levels)}' for aspect, levels in found.items())}."


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
    known = {
        each.key: [v for row in simulated if (v := getattr(row, each.key)) is not None]
        for each in (ERROR, TRACKING)
    }
    means = {key: float(np.mean(values or [np.inf])) for key, values in known.items()}
    flights, crashes = (sum(getattr(row, key) or 0 for row in simulated) for key in ("flights", "crashes"))
    estimate, attitude = means[ERROR.key], means[TRACKING.key]
    return Total(flights, crashes, estimate, attitude, means[measure.key], len(rows) - len(simulated))


def shown(error_deg: float) -> str:
    """An error in words; an infinite one is none at all."""
    return f"{error_deg:.2f}°" if np.isfinite(error_deg) else "not measured"


def _nobody(totals: Mapping[str, Total], references: Iterable[str]) -> str:
    """The headline where nothing that is ranked flew."""
    if any(totals[name].flights for name in references):
        return "Nothing is compared: only estimators that receive the true attitude ran."
    return (
        "No estimator ran." if not any(each.flights for each in totals.values()) else "No estimator is fit."
    )


def _reference(measure: Measure) -> str:
    return "of the cascade on the true attitude" if measure == TRACKING else "with the true attitude"


def _alone(name: str, own: Total, measure: Measure) -> str:
    """What happened, where there is nothing to compare with."""
    name = said(name, measure)
    if own.flights == 1:
        if own.crashes:
            return f"{name} crashed{_failed(own)}."
        return f"{name} did not crash: {measure.name} {shown(own.error)}{_failed(own)}."
    crashes = f"crashed in {own.crashes} of" if own.crashes else "no crash in"
    of_those = " in the others" if own.crashes else ""
    error = "" if own.crashes == own.flights else f", {measure.name} {shown(own.error)}{of_those}"
    return f"{name}: {crashes} {own.flights} flights{error}{_failed(own)}."


def _failed(own: Total) -> str:
    return f"; {own.failed} scenario{'s' if own.failed > 1 else ''} did not run" if own.failed else ""


def _headline(
    places: Sequence[Place],
    results: Results,
    lost: Sequence[str],
    measure: Measure,
) -> str:
    """What to fly in these scenarios, and why."""
    left = [name for name in results.scenarios if name not in lost]
    if not left:
        return f"No estimator survives {_where(lost, 'any of these')}."
    compared = {place.name for place in places}
    pairs = paired_differences([flight for flight in results.flights if flight.estimator in compared])
    best = winners(places, lambda first, other: _worse(first, other, pairs, measure))
    text, seeds = recommended(best, places, measure), results.settings.seeds
    if seeds == 1 and (alike := sum(place.whole for place in places)) > 1:
        text = (
            f"{said(places[0].name, measure)} has the smallest {measure.name}, {shown(places[0].error)}, of "
            f"the {alike} that did not crash; one flight in each scenario is too few to recommend it."
        )
    elif seeds < FEW and len(best) > 1:
        text += f" {_flights(seeds)} of each in a scenario cannot show small differences."
    where = _where(left, "these")
    if lost:
        return f"No estimator survives {_where(lost, 'any of')}; in {where} {text}"
    return f"In {where} {text}"


def _flights(count: int) -> str:
    return f"{count} flight{'s' if count != 1 else ''}"


def _where(names: Sequence[str], which: str) -> str:
    return listed(names) if len(names) < 4 else f"{which} {len(names)} scenarios"


def recommended(best: Sequence[Place], places: Sequence[Place], measure: Measure = ERROR) -> str:
    """What to fly and why, as the end of a sentence.

    Args:
        best: The best, and those that are not significantly worse, as `ranking.winners` gives them.
        places: All that were compared, from best to worst.
        measure: What ranked.
    """
    first, names = best[0], listed([said(place.name, measure) for place in best], "or")
    flights, error = _flights(first.flights), shown(first.error)
    if not first.fit:
        return f"no estimator is fit to fly: {names} {first.lost}, the others in more."
    if len(best) > 1:
        errors = [place.error for place in best]
        crashes = f"none of them crashed in {flights}" if first.whole else f"each {first.lost}"
        span = f"{shown(min(errors))} to {shown(max(errors))}"
        return f"fly {names}; {crashes}, and the differences in {measure.name} ({span}) are not significant."
    if not first.whole:
        own = f"its {measure.name} is {error} in the others"
        return f"fly {names}, though it {first.lost}; no other survived more, and {own}."
    alike = sum(place.whole for place in places)
    if alike == 1:
        survives = f"to survive all {flights}" if first.flights > 1 else "to survive"
        only = survives if len(places) > 1 else f"that ran, with no crash in {flights}"
        return f"fly {names}, the only one {only}; its {measure.name} is {error}."
    of_those = "" if alike == len(places) else f" of the {alike} that survived all"
    return f"fly {names}, with no crash in {flights} and the smallest {measure.name}{of_those}, {error}."


def _worse(first: str, other: str, pairs: Sequence[PairRow], measure: Measure) -> bool:
    """Whether the error of `other` over all scenarios is significantly larger."""
    for row in pairs:
        if (row.scenario, row.metric) == (ALL, measure.key) and {row.estimator, row.versus} == {first, other}:
            if row.low is None or row.high is None:
                return False
            return row.high < 0.0 if row.estimator == first else row.low > 0.0
    return False


def _elsewhere(scenarios: Mapping[str, Scenario]) -> str:
    """On what conditions the verdict holds, and what to fly on others."""
    return f"{conditions(scenarios)} {recommendation().elsewhere}" if scenarios else ""


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


def _sentence(name: str, each: Total, truth: Total | None, measure: Measure) -> str:
    crashes = f"{each.crashes} crash{'es' if each.crashes > 1 else ''}" if each.crashes else "no crash"
    text = f"{said(name, measure)}: {crashes} in {_flights(each.flights)}, {measure.name} {shown(each.error)}"
    if truth and 0 < truth.attitude < np.inf and each.attitude < np.inf:
        ratio = each.attitude / truth.attitude
        what = "" if measure == TRACKING else "attitude tracking error "
        text += f", {what}{ratio:.2f} × that {_reference(measure)}"
    return text + "."


def _standing(
    name: str, each: Total, rows: Sequence[CellRow], measure: Measure, why_unranked: str
) -> Standing:
    own = [row for row in rows if row.estimator == name and row.crashes]
    crashed = [f"{row.scenario} ({row.crashes} of {row.flights})" for row in own]
    if not each.flights:
        return Standing(name, "crashes", "did not run")
    text = f"crashed in {', '.join(crashed)}" if crashed else f"no crash in {_flights(each.flights)}"
    text += f" · {measure.name} {shown(each.error)}"
    worst = worst_row(rows, name, measure)
    several = len({row.scenario for row in rows}) > 1
    if several and worst and getattr(worst, measure.key) is not None and not crashed and not why_unranked:
        text += f" · at worst {shown(_value(worst, measure))} in {worst.scenario}"
    changes = [row.jitter for row in rows if row.estimator == name and row.jitter]
    if measure == TRACKING and changes:
        text += f" · command jitter {np.mean(changes):.1f} rad/s"
    if each.failed:
        text += _failed(each).replace(";", " ·")
    if why_unranked:
        text += f" · not ranked: it {why_unranked}"
    return Standing(name, "crashes" if crashed or each.failed or why_unranked else "flies", text)
