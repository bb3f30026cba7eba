"""Results as tables for a terminal."""

from collections.abc import Mapping, Sequence

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from estimators.loihi.chip import LIMITS, ChipCore

from ..bench.results import Results
from ..bench.verdict import Verdict


def rows_table(rows: Sequence[Mapping[str, object]], title: str = "") -> Table:
    """Make a table of rows, given by their headings; numbers are aligned to the right.

    The first column is not wrapped. Columns without text are omitted.
    """
    table = Table(title=title, box=SIMPLE, padding=(0, 1, 0, 0))
    shown = [heading for heading in rows[0] if any(row[heading] != "" for row in rows)]
    for heading in shown:
        number = all(isinstance(row[heading], int | float | None) for row in rows)
        place = "right" if number else "left"
        table.add_column(Text(heading), justify=place, overflow="fold", no_wrap=heading == shown[0])
    for row in rows:
        values = (row[heading] for heading in shown)
        table.add_row(
            *(Text(f"{v:.2f}" if isinstance(v, float) else str("–" if v is None else v)) for v in values)
        )
    return table


def standings_table(judged: Verdict) -> Table:
    """Make the table of a verdict, with crashes in red."""
    table = rows_table([{"estimator": each.estimator, **each.texts} for each in judged.standings])
    for row, each in zip(table.rows, judged.standings, strict=True):
        row.style = "red" if each.crashed else None
    table.caption = (
        "Errors are means over scenarios of the flights without a crash. flights.parquet lists every flight."
    )
    return table


def breaking_table(results: Results) -> Table:
    """Make a table of contenders and sweeps, with the smallest level at which a flight crashed."""
    rows = [
        {"estimator": name} | {sweep: results.breaking_point(sweep, name) for sweep in results.axes}
        for name in results.estimators
    ]
    return rows_table(rows, "Breaking points: the smallest level at which a flight crashed")


def cores_table(cores: Sequence[ChipCore]) -> Table:
    """Make a table of the cores of a chip: neurons, and use of each limit."""
    headings = {name: "\n".join([*name.split(), f"({limit})"]) for name, limit in LIMITS.items()}
    rows = [
        {
            "core": str(number),
            "neurons of layer": ", ".join(f"{k}: {len(ids)}" for k, ids in core.neurons.items()),
        }
        | {headings[name]: used for name, used in core.used().items()}
        for number, core in enumerate(cores)
    ]
    return rows_table(rows, "Use of each core of the chip, with the limits in brackets")
