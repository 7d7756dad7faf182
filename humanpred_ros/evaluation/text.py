"""What evaluations print looks alike: headlines, sentences and tables of figures."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table


def headline(console: Console, text: str) -> None:
    """Print the title of what follows, as it is."""
    console.print(text, style="bold", markup=False, highlight=False)


def line(console: Console, text: str) -> None:
    """Print text as it is."""
    console.print(text, markup=False, highlight=False)


def figure_table(first: str, *others: str, wrap: bool = False) -> Table:
    """Return a table with these titles; `wrap` lets even the first column be broken into lines."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(first, no_wrap=not wrap)
    for title in others:
        table.add_column(title, overflow="fold")
    return table
