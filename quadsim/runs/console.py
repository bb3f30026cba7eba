"""What is printed on a terminal, and what long work shows there."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

output = Console(
    width=None if sys.stdout.isatty() else 160, emoji=False
)  # a file or a pipe has no width of its own


def say(line: object, style: str | None = None) -> None:
    """Print a line as it is: it holds no markup, no number is coloured, and it is not wrapped."""
    output.print(str(line), style=style, markup=False, highlight=False, soft_wrap=True)


def print_table(
    rows: Iterable[Iterable[object]], headings: Sequence[str] = (), title: str | None = None
) -> None:
    """Print rows of cells below headings, or without any."""
    table = Table(*headings, title=title, show_header=bool(headings))
    for row in rows:
        table.add_row(*(Text(str(cell)) for cell in row))
    output.print(table)


class Bar(Protocol):
    """A progress bar: how much is done of how much, and a remark."""

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Move the bar."""


@contextmanager
def progress_bar(title: str, unit: str) -> Iterator[Bar]:
    """A progress bar as a callback, with time elapsed and left."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{unit}{{task.fields[note]}}"),
        TimeElapsedColumn(),
        TextColumn("elapsed,"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    with Progress(*columns, console=Console(stderr=True, emoji=False)) as bar:
        task = bar.add_task(title, total=None, note="")

        def update(done: int, total: int, note: str = "") -> None:
            bar.update(task, completed=done, total=total, note=f", {note}" if note else "")

        try:
            yield update
        except Exception:  # refused before anything was done: the line that says why stands alone
            if bar.tasks[0].completed == 0:
                bar.live.transient = True
                bar.remove_task(task)
            raise
