"""The plot of whether predicted probabilities came true: one point per bin, on the diagonal if they were right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from humanpred_ros.viewing.figures import INK, MUTED, SERIES, empty_figure, new_figure
from humanpred_ros.viewing.reliability import AT_REST, MOVING
from humanpred_ros.viewing.run_summary import OccupancyCalibration

_SIZE_IN = (4.5, 5.2)
#: Area of the marker of a bin that holds all voxels, and of one with next to none, in square points.
_FULL_AREA, _LEAST_AREA = 420.0, 16.0
_LOOK: Mapping[str, Mapping[str, Any]] = {
    MOVING: {"color": SERIES[0], "marker": "o"},
    AT_REST: {"color": SERIES[1], "marker": "D"},
}


def reliability_plot(calibration: Mapping[str, OccupancyCalibration]) -> Figure:
    """Return the reliability diagram of a run's predicted occupancy, by part of the run."""
    parts = {name: part for name, part in calibration.items() if part.voxels}
    if not parts:
        return empty_figure("no predicted probability could be compared with what happened")
    figure = new_figure(*_SIZE_IN)
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED, linewidth=1.0, zorder=1)
    axes.text(
        0.3, 0.33, "as predicted", rotation=45, rotation_mode="anchor", transform_rotates_text=True, color=MUTED,
        fontsize=8, ha="center",
    )  # fmt: skip
    for k, (name, part) in enumerate(parts.items()):
        filled = [row for row in part.bins if row.count]
        x, y = (np.array([getattr(row, of) for row in filled], dtype=np.float64) for of in ("probability", "observed"))
        count = np.array([row.count for row in filled], dtype=np.float64)
        area = np.maximum(_LEAST_AREA, _FULL_AREA * count / count.sum())
        look = _LOOK.get(name, {"color": SERIES[(2 + k) % len(SERIES)], "marker": "s"})
        axes.plot(x, y, color=look["color"], linewidth=1.1, alpha=0.7, zorder=2)
        axes.scatter(x, y, s=area, alpha=0.75, linewidths=0, clip_on=False, zorder=3, **look)
        axes.plot([], [], linestyle="-", linewidth=1.1, markersize=6, label=_label(name, part), **look)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.set_aspect("equal")
    axes.set_xlabel("predicted probability")
    axes.set_ylabel("share really occupied")
    figure.legend(loc="outside lower center", ncol=len(parts), title="size: how many voxels", labelcolor=INK)
    return figure


def _label(name: str, part: OccupancyCalibration) -> str:
    return name if part.error is None else f"{name}: error {part.error:.2f}"
