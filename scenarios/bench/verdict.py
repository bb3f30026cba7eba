"""The verdict of a benchmark: a sorted table, and one sentence that says what to fly there."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadsim.flight.scenario import Scenario

from .controllers import CASCADED, controller_of, estimator_of
from .flight_metrics import CellRow, wilson
from .ranking import Flown, Place, by_contender, listed, paired_difference, ranked, winners
from .recommendation import recommendation
from .results import Results, Total, totals_of

FEW = 5
"""Flights of each estimator in a scenario below which the headline warns that they are few."""
MOST_NAMED = 3
"""Scenarios, and estimators that tie on a condition, that the headline names; more are counted."""


class Measure(NamedTuple):
    """What ranks."""

    key: str
    """Of a `CellRow` [deg]."""
    name: str


ERROR = Measure("error_deg", "error")
TRACKING = Measure("attitude_deg", "tracking error")
"""Between controllers: an estimate's error says nothing of them."""


class Standing(NamedTuple):
    """A row of the table."""

    estimator: str
    crashed: bool  #: or did not run everywhere
    texts: dict[str, str]  #: by the heading of their column


class Verdict(NamedTuple):
    """The answer."""

    headline: str
    lines: list[str]
    standings: list[Standing]  #: from best to worst, then those that are not ranked


class Choice(NamedTuple):
    """What to fly in some scenarios."""

    places: list[Place]  #: the contenders that are ranked and flew, from best to worst
    best: list[Place]  #: the first, and those that do not differ from it significantly
    lost: list[str]  #: scenarios in which none of them survived a flight


def verdict(results: Results) -> Verdict:
    """Rank the contenders of a benchmark, and say which to fly in its scenarios.

    Paired differences on the same seeds decide which errors are not significantly larger than the best.
    """
    partial = results.partial
    measure, whole = measure_of(results.estimators), choice(results, list(results.scenarios))
    table = _table(results, whole.places, measure)
    if not whole.places:
        return Verdict(*_nobody(results), table)
    lines: list[str] = []
    if results.experiment.conditions:
        headline, found = _by_condition(results, measure, whole.lost, partial)
        lines += found
    else:
        lines.append(conditions(results.scenarios))
        headline = _headline(results, whole, measure)
    if partial:
        lines.append(f"This is not the recommendation of the release: {partial} were flown.")
    if partial or not results.experiment.held_out:
        lines.append(recommendation().elsewhere)
    return Verdict(headline, lines, table)


def choice(results: Results, scenarios: Sequence[str]) -> Choice:
    """What to fly in some of the scenarios; those in which every flight crashes do not count."""
    measure, unranked = measure_of(results.estimators), results.unranked
    flights = [f for f in results.flights if f.scenario in scenarios and f.estimator not in unranked]
    safe = {flight.scenario for flight in flights if not flight.cause}
    planned = [flight for flight in results.planned if flight[0] in scenarios]
    flown = by_contender(flights)
    counted = [flight for flight in planned if flight[0] in safe] or planned
    places = ranked(flown, counted, measure.key)

    def worse(first: str, other: str) -> bool:
        low = paired_difference(flown[other], flown[first], measure.key).low
        return low is not None and low > 0.0

    best = winners(places, worse)
    return Choice(places, best, [name for name in scenarios if name not in safe])


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


def shown(error_deg: float | None) -> str:
    """An error in words."""
    return "not measured" if error_deg is None or np.isinf(error_deg) else f"{error_deg:.2f}°"


def conditions(scenarios: Mapping[str, Scenario]) -> str:
    """What the scenarios have in common, and how many differ, in a sentence."""
    aspects = {
        "airframe": [Path(each.vehicle).stem for each in scenarios.values()],
        "its drag": [_drag(each) for each in scenarios.values()],
        "IMU": [Path(each.imu).stem for each in scenarios.values()],
        "initial attitude": [_initial(each) for each in scenarios.values()],
    }
    return f"Conditions: {'; '.join(f'{aspect} {_counted(levels)}' for aspect, levels in aspects.items())}."


# --- the table ------------------------------------------------------------------------------------


def _table(results: Results, places: Sequence[Place], measure: Measure) -> list[Standing]:
    unranked, totals, levels = results.unranked, totals_of(results.rows), results.by_level
    order = [place.name for place in places]
    left_out = [name for name in results.estimators if name not in order and name not in unranked]
    flown = by_contender(results.flights)
    behind = {name: _behind(flown[name], flown[order[0]], measure) for name in order[1:]}
    rows = []
    for name in [*order, *left_out, *unranked]:
        own = totals[name]
        worst = max(
            ((axis, row) for (axis, _, each), row in levels.items() if each == name and row.flights),
            key=lambda each: (each[1].crash_rate or 0.0, getattr(each[1], measure.key) or 0.0),
            default=None,
        )
        note = f"not ranked: it {unranked[name]}" if name in unranked else ""
        if own.failed:
            why = next(cell.reason for cell in results.cells if cell.estimator == name and cell.reason)
            note = "; ".join(filter(None, (note, f"did not run in {_count(own.failed, 'scenario')}: {why}")))
        low, high = wilson(own.crashes, own.flights)
        texts = {
            "rank": str(order.index(name) + 1) if name in order else "–",
            "crashed": f"{own.crashes} of {own.flights} ({100 * low:.0f}–{100 * high:.0f} %)",
            "error [°]": _number(own.means["error_deg"]),
            "tracking [°]": _number(own.means["attitude_deg"]),
            "behind the best [°]": behind.get(name, "–"),
            "command change [rad/s]": _number(own.means["jitter"]),
            "at worst": described(*worst, measure) if worst else "–",
            "note": note,
        }
        if measure == ERROR:
            del texts["command change [rad/s]"]
        rows.append(Standing(name, bool(own.crashes or own.failed), texts))
    return rows


def described(axis: str, row: CellRow, measure: Measure = ERROR) -> str:
    """A level with its crashes and error: "storm, 2 of 10 crashed, 3.10°"."""
    level = row.scenario if axis == "scenario" else f"{axis}: {row.scenario}"
    crashes = f"{row.crashes} of {row.flights} crashed, " if row.crashes else ""
    return f"{level}, {crashes}{shown(getattr(row, measure.key))}"


def _behind(other: Flown, best: Flown, measure: Measure) -> str:
    """The paired difference from the best, with half its 95 % interval."""
    found = paired_difference(other, best, measure.key)
    if found.mean is None:
        return "–"
    half = "" if found.low is None or found.high is None else f" ± {(found.high - found.low) / 2:.2f}"
    return f"{found.mean:+.2f}{half}"


# --- the sentence ---------------------------------------------------------------------------------


def _nobody(results: Results) -> tuple[str, list[str]]:
    """Headline and advice where nothing that is ranked flew."""
    reasons = {cell.estimator: f"did not run ({cell.reason})" for cell in results.cells if cell.reason}
    flaws = {name: why for name, why in results.unranked.items() if name not in results.references}
    if any(flight.estimator in results.references for flight in results.flights) and not {**reasons, **flaws}:
        return "Nothing is compared: only estimators that receive the true attitude ran.", []
    what = "No estimator is fit" if flaws else "No estimator ran"
    why = "; ".join(f"{name} {reason}" for name, reason in {**reasons, **flaws}.items())
    advice = (
        "Estimates are roll and pitch in rad at every sample. Fly one that ships beside: --estimator eskf."
    )
    return f"{what}: {why}.", [advice]


def _headline(results: Results, whole: Choice, measure: Measure) -> str:
    """What to fly in these scenarios, and why."""
    unranked, totals = results.unranked, totals_of(results.rows)
    compared = [name for name in results.estimators if name not in unranked]
    if len(compared) == 1:
        return _alone(compared[0], totals[compared[0]], measure)
    left = [name for name in results.scenarios if name not in whole.lost]
    if not left:
        return f"No estimator survives {_where(whole.lost, 'any of these')}."
    text, seeds = recommended(whole, measure), results.settings.seeds
    if seeds == 1 and (alike := sum(place.whole for place in whole.places)) > 1:
        text = (
            f"{said(whole.places[0].name, measure)} has the smallest {measure.name}, "
            f"{shown(whole.places[0].error)}, of the {alike} that did not crash; one flight in each scenario "
            "is too few to recommend it."
        )
    elif seeds < FEW and len(whole.best) > 1:
        text += f" {_count(seeds, 'flight')} of each in a scenario cannot show small differences."
    where = f"in {_where(left, 'these')} {text}"
    if whole.lost:
        return f"No estimator survives {_where(whole.lost, 'any of')}; {where}"
    return where[0].upper() + where[1:]


def _by_condition(
    results: Results, measure: Measure, lost: Sequence[str], partial: str
) -> tuple[str, list[str]]:
    """The headline with a clause for each condition of the experiment, and a line for each."""
    clauses, unfit, names, lines = [], [], {}, []
    for condition in results.experiment.conditions:
        part = [k for k, levels in results.levels.items() if levels[condition.axis] in condition.levels]
        found = choice(results, part)
        lines.append(f"{condition.name}: {recommended(found, measure) if found.best else 'none flew.'}")
        if not found.best or not found.best[0].fit:
            unfit.append(condition.clause)
            continue
        first = found.best[0]
        alike = sorted(found.best, key=lambda place: place.error)
        named = _first_of([said(place.name, measure) for place in alike])
        named += "" if first.whole else f" ({first.lost})"
        names[named] = None
        clauses.append(f"{named} {condition.clause}")
    if not clauses:
        return "No estimator is fit to fly on these conditions.", lines
    fly = "Fly" if results.experiment.held_out else f"On these {len(results.scenarios)} combinations fly"
    if partial:
        fly = f"On a part of the held-out suite ({partial}) fly"
    if lost:
        survived_by_none = f"No estimator survives {_where(lost, 'any of')}"
        fly = f"{survived_by_none}; elsewhere {fly[0].lower()}{fly[1:]}"
    if len(names) == 1 and not unfit:
        return f"{fly} {next(iter(names))}, {results.experiment.always}.", lines
    rest = f"; no estimator is fit to fly {listed(unfit, 'or')}" if unfit else ""
    return f"{fly} {', '.join(clauses)}{rest}.", lines


def recommended(found: Choice, measure: Measure = ERROR) -> str:
    """What to fly and why, as the end of a sentence."""
    first, best = found.best[0], found.best
    names = listed([said(place.name, measure) for place in best], "or")
    flights, error = _count(first.flights, "flight"), shown(first.error)
    if not first.fit:
        return f"no estimator is fit to fly: {names} {first.lost}, the others in more."
    if len(best) > 1:
        crashes = f"none of them crashed in {flights}" if first.whole else f"each {first.lost}"
        most = shown(max(place.error for place in best))
        return (
            f"fly {names}; {crashes}, and the {measure.name} of the others, up to {most}, is not "
            f"significantly larger than that of {said(first.name, measure)}, {error}."
        )
    if not first.whole:
        own = f"its {measure.name} is {error} in the others"
        return f"fly {names}, though it {first.lost}; no other survived more, and {own}."
    alike = sum(place.whole for place in found.places)
    if alike == 1:
        survives = f"to survive all {flights}" if first.flights > 1 else "to survive"
        only = survives if len(found.places) > 1 else f"that ran, with no crash in {flights}"
        return f"fly {names}, the only one {only}; its {measure.name} is {error}."
    of_those = "" if alike == len(found.places) else f" of the {alike} that survived all"
    return f"fly {names}, with no crash in {flights} and the smallest {measure.name}{of_those}, {error}."


def _alone(name: str, own: Total, measure: Measure) -> str:
    """What happened, where there is nothing to compare with."""
    name, error = said(name, measure), shown(own.means[measure.key])
    failed = f"; {_count(own.failed, 'scenario')} did not run" if own.failed else ""
    if own.flights == 1:
        return (
            f"{name} crashed{failed}."
            if own.crashes
            else f"{name} did not crash: {measure.name} {error}{failed}."
        )
    crashes = f"crashed in {own.crashes} of" if own.crashes else "no crash in"
    of_those = " in the others" if own.crashes else ""
    error = "" if own.crashes == own.flights else f", {measure.name} {error}{of_those}"
    return f"{name}: {crashes} {own.flights} flights{error}{failed}."


def _first_of(names: Sequence[str]) -> str:
    """Those that tie, the best of many; the line of a condition names all."""
    if len(names) <= MOST_NAMED + 1:
        return listed(names, "or")
    return listed([*names[:MOST_NAMED], f"one of {len(names) - MOST_NAMED} others that do not differ"], "or")


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count != 1 else ''}"


def _where(names: Sequence[str], which: str) -> str:
    return listed(names) if len(names) <= MOST_NAMED else f"{which} {len(names)} scenarios"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _drag(scenario: Scenario) -> str:
    if not scenario.vehicle_known:
        return "not known"
    return "known" if scenario.drag_factor == 1.0 else f"{scenario.drag_factor:g} times what is known"


def _initial(scenario: Scenario) -> str:
    if not scenario.start.known_attitude:
        return "not given"
    error = scenario.start.attitude_error_deg
    return f"given {error:g}° wrong" if error else "given"


def _counted(levels: Sequence[str]) -> str:
    counts = Counter(levels).most_common()
    if len(counts) == 1:
        return levels[0]
    return ", ".join(f"{level} in {_count(times, 'scenario')}" for level, times in counts)
