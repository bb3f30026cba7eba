"""The verdict of a benchmark: a ranked table, and a sentence with the recommended estimators."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from quadsim.flight.scenario import Scenario

from .controllers import CASCADED, controller_of, estimator_of
from .experiment import Condition
from .ranking import Place, listed, paired_difference, ranked
from .recommendation import recommendation
from .results import Results

FEW = 5
"""Number of flights of each estimator in a scenario below which the headline adds a warning."""
MOST_NAMED = 3
"""Largest number of scenarios, or of tied estimators, that the headline names; more are counted."""


class Measure(NamedTuple):
    """A measure that ranks contenders."""

    key: str
    """Column of the tables [deg]."""
    name: str


ERROR = Measure("error_deg", "error")
TRACKING = Measure("attitude_deg", "tracking error")
"""Measure for controllers, which estimation errors do not describe."""


class Standing(NamedTuple):
    """A row of the table."""

    estimator: str
    crashed: bool  #: or did not run everywhere
    texts: dict[str, str]  #: by the heading of their column


class Verdict(NamedTuple):
    """The verdict of a benchmark."""

    headline: str
    lines: list[str]
    standings: list[Standing]  #: from best to worst, then those that are not ranked


class Choice(NamedTuple):
    """The best contenders in some scenarios."""

    places: list[Place]  #: the contenders that are ranked and flew, from best to worst
    best: list[Place]  #: the first, and those that do not differ from it significantly
    lost: list[str]  #: scenarios in which none of them survived a flight


def verdict(results: Results) -> Verdict:
    """Rank the contenders of a benchmark, and recommend the best ones.

    Paired differences on the same seeds decide which errors are not significantly larger than the best.
    """
    partial = results.partial
    measure, whole = measure_of(results.estimators), choice(results, list(results.scenarios))
    table = _table(results, whole.places, measure)
    if not whole.places:
        return Verdict(*_nobody(results), table)
    lines: list[str] = []
    if results.experiment.conditions:
        levels = results.levels.items()
        found = [
            (each, choice(results, [name for name, own in levels if own[each.axis] in each.levels]))
            for each in results.experiment.conditions
        ]
        headline = _headline_of(results, found, whole, measure)
        lines += [
            f"{each.name}: {recommended(own, measure) if own.best else 'none flew.'}" for each, own in found
        ]
    else:
        lines.append(conditions(results.scenarios))
        headline = _headline(results, whole, measure)
    if partial:
        lines.append(f"This is not the recommendation of the release: {partial} were flown.")
    if partial or not results.experiment.held_out:
        lines.append(recommendation().elsewhere)
    return Verdict(headline, lines, table)


def choice(results: Results, scenarios: Sequence[str]) -> Choice:
    """Find the best contenders in some scenarios; scenarios in which every flight crashes are ignored.

    The list of the best ends before the first contender that survived fewer flights or whose error is
    significantly larger, so that no member ranks below a contender outside the list.
    """
    measure = measure_of(results.estimators)
    flights = results.flights.query("scenario in @scenarios and estimator not in @results.unranked")
    safe = {*flights.query("cause == ''")["scenario"]}
    counted = [name for name in scenarios if name in safe] or scenarios
    planned = [(name, seed) for name in counted for seed in range(results.settings.seeds)]
    places = ranked(flights, planned, measure.key)
    best = places[:1]
    for place in places[1:]:
        behind = paired_difference(flights, place.name, places[0].name, measure.key)
        if place.survived != places[0].survived or behind.mean - behind.half > 0.0:
            break
        best.append(place)
    return Choice(places, best, [name for name in scenarios if name not in safe])


def measure_of(names: Iterable[str]) -> Measure:
    """Return the ranking measure: tracking error for controllers, estimation error for estimators."""
    names = list(names)
    controllers = {controller_of(name) for name in names}
    alone = len({estimator_of(name) for name in names}) == 1 and controllers != {CASCADED}
    return TRACKING if len(controllers) > 1 or alone else ERROR


def said(name: str, measure: Measure) -> str:
    """Name a contender in words; if controllers are compared, such as "the cascade with mahony"."""
    if measure == ERROR:
        return name
    controller = controller_of(name)
    return f"{'the cascade' if controller == CASCADED else controller} on {estimator_of(name)}"


def error_text(error_deg: float | None) -> str:
    """Format an error."""
    return "not measured" if error_deg is None or math.isinf(error_deg) else f"{error_deg:.2f}°"


def conditions(scenarios: Mapping[str, Scenario]) -> str:
    """Describe the conditions of the scenarios in a sentence."""
    aspects: dict[str, Callable[[Scenario], str]] = {
        "The airframe": lambda each: Path(each.vehicle).stem,
        "Its drag": _drag,
        "The IMU": lambda each: Path(each.imu).stem,
        "The initial attitude": _initial,
    }
    found = []
    for aspect, level_of in aspects.items():
        counts = Counter(map(level_of, scenarios.values())).most_common()
        each = [f"{level} in {_count(times, 'scenario')}" for level, times in counts]
        found.append(f"{aspect} is {listed(each) if len(counts) > 1 else counts[0][0]}.")
    return " ".join(found)


# --- the table ------------------------------------------------------------------------------------


def _table(results: Results, places: Sequence[Place], measure: Measure) -> list[Standing]:
    unranked, order = results.unranked, [place.name for place in places]
    left_out = [name for name in results.estimators if name not in order and name not in unranked]
    rows = []
    for name in [*order, *left_out, *unranked]:
        own = results.totals[name]
        notes = [f"not ranked: it {unranked[name]}"] if name in unranked else []
        if own.failed:
            why = next(cell.reason for cell in results.cells if cell.estimator == name and cell.reason)
            notes.append(f"did not run in {_count(own.failed, 'scenario')}: {why}")
        interval, behind = f"{100 * own.crash_low:.0f}–{100 * own.crash_high:.0f}", "–"
        if name in order[1:]:
            found = paired_difference(results.flights, name, order[0], measure.key)
            half = f" ± {found.half:.2f}" if found.half >= 0.0 else ""
            behind = "–" if math.isnan(found.mean) else f"{found.mean:+.2f}{half}"
        texts = {
            "rank": str(order.index(name) + 1) if name in order else "–",
            "crashed": f"{own.crashes} of {own.flights} ({interval} %)",
            "error [°]": _number(own.error_deg),
            "attitude tracking [°]": _number(own.attitude_deg),
            "error minus that of rank 1 [°]": behind,
            "command change [rad/s]": _number(own.jitter),
            "at worst": _worst(results, name, measure),
            "note": "; ".join(notes),
        }
        if measure == ERROR:
            del texts["command change [rad/s]"]
        rows.append(Standing(name, bool(own.crashes or own.failed), texts))
    return rows


def _worst(results: Results, name: str, measure: Measure) -> str:
    """The level with most crashes, and the largest error among these: "storm, 2 of 10 crashed, 3.10°"."""
    flown = [(axis, row) for (axis, _, n), row in results.by_level.items() if n == name and row.flights]
    if not flown:
        return "–"
    axis, row = max(flown, key=lambda each: (each[1].crash_rate, getattr(each[1], measure.key) or 0.0))
    level = row.scenario if axis == "scenario" else f"{axis}: {row.scenario}"
    crashes = f"{row.crashes} of {row.flights} crashed, " if row.crashes else ""
    return f"{level}, {crashes}{error_text(getattr(row, measure.key))}"


# --- the sentence ---------------------------------------------------------------------------------


def _nobody(results: Results) -> tuple[str, list[str]]:
    """Headline and advice where nothing that is ranked flew."""
    reasons = {cell.estimator: f"did not run ({cell.reason})" for cell in results.cells if cell.reason}
    flaws = {name: why for name, why in results.unranked.items() if name not in results.references}
    if not {**reasons, **flaws}:
        return "Nothing is compared: only estimators that receive the true attitude ran.", []
    what = "No estimator is fit" if flaws else "No estimator ran"
    why = "; ".join(f"{name} {reason}" for name, reason in {**reasons, **flaws}.items())
    advice = (
        "An estimator returns roll and pitch in rad at every sample. To compare, add a shipped one: "
        "--estimator eskf."
    )
    return f"{what}: {why}.", [advice]


def _headline(results: Results, whole: Choice, measure: Measure) -> str:
    """What to fly in these scenarios, and why."""
    compared = [name for name in results.estimators if name not in results.unranked]
    if len(compared) == 1:
        own = results.totals[compared[0]]
        place = Place(compared[0], own.flights, own.flights - own.crashes, 0, getattr(own, measure.key))
        failed = f"; {_count(own.failed, 'scenario')} did not run" if own.failed else ""
        return f"{said(place.name, measure)}: {outcome([place], measure)}{failed}."
    left = [name for name in results.scenarios if name not in whole.lost]
    if not left:
        return f"No estimator survives {_where(whole.lost, 'any of these')}."
    text, seeds = f"in {_where(left, 'these')}, {recommended(whole, measure)}", results.settings.seeds
    if seeds < FEW and len(whole.best) > 1:
        few = f"{_count(seeds, 'flight')} of each in a scenario {'is' if seeds == 1 else 'are'} too few"
        text += f" {few} to choose between them."
    if whole.lost:
        return f"No estimator survives {_where(whole.lost, 'any of')}; {text}"
    return text[0].upper() + text[1:]


def _headline_of(
    results: Results, found: list[tuple[Condition, Choice]], whole: Choice, measure: Measure
) -> str:
    """What to fly on all conditions, where the same is best on each, else on every one."""
    best = {each.clause: own.best for each, own in found if own.best and own.best[0].fit}
    if not best:
        return "No estimator is fit to fly on these conditions."
    tied = [{place.name for place in own.best} for _, own in found]
    everywhere = [place for place in whole.places if place.name in set.intersection(*tied)]
    if everywhere and len(best) == len(found):
        named = listed([said(place.name, measure) for place in everywhere], "or")
        fates = listed(list(dict.fromkeys(place.fate for place in everywhere)), "or")
        return f"{_fly(results, whole)} {named}, {results.experiment.always} ({fates})."
    clauses = [f"{_first_of(places, measure)} {clause}" for clause, places in best.items()]
    unfit = [each.clause for each, _ in found if each.clause not in best]
    rest = f"; no estimator is fit to fly {listed(unfit, 'or')}" if unfit else ""
    if len(clauses) > 1 and not rest:
        clauses[-1] = f"and {clauses[-1]}"
    return f"{_fly(results, whole)} {'; '.join(clauses)}{rest}."


def _fly(results: Results, whole: Choice) -> str:
    """Begin a headline: where nothing survives, and on which flights the rest of it was found."""
    fly = "Fly" if results.experiment.held_out else f"On these {len(results.scenarios)} combinations, fly"
    if results.partial:
        fly = f"On a part of the held-out suite ({results.partial}), fly"
    if whole.lost:
        return f"No estimator survives {_where(whole.lost, 'any of')}; elsewhere, {fly[0].lower()}{fly[1:]}"
    return fly


def recommended(found: Choice, measure: Measure) -> str:
    """Return the recommendation with its reason, as the end of a sentence."""
    names = listed([said(place.name, measure) for place in found.best], "or")
    if not found.best[0].fit:
        return f"no estimator is fit to fly: {names} {found.best[0].fate}, and the others in more."
    only = ", the only one that ran" if len(found.places) == 1 else ""
    return f"fly {names}{only} ({outcome(found.best, measure)})."


def outcome(best: Sequence[Place], measure: Measure) -> str:
    """Describe the results of tied contenders, such as "no crash in 4 flights, error 1.00°"."""
    first, errors = best[0], [place.error for place in best]
    text = first.fate + (" each" if len(best) > 1 else "")
    if first.survived:
        text += f", {measure.name} {' to '.join(dict.fromkeys(error_text(f(errors)) for f in (min, max)))}"
        text += "" if first.whole else " in the others"
    return text + ("; the difference is not significant" if len(best) > 1 else "")


def _first_of(best: Sequence[Place], measure: Measure) -> str:
    """Those that tie, the best of many; the line of a condition names all."""
    names = [said(place.name, measure) for place in sorted(best, key=lambda place: place.error)]
    if len(names) > MOST_NAMED + 1:
        names[MOST_NAMED:] = [f"one of {len(names) - MOST_NAMED} others that do not differ"]
    return listed(names, "or") + ("" if best[0].whole else f" ({best[0].fate})")


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count != 1 else ''}"


def _where(names: Sequence[str], which: str) -> str:
    return listed(names) if len(names) <= MOST_NAMED else f"{which} {len(names)} scenarios"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _drag(scenario: Scenario) -> str:
    if not scenario.vehicle_known:
        return "not known"
    return "known" if scenario.drag_factor == 1.0 else f"{scenario.drag_factor:g} times the known value"


def _initial(scenario: Scenario) -> str:
    if not scenario.start.known_attitude:
        return "not given"
    error = scenario.start.attitude_error_deg
    return f"given {error:g}° wrong" if error else "given"
