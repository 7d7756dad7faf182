"""The plots of the evaluations of recognition, occupancy and streams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from humanpred_ros.evaluation.published import ReferenceCurve
from humanpred_ros.evaluation.recognition_scores import ClassifierResult
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, note

_PANEL_IN = (4.3, 3.9)
#: Area of the marker of a bin that holds everything, in square points.
_FULL_AREA = 420.0
_LEAST_AREA = 14.0


def recognition_plot(results: Sequence[ClassifierResult], reference: ReferenceCurve | None = None) -> Figure:
    """Return recognition rate (as P1 Fig. 6), reliability, and the probability of no class, side by side.

    Args:
        results: of the classifiers, in the order of the legend.
        reference: the published curve.
    """
    speaking = [result for result in results if result.unknown is not None and result.unknown.says_something]
    figure = new_figure(_PANEL_IN[1], _PANEL_IN[0] * (2 + max(1, len(speaking))))
    panels = figure.subplots(1, 2 + max(1, len(speaking)), squeeze=False)[0]
    _draw_rates(panels[0], results, reference)
    _draw_confidences(panels[1], results)
    for axes, result in zip(panels[2:], speaking, strict=False):
        _draw_unknown(axes, result)
    if not speaking:
        panels[2].set_title("probability of no class")
        note(panels[2], "no unknown motions were tried,\nor no classifier here\nsays anything about them")
    return figure


def _style(k: int) -> dict[str, Any]:
    return {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[(k // len(SERIES)) % len(DASHES)]}


def _draw_rates(axes: Axes, results: Sequence[ClassifierResult], reference: ReferenceCurve | None) -> None:
    axes.set_title("motions recognised")
    axes.axhline(50, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    if reference is not None:
        _draw_rate(axes, "published", reference, {"color": INK, "linewidth": 1.4, "linestyle": DASHES[1]})
    for k, result in enumerate(results):
        _draw_rate(axes, result.name, result, _style(k))
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.set_xlabel("part of the motion seen in %")
    axes.set_ylabel("recognised in %")
    axes.legend(loc="lower right", title="half recognised from", title_fontsize=8.5, alignment="left")


def _draw_rate(axes: Axes, name: str, curve: ClassifierResult | ReferenceCurve, style: dict[str, Any]) -> None:
    first = curve.figures.first_50_percent
    text = f"{name}: never" if first is None else f"{name}: {first} %"
    axes.plot(_percents(curve.rate), 100 * curve.rate, label=text, **style)
    if first is not None:
        axes.plot([first], [50], marker="o", markersize=5, color=style["color"], zorder=4)


def _draw_confidences(axes: Axes, results: Sequence[ClassifierResult]) -> None:
    axes.set_title("reliability, over the whole motion")
    axes.plot([0, 100], [0, 100], color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    for k, result in enumerate(results):
        bins = result.calibration
        used = bins.count > 0
        x, y = 100 * bins.confidence[used], 100 * bins.right[used]
        area = np.maximum(_LEAST_AREA, _FULL_AREA * bins.count[used] / bins.count.sum())
        axes.plot(x, y, linewidth=1.2, **_style(k))
        marker, colour = MARKERS[k % len(MARKERS)], SERIES[k % len(SERIES)]
        axes.scatter(x, y, s=area, color=colour, alpha=0.75, marker=marker, linewidths=0, zorder=3, clip_on=False)
        axes.plot([], [], marker=marker, label=f"{result.name}: ECE {bins.error_pooled:.3f}", **_style(k))
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.set_xlabel("probability of the most probable class in %")
    axes.set_ylabel("it is the true class in %")
    axes.legend(loc="upper left", title="size: how often", title_fontsize=8.5, alignment="left")


def _draw_unknown(axes: Axes, result: ClassifierResult) -> None:
    axes.set_title(f"{result.name}: probability of no class")
    parts = [("motions of learned classes", result.unknown_quartiles, SERIES[0], DASHES[1])]
    if result.unknown is not None:
        parts.insert(0, ("motions of classes never learned", result.unknown.quartiles, SERIES[1], DASHES[0]))
    for label, quartiles, colour, dashes in parts:
        percents = _percents(quartiles[0])
        axes.fill_between(percents, 100 * quartiles[0], 100 * quartiles[2], color=colour, alpha=0.18, linewidth=0)
        axes.plot(percents, 100 * quartiles[1], color=colour, linestyle=dashes, label=label)
    axes.set_xlim(0, 100)
    axes.set_ylim(-1, 101)
    axes.set_xlabel("part of the motion seen in %")
    axes.set_ylabel("in %")
    axes.legend(loc="best", title="median, and quartiles shaded", title_fontsize=8.5, alignment="left")


def _percents(values: FloatArray) -> FloatArray:
    return np.arange(1.0, len(values) + 1)
