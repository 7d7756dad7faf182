"""The plot of `humanpred evaluate reaching`: wrist paths, distances, and what was learned (P2 Figs. 7 and 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from humanpred_ros.evaluation.reaching_predictors import GROUPS
from humanpred_ros.evaluation.reaching_runs import (
    DISTANCES,
    ITSELF,
    YARDSTICK,
    Paths,
    by_group,
    many,
    published_of,
    score_of,
)
from humanpred_ros.evaluation.reaching_weights import PUBLISHED
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.features import FEATURE_NAMES, NAMED_WEIGHTS
from humanpred_ros.viewing.figures import INK, MARKERS, MUTED, SERIES, new_figure, note

#: Predictors whose paths are drawn; more would hide each other.
_DRAWN = ("minimum_jerk", "learned", "improved")
_MOST_DRAWN = 4
_COLUMNS, _PATHS_IN, _ROW_IN = 4, 3.6, 0.19
_GROUP_COLOURS = (MUTED, SERIES[4], SERIES[0], SERIES[1], INK)
_PUBLISHED_MARK: dict[str, Any] = {"markersize": 4.0, "markerfacecolor": "white", "markeredgecolor": INK}


def draw_reaching(figures: Mapping[str, Any], paths: Paths) -> Figure:
    """Return the plot: wrists from above and their height over time, distances, weights."""
    sets, weights, recovery = figures["sets"], figures["weights"], figures["recovery"]
    drawn = [(entry, facts["name"]) for entry in sets for facts in entry["recordings"]]
    path_rows = -(-len(drawn) // _COLUMNS)
    heights = [_PATHS_IN] * path_rows + [1.0 + _ROW_IN * len(entry["predictors"]) for entry in sets]
    left_out = [each["weights"] for each in (weights or {"left_out": ()})["left_out"] if each["how"] == PUBLISHED]
    if weights is not None or recovery is not None:
        heights.append(0.9 + _ROW_IN * (len(FEATURE_NAMES) if left_out else 12))
    figure = new_figure(sum(heights) + 0.3)
    figure.set_facecolor("white")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    names = list(dict.fromkeys(name for entry in sets for name in _drawn(entry)))
    styles: dict[str, dict[str, Any]] = {
        name: {"color": SERIES[k % len(SERIES)], "linestyle": "--" if k >= len(SERIES) else "-"}
        for k, name in enumerate(names)
    }
    for row in range(path_rows):
        cells = grid[row].subgridspec(2, _COLUMNS, height_ratios=[3, 2])
        for column, (entry, recording) in enumerate(drawn[row * _COLUMNS : (row + 1) * _COLUMNS]):
            above, over_time = (figure.add_subplot(cells[part, column]) for part in (0, 1))
            above.set_title(recording)
            _draw_path(above, over_time, paths[ITSELF, recording], {"color": INK, "linewidth": 2.4})
            above.plot(*paths[ITSELF, recording][0, :2], "o", color=INK, markersize=4.0)
            for name in _drawn(entry):
                _draw_path(above, over_time, paths[name, recording], {"linewidth": 1.4, **styles[name]})
            above.set_aspect("equal", adjustable="datalim")
            above.set_xlabel("from above: x, m")
            over_time.set_xlabel("% of the duration")
            if column == 0:
                above.set_ylabel("y, m")
                over_time.set_ylabel("wrist height, m")
    for row, entry in enumerate(sets, start=path_rows):
        cells = grid[row].subgridspec(1, len(DISTANCES))
        _draw_distances([figure.add_subplot(cells[k]) for k in range(len(DISTANCES))], entry)
    if weights is not None or recovery is not None:
        cells = grid[len(heights) - 1].subgridspec(1, 2)
        _draw_recovery(figure.add_subplot(cells[0]), recovery)
        _draw_weights(figure.add_subplot(cells[1]), left_out[0] if left_out else None)
    handles = [Line2D([], [], color=INK, linewidth=2.4, label="real wrist (dot: start)")]
    handles += [Line2D([], [], label=name, **style) for name, style in styles.items()]
    figure.legend(handles=handles, ncols=len(handles), loc="outside upper center")
    return figure


def _drawn(entry: Mapping[str, Any]) -> list[str]:
    names = [predictor["name"] for predictor in entry["predictors"] if predictor["name"] != ITSELF]
    return [name for name in _DRAWN if name in names] or names[:_MOST_DRAWN]


def _draw_path(above: Axes, over_time: Axes, path: FloatArray, style: Mapping[str, Any]) -> None:
    above.plot(path[:, 0], path[:, 1], **style)
    over_time.plot(np.linspace(0.0, 100.0, len(path)), path[:, 2], **style)


def _draw_distances(panels: Sequence[Axes], entry: Mapping[str, Any]) -> None:
    """Draw one panel for each distance; bars that would dwarf all others are cut off, with their value."""
    ordered, rows = by_group(entry), np.arange(len(entry["predictors"]))
    titles = [
        f"{many(entry)} ({entry['published'][-1]['table']}): joint" if entry["published"] else f"{many(entry)}: joint"
    ]
    titles += ["task as coded", "task"]
    units = ("m summed over frames (◇: published)", "m (line: least to largest run)", f"m (dotted: {YARDSTICK})")
    for which, (axes, distance) in enumerate(zip(panels, DISTANCES, strict=True)):
        published = [published_of(entry, predictor["name"]).get(distance, np.nan) for predictor in ordered]
        averages = [predictor["average"][distance] for predictor in ordered]
        end = _end([average["high"] for average in averages] + published)
        for row, (predictor, average, printed) in enumerate(zip(ordered, averages, published, strict=True)):
            value, least, largest = (average[what] for what in ("mean", "low", "high"))
            axes.barh(row, min(value, end), 0.75, color=_GROUP_COLOURS[GROUPS.index(predictor["group"])])
            if largest > least:
                axes.plot([least, largest], [row, row], color=INK, linewidth=0.9)
            if np.isfinite(printed):
                axes.plot(printed, row, "D", **_PUBLISHED_MARK)
            if value >= end:
                axes.text(end, row, f"{value:.1f} ", va="center", ha="right", color="white", fontsize=7.0)
            else:
                offset: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7.0}
                axes.annotate(f"{value:.1f}", (np.nanmax([largest, printed]), row), (5.0, 0.0), **offset)
        if (yardstick := score_of(entry, YARDSTICK)) is not None:
            axes.axvline(yardstick["average"][distance]["mean"], color=INK, linewidth=0.9, linestyle=":")
        axes.set_title(titles[which])
        axes.set_xlabel(units[which])
        axes.set_yticks(rows, [predictor["name"] if which == 0 else "" for predictor in ordered])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.12 * end)
        axes.grid(axis="y", visible=False)


def _draw_recovery(axes: Axes, figures: Mapping[str, Any] | None) -> None:
    """Draw averages with bands from the least to the largest repetition."""
    axes.set_title("known weights learned again (P2 Fig. 7)")
    if figures is None:
        note(axes, "left out")
        return
    samples = figures["samples"]
    curves = {f"learned as {how}": values for how, values in figures["learned"].items()}
    for k, (name, values) in enumerate({**curves, "best of the samples": figures["best_sample"]}.items()):
        mean, low, high = ([value[what] for value in values] for what in ("mean", "low", "high"))
        axes.plot(samples, mean, color=SERIES[k], marker=MARKERS[k], markersize=4.0, label=name)
        axes.fill_between(samples, low, high, color=SERIES[k], alpha=0.15)
    axes.axhline(figures["line"]["mean"], color=INK, linewidth=1.0, linestyle=":", label="straight line")
    axes.set_xscale("log")
    axes.set_xticks(samples, [str(count) for count in samples])
    axes.minorticks_off()
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("samples around each demonstration")
    axes.set_ylabel("cost above the demonstrations', %")
    axes.legend(loc="upper right")


def _draw_weights(axes: Axes, left_out: FloatArray | None) -> None:
    """Draw a row for each feature: a dot for each recording left out (R, 24), a mark for the authors' weight."""
    axes.set_title("weights leaving one out (P2 Fig. 10)")
    if left_out is None:
        note(axes, "nothing was learned as published")
        return
    rows = np.arange(len(FEATURE_NAMES))
    for k, (offset, weights) in enumerate(zip(np.linspace(-0.3, 0.3, len(left_out)), left_out, strict=True)):
        label = "learned, one dot for each left out" if k == 0 else None
        axes.plot(weights, rows + offset, "o", color=SERIES[0], markersize=2.6, linestyle="none", label=label)
    label = "authors, mean of single ones"
    axes.plot(NAMED_WEIGHTS["authors_static"], rows, "D", linestyle="none", label=label, **_PUBLISHED_MARK)
    axes.set_yticks(rows, list(FEATURE_NAMES))
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("weight")
    axes.margins(x=0.04)
    axes.legend(loc="upper center", bbox_to_anchor=(0.3, -0.1), ncols=2)


def _end(values: Sequence[float]) -> float:
    """Return where to end the axis: at the largest value, unless that is far beyond the others."""
    finite = sorted(value for value in values if np.isfinite(value))
    if len(finite) < 3:
        return finite[-1] if finite else 1.0
    second = finite[-2] if finite[-2] < finite[-1] else finite[-3]
    return float(finite[-1] if finite[-1] < 1.5 * second else 1.15 * second)
