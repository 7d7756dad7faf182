"""Whether the predicted occupancy of a run came true: published probabilities beside what the recorded body then did.

A voxel came true if the body touches it in the posture predicted from or in any recorded later, to the end of the
recording: where the person stays counts like where the person went. Bins and scores are those of
`humanpred evaluate occupancy`, so that one run can be read beside a whole library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.viewing.figures import INK, MUTED, SERIES, empty_figure, new_figure
from humanpred_ros.viewing.recorded import OccupancySnapshot
from humanpred_ros.viewing.run import WHOLE_REACH_PERCENT, Run
from humanpred_ros.viewing.workcell import Workcell

#: A swept voxel given less than this was missed.
MISSED_BELOW = 0.01
#: Edges of the ten bins; an edge belongs to the bin above, 1 to the last one. What was given less than the first edge
#: is left out: far from anybody there is plenty of it, it is right without effort, and how much depends on the
#: threshold of publishing.
BIN_EDGES = (MISSED_BELOW, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
#: The two parts of a run that are judged apart: at rest there is nothing left to predict.
MOVING, AT_REST = "human moving", "human at rest"

_SIZE_IN = (4.5, 5.2)
#: Area of the marker of a bin that holds all voxels, and of one with next to none, in square points.
_FULL_AREA, _LEAST_AREA = 420.0, 16.0
_LOOK: Mapping[str, Mapping[str, Any]] = {
    MOVING: {"color": SERIES[0], "marker": "o"},
    AT_REST: {"color": SERIES[1], "marker": "D"},
}
_N_BINS = len(BIN_EDGES) - 1
#: Of a voxel: what the float32 coordinates of its centre can be off by, with room to spare.
_CENTRE_TOLERANCE = 1e-3
_STAMP_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class ReliabilityBin:
    """Voxels whose predicted probability was at least `low` and less than `high`; the last bin holds 1, too."""

    low: float
    high: float
    count: int  #: over all occupancies compared
    probability: float | None  #: mean of what was predicted, None without voxels
    observed: float | None  #: share of them that came true, None without voxels


@dataclass(frozen=True)
class OccupancyCalibration:
    """Predicted occupancies beside the voxels the body really swept from then on."""

    occupancies: int  #: how many were compared
    voxels: int  #: in `bins`, over all of them
    #: expected calibration error: mean over these voxels of |mean probability - observed share| of their bin
    error: float | None
    missed: float | None  #: share of the swept voxels that were given less than 1 %, None if nothing was swept
    expected_voxels: float  #: sum of the probabilities; mean per occupancy
    swept_voxels: float  #: voxels really swept; mean per occupancy
    #: sum over voxels of (p - y)^2, mean per occupancy (divided by the grid's size: Brier score)
    squared_error: float
    squared_error_current: float  #: the same of the baseline that predicts the current posture only
    squared_error_ratio: float | None  #: the one over the other, None where the baseline made no error
    bins: tuple[ReliabilityBin, ...]  #: reliability table


def measure_calibration(run: Run, workcell: Workcell) -> tuple[dict[str, OccupancyCalibration], tuple[str, ...]]:
    """Compare the occupancies sampled from a run with the voxels the human's body really touched from then on.

    Args:
        run: with all of the human's motion; what happened after an interruption is not known.
        workcell: of that run.

    Returns:
        (figures by part of the run, why there are none).
    """
    scene, human, seen = workcell.scene, workcell.human, run.seen_percent
    why = ""
    if not len(run.occupancy):
        why = "no occupancy was recorded"
    elif not len(run.postures):
        why = "no posture of the human was recorded"
    elif scene is None or human is None:
        why = f"the {'scene' if scene is None else 'human model'} is not known"
    elif seen is not None and seen < WHOLE_REACH_PERCENT:
        why = f"what the human did after {seen:.0f} % of the reach was not recorded"
    else:
        last_s = run.postures.t_s[-1] + _STAMP_TOLERANCE_S
        samples = [sample for sample in run.occupancy.samples if sample.t_s <= last_s]
        grid = run.occupancy.grid or scene.grid
        troubles = [f"at {sample.t_s:.2f} s {found}" for sample in samples if (found := _trouble(sample, grid))]
        why = troubles[0] if troubles else ""
        if not any(len(sample.probability) for sample in samples):
            why = "the recorded occupancies hold no voxel"
        if not why:
            return _compared(run, samples, grid, BodyVoxeliser(human, grid, scene.T_world_human)), ()
    return {}, (f"whether the predicted probabilities were right cannot be told: {why}",)


def _compared(
    run: Run, samples: list[OccupancySnapshot], grid: VoxelGrid, body: BodyVoxeliser
) -> dict[str, OccupancyCalibration]:
    """Return the figures of the samples by part of the run."""
    last = body.last_touch(run.postures.q).ravel()  # (V,) posture in which each voxel is touched last, -1 for never
    last_touched = np.sort(last[last >= 0])
    tally = {MOVING: _Tally(), AT_REST: _Tally()}
    for sample in samples:
        moving = sample.t_s <= run.motion_duration_s + _STAMP_TOLERANCE_S and run.motion_duration_s > 0.0
        # The posture at the sample's time, the next one where that was not recorded.
        posture = int(np.searchsorted(run.postures.t_s, sample.t_s - _STAMP_TOLERANCE_S))
        n_swept = len(last_touched) - int(np.searchsorted(last_touched, posture))
        n_now = int(body.mask(run.postures.q[posture]).sum())
        swept = last[grid.flat_index(sample.centres_m)] >= posture
        tally[MOVING if moving else AT_REST].add(sample.probability, swept, n_swept, n_now)
    return {name: part.figures() for name, part in tally.items() if part.occupancies}


@dataclass
class _Tally:
    """Sums over occupancies."""

    occupancies: int = 0
    expected: float = 0.0
    swept: int = 0
    missed: int = 0
    squared_error: float = 0.0
    squared_error_current: int = 0
    #: of each bin: voxels, sum of their probabilities, and how many came true
    bins: FloatArray = field(default_factory=lambda: np.zeros((3, _N_BINS)))

    def add(self, p: FloatArray, y: NDArray[np.bool_], n_swept: int, n_now: int) -> None:
        """Add an occupancy: probabilities (N,), whether these voxels were swept (N,), and how many were, from now on
        and now.
        """
        warned = p >= MISSED_BELOW
        self.occupancies += 1
        self.expected += float(p.sum())
        self.swept += n_swept
        self.missed += n_swept - int(y[warned].sum())
        # Voxels that were not published count as probability 0.
        self.squared_error += float(((p - y) ** 2).sum()) + n_swept - int(y.sum())
        # Where the body is now is part of what it sweeps from now on: that baseline errs by the rest alone.
        self.squared_error_current += n_swept - n_now
        number = np.minimum(np.searchsorted(BIN_EDGES, p[warned], side="right") - 1, _N_BINS - 1)
        for row, weights in zip(self.bins, (None, p[warned], y[warned]), strict=True):
            row += np.bincount(number, weights=weights, minlength=_N_BINS)

    def figures(self) -> OccupancyCalibration:
        count, probability, came_true = self.bins
        voxels, baseline = int(count.sum()), self.squared_error_current
        gap = float(np.abs(probability - came_true).sum())
        return OccupancyCalibration(
            occupancies=self.occupancies,
            voxels=voxels,
            error=gap / voxels if voxels else None,
            missed=self.missed / self.swept if self.swept else None,
            expected_voxels=self.expected / self.occupancies,
            swept_voxels=self.swept / self.occupancies,
            squared_error=self.squared_error / self.occupancies,
            squared_error_current=baseline / self.occupancies,
            squared_error_ratio=self.squared_error / baseline if baseline else None,
            bins=tuple(
                ReliabilityBin(low, high, int(n), p / n if n else None, y / n if n else None)
                for low, high, (n, p, y) in zip(BIN_EDGES[:-1], BIN_EDGES[1:], self.bins.T.tolist(), strict=True)
            ),
        )


def _trouble(sample: OccupancySnapshot, grid: VoxelGrid) -> str:
    """Return why a published occupancy cannot be compared, empty if it can."""
    p = sample.probability
    if not ((p >= 0.0) & (p <= 1.0)).all():  # NaN is neither
        return "probabilities outside of 0 to 1 were published"
    flat = grid.flat_index(sample.centres_m)
    off = np.abs(grid.centres_m(np.maximum(flat, 0)) - sample.centres_m)
    if (flat < 0).any() or (off > _CENTRE_TOLERANCE * grid.resolution_m).any():
        return "points were published that are not voxel centres of the grid"
    return ""


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
