"""The plot of `humanpred evaluate reaching`: wrist paths, distances, and what was learned (P2 Figs. 7 and 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from humanpred_ros.evaluation.reaching_predictors import GROUPS
from humanpred_ros.evaluation.reaching_runs import ReachingResult
from humanpred_ros.evaluation.reaching_scores import ITSELF, YARDSTICK, ReachingSet
from humanpred_ros.evaluation.reaching_weights import PUBLISHED
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.features import FEATURE_NAMES, NAMED_WEIGHTS
from humanpred_ros.viewing.figures import INK, MARKERS, MUTED, SERIES, new_figure, note

#: Predictors whose paths are drawn; more would hide each other.
_DRAWN = ("minimum_jerk", "learned", "improved")
_MOST_DRAWN = 4
_COLUMNS, _PATHS_IN, _ROW_IN = 4, 3.6, 0.19
_GROUP_COLOURS = (MUTED, SERIES[4], SERIES[0], SERIES[1], INK)


def draw_reaching(result: ReachingResult) -> Figure:
    """Return the plot: wrists from above and their height over time, distances, weights."""
    paths = [(entry, k) for entry in result.sets for k in range(len(entry.names))]
    path_rows = -(-len(paths) // _COLUMNS)
    heights = [_PATHS_IN] * path_rows + [1.0 + _ROW_IN * len(entry.scores) for entry in result.sets]
    with_weights = result.recovery is not None or bool(result.columns)
    if with_weights:
        heights.append(0.9 + _ROW_IN * (len(FEATURE_NAMES) if PUBLISHED in result.learned else 12))
    figure = new_figure(sum(heights) + 0.3)
    figure.set_facecolor("white")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    names = list(dict.fromkeys(name for entry in result.sets for name in _drawn(entry)))
    styles = {
        name: {"color": SERIES[k % len(SERIES)], "linestyle": "--" if k >= len(SERIES) else "-"}
        for k, name in enumerate(names)
    }
    for row in range(path_rows):
        cells = grid[row].subgridspec(2, _COLUMNS, height_ratios=[3, 2])
        for column, (entry, k) in enumerate(paths[row * _COLUMNS : (row + 1) * _COLUMNS]):
            above, over_time = (figure.add_subplot(cells[part, column]) for part in (0, 1))
            _draw_paths(above, over_time, entry, k, styles)
            if column == 0:
                above.set_ylabel("y, m")
                over_time.set_ylabel("wrist height, m")
    for row, entry in enumerate(result.sets, start=path_rows):
        cells = grid[row].subgridspec(1, 3)
        _draw_distances([figure.add_subplot(cells[k]) for k in range(3)], entry)
    if with_weights:
        cells = grid[len(heights) - 1].subgridspec(1, 2)
        _draw_recovery(figure.add_subplot(cells[0]), result.recovery)
        learned = result.learned.get(PUBLISHED)
        left_out = None if learned is None else np.array(list(learned.table.left_out.values()))
        _draw_weights(figure.add_subplot(cells[1]), left_out)
    handles = [Line2D([], [], color=INK, linewidth=2.4, label="real wrist (dot: start)")]
    handles += [Line2D([], [], label=name, **style) for name, style in styles.items()]  # type: ignore[arg-type]
    figure.legend(handles=handles, ncols=len(handles), loc="outside upper center")
    return figure


def _drawn(entry: ReachingSet) -> list[str]:
    names = [scores.name for scores in entry.scores if scores.name != ITSELF]
    return [name for name in _DRAWN if name in names] or names[:_MOST_DRAWN]


def _draw_paths(
    above: Axes, over_time: Axes, entry: ReachingSet, k: int, styles: Mapping[str, Mapping[str, Any]]
) -> None:
    """Draw the real and the predicted wrist of recording k, from above and its height over time."""
    real = entry.wrist_m[k]
    above.set_title(entry.names[k])
    above.plot(real[:, 0], real[:, 1], color=INK, linewidth=2.4)
    above.plot(*real[0, :2], "o", color=INK, markersize=4.0)
    over_time.plot(np.linspace(0.0, 100.0, len(real)), real[:, 2], color=INK, linewidth=2.4)
    for name in _drawn(entry):
        scores = entry.of(name)
        assert scores is not None
        path = scores.wrist_m[k]
        above.plot(path[:, 0], path[:, 1], linewidth=1.4, **styles[name])
        over_time.plot(np.linspace(0.0, 100.0, len(path)), path[:, 2], linewidth=1.4, **styles[name])
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("from above: x, m")
    over_time.set_xlabel("% of the duration")


def _draw_distances(panels: Sequence[Axes], entry: ReachingSet) -> None:
    """Draw one panel for each distance; bars that would dwarf all others are cut off, with their value."""
    ordered = sorted(entry.scores, key=lambda scores: GROUPS.index(scores.group))
    names = [scores.name for scores in ordered]
    many = f"{len(entry.names)} reaches" if len(entry.names) > 1 else "1 reach"
    title = f"{many} ({entry.published[-1].table})" if entry.published else many
    units = ("m summed over frames (◇: published)", "m (line: least to largest run)", f"m (dotted: {YARDSTICK})")
    for which, (axes, distance) in enumerate(zip(panels, ("joint", "task as coded", "task"), strict=True)):
        published = []
        for name in names:
            row = entry.published_of(name)
            published.append(np.nan if row is None or which == 2 else (row.joint_m, row.task_as_coded_m)[which])
        averages = [scores.average[:, which] for scores in ordered]
        end = _end([float(values[3]) for values in averages] + published)
        for row_number, (scores, (value, _, least, largest), printed) in enumerate(
            zip(ordered, averages, published, strict=True)
        ):
            colour = _GROUP_COLOURS[GROUPS.index(scores.group) % len(_GROUP_COLOURS)]
            axes.barh(row_number, min(value, end), 0.75, color=colour)
            if largest > least:
                axes.plot([least, largest], [row_number, row_number], color=INK, linewidth=0.9)
            if np.isfinite(printed):
                axes.plot(printed, row_number, "D", markersize=4.0, markerfacecolor="white", markeredgecolor=INK)
            if value >= end:
                axes.text(end, row_number, f"{value:.1f} ", va="center", ha="right", color="white", fontsize=7.0)
            else:
                at = (max(largest, printed if np.isfinite(printed) else 0.0), row_number)
                offset = {"textcoords": "offset points", "va": "center", "fontsize": 7.0}
                axes.annotate(f"{value:.1f}", at, (5.0, 0.0), **offset)  # type: ignore[arg-type]
        if YARDSTICK in names:
            axes.axvline(averages[names.index(YARDSTICK)][0], color=INK, linewidth=0.9, linestyle=":")
        axes.set_title(f"{title}: {distance}" if which == 0 else distance)
        axes.set_xlabel(units[which])
        axes.set_yticks(np.arange(len(names)), names if which == 0 else [""] * len(names))
        axes.set_ylim(len(names) - 0.4, -0.6)
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
    axes.plot(
        NAMED_WEIGHTS["authors_static"], rows, "D", markersize=4.0, markerfacecolor="white", markeredgecolor=INK,
        linestyle="none", label="authors, mean of single ones",
    )  # fmt: skip
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
