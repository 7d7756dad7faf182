"""What is printed is what was said: brackets are no markup, and names in the first column stay in one piece."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from humanpred_ros.evaluation.text import figure_table, headline, line


def test_brackets_are_printed_as_they_are() -> None:
    text = io.StringIO()
    console = Console(file=text, width=80)
    headline(console, "[bold]library[/bold]")
    line(console, "motion [3/2]")
    assert text.getvalue() == "[bold]library[/bold]\nmotion [3/2]\n"


@pytest.mark.parametrize(("wrap", "whole"), [(False, True), (True, False)])
def test_the_first_column_stays_whole_unless_it_may_be_broken(wrap: bool, whole: bool) -> None:
    text = io.StringIO()
    table = figure_table("", "figures", wrap=wrap)
    table.add_row("median least distance", "1.23 " * 12)
    Console(file=text, width=32).print(table)
    assert ("median least distance" in text.getvalue()) is whole
