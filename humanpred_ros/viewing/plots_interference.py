"""The plot of an evaluation of interference: Table I's costs beside the published, and how close and how late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from humanpred_ros.viewing.figures import ALARM, INK, MUTED, SERIES, new_figure, note, report_style

_DPI = 150
#: What stands for a cost of zero on a logarithmic axis.
_SMALLEST_COST = 1e-4


@dataclass(frozen=True)
class CostBars:
    """Costs of one human trajectory: mean and standard deviation by method, and as published."""

    name: str
    methods: Mapping[str, tuple[float, float]]
    published: Mapping[str, tuple[float, float]] | None


@dataclass(frozen=True)
class MethodDots:
    """All runs of one method: least distances to the human in m, and times to the goal in s, infinite if never."""

    method: str
    least_distance_m: Sequence[float]
    time_to_goal_s: Sequence[float]


def save_interference_plot(path: Path, bars: Sequence[CostBars], dots: Sequence[MethodDots]) -> None:
    """Write the plot as PNG; parts without data say so."""
    with report_style():
        figure = new_figure(6.4)
        figure.set_facecolor("white")
        above, below = figure.subplots(2, 1)
        _costs(above, bars)
        cells = below.get_subplotspec().subgridspec(1, 2)
        below.remove()
        distance, time = (figure.add_subplot(cell) for cell in cells)
        _runs(distance, dots, [dot.least_distance_m for dot in dots], "least distance to the human, m")
        if dots:
            distance.axvline(0.0, color=ALARM, linewidth=1.0)
        _runs(time, dots, [dot.time_to_goal_s for dot in dots], "time to goal, s")
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _costs(axes: Axes, bars: Sequence[CostBars]) -> None:
    axes.set_title("human occupancy of the executed motion (P1 Table I), mean and standard deviation")
    if not bars:
        note(axes, "Table I was left out")
        return
    kinds = [("published", name) for name in (bars[0].published or {})] + [("here", name) for name in bars[0].methods]
    width = 0.8 / len(kinds)
    for k, (where, name) in enumerate(kinds):
        entries = [(bar.published or {}) if where == "published" else bar.methods for bar in bars]
        mean = np.array([entry.get(name, (np.nan, np.nan))[0] for entry in entries])
        sd = np.array([entry.get(name, (np.nan, np.nan))[1] for entry in entries])
        x = np.arange(len(bars)) + (k - (len(kinds) - 1) / 2.0) * width
        low = np.minimum(sd, mean - np.maximum(mean / 10.0, _SMALLEST_COST / 2.0))  # an error bar stays on the axis
        axes.bar(
            x,
            np.maximum(mean, _SMALLEST_COST),
            0.92 * width,
            yerr=np.stack([np.maximum(low, 0.0), sd]),
            error_kw={"elinewidth": 0.8, "ecolor": INK},
            color=SERIES[k % len(SERIES)],
            alpha=0.45 if where == "published" else 1.0,
            hatch="//" if where == "published" else None,
            edgecolor="white",
            label=f"{name}, {where}",
        )
    axes.set_yscale("log")
    axes.set_xticks(np.arange(len(bars)), [bar.name for bar in bars])
    axes.set_xlabel("human trajectory")
    axes.set_ylabel("cost")
    axes.legend(ncols=len(kinds), loc="lower center", bbox_to_anchor=(0.5, 1.08))


def _runs(axes: Axes, dots: Sequence[MethodDots], values: Sequence[Sequence[float]], label: str) -> None:
    if not dots:
        note(axes, "the comparison was left out")
        return
    for row, (dot, numbers) in enumerate(zip(dots, values, strict=True)):
        all_runs = np.asarray(numbers, dtype=np.float64)
        array = all_runs[np.isfinite(all_runs)]
        spread = ((np.arange(len(array)) * 0.618) % 1.0 - 0.5) * 0.5  # side by side without chance
        axes.plot(array, row + spread, ".", color=SERIES[row % len(SERIES)], markersize=3.0, alpha=0.6)
        median = float(np.median(all_runs))
        if np.isfinite(median):
            axes.plot([median, median], [row - 0.35, row + 0.35], color=INK, linewidth=2.0)
        never = len(all_runs) - len(array)
        if never:
            axes.text(0.99, row, f"{never} never", transform=axes.get_yaxis_transform(), ha="right", color=MUTED)
        axes.text(-0.02, row, dot.method, transform=axes.get_yaxis_transform(), ha="right", va="center")
    if not all(np.isfinite(numbers).all() for numbers in values):
        low, high = axes.get_xlim()
        axes.set_xlim(low, high + 0.15 * (high - low))  # room for who never arrives
    axes.set_yticks([])
    axes.set_ylim(len(dots) - 0.4, -0.6)
    axes.set_xlabel(label + "; the bar is the median")
