"""The plot of `humanpred bench planner`: what planning time grows with, on axes where proportional is a diagonal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator, ScalarFormatter

from humanpred_ros.viewing.figures import DASHES, INK, MARKERS, MUTED, SERIES, new_figure, report_style

_DPI = 150
_HEIGHT_IN = 3.0
_STYLES: Mapping[str, dict[str, Any]] = {
    "ours, one thread": {"color": SERIES[0], "marker": MARKERS[0], "linestyle": DASHES[0]},
    "ours, two threads": {"color": SERIES[1], "marker": MARKERS[1], "linestyle": DASHES[1]},
    "C++ floor, one thread": {"color": MUTED, "marker": MARKERS[2], "linestyle": DASHES[2]},
}


@dataclass(frozen=True)
class GrowthCurve:
    """Milliseconds by size of one thing; `lines` by name, each as long as `sizes`."""

    what: str
    sizes: Sequence[int]
    lines: Mapping[str, Sequence[float]]


def growth_plot(curves: Sequence[GrowthCurve]) -> Figure:
    """Return one panel per curve with logarithmic axes and a common scale of time."""
    figure = new_figure(_HEIGHT_IN)
    panels = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    handles: dict[str, Any] = {}
    for axes, curve in zip(panels, curves, strict=True):
        axes.set_title(f"growth with {curve.what}")
        for name, values in curve.lines.items():
            style = _STYLES.get(name, {"color": INK})
            handles[name] = axes.plot(curve.sizes, values, label=name, markersize=4.5, **style)[0]
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(list(curve.sizes))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(curve.what)
    panels[0].set_ylabel("ms")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncol=len(handles))
    return figure


def save_growth_plot(path: Path, curves: Sequence[GrowthCurve]) -> None:
    """Write `growth_plot` as a PNG file. Raises OSError if that cannot be done."""
    with report_style():
        figure = growth_plot(curves)
        canvas: Any = FigureCanvasAgg(figure)
        figure.set_facecolor("white")
        canvas.print_figure(path, format="png", dpi=_DPI, facecolor="white")
