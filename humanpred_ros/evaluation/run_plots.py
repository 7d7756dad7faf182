"""Plots of the arm beside recorded people: what it disturbs (P1 Table I), and when it changes its goal (P1 Fig. 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.evaluation.interference_runs import BASIC, TABLE_METHODS
from humanpred_ros.evaluation.switching_runs import (
    CURRENT,
    VARIANTS,
    Curve,
    Person,
    curves,
    steps_earlier,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import (
    ALARM,
    DASHES,
    INK,
    MARKERS,
    MUTED,
    SERIES,
    goal_colours,
    new_figure,
    note,
    plain_powers,
)

#: What stands for a cost of zero on a logarithmic axis.
_SMALLEST_COST = 1e-4
_PLOT_COLUMNS = 3


def draw_interference(
    table1: Sequence[Mapping[str, Any]], comparison: Sequence[Mapping[str, Any]], figures: Mapping[str, Any]
) -> Figure:
    """Return the plot: Table I's costs beside the published, and how close and how late; parts without data say so."""
    figure = new_figure(6.4)
    above, below = figure.subplots(2, 1)
    _draw_costs(above, table1)
    cells = below.get_subplotspec().subgridspec(1, 2)
    below.remove()
    distance, time = (figure.add_subplot(cell) for cell in cells)
    methods = [f["method"] for f in comparison[0]["methods"]] if comparison else []
    motions = set(figures["compared_motions"])
    runs = [[one for one in figures["runs"] if one.method == name and one.motion in motions] for name in methods]
    near = [np.array([one.least_distance_m for one in some]) for some in runs]
    late = [np.array([one.time_to_goal_s for one in some]) for some in runs]
    _draw_runs(distance, methods, near, "least distance to the human, m")
    if methods:
        distance.axvline(0.0, color=ALARM, linewidth=1.0)
    _draw_runs(time, methods, late, "time to goal, s")
    return figure


def _draw_costs(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    axes.set_title("human occupancy of the executed motion (P1 Table I), mean and standard deviation")
    if not rows:
        note(axes, "Table I was left out")
        return
    series = {f"{name}, here": [row["methods"][name] for row in rows] for name in TABLE_METHODS}
    here = {name: [(f["cost_mean"], f["cost_sd"]) for f in values] for name, values in series.items()}
    theirs = {}
    if all(row["published"] for row in rows):
        for name in ("ours", BASIC):
            theirs[f"{name}, published"] = [
                (r["published"][f"{name}_mean"], r["published"][f"{name}_sd"]) for r in rows
            ]
    width = 0.8 / (len(here) + len(theirs))
    for k, (name, values) in enumerate({**theirs, **here}.items()):
        mean, sd = np.array(values).T
        x = np.arange(len(rows)) + (k - (len(here) + len(theirs) - 1) / 2.0) * width
        low = np.minimum(sd, mean - np.maximum(mean / 10.0, _SMALLEST_COST / 2.0))  # an error bar stays on the axis
        faint: dict[str, Any] = {"alpha": 0.45, "hatch": "//"} if name in theirs else {}
        axes.bar(
            x, np.maximum(mean, _SMALLEST_COST), 0.92 * width, yerr=np.stack([np.maximum(low, 0.0), sd]),
            error_kw={"elinewidth": 0.8, "ecolor": INK}, color=SERIES[k % len(SERIES)], edgecolor="white", label=name,
            **faint,
        )  # fmt: skip
    axes.set_yscale("log")
    plain_powers(axes.yaxis)
    axes.set_xticks(np.arange(len(rows)), [str(row["number"]) for row in rows])
    axes.set_xlabel("human trajectory")
    axes.set_ylabel("cost")
    axes.legend(ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.08))


def _draw_runs(axes: Axes, methods: Sequence[str], values: Sequence[FloatArray], label: str) -> None:
    if not methods:
        note(axes, "the comparison was left out")
        return
    for row, (method, all_runs) in enumerate(zip(methods, values, strict=True)):
        finite = all_runs[np.isfinite(all_runs)]
        spread = ((np.arange(len(finite)) * 0.618) % 1.0 - 0.5) * 0.5  # side by side without chance
        axes.plot(finite, row + spread, ".", color=SERIES[row % len(SERIES)], markersize=3.0, alpha=0.6)
        median = float(np.median(all_runs))
        if np.isfinite(median):
            axes.plot([median, median], [row - 0.35, row + 0.35], color=INK, linewidth=2.0)
        never = len(all_runs) - len(finite)
        if never:
            axes.text(0.99, row, f"{never} never", transform=axes.get_yaxis_transform(), ha="right", color=MUTED)
        axes.text(-0.02, row, method, transform=axes.get_yaxis_transform(), ha="right", va="center")
    if not all(np.isfinite(numbers).all() for numbers in values):
        low, high = axes.get_xlim()
        axes.set_xlim(low, high + 0.15 * (high - low))  # room for the runs that never arrive
    axes.set_yticks([])
    axes.set_ylim(len(methods) - 0.4, -0.6)
    axes.set_xlabel(label + "; the bar is the median")


def draw_switching(
    figure: Person | None,
    goals: Sequence[str],
    published: Mapping[str, Any] | None,
    contested: Sequence[Person],
    n_steps: int,
) -> Figure:
    """Return the plot: the goals' costs as in P1's Fig. 9, and how many steps are gained; parts without data say so."""
    panels = [] if figure is None else curves(figure, goals, published)
    n_rows = max(1, -(-(len(panels) + 1) // _PLOT_COLUMNS))
    drawing = new_figure(3.0 * n_rows)
    cells = drawing.subplots(n_rows, _PLOT_COLUMNS, squeeze=False).ravel()
    positive = np.concatenate([panel.costs[panel.costs > 0.0] for panel in panels] or [np.zeros(0)])
    limits = (positive.min() / 2.0, positive.max() * 2.0) if len(positive) else (0.1, 1.0)
    for axes, panel in zip(cells, panels, strict=False):
        _draw_goal_costs(axes, panel, limits)
    gained = {
        variant: [steps_earlier(p.run(variant).figures, p.run(CURRENT).figures, n_steps) for p in contested]
        for variant in VARIANTS
        if variant != CURRENT
    }
    _draw_gained(cells[len(panels)], gained if contested else {})
    for axes in cells[len(panels) + 1 :]:
        axes.remove()
    return drawing


def _draw_goal_costs(axes: Axes, curve: Curve, limits: tuple[float, float]) -> None:
    colours = goal_colours(curve.goals)
    for k, goal in enumerate(curve.goals):
        costs = curve.costs[:, k]
        axes.plot(
            np.arange(1, len(costs) + 1), np.where(costs > 0.0, costs, np.nan), color=colours[goal],
            linestyle=DASHES[k % len(DASHES)], marker=MARKERS[k % len(MARKERS)], markersize=3.0, label=goal,
        )  # fmt: skip
    if curve.switch is not None:
        axes.axvline(curve.switch, color=INK, linewidth=1.0)
        axes.annotate(f" switch: {curve.switch}", (curve.switch, limits[1]), va="top", fontsize=8.0)
    axes.set_yscale("log")
    plain_powers(axes.yaxis)
    axes.set_ylim(*limits)
    axes.set_xlim(0.5, max(20, len(curve.costs)) + 0.5)
    axes.set_title(curve.title)
    axes.set_xlabel("replanning step")
    axes.set_ylabel("cost")
    axes.legend(loc="lower left")


def _draw_gained(axes: Axes, gained: Mapping[str, Sequence[int]]) -> None:
    if not gained:
        note(axes, "no motion was shown in which\nsomething is to be decided")
        return
    everything = np.concatenate([np.asarray(steps) for steps in gained.values()])
    axes.hist(
        [np.asarray(steps) for steps in gained.values()],
        bins=(np.arange(everything.min(), everything.max() + 2) - 0.5).tolist(),
        color=list(SERIES[: len(gained)]),
        label=[f"{variant}, median {np.median(steps):g}" for variant, steps in gained.items()],
    )
    axes.set_title("right earlier than current")
    axes.set_xlabel("replanning steps")
    axes.set_ylabel("motions that take the default goal")
    axes.legend()
