"""The plot of an evaluation of occupancy: errors along the motion, calibration, and one moment seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, report_style

_DPI = 150
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


@dataclass(frozen=True, eq=False)
class OccupancyCurves:
    """What is drawn of one predictor.

    Attributes:
        name: for the legend.
        squared_error: (P,) sum over voxels at each percent.
        missed: (P,) share of swept voxels given next to nothing.
        probability, observed, count: (B,) mean probability, share swept and number of voxels of each bin but the
            first, which holds what nobody was warned of.
        error: calibration error over these voxels, for the legend.
        above: (X, Y) predicted probability at the moment drawn.
    """

    name: str
    squared_error: FloatArray
    missed: FloatArray
    probability: FloatArray
    observed: FloatArray
    count: FloatArray
    error: float
    above: NDArray[np.float32] | None


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


def occupancy_plot(percents: Sequence[int], curves: Sequence[OccupancyCurves], moment: Moment | None) -> Figure:
    """Return errors over percents, missed share over percents and calibration; below them the moment from above.

    Args:
        percents: (P,) of the motion.
        curves: of the predictors, in the order of the legend.
        moment: None leaves the lower row out.
    """
    drawn = [curve for curve in curves if curve.above is not None] if moment is not None else []
    width = max(_LEAST_WIDTH_IN, _PICTURE_WIDTH_IN * (1 + len(drawn)))
    if moment is not None and drawn:
        box = _box_of([moment.swept, *(curve.above for curve in drawn if curve.above is not None)])
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
    for k, curve in enumerate(curves):
        style = _style(k)
        errors.plot(percents, curve.squared_error, label=curve.name, **style)
        missed.plot(percents, 100.0 * curve.missed, **style)
    for axes in (errors, missed):
        axes.set_xlabel("% of the motion seen")
        axes.set_ylim(bottom=0.0)
    missed.set_ylabel("%")
    errors.set_ylabel("voxels")
    _draw_reliability(reliability, curves)
    upper.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncol=max(1, len(curves)))
    return figure


def save_occupancy_plot(
    path: Path, percents: Sequence[int], curves: Sequence[OccupancyCurves], moment: Moment | None
) -> None:
    """Write `occupancy_plot` as a PNG file. Raises OSError if that cannot be done."""
    with report_style():
        figure = occupancy_plot(percents, curves, moment)
        canvas: Any = FigureCanvasAgg(figure)
        figure.set_facecolor("white")
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")


def _style(k: int) -> dict[str, Any]:
    return {
        "color": SERIES[k % len(SERIES)],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
        "markersize": 4.0,
    }


def _draw_reliability(axes: Axes, curves: Sequence[OccupancyCurves]) -> None:
    axes.set_title("calibration of the voxels")
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED, linewidth=1.0, zorder=1)
    most = max((float(curve.count.max()) for curve in curves if len(curve.count)), default=1.0)
    for k, curve in enumerate(curves):
        some = curve.count > 0
        style = _style(k)
        if some.sum() > 1:
            axes.plot(curve.probability[some], curve.observed[some], color=style["color"], linestyle=style["linestyle"])
        share = curve.count[some] / max(most, 1.0)
        axes.scatter(
            curve.probability[some],
            curve.observed[some],
            s=_AREA[0] + (_AREA[1] - _AREA[0]) * share,
            color=style["color"],
            marker=style["marker"],
            label=f"{curve.name} (error {curve.error:.2f})",
            zorder=3,
        )
    axes.set_xlim(-0.02, 1.04)
    axes.set_ylim(-0.02, 1.04)
    axes.set_xlabel("predicted probability (1 % and more)")
    axes.set_ylabel("share truly swept")
    axes.legend(loc="upper left", fontsize=7.5)


def _draw_moment(figure: Any, curves: Sequence[OccupancyCurves], moment: Moment, box: tuple[slice, slice]) -> None:
    pictures = [moment.swept, *(curve.above for curve in curves if curve.above is not None)]
    panels = figure.subplots(1, len(pictures), sharex=True, sharey=True, squeeze=False)[0]
    image: AxesImage | None = None
    for k, (axes, picture) in enumerate(zip(panels, pictures, strict=True)):
        axes.set_title(f"{moment.title}\nreally swept" if k == 0 else curves[k - 1].name)
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
