"""Results as tables for a terminal."""

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from .offline import Row
from .runner import Results
from .verdict import verdict


def closed_loop_table(results: Results) -> Table:
    """Estimators from best to worst against scenarios: mean error, and crashes where there were any."""
    scenarios = list(results.settings.scenarios)
    rows = {(row["scenario"], row["estimator"]): row for row in results.rows}
    table = Table("estimator", title="In closed loop: error of roll and pitch, °; ✕ crashed flights")
    for name in scenarios:
        table.add_column(name, justify="right")
    for standing in verdict(results.rows).standings:
        estimator = standing["estimator"]
        table.add_row(estimator, *(_entry(rows[name, estimator]) for name in scenarios))
    return table


def offline_table(rows: Sequence[Row]) -> Table:
    """Errors on recorded flights, in the order given."""
    table = Table("estimator", "start", title="On recorded flights: error of roll and pitch, °")
    for heading in ("median", "mean", "SD", "inclination RMSE"):
        table.add_column(heading, justify="right")
    for row in rows:
        keys = ("median_deg", "mean_deg", "sd_deg", "inclination_rmse_deg")
        numbers = [f"{value:.2f}" if isinstance(value := row.get(key), float) else "–" for key in keys]
        table.add_row(str(row["estimator"]), str(row["start"]), *numbers)
    return table


def _entry(row: Row) -> Text:
    if row["reason"]:
        return Text("did not run", style="red")
    error = row["error_deg"]
    text = Text("–" if error is None else f"{error:.2f}")
    if row["crashes"]:
        text.append(f" ✕ {row['crashes']}/{row['flights']}", style="red")
    return text
