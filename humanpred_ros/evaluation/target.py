"""What the project wants of itself, beside what was reached and published: one form for all evaluations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class Target:
    """What the project wants, beside what was reached and, where there is something, published."""

    what: str
    wanted: str
    reached: str
    published: str
    met: bool


def targets_table(targets: Sequence[Target]) -> Table:
    """Return target, reached and published side by side."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for title in ("target", "wanted", "reached", "published", ""):
        table.add_column(title, overflow="fold")
    for target in targets:
        verdict = "[green]met[/green]" if target.met else "[red]missed[/red]"
        row = (escape(text) for text in (target.what, target.wanted, target.reached, target.published or "–"))
        table.add_row(*row, verdict)
    return table
