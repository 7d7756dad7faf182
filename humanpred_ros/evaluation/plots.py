"""The plots of the evaluations of recognition, occupancy and streams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from humanpred_ros.evaluation.occupancy_scores import PredictorResult
from humanpred_ros.evaluation.published import ReferenceCurve
from humanpred_ros.evaluation.recognition_scores import ClassifierResult
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, note

_PANEL_IN = (4.3, 3.9)
#: Area of the marker of a bin that holds everything, in square points.
_FULL_AREA = 420.0
_LEAST_AREA = 14.0
_CURVES_IN = 3.3
_LEAST_WIDTH_IN, _PICTURE_WIDTH_IN = 10.0, 2.7
#: Titles, axis labels and colour bar of the lower row; and how high its pictures may become.
_AROUND_IN, _BAR_IN, _MOST_PICTURE_IN = 1.0, 1.3, 3.2
_TRUTH = "#52606d"
_PROBABILITY = LinearSegmentedColormap.from_list("probability", ["#fdf3e1", "#f0a04b", "#9c2a10"])
#: Free cells around what is drawn from above, and the least probability that is drawn for sure.
_FRAME_CELLS = 3
_WORTH_DRAWING = 0.05
#: Area of a calibration marker in square points, for few voxels and for the bin with the most.
_AREA = (8.0, 90.0)


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


@dataclass(frozen=True, eq=False)
class Moment:
    """The moment drawn from above.

    Attributes:
        title: which motion, how much of it was seen.
        swept: (X, Y) 1 where the body is from then on.
        origin_m, resolution_m: of the grid.
    """

    title: str
    swept: NDArray[np.float32]
    origin_m: tuple[float, float, float]
    resolution_m: float


def occupancy_plot(percents: Sequence[int], results: Sequence[PredictorResult], moment: Moment | None) -> Figure:
    """Return errors over percents, missed share over percents and calibration; below them the moment from above.

    Args:
        percents: (P,) of the motion.
        results: of the predictors, in the order of the legend.
        moment: None leaves the lower row out.
    """
    pictures = {result.name: result.picture.predicted for result in results if result.picture is not None}
    drawn = pictures if moment is not None else {}
    width = max(_LEAST_WIDTH_IN, _PICTURE_WIDTH_IN * (1 + len(drawn)))
    if moment is not None and drawn:
        box = _box_of([moment.swept, *drawn.values()])
        rows, columns = moment.swept[box].T.shape
        picture_in = min((width - _BAR_IN) / (1 + len(drawn)) * rows / columns, _MOST_PICTURE_IN) + _AROUND_IN
        figure = new_figure(_CURVES_IN + picture_in, width)
        halves: Any = figure.subfigures(2, 1, height_ratios=[_CURVES_IN, picture_in])
        upper = halves[0]
        _draw_moment(halves[1], drawn, moment, box)
    else:
        figure = new_figure(_CURVES_IN, width)
        upper = figure.subfigures(1, 1)
    errors, missed, reliability = upper.subplots(1, 3)
    errors.set_title("Brier score, as a sum over voxels")
    missed.set_title("swept voxels given less than 1 %")
    for k, result in enumerate(results):
        style = _marked_style(k)
        errors.plot(percents, result.at_percent.squared_error, label=result.name, **style)
        missed.plot(percents, 100.0 * result.at_percent.missed, **style)
    for axes in (errors, missed):
        axes.set_xlabel("% of the motion seen")
        axes.set_ylim(bottom=0.0)
    missed.set_ylabel("%")
    errors.set_ylabel("voxels")
    _draw_voxel_reliability(reliability, results)
    upper.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncol=max(1, len(results)))
    return figure


def _marked_style(k: int) -> dict[str, Any]:
    return {
        "color": SERIES[k % len(SERIES)],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
        "markersize": 4.0,
    }


def _draw_voxel_reliability(axes: Axes, results: Sequence[PredictorResult]) -> None:
    axes.set_title("calibration of the voxels")
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED, linewidth=1.0, zorder=1)
    # The first bin holds voxels given next to nothing.
    most = max((float(result.calibration.count[1:].max()) for result in results), default=1.0)
    for k, result in enumerate(results):
        table, style = result.calibration, _marked_style(k)
        count = table.count[1:]
        some = count > 0
        x, y = table.mean_probability[1:][some], table.observed[1:][some]
        if some.sum() > 1:
            axes.plot(x, y, color=style["color"], linestyle=style["linestyle"])
        axes.scatter(
            x,
            y,
            s=_AREA[0] + (_AREA[1] - _AREA[0]) * count[some] / max(most, 1.0),
            color=style["color"],
            marker=style["marker"],
            label=f"{result.name} (error {table.error_predicted:.2f})",
            zorder=3,
        )
    axes.set_xlim(-0.02, 1.04)
    axes.set_ylim(-0.02, 1.04)
    axes.set_xlabel("predicted probability (1 % and more)")
    axes.set_ylabel("share truly swept")
    axes.legend(loc="upper left", fontsize=7.5)


def _draw_moment(
    figure: Any, drawn: Mapping[str, NDArray[np.float32]], moment: Moment, box: tuple[slice, slice]
) -> None:
    pictures, names = [moment.swept, *drawn.values()], list(drawn)
    panels = figure.subplots(1, len(pictures), sharex=True, sharey=True, squeeze=False)[0]
    image: AxesImage | None = None
    for k, (axes, picture) in enumerate(zip(panels, pictures, strict=True)):
        axes.set_title(f"{moment.title}\nreally swept" if k == 0 else names[k - 1])
        axes.grid(False)
        axes.set_aspect("equal")
        part = picture[box]
        extent = _extent(box, moment)
        shown = np.ma.masked_less_equal(part.T, 0.0)
        if k == 0:
            axes.imshow(shown, origin="lower", extent=extent, cmap=_flat(_TRUTH), vmin=0.0, vmax=1.0)
        else:
            image = axes.imshow(shown, origin="lower", extent=extent, cmap=_PROBABILITY, vmin=0.0, vmax=1.0)
            # What really happened, as an outline: misses and false alarms show at a glance.
            x = np.linspace(extent[0], extent[1], part.shape[0] * 2 + 1)[1::2]
            y = np.linspace(extent[2], extent[3], part.shape[1] * 2 + 1)[1::2]
            axes.contour(x, y, moment.swept[box].T, levels=[0.5], colors=[INK], linewidths=0.9)
        axes.set_xlabel("x in m")
    panels[0].set_ylabel("y in m")
    if image is not None:
        bar = figure.colorbar(image, ax=list(panels), shrink=0.85, aspect=14, pad=0.01)
        bar.set_label("highest probability in the column")
        bar.outline.set_visible(False)


def _flat(colour: str) -> LinearSegmentedColormap:
    return LinearSegmentedColormap.from_list("flat", [colour, colour])


def _box_of(pictures: Sequence[NDArray[np.float32]]) -> tuple[slice, slice]:
    """Return the part of the grid that holds everything drawn, with some frame."""
    used = np.max(pictures, axis=0) > _WORTH_DRAWING
    parts = []
    for axis in (0, 1):
        filled = np.flatnonzero(used.any(axis=1 - axis))
        if not len(filled):
            return slice(None), slice(None)
        parts.append(slice(max(0, int(filled[0]) - _FRAME_CELLS), int(filled[-1]) + 1 + _FRAME_CELLS))
    return parts[0], parts[1]


def _extent(box: tuple[slice, slice], moment: Moment) -> tuple[float, float, float, float]:
    shape = moment.swept.shape
    edges = []
    for axis in (0, 1):
        start, stop, _ = box[axis].indices(shape[axis])
        edges += [moment.origin_m[axis] + moment.resolution_m * end for end in (start, stop)]
    return edges[0], edges[1], edges[2], edges[3]
