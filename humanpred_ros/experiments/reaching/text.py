"""What all tables of the evaluation of reaches look like."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table


def line(console: Console, text: str, *, bold: bool = False) -> None:
    """Print text as it is."""
    console.print(text, style="bold" if bold else None, markup=False, highlight=False)


def figure_table(first: str, *others: str) -> Table:
    """Return a table with these titles."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(first, no_wrap=True)
    for title in others:
        table.add_column(title, overflow="fold")
    return table
