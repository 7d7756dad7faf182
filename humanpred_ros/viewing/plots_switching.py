"""The plot of an evaluation of switching: the candidates' costs as in P1's Fig. 9, and how many steps are gained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import (
    DASHES,
    INK,
    MARKERS,
    SERIES,
    goal_colours,
    new_figure,
    note,
    report_style,
)

_DPI = 150
_COLUMNS = 3


@dataclass(frozen=True, eq=False)
class CandidateCosts:
    """Costs (steps, goals) of the candidates of one run, NaN where there is none, and when it first switched."""

    title: str
    goals: tuple[str, ...]
    costs: FloatArray
    switch: int | None


@dataclass(frozen=True)
class StepsEarlier:
    """By how many steps each of some motions was decided rightly before the baseline did."""

    variant: str
    steps: Sequence[int]


def save_switching_plot(path: Path, panels: Sequence[CandidateCosts], gained: Sequence[StepsEarlier]) -> None:
    """Write the plot as PNG; parts without data say so."""
    with report_style():
        n_rows = max(1, -(-(len(panels) + 1) // _COLUMNS))
        figure = new_figure(3.0 * n_rows)
        cells = figure.subplots(n_rows, _COLUMNS, squeeze=False).ravel()
        shown = np.concatenate([panel.costs[panel.costs > 0.0] for panel in panels] or [np.zeros(0)])
        low, high = (shown.min() / 2.0, shown.max() * 2.0) if len(shown) else (0.1, 1.0)
        for axes, panel in zip(cells, panels, strict=False):
            _draw_costs(axes, panel, low, high)
        _draw_gained(cells[len(panels)], gained)
        for axes in cells[len(panels) + 1 :]:
            axes.remove()
        canvas: Any = FigureCanvasAgg(figure)
        figure.set_facecolor("white")
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _draw_costs(axes: Axes, panel: CandidateCosts, low: float, high: float) -> None:
    colours = goal_colours(panel.goals)
    step = np.arange(1, len(panel.costs) + 1)
    for k, goal in enumerate(panel.goals):
        cost = np.where(panel.costs[:, k] > 0.0, panel.costs[:, k], np.nan)
        axes.plot(
            step,
            cost,
            color=colours[goal],
            linestyle=DASHES[k % len(DASHES)],
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.0,
            label=goal,
        )
    if panel.switch is not None:
        axes.axvline(panel.switch, color=INK, linewidth=1.0)
        axes.annotate(f" switch: {panel.switch}", (panel.switch, high), va="top", fontsize=8.0)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.set_xlim(0.5, max(20, len(panel.costs)) + 0.5)
    axes.set_title(panel.title)
    axes.set_xlabel("replanning step")
    axes.set_ylabel("cost")
    axes.legend(loc="lower left")


def _draw_gained(axes: Axes, gained: Sequence[StepsEarlier]) -> None:
    gained = [entry for entry in gained if len(entry.steps)]
    if not gained:
        note(axes, "no motion was shown in which\nsomething is to be decided")
        return
    everything = np.concatenate([np.asarray(entry.steps) for entry in gained])
    edges = np.arange(everything.min(), everything.max() + 2) - 0.5
    axes.hist(
        [np.asarray(entry.steps) for entry in gained],
        bins=edges.tolist(),
        color=list(SERIES[: len(gained)]),
        label=[f"{entry.variant}, median {np.median(entry.steps):g}" for entry in gained],
    )
    axes.set_title("right earlier than current")
    axes.set_xlabel("replanning steps")
    axes.set_ylabel("motions that take the default goal")
    axes.legend()
