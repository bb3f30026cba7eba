"""Results as tables for a terminal."""

import math
from collections.abc import Sequence

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from estimators.analysis.ablation import Pruned
from estimators.evaluation.comparison import EvaluationRow
from estimators.loihi.chip import LIMITS, Core

from ..bench.breaking import DISTURBANCES, BreakingPoint
from ..bench.flight_metrics import CellRow
from ..bench.offline import OfflineRow
from ..bench.runner import Results
from ..bench.verdict import verdict


def closed_loop_table(results: Results) -> Table:
    """Estimators from best to worst against scenarios: mean error, and crashes where there were any."""
    scenarios = list(results.scenarios)
    rows = {(row.scenario, row.estimator): row for row in results.rows}
    table = Table("estimator", title="In closed loop: error of roll and pitch, °; ✕ crashed flights")
    for name in scenarios:
        table.add_column(name, justify="right")
    for standing in verdict(results.rows).standings:
        entries = (_entry(rows[name, standing.estimator]) for name in scenarios)
        table.add_row(standing.estimator, *entries)
    return table


def breaking_table(points: Sequence[BreakingPoint]) -> Table:
    """Estimators against disturbances: the least level at which one crashed."""
    kinds = list(dict.fromkeys(point.disturbance for point in points))
    table = Table("estimator", title="Breaking points: the least level at which a flight crashed")
    for kind in kinds:
        table.add_column(
            f"{kind}{', ' if DISTURBANCES[kind].unit else ''}{DISTURBANCES[kind].unit}", justify="right"
        )
    for name in dict.fromkeys(point.estimator for point in points):
        found = {point.disturbance: point for point in points if point.estimator == name}
        table.add_row(name, *(found[kind].text if kind in found else "" for kind in kinds))
    return table


def evaluation_table(rows: Sequence[EvaluationRow], title: str) -> Table:
    """Errors on recorded flights with their confidence, convergence from an initial tilt, and run time."""
    table = Table(title=title, box=SIMPLE, padding=(0, 1, 0, 0))
    table.add_column("estimator", overflow="fold")
    table.add_column("start", overflow="fold")
    for heading in (
        "median°", "mean° (95 %)", "SD°", "silenced°", "behind the best°", "20→2° s", "45→2° s", "ns",
    ):  # fmt: skip
        table.add_column(heading, justify="right", overflow="fold")
    for row in rows:
        settling = ["never" if math.isnan(s) else f"{s:.1f}" for s in (row.settle_20_s, row.settle_45_s)]
        mean = f"{row.mean_deg:.2f} ({row.mean_low_deg:.2f}–{row.mean_high_deg:.2f})"
        table.add_row(
            row.estimator,
            row.initial,
            f"{row.median_deg:.2f}",
            mean,
            f"{row.sd_deg:.2f}",
            row.silenced,
            row.behind,
            *settling,
            f"{row.runtime_ns:.0f}",
        )
    return table


def evaluation_columns(rows: Sequence[EvaluationRow]) -> list[dict[str, object]]:
    """The rows as a page shows them."""
    return [
        {
            "estimator": row.estimator,
            "start": row.initial,
            "median_deg": row.median_deg,
            "mean_deg": row.mean_deg,
            "95 % interval": f"{row.mean_low_deg:.2f}–{row.mean_high_deg:.2f}",
            "sd_deg": row.sd_deg,
            "silenced_deg": None if math.isnan(row.silenced_deg) else row.silenced_deg,
            "behind the best": row.behind,
            "inclination_rmse_deg": row.inclination_rmse_deg,
            "20° to 2° [s]": None if math.isnan(row.settle_20_s) else row.settle_20_s,
            "45° to 2° [s]": None if math.isnan(row.settle_45_s) else row.settle_45_s,
            "runtime_us": row.runtime_ns / 1e3,
        }
        for row in rows
    ]


EVALUATION_METHOD = (
    "Errors are the mean absolute error of roll and pitch of each flight; median, mean and SD are over "
    "flights, the interval of the mean is a bootstrap's, 95 %. Silenced: the mean error of the same network "
    "with output weights of zero. Behind the best: the paired difference of each flight from the best "
    "estimator's; tied where its interval reaches zero. 20° to 2°: after a start in an "
    "unknown tilt of 20°, when the median start's inclination error stays below 2°; a dash is never. "
    "Networks are never given the initial attitude: they have no row with a known start."
)


def evaluation_notes(rows: Sequence[EvaluationRow]) -> list[str]:
    """What the table does not say by itself."""
    notes = []
    most = max(row.flights for row in rows)
    fewer = {row.estimator: row.flights for row in rows if row.flights < most}
    if fewer:
        flights = ", ".join(f"{name} on the first {count}" for name, count in fewer.items())
        notes.append(f"Slow ones were run on fewer flights: {flights}; --slow-flights changes that.")
    missing = max(row.missing for row in rows)
    if missing > 0:
        notes.append(
            f"{missing} samples were missing or beyond any sensor's range; estimators went on from their "
            "predictions there."
        )
    for row in rows:
        if row.without_number > 0.0:
            notes.append(
                f"{row.estimator}, {row.initial} start: {100.0 * row.without_number:.1f} % of its estimates "
                "are no number; each counts as 180°."
            )
    return notes


def offline_table(rows: Sequence[OfflineRow]) -> Table:
    """Errors on recorded flights, one estimator a row, in the order given."""
    table = Table(
        "estimator", title="On recorded flights: error of roll and pitch, mean ± SD over flights, °"
    )
    starts = {"level": "unknown initial attitude", "known": "known initial attitude"}
    for heading in (*starts.values(), "silenced"):
        table.add_column(heading, justify="right")
    errors = {(row.estimator, row.start): _error(row) for row in rows}
    silenced = {row.estimator: row.silenced_deg for row in rows}
    for name, silent in silenced.items():
        text = "–" if silent is None else f"{silent:.2f}"
        table.add_row(name, *(errors.get((name, start), "–") for start in starts), text)
    return table


def _error(row: OfflineRow) -> str:
    return "did not run" if row.mean_deg is None else f"{row.mean_deg:.2f} ± {row.sd_deg:.2f}"


def cores_table(cores: Sequence[Core]) -> Table:
    """The neurons of each core of a chip, and how much of each limit they take."""
    table = Table("core", "neurons of layer", title="On the chip: used of what a core has")
    for name, limit in LIMITS.items():
        table.add_column(f"{name}\n({limit})", justify="right")
    for number, core in enumerate(cores):
        layers = ", ".join(f"{k}: {len(ids)}" for k, ids in core.neurons.items())
        table.add_row(str(number), layers, *map(str, core.used().values()))
    return table


def plain_table(rows: Sequence[tuple[str, str]]) -> Table:
    """What and how much, a line each."""
    table = Table(show_header=False, box=SIMPLE)
    for row in rows:
        table.add_row(*row)
    return table


def stages_table(stages: Sequence[Pruned]) -> Table:
    """A network pruned step by step: its size, and its error after the cut and after training on."""
    table = Table("removed", "neurons", title="Pruned: error of roll and pitch from an unknown start, °")
    for heading in ("parameters", "after the cut", "trained on"):
        table.add_column(heading, justify="right")
    for each in stages:
        sizes = f"{100 * each.removed:.0f} %", f"{each.encoding} + {each.hidden}", f"{each.parameters}"
        table.add_row(*sizes, f"{each.cut_deg:.2f}", f"{each.tuned_deg:.2f}")
    return table


def _entry(row: CellRow) -> Text:
    if row.reason:
        return Text("did not run", style="red")
    text = Text("–" if row.error_deg is None else f"{row.error_deg:.2f}")
    if row.crashes:
        text.append(f" ✕ {row.crashes}/{row.flights}", style="red")
    return text
