"""Results as tables for a terminal."""

import math
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE
from rich.table import Column, Table
from rich.text import Text

from estimators.evaluation.comparison import EvaluationRow
from estimators.loihi.chip import LIMITS, ChipCore

from ..bench.axes import ALL, Effect, ranking
from ..bench.breaking import BreakingPoint
from ..bench.controllers import CASCADED, controller_of
from ..bench.flight_metrics import CellRow
from ..bench.offline import UNRANKED, OfflineRow
from ..bench.runner import Results, shown_once
from ..bench.verdict import ERROR, measure_of, totals_of, verdict, worst_row

MOST_COLUMNS = 6
"""Scenarios that have a column of their own."""


def _table(
    title: str, left: Sequence[str], right: Iterable[str], rows: Iterable[Iterable[str | Text]]
) -> Table:
    """A table with headings of columns that are aligned to the left, then of those to the right."""
    table = Table(*left, *(Column(heading, justify="right") for heading in right), title=title)
    for row in rows:
        table.add_row(*(Text(each) if isinstance(each, str) else each for each in row))
    return table


def closed_loop_table(results: Results) -> Table:
    """Estimators from best to worst, those that flew exactly alike once.

    Against scenarios: mean error, and crashes where there were any. With more than `MOST_COLUMNS` scenarios
    the mean over them and the worst one.
    """
    results = shown_once(results)[0]
    ranked = [standing.estimator for standing in verdict(results).standings]
    return (_over_scenarios if len(results.scenarios) > MOST_COLUMNS else _by_scenario)(results, ranked)


def _by_scenario(results: Results, ranked: Sequence[str]) -> Table:
    found = {(row.scenario, row.estimator): row for row in results.rows}
    rows = ([name, *(_entry(found[scenario, name]) for scenario in results.scenarios)] for name in ranked)
    title = "In closed loop: error of roll and pitch | of attitude tracking, °; ✕ crashed flights"
    return _table(title, ["estimator"], results.scenarios, rows)


def _over_scenarios(results: Results, ranked: Sequence[str]) -> Table:
    totals, measure = totals_of(results.rows), measure_of(results.estimators)
    unranked, rows = results.unranked, []
    for rank, name in enumerate(ranked, 1):
        whole, worst = totals[name], worst_row(results.rows, name, measure)
        place = "–" if name in unranked else str(rank)
        if worst is None:
            rows.append((name, place, Text("did not run", style="red"), "", "", "", ""))
            continue
        crashes = Text(f"{whole.crashes}/{whole.flights}", style="red" if whole.crashes else "")
        there = _entry(worst) if measure == ERROR else _tracked(worst)
        means = (_number(value) for value in (whole.estimate, whole.attitude))
        rows.append((name, place, *means, crashes, worst.scenario, there))
    columns = ["rank", "error", "tracking", "crashes", "worst scenario", "there"]
    title = (
        f"In closed loop, {len(results.scenarios)} scenarios: mean error of roll and pitch, and of attitude "
        "tracking, °, without crashed flights (✕)"
    )
    table = _table(title, ["estimator"], columns, rows)
    table.caption = "Every scenario: report.html, results.csv"
    return table


def controllers_table(results: Results) -> Table | None:
    """Attitude tracking and motor effort by scenario of each contender; None where the cascade alone flew.

    None too with more than `MOST_COLUMNS` scenarios, of which there is a table already.
    """
    results = shown_once(results)[0]
    flown = {controller_of(name) for name in results.estimators}
    again = measure_of(results.estimators) != ERROR and len(results.scenarios) > MOST_COLUMNS
    if flown <= {CASCADED} or again:
        return None
    found = {(row.scenario, row.estimator): row for row in results.rows}
    ranked = [standing.estimator for standing in verdict(results).standings]
    rows = ([name, *(_tracked(found[key, name]) for key in results.scenarios)] for name in ranked)
    title = "Attitude tracking RMS, ° (change of the rotor command, rad/s a sample); ✕ crashed flights"
    return _table(title, ["estimator @ controller"], results.scenarios, rows)


def _tracked(row: CellRow) -> Text:
    if row.reason:
        return Text("did not run", style="red")
    crashed = f" ✕{row.crashes}" if row.crashes else ""
    jitter = "" if row.jitter is None else f" ({row.jitter:.1f})"
    return Text(f"{_number(row.attitude_deg)}{jitter}{crashed}", style="red" if row.crashes else "")


def _number(value: float | None) -> str:
    """Two decimals; a dash for what was not measured."""
    return "–" if value is None or math.isinf(value) else f"{value:.2f}"


def axes_tables(effects: Sequence[Effect]) -> list[Table]:
    """A table for each axis: estimators against its levels, best over all first."""
    names = ranking(effects)
    found = {(each.axis, each.level, each.estimator): each for each in effects}
    levels: dict[str, list[str]] = {}
    for each in effects:
        of_axis = levels.setdefault(each.axis, [])
        if each.level not in of_axis:
            of_axis.append(each.level)
    return [
        _table(
            "all flights" if axis == ALL else axis,
            ["estimator"],
            ["error, °; ✕ crashed"] if axis == ALL else own,
            ([name, *(_effect(found[axis, level, name]) for level in own)] for name in names),
        )
        for axis, own in levels.items()
    ]


def _effect(each: Effect) -> str:
    if not each.flights:
        return "does not fly"
    error = "–" if each.error_deg is None else f"{each.error_deg:.2f}"
    return error + (f" ✕{each.crashes}/{each.flights}" if each.crashes else "")


def breaking_table(points: Sequence[BreakingPoint]) -> Table:
    """Estimators against disturbances: the least level at which one crashed."""
    headings = {p.disturbance: f"{p.disturbance}, {p.unit}" if p.unit else p.disturbance for p in points}
    found = {(point.estimator, point.disturbance): point.text for point in points}
    names = dict.fromkeys(point.estimator for point in points)
    rows = ([name, *(found.get((name, kind), "") for kind in headings)] for name in names)
    title = "Breaking points: the least level at which a flight crashed"
    return _table(title, ["estimator"], headings.values(), rows)


def evaluation_table(rows: Sequence[EvaluationRow], title: str) -> Table:
    """Errors on recorded flights with their confidence, convergence from an initial tilt, and run time."""
    table = Table(title=title, box=SIMPLE, padding=(0, 1, 0, 0))
    headings = "median°", "mean° (95 %)", "SD°", "silenced°", "behind the best°", "20→2° s", "45→2° s", "ns"
    for heading in ("estimator", "start", *headings):
        table.add_column(heading, justify="right" if heading in headings else "left", overflow="fold")
    for row in rows:
        if math.isnan(row.mean_deg):
            table.add_row(row.estimator, row.initial, *["–"] * 4, row.behind, *["–"] * 3)
            continue
        settling = ["never" if math.isnan(s) else f"{s:.1f}" for s in (row.settle_20_s, row.settle_45_s)]
        mean = f"{row.mean_deg:.2f} ({row.mean_low_deg:.2f}–{row.mean_high_deg:.2f})"
        errors = f"{row.median_deg:.2f}", mean, f"{row.sd_deg:.2f}", row.silenced, row.behind
        table.add_row(row.estimator, row.initial, *errors, *settling, f"{row.runtime_ns:.0f}")
    return table


def evaluation_columns(rows: Sequence[EvaluationRow]) -> list[dict[str, object]]:
    """The rows as a page shows them; what is not known is None."""
    shown: list[dict[str, object]] = [
        {
            "estimator": row.estimator,
            "start": row.initial,
            "median_deg": _known(row.median_deg),
            "mean_deg": _known(row.mean_deg),
            "95 % interval": _interval(row.mean_low_deg, row.mean_high_deg),
            "sd_deg": _known(row.sd_deg),
            "silenced_deg": _known(row.silenced_deg),
            "behind the best": row.behind,
            "inclination_rmse_deg": _known(row.inclination_rmse_deg),
            "20° to 2° [s]": _known(row.settle_20_s),
            "45° to 2° [s]": _known(row.settle_45_s),
            "runtime_us": _known(row.runtime_ns / 1e3),
        }
        for row in rows
    ]
    if any(row.unranked for row in rows):
        for columns, row in zip(shown, rows, strict=True):
            columns[UNRANKED] = row.unranked
    return shown


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _interval(low: float, high: float) -> str:
    return "–" if math.isnan(low) else f"{low:.2f}–{high:.2f}"


EVALUATION_METHOD = (
    "Errors are the mean absolute error of roll and pitch of each flight; median, mean and SD are over "
    "flights, the interval of the mean is a bootstrap's, 95 %. Silenced: the mean error of the same network "
    "with output weights of zero. Behind the best: the paired difference of each flight from the best "
    "estimator's; tied where its interval reaches zero. 20° to 2°: after a start in an "
    "unknown tilt of 20°, when the median start's inclination error stays below 2°; a dash is never. "
    "Networks are never given the initial attitude: they have no row with a known start. A reference "
    "receives the true attitude and is not ranked, nor is an estimator that failed or has a flaw."
)


def evaluation_notes(rows: Sequence[EvaluationRow]) -> list[str]:
    """What the table does not say by itself."""
    notes = []
    most = max(row.flights for row in rows)
    fewer = {row.estimator: row.flights for row in rows if 0 < row.flights < most}
    if fewer:
        flights = ", ".join(f"{name} on the first {count}" for name, count in fewer.items())
        notes.append(f"Slow ones were run on fewer flights: {flights}; --slow-flights changes that.")
    missing = max(row.missing for row in rows)
    if missing > 0:
        notes.append(
            f"{missing} samples were missing or beyond any sensor's range; estimators went on from their "
            "predictions there."
        )
    flaws: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.flaw:
            flaws.setdefault((row.estimator, row.flaw), []).append(row.initial)
    for (name, flaw), starts in flaws.items():
        counted = " Each of these counts as 180°." * any(
            r.without_number > 0.0 for r in rows if r.flaw == flaw
        )
        notes.append(f"{name} is not ranked ({' and '.join(starts)} start): it {flaw.rstrip('.')}.{counted}")
    if references := dict.fromkeys(row.estimator for row in rows if row.unranked == "reference"):
        verbs = ("receives", "is") if len(references) == 1 else ("receive", "are")
        notes.append(f"{', '.join(references)} {verbs[0]} the true attitude and {verbs[1]} not ranked.")
    return notes


def offline_table(rows: Sequence[OfflineRow]) -> Table:
    """Errors on recorded flights, one estimator a row, in the order given."""
    starts = {"level": "unknown initial attitude", "known": "known initial attitude"}
    errors = {
        (r.estimator, r.start): "did not run" if r.mean_deg is None else f"{r.mean_deg:.2f} ± {r.sd_deg:.2f}"
        for r in rows
    }
    silenced = {r.estimator: "–" if r.silenced_deg is None else f"{r.silenced_deg:.2f}" for r in rows}
    unranked = {r.estimator: f"{r.estimator}: not ranked, {r.unranked}" for r in rows if r.unranked}
    entries = (
        [unranked.get(n, n), *(errors.get((n, start), "–") for start in starts), s]
        for n, s in silenced.items()
    )
    title = "On recorded flights: error of roll and pitch, mean ± SD over flights, °"
    return _table(title, ["estimator"], [*starts.values(), "silenced"], entries)


def cores_table(cores: Sequence[ChipCore]) -> Table:
    """The neurons of each core of a chip, and how much of each limit they take."""
    headings = ["\n".join([*name.split(), f"({limit})"]) for name, limit in LIMITS.items()]
    layers = [", ".join(f"{k}: {len(ids)}" for k, ids in core.neurons.items()) for core in cores]
    rows = ([str(k), layers[k], *map(str, core.used().values())] for k, core in enumerate(cores))
    return _table("On the chip: used of what a core has", ["core", "neurons of layer"], headings, rows)


def plain_table(rows: Sequence[tuple[str, str]]) -> Table:
    """What and how much, a line each."""
    table = Table(show_header=False, box=SIMPLE)
    for row in rows:
        table.add_row(*row)
    return table


def _entry(row: CellRow) -> Text:
    if row.reason:
        return Text("did not run", style="red")
    text = Text(" | ".join(_number(value) for value in (row.error_deg, row.attitude_deg)))
    if row.crashes:
        text.append(f" ✕ {row.crashes}/{row.flights}", style="red")
    return text
