"""Rows of a benchmark: printed, and written as CSV for the pages."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table


def show(title: str, rows: Sequence[Mapping[str, object]], out: Path | None = None) -> None:
    """Print the rows under the names of their columns, and write them to a CSV file."""
    table = Table(*rows[0], title=title)
    for each in rows:
        table.add_row(*map(str, each.values()))
    Console(width=120).print(table)
    if out is not None:
        with out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
