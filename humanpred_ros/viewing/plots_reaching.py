"""The plot of an evaluation of reaches: predicted and real paths of the wrist, and how far off each predictor is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from humanpred_ros.viewing.figures import DASHES, INK, MUTED, SERIES, new_figure, report_style

_DPI = 150
_COLUMNS = 4
_BARS = ("joint", "task as coded", "task")


@dataclass(frozen=True)
class WristPaths:
    """One recording: the real path of the wrist (n, 3) and those predicted, by predictor, metres."""

    name: str
    real_m: NDArray[np.float64]
    predicted_m: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class DistanceBar:
    """One row of the comparison: joint, task as coded, task; NaN where there is nothing (published rows: task)."""

    name: str
    values_m: tuple[float, float, float]
    published: bool


def save_reaching_plot(path: Path, paths: Sequence[WristPaths], bars: Sequence[DistanceBar]) -> None:
    """Write the plot as PNG: for each recording the wrist from above and its height over time, below the comparison."""
    colours = _colours(paths)
    rows = -(-len(paths) // _COLUMNS)
    bars_in = 0.5 + 0.21 * len(bars)
    with report_style():
        figure = new_figure(4.0 * rows + bars_in + 0.3)
        figure.set_facecolor("white")
        grid = figure.add_gridspec(rows + 1, 1, height_ratios=[4.0] * rows + [bars_in])
        for row in range(rows):
            cells = grid[row].subgridspec(2, _COLUMNS, height_ratios=[3, 2])
            for column, entry in enumerate(paths[row * _COLUMNS : (row + 1) * _COLUMNS]):
                above, over_time = (figure.add_subplot(cells[k, column]) for k in (0, 1))
                _from_above(above, entry, colours)
                _height(over_time, entry, colours)
                if column == 0:
                    above.set_ylabel("wrist y, m")
                    over_time.set_ylabel("wrist height, m")
        below = grid[rows].subgridspec(1, len(_BARS))
        for k, title in enumerate(_BARS):
            _bars(figure.add_subplot(below[k]), title, bars, k, colours)
        handles = [Line2D([], [], color=INK, linewidth=2.4, label="real")]
        handles += [Line2D([], [], label=name, **style) for name, style in colours.items()]
        figure.legend(handles=handles, ncols=len(handles), loc="outside upper center")
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _colours(paths: Sequence[WristPaths]) -> dict[str, dict[str, Any]]:
    names = dict.fromkeys(name for entry in paths for name in entry.predicted_m)
    return {
        name: {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[(k // len(SERIES)) % len(DASHES)]}
        for k, name in enumerate(names)
    }


def _from_above(axes: Axes, entry: WristPaths, colours: Mapping[str, Mapping[str, Any]]) -> None:
    axes.set_title(entry.name)
    axes.plot(entry.real_m[:, 0], entry.real_m[:, 1], color=INK, linewidth=2.4)
    axes.plot(*entry.real_m[0, :2], "o", color=INK, markersize=4.0)
    for name, path in entry.predicted_m.items():
        axes.plot(path[:, 0], path[:, 1], linewidth=1.2, **colours[name])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("wrist from above: x, m (dot: start)")


def _height(axes: Axes, entry: WristPaths, colours: Mapping[str, Mapping[str, Any]]) -> None:
    axes.plot(np.linspace(0.0, 100.0, len(entry.real_m)), entry.real_m[:, 2], color=INK, linewidth=2.4)
    for name, path in entry.predicted_m.items():
        axes.plot(np.linspace(0.0, 100.0, len(path)), path[:, 2], linewidth=1.2, **colours[name])
    axes.set_xlabel("% of the duration")


def _bars(
    axes: Axes, title: str, bars: Sequence[DistanceBar], which: int, colours: Mapping[str, Mapping[str, Any]]
) -> None:
    axes.set_title(title)
    axes.set_xlabel("distance, m summed over frames")
    for row, bar in enumerate(bars):
        value = bar.values_m[which]
        if np.isfinite(value):
            colour = MUTED if bar.published else colours.get(bar.name, {}).get("color", INK)
            axes.barh(row, value, 0.75, color=colour, alpha=0.5 if bar.published else 1.0)
            axes.text(value, row, f" {value:.2f}", va="center", color=INK, fontsize=7.5)
    axes.set_yticks(np.arange(len(bars)), [bar.name for bar in bars] if which == 0 else [""] * len(bars))
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.margins(x=0.18)
    axes.grid(axis="y", visible=False)
