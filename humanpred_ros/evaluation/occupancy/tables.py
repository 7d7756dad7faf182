"""The evaluation of occupancy as tables in the terminal: predictors side by side, figures below each other."""

from __future__ import annotations

import math
from collections.abc import Callable

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.evaluation.occupancy.result import OccupancyEvaluation, PredictorResult, VoxelFigures
from humanpred_ros.evaluation.text import headline, line
from humanpred_ros.geometry.checks import FloatArray

_Row = tuple[str, Callable[[PredictorResult], str]]

_AVERAGES: tuple[_Row, ...] = (
    ("learned from the tested class", lambda r: r.learned_from_class),
    ("Brier score x 1000", lambda r: f"{1e3 * float(r.average.brier):.2f}"),
    ("  as a sum over voxels", lambda r: f"{float(r.average.squared_error):.0f}"),
    (
        "  without mistracked motions x 1000",
        lambda r: _of(r.without_mistracked, lambda f: f"{1e3 * float(f.brier):.2f}"),
    ),
    ("  its place not told x 1000", lambda r: _of(r.untold, lambda f: f"{1e3 * float(f.brier):.2f}")),
    ("log score x 1000", lambda r: f"{1e3 * float(r.average.log_loss):.1f}"),
    ("area under precision-recall", lambda r: f"{float(r.average.average_precision):.3f}"),
    ("swept voxels given < 1 %", lambda r: _share(r.average.missed)),
    ("  without mistracked motions", lambda r: _of(r.without_mistracked, lambda f: _share(f.missed))),
    ("  its place not told", lambda r: _of(r.untold, lambda f: _share(f.missed))),
    ("calibration error, voxels given >= 1 %", lambda r: f"{r.calibration.error_predicted:.3f}"),
    ("voxels expected", lambda r: f"{float(r.average.n_predicted):.0f}"),
    ("voxels swept", lambda r: f"{float(r.average.n_swept):.0f}"),
    ("one update (99 % below), ms", lambda r: f"{r.timing.median_ms:.2f} ({r.timing.p99_ms:.2f})"),
    ("training without one motion, s", lambda r: f"{r.timing.prepare_s:.2f}"),
    ("postures refused", lambda r: str(r.refused_postures)),
)


def print_occupancy_evaluation(evaluation: OccupancyEvaluation, console: Console) -> None:
    """Print the averages of every predictor, and its errors along the motion."""
    library = evaluation.library
    headline(
        console,
        f"{library['name']}: {len(evaluation.tested)} of {library['n_motions']} motions left out in turn; averages "
        f"over {len(evaluation.percents)} fractions, means over {evaluation.region_voxels} voxels",
    )
    table = _table(evaluation)
    # Rows that say nothing of anybody are left out.
    without = {"mistracked"} if not evaluation.mistracked else set()
    without |= {"not told"} if all(result.untold is None for result in evaluation.predictors) else set()
    for title, cell in _AVERAGES:
        if not any(words in title for words in without):
            table.add_row(title, *(cell(result) for result in evaluation.predictors))
    console.print(table)
    _print_unseen(evaluation, console)
    for title, cells in (
        ("Brier score x 1000 by % seen", lambda f: [f"{1e3 * value:.2f}" for value in f.brier]),
        ("swept voxels given < 1 % by % seen", lambda f: [_share(value) for value in f.missed]),
    ):
        headline(console, title)
        console.print(_by_percent(evaluation, cells))


def _print_unseen(evaluation: OccupancyEvaluation, console: Console) -> None:
    """Say what it means that one predictor stands beside others that have learned the class."""
    names = {result.name for result in evaluation.predictors}
    if "reaching" not in names:
        return
    text = (
        "reaching (P2) has learned from no motion of the tested motion's class; it is told the places of all classes, "
        "the tested one's from the class's other motions. Place not told: all but that one, so that the reach goes to "
        "none of those it knows of"
    )
    if evaluation.unseen_beside_seen is not None:
        text += (
            f". Beside swept_volume (P1), which was trained with the class, its Brier score is "
            f"{evaluation.unseen_beside_seen:.2f} times as large (target: no worse, 1.00)"
        )
    line(console, text + "\n")


def _table(evaluation: OccupancyEvaluation) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column()
    for result in evaluation.predictors:
        table.add_column(escape(result.name), justify="right", overflow="fold")
    return table


def _by_percent(evaluation: OccupancyEvaluation, cells: Callable[[VoxelFigures], list[str]]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column()
    for percent in evaluation.percents:
        table.add_column(str(percent), justify="right", no_wrap=True)
    for result in evaluation.predictors:
        table.add_row(escape(result.name), *cells(result.at_percent))
        if result.untold_at_percent is not None:
            table.add_row("  place not told", *cells(result.untold_at_percent))
    return table


def _of(figures: VoxelFigures | None, text: Callable[[VoxelFigures], str]) -> str:
    return "–" if figures is None else text(figures)


def _share(value: FloatArray | float) -> str:
    return "–" if math.isnan(float(value)) else f"{100.0 * float(value):.1f} %"
