"""Panels of the plot of predicted reaches: distances beside the published, cost by samples, and learned weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import INK, MARKERS, MUTED, SERIES, note

DISTANCE_TITLES = ("joint", "task as coded", "task")
_ROW_IN = 0.19
_GROUP_COLOURS = (MUTED, SERIES[4], SERIES[0], SERIES[1], INK)


@dataclass(frozen=True)
class DistanceBar:
    """One predictor: average, least and largest of the three distances, m; published ones, NaN where there is none.

    `group` numbers the kinds of predictors, for the colour.
    """

    name: str
    group: int
    average_m: tuple[float, float, float]
    least_m: tuple[float, float, float]
    largest_m: tuple[float, float, float]
    published_m: tuple[float, float, float]


@dataclass(frozen=True)
class DistanceBars:
    """Predictors side by side.

    Attributes:
        title: what was predicted.
        bars: in order.
        yardstick: name of the one that a line is drawn at; any other name for none.
    """

    title: str
    bars: Sequence[DistanceBar]
    yardstick: str


@dataclass(frozen=True, eq=False)
class CostBySamples:
    """Cost differences in percent: average, least, largest (K, 3) by name, for numbers of samples (K,)."""

    samples: Sequence[int]
    curves: Mapping[str, FloatArray]
    level: float
    level_name: str


@dataclass(frozen=True, eq=False)
class WeightDots:
    """Weights (R, F) of features, learned leaving out one recording after the other, beside published (F,)."""

    features: Sequence[str]
    left_out: FloatArray
    published: FloatArray
    published_name: str


def bars_height_in(bars: DistanceBars) -> float:
    """Return how high the panels of `draw_distances` should be."""
    return 1.0 + _ROW_IN * len(bars.bars)


def weights_height_in(dots: WeightDots | None) -> float:
    """Return how high the panel of `draw_weights` should be."""
    return 0.9 + _ROW_IN * max(12, len(dots.features) if dots is not None else 0)


def draw_distances(panels: Sequence[Axes], bars: DistanceBars) -> None:
    """Draw one panel for each distance; bars that would dwarf all others are cut off, with their value."""
    names = [bar.name for bar in bars.bars]
    units = (
        "m summed over frames (◇: published)",
        "m (line: least to largest run)",
        f"m (dotted: {bars.yardstick})",
    )
    for which, (axes, title) in enumerate(zip(panels, DISTANCE_TITLES, strict=True)):
        end = _end([value for bar in bars.bars for value in (bar.largest_m[which], bar.published_m[which])])
        for row, bar in enumerate(bars.bars):
            value, published = bar.average_m[which], bar.published_m[which]
            axes.barh(row, min(value, end), 0.75, color=_GROUP_COLOURS[bar.group % len(_GROUP_COLOURS)])
            if bar.largest_m[which] > bar.least_m[which]:
                axes.plot([bar.least_m[which], bar.largest_m[which]], [row, row], color=INK, linewidth=0.9)
            if np.isfinite(published):
                axes.plot(published, row, "D", markersize=4.0, markerfacecolor="white", markeredgecolor=INK)
            if value >= end:
                axes.text(end, row, f"{value:.1f} ", va="center", ha="right", color="white", fontsize=7.0)
            else:
                beyond = max(bar.largest_m[which], published if np.isfinite(published) else 0.0)
                axes.annotate(
                    f"{value:.1f}", (beyond, row), (5.0, 0.0), textcoords="offset points", va="center", fontsize=7.0
                )
        if bars.yardstick in names:
            axes.axvline(
                bars.bars[names.index(bars.yardstick)].average_m[which], color=INK, linewidth=0.9, linestyle=":"
            )
        axes.set_title(f"{bars.title}: {title}" if which == 0 else title)
        axes.set_xlabel(units[which])
        axes.set_yticks(np.arange(len(names)), names if which == 0 else [""] * len(names))
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.12 * end)
        axes.grid(axis="y", visible=False)


def draw_cost_by_samples(axes: Axes, shown: CostBySamples | None) -> None:
    """Draw averages with bands from the least to the largest repetition."""
    axes.set_title("known weights learned again (P2 Fig. 7)")
    if shown is None:
        note(axes, "left out")
        return
    for k, (name, values) in enumerate(shown.curves.items()):
        axes.plot(shown.samples, values[:, 0], color=SERIES[k], marker=MARKERS[k], markersize=4.0, label=name)
        axes.fill_between(np.asarray(shown.samples), values[:, 1], values[:, 2], color=SERIES[k], alpha=0.15)
    axes.axhline(shown.level, color=INK, linewidth=1.0, linestyle=":", label=shown.level_name)
    axes.set_xscale("log")
    axes.set_xticks(list(shown.samples), [str(count) for count in shown.samples])
    axes.minorticks_off()
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("samples around each demonstration")
    axes.set_ylabel("cost above the demonstrations', %")
    axes.legend(loc="upper right")


def draw_weights(axes: Axes, dots: WeightDots | None) -> None:
    """Draw a row for each feature: a dot for each recording left out, a mark for the published weight."""
    axes.set_title("weights leaving one out (P2 Fig. 10)")
    if dots is None:
        note(axes, "nothing was learned as published")
        return
    rows = np.arange(len(dots.features))
    offsets = np.linspace(-0.3, 0.3, len(dots.left_out))
    for k, (offset, weights) in enumerate(zip(offsets, dots.left_out, strict=True)):
        label = "learned, one dot for each left out" if k == 0 else None
        axes.plot(weights, rows + offset, "o", color=SERIES[0], markersize=2.6, linestyle="none", label=label)
    axes.plot(
        dots.published, rows, "D", markersize=4.0, markerfacecolor="white", markeredgecolor=INK, linestyle="none",
        label=dots.published_name,
    )  # fmt: skip
    axes.set_yticks(rows, list(dots.features))
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("weight")
    axes.margins(x=0.04)
    axes.legend(loc="upper center", bbox_to_anchor=(0.3, -0.1), ncols=2)


def _end(values: Sequence[float]) -> float:
    """Return where to end the axis: at the largest value, but for one that is far beyond the others."""
    finite = sorted(value for value in values if np.isfinite(value))
    if len(finite) < 3:
        return finite[-1] if finite else 1.0
    second = finite[-2] if finite[-2] < finite[-1] else finite[-3]
    return float(finite[-1] if finite[-1] < 1.5 * second else 1.15 * second)
