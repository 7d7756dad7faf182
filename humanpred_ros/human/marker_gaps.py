"""Fills hidden markers, first from the segment's others, then over short gaps in time, and reports what was filled.

A segment is rigid: its shape is measured on the frames that show all its markers (the median over them), and three seen
markers place it. The two markers of the shoulder move with the torso's orientation, so one of them is enough. Markers
that are still hidden, for no longer than a stated time, are interpolated; longer gaps stay open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.marker_set import MarkerConfig, MarkerSet
from humanpred_ros.human.rigid_fit import groups_of, is_spread, mean_shape, misfit_m, place, seen_in

#: A polynomial of this degree over this many seen frames on either side bridges a gap in time: smoother than a line
#: where a hand accelerates, and not led astray by the noise of single frames.
BRIDGE_DEGREE, BRIDGE_FRAMES = 3, 6


@dataclass(frozen=True)
class FilledMarkers:
    """Markers after filling."""

    points_m: FloatArray  #: (T, M, 3), NaN where a gap stays open
    restored: NDArray[np.bool_]  #: (T, M) hidden or misplaced, known from the segment's other markers
    interpolated: NDArray[np.bool_]  #: (T, M) hidden, bridged in time
    misplaced: NDArray[np.bool_]  #: (T, M) seen, but not where the segment's others want it


def measure_shapes(markers: MarkerSet, points_m: FloatArray) -> dict[str, FloatArray]:
    """Return each segment's shape (K, 3) from frames (T, M, 3) that show all of it, if there are any.

    Shapes are turned as the marker set's, their middles at 0. The shoulder's is (2, 3), turned as the torso's shape.
    """
    shapes: dict[str, FloatArray] = {}
    for segment, columns in markers.of_segment.items():
        own = points_m[:, columns]
        whole = seen_in(own).all(axis=1)
        if segment == "shoulder":
            R = _torso_rotation(markers, shapes, points_m)
            whole &= np.isfinite(R).all(axis=(1, 2))
            if whole.any():
                turned = np.einsum("tji,tkj->tki", R[whole], own[whole] - own[whole].mean(axis=1, keepdims=True))
                shapes[segment] = np.median(turned, axis=0)
        elif whole.any() and is_spread(own[whole][0]):
            shape = mean_shape(own[whole])
            R_shape, _ = place(markers.local_m[columns], shape[None])
            shapes[segment] = shape @ R_shape[0]
    return shapes


def fill_markers(
    markers: MarkerSet,
    points_m: FloatArray,
    t_s: FloatArray,
    shapes: Mapping[str, FloatArray],
    config: MarkerConfig | None = None,
) -> FilledMarkers:
    """Return markers (T, M, 3) with hidden ones filled as far as `config` allows.

    Args:
        markers: what the columns are.
        points_m: labelled markers, NaN where hidden.
        t_s: (T,) stamps, rising.
        shapes: each segment's shape, as `measure_shapes` returns them; the others are only interpolated.
        config: what is filled.

    Raises:
        MotionError: exchanging two markers' labels would make a segment keep its shape: the labels are swapped.
    """
    config = config or MarkerConfig()
    points = points_m.copy()
    hidden = ~seen_in(points)
    points[hidden] = np.nan
    misplaced = np.zeros_like(hidden)
    for segment, shape in shapes.items():
        if segment != "shoulder":
            _restore(markers, segment, shape, points, misplaced, config)
    if "shoulder" in shapes:
        _restore_shoulder(markers, shapes, points)
    known = seen_in(points)
    for column in range(points.shape[1]):
        _bridge(points[:, column], t_s, config.longest_gap_s)
    interpolated = seen_in(points) & ~known
    return FilledMarkers(points, (hidden | misplaced) & known, interpolated, misplaced)


def _restore(
    markers: MarkerSet,
    segment: str,
    shape: FloatArray,
    points: FloatArray,
    misplaced: NDArray[np.bool_],
    config: MarkerConfig,
) -> None:
    """Put a rigid segment's hidden and misplaced markers where the others place them; in place."""
    columns = markers.of_segment[segment]
    own = points[:, columns]
    seen = seen_in(own)
    for row, frames in groups_of(seen):
        if is_spread(shape[row]):
            off = misfit_m(shape[row], own[np.ix_(frames, row)]).max(axis=1) > config.misplaced_m / 2
            for t in frames[off]:
                seen[t] = _plausible(markers, segment, shape, own[t], row, int(t), config.misplaced_m)
    misplaced[:, columns] = seen_in(own) & ~seen
    own[~seen] = np.nan
    for row, frames in groups_of(seen):
        if is_spread(shape[row]):
            R, p = place(shape[row], own[np.ix_(frames, row)])
            placed = np.einsum("tij,kj->tki", R, shape) + p[:, None]
            replaced = np.ones_like(row) if config.fit else ~row
            own[np.ix_(frames, replaced)] = placed[:, replaced]
    points[:, columns] = own


def _plausible(
    markers: MarkerSet,
    segment: str,
    shape: FloatArray,
    own: FloatArray,
    row: NDArray[np.bool_],
    frame: int,
    limit_m: float,
) -> NDArray[np.bool_]:
    """Return which of a segment's seen markers (K,) are right in a frame where they do not keep the shape well.

    A marker is left out if the others fit without it and it lies farther than the limit from where they place it.
    """
    seen = np.flatnonzero(row)
    swap = swapped_pair(shape[row], own[row], limit_m)
    if swap is not None:
        a, b = (markers.names[markers.of_segment[segment][seen[k]]] for k in swap)
        raise MotionError(
            f"markers: wanted each label on its own marker, but in frame {frame} the {segment} keeps its shape only "
            f"with {a} and {b} exchanged; the labels are swapped: correct them or label the recording again"
        )
    best, best_misfit, best_off = row, np.inf, 0.0
    for k in seen:
        rest = row.copy()
        rest[k] = False
        if is_spread(shape[rest]):
            R, p = place(shape[rest], own[None, rest])
            misfit = float(np.linalg.norm(shape[rest] @ R[0].T + p - own[rest], axis=1).max())
            if misfit < best_misfit:
                best, best_misfit = rest, misfit
                best_off = float(np.linalg.norm(R[0] @ shape[k] + p[0] - own[k]))
    if best_misfit <= limit_m / 2:
        return best if best_off > limit_m else row
    within = misfit_m(shape[row], own[None, row]).max() <= limit_m
    return row if within else np.zeros_like(row)  # which one is wrong is not clear: the segment is not seen


def swapped_pair(shape: FloatArray, own: FloatArray, limit_m: float) -> tuple[int, int] | None:
    """Return the two points (of K) whose exchange makes own (K, 3) fit the shape within half the limit, if any does.

    Nothing is swapped where the points fit within the limit as they are.
    """
    if misfit_m(shape, own[None]).max() <= limit_m or len(shape) < 4:
        return None
    for a in range(len(shape)):
        for b in range(a + 1, len(shape)):
            order = np.arange(len(shape))
            order[[a, b]] = b, a
            if misfit_m(shape, own[None, order]).max() <= limit_m / 2:
                return a, b
    return None


def _torso_rotation(markers: MarkerSet, shapes: Mapping[str, FloatArray], points: FloatArray) -> FloatArray:
    """Return how the torso's shape is turned in each frame (T, 3, 3), NaN where the torso is not seen whole."""
    torso = points[:, markers.of_segment["torso"]]
    R = np.full((len(points), 3, 3), np.nan)
    whole = seen_in(torso).all(axis=1)
    if "torso" in shapes and whole.any():
        R[whole] = place(shapes["torso"], torso[whole])[0]
    return R


def _restore_shoulder(markers: MarkerSet, shapes: Mapping[str, FloatArray], points: FloatArray) -> None:
    """Put hidden shoulder markers where the seen one and the torso's orientation place them; in place."""
    columns = markers.of_segment["shoulder"]
    R = _torso_rotation(markers, shapes, points)
    turned = np.einsum("tij,kj->tki", R, shapes["shoulder"])
    own = points[:, columns]
    seen = seen_in(own)
    some = (seen.sum(axis=1) == 1) & np.isfinite(R).all(axis=(1, 2))
    for t in np.flatnonzero(some):
        middle = (own[t, seen[t]] - turned[t, seen[t]]).mean(axis=0)
        points[t, columns[~seen[t]]] = middle + turned[t, ~seen[t]]


def _bridge(track: FloatArray, t_s: FloatArray, longest_gap_s: float) -> None:
    """Interpolate the gaps of one marker (T, 3) that are short enough and have seen frames on both sides, in place."""
    seen = seen_in(track)
    ticks = np.flatnonzero(seen)
    wide = np.diff(ticks) > 1
    for before, after in zip(ticks[:-1][wide], ticks[1:][wide], strict=True):
        # From the first to the last hidden frame: a gap of one frame is no time long.
        if t_s[after - 1] - t_s[before + 1] > longest_gap_s:
            continue
        near = np.concatenate([ticks[ticks <= before][-BRIDGE_FRAMES:], ticks[ticks >= after][:BRIDGE_FRAMES]])
        near = near[(t_s[near] >= t_s[before] - longest_gap_s) & (t_s[near] <= t_s[after] + longest_gap_s)]
        middle, half = (t_s[before] + t_s[after]) / 2, t_s[near[-1]] - t_s[near[0]]
        degree = min(BRIDGE_DEGREE, len(near) - 1)
        fit = np.polynomial.polynomial.polyfit((t_s[near] - middle) / half, track[near], degree)
        hidden = np.arange(before + 1, after)
        track[hidden] = np.polynomial.polynomial.polyval((t_s[hidden] - middle) / half, fit).T
