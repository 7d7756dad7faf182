"""The evaluation of reaches as tables in the terminal: published, trivial and predicted side by side."""

from __future__ import annotations

from collections.abc import Mapping

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.experiments.reaching_result import DistanceFigures, ReachingEvaluation, ReachingSet, Statistic
from humanpred_ros.experiments.target import targets_table

_COLUMNS = ("joint", "task as coded", "task")


def print_reaching(evaluation: ReachingEvaluation, console: Console) -> None:
    """Print averages, every recording, what is doubtful about the recordings, and the targets."""
    _line(
        console,
        "distances by time warping, metres summed over frames (P2: 100 Hz). joint: centres of pelvis, torso, shoulder, "
        "elbow, wrist; task: palm and its orientation; as coded: with the sign error of P2's code, to compare with P2",
    )
    for entry in evaluation.sets:
        names = entry.names
        many = "1 reach" if len(names) == 1 else f"{len(names)} reaches"
        _line(console, f"{many}, {entry.title}; average, and over runs: sd, least, largest", bold=True)
        console.print(_averages(entry))
        for which, title in enumerate(_COLUMNS):
            _line(console, f"each reach: {title}", bold=True)
            console.print(_each(entry, which, evaluation.table1))
        _notes(console, entry)
    if evaluation.targets:
        _line(console, "reference values (computed elsewhere from the same recordings) and targets", bold=True)
        console.print(targets_table(evaluation.targets))


def _averages(entry: ReachingSet) -> Table:
    table = _table("", "runs", *_COLUMNS, "without marked jumps", "ms")
    for row in entry.published:
        table.add_row(
            f"{row.table}: {row.what}", "10", f"{row.joint_m:.2f}", f"{row.task_as_coded_m:.2f}", "–", "–", "–"
        )
    if entry.published:
        table.add_section()
    for figures in entry.predictors:
        average = figures.average
        table.add_row(
            f"{figures.name}: {escape(figures.description)}",
            str(figures.runs),
            *(_spread(s, figures.runs) for s in (average.joint_m, average.task_as_coded_m, average.task_m)),
            "–" if figures.average_fit is None else _three(figures.average_fit),
            f"{figures.predict_ms:.2f}" if figures.predict_ms == figures.predict_ms else "–",
        )
    return table


def _each(entry: ReachingSet, which: int, table1: Mapping[str, tuple[float, float]]) -> Table:
    titles = [f"{f['name']}{'*' if f['unfit'] else ''}\n{f['duration_s']:.2f} s" for f in entry.recordings]
    table = _table("", *titles)
    if which < 2 and any(name in table1 for name in entry.names):
        cells = (f"{table1[name][which]:.2f}" if name in table1 else "–" for name in entry.names)
        table.add_row("P2 Table I: own weights", *cells)
        table.add_section()
    for figures in entry.predictors:
        table.add_row(figures.name, *(f"{figures.of(name).means[which]:.2f}" for name in entry.names))
    return table


def _notes(console: Console, entry: ReachingSet) -> None:
    for facts in entry.recordings:
        for text in facts["notes"]:
            _line(console, f"{facts['name']} {text}")
        if facts["unfit"]:
            _line(console, f"* not learned from, but tested: {facts['unfit']}")


def _three(figures: DistanceFigures) -> str:
    return " / ".join(f"{value:.2f}" for value in figures.means)


def _spread(statistic: Statistic, runs: int) -> str:
    if runs == 1:
        return f"{statistic.mean:.2f}"
    return f"{statistic.mean:.2f} ({statistic.sd:.2f}, {statistic.low:.2f}, {statistic.high:.2f})"


def _line(console: Console, text: str, *, bold: bool = False) -> None:
    console.print(text, style="bold" if bold else None, markup=False, highlight=False)


def _table(first: str, *others: str) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(first)
    for title in others:
        table.add_column(title, overflow="fold")
    return table
