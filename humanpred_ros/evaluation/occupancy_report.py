"""The tables and the plot of the evaluation of occupancy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from humanpred_ros.evaluation.framework import Column, Report, Table
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure

_CURVES_IN = 3.3
_LEAST_WIDTH_IN, _PICTURE_WIDTH_IN = 10.0, 2.7
#: Titles, axis labels and colour bar of the lower row; and how high its pictures may become.
_AROUND_IN, _BAR_IN, _MOST_PICTURE_IN = 1.0, 1.3, 3.2
_TRUTH = LinearSegmentedColormap.from_list("truth", ["#52606d", "#52606d"])
_PROBABILITY = LinearSegmentedColormap.from_list("probability", ["#fdf3e1", "#f0a04b", "#9c2a10"])
#: Free cells around what is drawn from above, and the least probability that is drawn for sure.
_FRAME_CELLS = 3
_WORTH_DRAWING = 0.05
#: Area of a calibration marker in square points, for few voxels and for the bin with the most.
_AREA = (8.0, 90.0)

_COLUMNS = (
    Column("predictor", "name"),
    Column("learned from the tested class", "learned_from_class"),
    Column("Brier score x 1000", "average/brier", ".2f", factor=1e3),
    Column("  as a sum over voxels", "average/squared_error", ".0f"),
    Column("  without mistracked motions x 1000", "without_mistracked/brier", ".2f", factor=1e3),
    Column("  its place not listed x 1000", "unlisted/brier", ".2f", factor=1e3),
    Column("log score x 1000", "average/log_loss", ".1f", factor=1e3),
    Column("area under precision-recall", "average/average_precision", ".3f"),
    Column("swept voxels given < 1 %", "average/missed", ".1%"),
    Column("  without mistracked motions", "without_mistracked/missed", ".1%"),
    Column("  its place not listed", "unlisted/missed", ".1%"),
    Column("calibration error, voxels given >= 1 %", "calibration/error_predicted", ".3f"),
    Column("voxels expected", "average/n_predicted", ".0f"),
    Column("voxels swept", "average/n_swept", ".0f"),
    Column("one update", "timing/median_ms", ".2f", "ms"),
    Column("  99 % below", "timing/p99_ms", ".2f", "ms"),
    Column("training without one motion", "timing/prepare_s", ".2f", "s"),
    Column("postures refused", "refused_postures"),
)


@dataclass(frozen=True, eq=False)
class Moment:
    """The moment of one motion that is drawn from above."""

    title: str  #: which motion, how much of it was seen
    #: (2, X, Y) by predictor, the highest value in each column of voxels: 1 where the body is from then on, and the
    #: predicted probability
    pictures: Mapping[str, NDArray[np.float32]]
    grid: VoxelGrid  #: the lattice


def report_of(figures: dict[str, Any], moment: Moment | None) -> Report:
    """Return averages of every predictor, and errors along the motion."""
    results, percents = figures["predictors"], figures["percents"]
    heads = [("predictor",), *((str(percent), ".2f") for percent in percents)]
    shares = [("predictor",), *((str(percent), ".1%") for percent in percents)]
    brier = ((name, *(1e3 * scores["brier"]).tolist()) for name, scores in _along_the_motion(results))
    missed = ((name, *scores["missed"].tolist()) for name, scores in _along_the_motion(results))
    return Report(
        f"{figures['library']['name']}: {len(figures['tested'])} of {figures['library']['n_motions']} motions left out "
        f"in turn; averages over {len(percents)} parts seen, means over {figures['region_voxels']} voxels",
        (
            Table("", results, _COLUMNS, _note(figures)),
            Table.of_rows("Brier score x 1000 by % seen", heads, brier),
            Table.of_rows("swept voxels given < 1 %, by % seen", shares, missed),
        ),
        figures,
        draw=lambda: occupancy_plot(percents, results, moment),
    )


def _along_the_motion(results: Sequence[dict[str, Any]]) -> Iterator[tuple[str, Mapping[str, FloatArray]]]:
    for result in results:
        yield result["name"], result["at_percent"]
        if result["unlisted_at_percent"] is not None:
            yield f"{result['name']}, place not listed", result["unlisted_at_percent"]


def _note(figures: dict[str, Any]) -> str:
    """Return how to read predictors that have not seen the class beside others that have learned it."""
    if all(result["name"] != "reaching" for result in figures["predictors"]):
        return ""
    text = (
        "reaching (P2) has learned from no motion of the tested motion's class; it knows the places of all classes, "
        "that of the tested one from the class's other motions. Its place not listed: it knows all places but that "
        "one, so that the reach goes to none of them."
    )
    if figures["unseen_beside_seen"] is not None:
        text += (
            f" Its Brier score is {figures['unseen_beside_seen']:.2f} times that of swept_volume (P1), which was "
            "trained with the class."
        )
    return text


def occupancy_plot(percents: Sequence[int], results: Sequence[dict[str, Any]], moment: Moment | None) -> Figure:
    """Return errors over percents, missed share over percents and calibration; below them the moment from above.

    Args:
        percents: (P,) of the motion.
        results: figures of the predictors, in the order of the legend.
        moment: None leaves the lower row out.
    """
    if moment is None:
        figure = new_figure(_CURVES_IN, _LEAST_WIDTH_IN)
        upper: Any = figure.subfigures(1, 1)
    else:
        n = 1 + len(moment.pictures)
        width = max(_LEAST_WIDTH_IN, _PICTURE_WIDTH_IN * n)
        box = _box_of(moment)
        columns, rows = (part.stop - part.start for part in box)
        lower_in = min((width - _BAR_IN) / n * rows / columns, _MOST_PICTURE_IN) + _AROUND_IN
        figure = new_figure(_CURVES_IN + lower_in, width)
        halves: Any = figure.subfigures(2, 1, height_ratios=[_CURVES_IN, lower_in])
        upper, lower = halves
        _draw_moment(lower, moment, box)
    errors, missed, calibration = upper.subplots(1, 3)
    for k, result in enumerate(results):
        scores = result["at_percent"]
        errors.plot(percents, scores["squared_error"], label=result["name"], **_style(k), markersize=4.0)
        missed.plot(percents, 100.0 * scores["missed"], **_style(k), markersize=4.0)
    errors.set(title="Brier score, as a sum over voxels", xlabel="% of the motion seen", ylabel="voxels")
    missed.set(title="swept voxels given less than 1 %", xlabel="% of the motion seen", ylabel="%")
    for axes in (errors, missed):
        axes.set_ylim(bottom=0.0)
    _draw_calibration(calibration, results)
    upper.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncol=max(1, len(results)))
    return figure


def _style(k: int) -> dict[str, Any]:
    return {
        "color": SERIES[k % len(SERIES)],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
    }


def _draw_calibration(axes: Axes, results: Sequence[dict[str, Any]]) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED, linewidth=1.0, zorder=1)
    # The first bin holds voxels given next to nothing.
    most = max((float(result["calibration"]["count"][1:].max()) for result in results), default=1.0)
    for k, result in enumerate(results):
        table, style = result["calibration"], _style(k)
        some = np.flatnonzero(table["count"][1:]) + 1
        x, y, count = table["mean_probability"][some], table["observed"][some], table["count"][some]
        if len(some) > 1:
            axes.plot(x, y, color=style["color"], linestyle=style["linestyle"])
        area = _AREA[0] + (_AREA[1] - _AREA[0]) * count / max(most, 1.0)
        # One that predicts certainties alone has no error where it predicts something.
        error = f"{table['error_predicted']:.2f}"
        label = result["name"] if error == "0.00" else f"{result['name']} (error {error})"
        axes.scatter(x, y, s=area, color=style["color"], marker=style["marker"], label=label, zorder=3)
    axes.set(title="calibration of the voxels", xlim=(-0.02, 1.04), ylim=(-0.02, 1.04))
    axes.set(xlabel="predicted probability (1 % and more)", ylabel="share truly swept")
    axes.legend(loc="upper left", fontsize=7.5)


def _draw_moment(figure: Any, moment: Moment, box: tuple[slice, slice]) -> None:
    """Draw what is swept, and beside it what each predictor said, with an outline of what is swept."""
    panels = figure.subplots(1, 1 + len(moment.pictures), sharex=True, sharey=True, squeeze=False)[0]
    swept = next(iter(moment.pictures.values()))[0][box].T
    x, y = (
        moment.grid.origin_m[axis] + moment.grid.resolution_m * np.arange(part.start, part.stop + 1)
        for axis, part in enumerate(box)
    )
    look: dict[str, Any] = {"origin": "lower", "extent": (x[0], x[-1], y[0], y[-1]), "vmin": 0.0, "vmax": 1.0}
    panels[0].imshow(np.ma.masked_less_equal(swept, 0.0), cmap=_TRUTH, **look)
    panels[0].set(title=f"{moment.title}\nreally swept", ylabel="y in m")
    for axes, (name, (_, predicted)) in zip(panels[1:], moment.pictures.items(), strict=True):
        image = axes.imshow(np.ma.masked_less_equal(predicted[box].T, 0.0), cmap=_PROBABILITY, **look)
        middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (x, y)]
        axes.contour(*middles, swept, levels=[0.5], colors=[INK], linewidths=0.9)
        axes.set_title(name)
    for axes in panels:
        axes.grid(False)
        axes.set_aspect("equal")
        axes.set_xlabel("x in m")
    bar = figure.colorbar(image, ax=list(panels), shrink=0.85, aspect=14, pad=0.01)
    bar.set_label("highest probability in the column")
    bar.outline.set_visible(False)


def _box_of(moment: Moment) -> tuple[slice, slice]:
    """Return the part of the grid that holds everything drawn, with some frame."""
    used = np.max([picture.max(axis=0) for picture in moment.pictures.values()], axis=0) > _WORTH_DRAWING
    parts = []
    for axis in (0, 1):
        filled = np.flatnonzero(used.any(axis=1 - axis)) if used.any() else np.array([0, used.shape[axis]])
        first, last = max(0, int(filled[0]) - _FRAME_CELLS), int(filled[-1]) + 1 + _FRAME_CELLS
        parts.append(slice(first, min(last, used.shape[axis])))
    return parts[0], parts[1]
