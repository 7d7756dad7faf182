"""The plot of an evaluation of recognition: how early (as P1 Fig. 6), how well calibrated, what of unknown motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, note, report_style

_PANEL_IN = (4.3, 3.9)
_DPI = 150
#: Area of the marker of a bin that holds everything, in square points.
_FULL_AREA = 420.0
_LEAST_AREA = 14.0


@dataclass(frozen=True)
class RecognitionCurves:
    """What is drawn of one classifier.

    Attributes:
        name: for the legend.
        rate: (P,) share of motions recognised after each percent of the motion, percents 1 to P.
        first_percent: percent from which on half of the motions are recognised; None if never.
        confidence, right, count: (B,) mean confidence, share right and size of each bin of the reliability diagram.
        error: expected calibration error, for the legend.
        unknown_of_known, unknown_of_unknown: (3, P) quartiles of the probability of no class over motions of known
            and of unknown classes; None for a classifier that says nothing about that.
    """

    name: str
    rate: FloatArray
    first_percent: int | None
    confidence: FloatArray
    right: FloatArray
    count: NDArray[np.int64]
    error: float
    unknown_of_known: FloatArray | None = None
    unknown_of_unknown: FloatArray | None = None


def recognition_plot(
    curves: Sequence[RecognitionCurves], reference: FloatArray | None = None, reference_first: int | None = None
) -> Figure:
    """Return recognition rate, reliability and probability of no class, side by side.

    Args:
        curves: of the classifiers, in the order of the legend.
        reference: (P,) published recognition rate.
        reference_first: percent from which on that stays at half or above.
    """
    speaking = [k for k, curve in enumerate(curves) if curve.unknown_of_unknown is not None]
    figure = new_figure(_PANEL_IN[1], _PANEL_IN[0] * (2 + max(1, len(speaking))))
    panels = figure.subplots(1, 2 + max(1, len(speaking)), squeeze=False)[0]
    _draw_rates(panels[0], curves, reference, reference_first)
    _draw_reliability(panels[1], curves)
    for axes, k in zip(panels[2:], speaking, strict=False):
        _draw_unknown(axes, curves[k])
    if not speaking:
        panels[2].set_title("probability of no class")
        note(panels[2], "no unknown motions were tried,\nor no classifier here\nsays anything about them")
    return figure


def save_recognition_plot(
    path: Path,
    curves: Sequence[RecognitionCurves],
    reference: FloatArray | None = None,
    reference_first: int | None = None,
) -> None:
    """Write `recognition_plot` as a PNG file. Raises OSError if that cannot be done."""
    with report_style():
        figure = recognition_plot(curves, reference, reference_first)
        canvas: Any = FigureCanvasAgg(figure)
        figure.set_facecolor("white")
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _style(k: int) -> dict[str, Any]:
    return {"color": SERIES[k % len(SERIES)], "linestyle": DASHES[(k // len(SERIES)) % len(DASHES)]}


def _draw_rates(
    axes: Axes, curves: Sequence[RecognitionCurves], reference: FloatArray | None, reference_first: int | None
) -> None:
    axes.set_title("motions recognised")
    axes.axhline(50, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    if reference is not None:
        label = "published" + _first(reference_first)
        axes.plot(_percents(reference), 100 * reference, color=INK, linewidth=1.4, linestyle=DASHES[1], label=label)
        _mark(axes, reference_first, INK)
    for k, curve in enumerate(curves):
        axes.plot(_percents(curve.rate), 100 * curve.rate, label=curve.name + _first(curve.first_percent), **_style(k))
        _mark(axes, curve.first_percent, SERIES[k % len(SERIES)])
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.set_xlabel("part of the motion seen in %")
    axes.set_ylabel("recognised in %")
    axes.legend(loc="lower right", title="half recognised from", title_fontsize=8.5, alignment="left")


def _draw_reliability(axes: Axes, curves: Sequence[RecognitionCurves]) -> None:
    axes.set_title("reliability, over the whole motion")
    axes.plot([0, 100], [0, 100], color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    for k, curve in enumerate(curves):
        used = curve.count > 0
        x, y = 100 * curve.confidence[used], 100 * curve.right[used]
        area = np.maximum(_LEAST_AREA, _FULL_AREA * curve.count[used] / curve.count.sum())
        axes.plot(x, y, linewidth=1.2, **_style(k))
        marker = MARKERS[k % len(MARKERS)]
        colour = SERIES[k % len(SERIES)]
        axes.scatter(x, y, s=area, color=colour, alpha=0.75, marker=marker, linewidths=0, zorder=3, clip_on=False)
        axes.plot([], [], marker=marker, label=f"{curve.name}: ECE {curve.error:.3f}", **_style(k))
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.set_xlabel("probability of the most probable class in %")
    axes.set_ylabel("it is the true class in %")
    axes.legend(loc="upper left", title="size: how often", title_fontsize=8.5, alignment="left")


def _draw_unknown(axes: Axes, curve: RecognitionCurves) -> None:
    axes.set_title(f"{curve.name}: probability of no class")
    parts = (
        ("motions of classes never learned", curve.unknown_of_unknown, SERIES[1], DASHES[0]),
        ("motions of learned classes", curve.unknown_of_known, SERIES[0], DASHES[1]),
    )
    for label, quartiles, colour, dashes in parts:
        if quartiles is None:
            continue
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


def _first(percent: int | None) -> str:
    return ": never" if percent is None else f": {percent} %"


def _mark(axes: Axes, percent: int | None, colour: str) -> None:
    if percent is not None:
        axes.plot([percent], [50], marker="o", markersize=5, color=colour, zorder=4)
