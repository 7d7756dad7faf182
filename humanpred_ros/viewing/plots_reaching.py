"""The plot of an evaluation of reaches: paths of the wrist, how far off each predictor is, and what was learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import INK, SERIES, new_figure, report_style
from humanpred_ros.viewing.plots_reach_figures import (
    DISTANCE_TITLES,
    CostBySamples,
    DistanceBars,
    WeightDots,
    bars_height_in,
    draw_cost_by_samples,
    draw_distances,
    draw_weights,
    weights_height_in,
)

_DPI = 150
_COLUMNS = 4
_PATHS_IN = 3.6


@dataclass(frozen=True, eq=False)
class WristPaths:
    """One recording: the real path of the wrist (n, 3) and those predicted, by predictor, metres."""

    name: str
    real_m: FloatArray
    predicted_m: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class ReachingPlot:
    """Everything that is drawn; parts may be empty or None.

    Attributes:
        paths: one for each recording.
        bars: one set for each set of recordings.
        samples: cost differences by number of samples (P2 Fig. 7).
        weights: learned leaving one out (P2 Fig. 10).
    """

    paths: Sequence[WristPaths]
    bars: Sequence[DistanceBars]
    samples: CostBySamples | None = None
    weights: WeightDots | None = None


def save_reaching_plot(path: Path, plot: ReachingPlot) -> None:
    """Write the plot as PNG: wrists from above and their height over time; distances; weights."""
    path_rows = -(-len(plot.paths) // _COLUMNS)
    heights = [_PATHS_IN] * path_rows + [bars_height_in(bars) for bars in plot.bars]
    if plot.samples is not None or plot.weights is not None:
        heights.append(weights_height_in(plot.weights))
    with report_style():
        figure = new_figure(sum(heights) + 0.3)
        figure.set_facecolor("white")
        grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
        styles = _styles(plot.paths)
        for row in range(path_rows):
            cells = grid[row].subgridspec(2, _COLUMNS, height_ratios=[3, 2])
            for column, entry in enumerate(plot.paths[row * _COLUMNS : (row + 1) * _COLUMNS]):
                above, over_time = (figure.add_subplot(cells[k, column]) for k in (0, 1))
                _from_above(above, entry, styles)
                _height(over_time, entry, styles)
                if column == 0:
                    above.set_ylabel("y, m")
                    over_time.set_ylabel("wrist height, m")
        for row, bars in enumerate(plot.bars, start=path_rows):
            cells = grid[row].subgridspec(1, len(DISTANCE_TITLES))
            panels = [figure.add_subplot(cells[k]) for k in range(len(DISTANCE_TITLES))]
            draw_distances(panels, bars)
        if plot.samples is not None or plot.weights is not None:
            cells = grid[len(heights) - 1].subgridspec(1, 2)
            draw_cost_by_samples(figure.add_subplot(cells[0]), plot.samples)
            draw_weights(figure.add_subplot(cells[1]), plot.weights)
        if plot.paths:
            handles = [Line2D([], [], color=INK, linewidth=2.4, label="real wrist (dot: start)")]
            handles += [Line2D([], [], label=name, **style) for name, style in styles.items()]
            figure.legend(handles=handles, ncols=len(handles), loc="outside upper center")
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _styles(paths: Sequence[WristPaths]) -> dict[str, dict[str, Any]]:
    names = dict.fromkeys(name for entry in paths for name in entry.predicted_m)
    return {
        name: {"color": SERIES[k % len(SERIES)], "linestyle": "--" if k >= len(SERIES) else "-"}
        for k, name in enumerate(names)
    }


def _from_above(axes: Axes, entry: WristPaths, styles: Mapping[str, Mapping[str, Any]]) -> None:
    axes.set_title(entry.name)
    axes.plot(entry.real_m[:, 0], entry.real_m[:, 1], color=INK, linewidth=2.4)
    axes.plot(*entry.real_m[0, :2], "o", color=INK, markersize=4.0)
    for name, path in entry.predicted_m.items():
        axes.plot(path[:, 0], path[:, 1], linewidth=1.4, **styles[name])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("from above: x, m")


def _height(axes: Axes, entry: WristPaths, styles: Mapping[str, Mapping[str, Any]]) -> None:
    axes.plot(np.linspace(0.0, 100.0, len(entry.real_m)), entry.real_m[:, 2], color=INK, linewidth=2.4)
    for name, path in entry.predicted_m.items():
        axes.plot(np.linspace(0.0, 100.0, len(path)), path[:, 2], linewidth=1.4, **styles[name])
    axes.set_xlabel("% of the duration")
