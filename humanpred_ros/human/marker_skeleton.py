"""From labelled markers to the 23 DoFs of P2's human.

Hidden markers are filled first. A segment is rigid: its shape is measured on the frames that show all its markers (the
median over them), and three seen markers place it. The two markers of the shoulder move with the torso's orientation,
so one of them is enough. Markers that are still hidden, for no longer than a stated time, are interpolated; longer gaps
stay open. Joint centres, frames and angles then follow from anatomical markers (`segment_angles`). What the markers do
not determine is NaN in the postures and named in the result, never guessed; labels that cannot be right are an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.marker_set import (
    ANATOMICAL,
    LINK_OF_SEGMENT,
    MarkerSet,
    groups_of,
    is_spread,
    mean_shape,
    misfit_m,
    pairwise_m,
    place,
    seen_in,
)
from humanpred_ros.human.model import MOCAP23_DOFS, HumanModel
from humanpred_ros.human.segment_angles import postures_of, segment_frames

#: Distances between a segment's markers, as a share of the marker set's, outside which the labels cannot be right.
PLAUSIBLE_RATIO = (0.4, 2.5)
#: How far (m) a person's markers may sit from the marker set's places before an exchange of two labels is suspected.
PLAUSIBLE_PLACE_M = 0.04
#: Gaps up to this long are interpolated in time: a bridge over 0.1 s bends a reach by about 5 mm.
LONGEST_GAP_S = 0.1
#: Markers this far off their segment's shape count as hidden; skin moves them by 0.01 to 0.02 m.
MISPLACED_M = 0.03
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
    longest_gap_s: float = LONGEST_GAP_S,
) -> FilledMarkers:
    """Return markers (T, M, 3) with hidden ones filled.

    A seen segment's markers are taken from its shape placed on them, which averages noise.

    Args:
        markers: what the columns are.
        points_m: labelled markers, NaN where hidden.
        t_s: (T,) stamps, rising.
        shapes: each segment's shape, as `measure_shapes` returns them; the others are only interpolated.
        longest_gap_s: gaps up to this long are interpolated in time.

    Raises:
        MotionError: exchanging two markers' labels would make a segment keep its shape: the labels are swapped.
    """
    points = points_m.copy()
    hidden = ~seen_in(points)
    points[hidden] = np.nan
    misplaced = np.zeros_like(hidden)
    for segment, shape in shapes.items():
        if segment != "shoulder":
            _restore(markers, segment, shape, points, misplaced)
    if "shoulder" in shapes:
        _restore_shoulder(markers, shapes, points)
    known = seen_in(points)
    for column in range(points.shape[1]):
        _bridge(points[:, column], t_s, longest_gap_s)
    interpolated = seen_in(points) & ~known
    return FilledMarkers(points, (hidden | misplaced) & known, interpolated, misplaced)


def _restore(
    markers: MarkerSet,
    segment: str,
    shape: FloatArray,
    points: FloatArray,
    misplaced: NDArray[np.bool_],
) -> None:
    """Put a rigid segment's hidden and misplaced markers where the others place them; in place."""
    columns = markers.of_segment[segment]
    own = points[:, columns]
    seen = seen_in(own)
    for row, frames in groups_of(seen):
        if is_spread(shape[row]):
            off = misfit_m(shape[row], own[np.ix_(frames, row)]).max(axis=1) > MISPLACED_M / 2
            for t in frames[off]:
                seen[t] = _plausible(markers, segment, shape, own[t], row, int(t), MISPLACED_M)
    misplaced[:, columns] = seen_in(own) & ~seen
    own[~seen] = np.nan
    for row, frames in groups_of(seen):
        if is_spread(shape[row]):
            R, p = place(shape[row], own[np.ix_(frames, row)])
            placed = np.einsum("tij,kj->tki", R, shape) + p[:, None]
            own[frames] = placed
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


@dataclass(frozen=True)
class MarkerPostures:
    """The postures of T frames of markers."""

    q: FloatArray  #: (T, 23) postures, angles unwrapped, NaN exactly where the markers do not determine a DoF
    markers: FilledMarkers  #: the markers after filling, with what was done to each
    #: (T, 6) segments (in the order of `LINK_OF_SEGMENT`) that were not seen and could not be filled
    lost: NDArray[np.bool_]
    worn: MarkerSet  #: the marker set

    @property
    def complete(self) -> NDArray[np.bool_]:
        """(T,) True where every DoF is determined."""
        return np.asarray(np.isfinite(self.q).all(axis=1))

    def require_complete(self, name: str = "recording") -> FloatArray:
        """Return `q`, or say which segments are lost in which frames of the recording `name`.

        Raises:
            MotionError: a frame with a DoF that is not determined.
        """
        if self.complete.all():
            return self.q
        said = []
        for segment, lost in zip(LINK_OF_SEGMENT, self.lost.T, strict=True):
            if lost.any():
                frames = np.flatnonzero(lost)
                said.append(
                    f"{segment} ({self.worn.labels(segment)}) in {len(frames)} frames from {frames[0]} to {frames[-1]}"
                )
        where = "; ".join(said) or f"joint centres that coincide in frame {int(np.argmin(self.complete))}"
        raise MotionError(
            f"{name}: wanted markers that determine all 23 DoFs in all {len(self.q)} frames, lost: {where}; cut the "
            "recording there or allow longer gaps (--longest-gap)"
        )


class MarkerSkeleton:
    """Converts between markers and postures of the 23-DoF human.

    Args:
        model: the 23-DoF human; P2's if left out.
        markers: what the person wears; `UPPER_BODY` if left out.
        longest_gap_s: gaps up to this long are interpolated in time.
        upright_pelvis: take PelvisRotX and PelvisRotY as 0, as P2's recordings do.
        shapes: each segment's shape (see `calibrated`); measured on every recording if left out.

    Raises:
        HumanModelError: another set of DoFs, or links that are lacking.
    """

    def __init__(
        self,
        model: HumanModel | None = None,
        markers: MarkerSet | None = None,
        longest_gap_s: float = LONGEST_GAP_S,
        upright_pelvis: bool = False,
        shapes: Mapping[str, FloatArray] | None = None,
    ) -> None:
        self.model = model or HumanModel.mocap23()
        self.markers = markers or MarkerSet()
        self.longest_gap_s, self.upright_pelvis = longest_gap_s, upright_pelvis
        self.shapes = shapes
        self.model.check_dofs(MOCAP23_DOFS)
        lacking = sorted(set(LINK_OF_SEGMENT.values()) - set(self.model.link_names))
        if lacking:
            raise HumanModelError(
                f"marker skeleton: model {self.model.name} lacks the links {', '.join(lacking)}; add them to its URDF"
            )

    def points(self, q: ArrayLike) -> FloatArray:
        """Return the markers (..., M, 3) of postures (..., 23) of a person who wears them where the set says."""
        return self.markers.places(self.model, q)

    def calibrated(self, points_m: ArrayLike) -> MarkerSkeleton:
        """Return this skeleton with the segments' shapes measured on markers (T, M, 3) of a trial without gaps.

        Raises:
            MotionError: a segment that no frame shows whole, or labels that cannot be right.
            ArrayError: another shape.
        """
        shapes = self._measured(checked("points_m", points_m, ("T", len(self.markers.names), 3), finite=False))
        for segment in LINK_OF_SEGMENT:
            if segment not in shapes:
                raise MotionError(
                    f"marker calibration: wanted one frame with all markers of the {segment} "
                    f"({self.markers.labels(segment)}), got none; record a trial in which they are seen"
                )
        return MarkerSkeleton(self.model, self.markers, self.longest_gap_s, self.upright_pelvis, shapes)

    def postures(self, points_m: ArrayLike, t_s: ArrayLike) -> MarkerPostures:
        """Return the postures of labelled markers (T, M, 3), in metres and the tracker's frame, z up.

        A marker with a coordinate that is not finite counts as hidden. Angles are unwrapped over the recording.

        Args:
            points_m: markers in the order of the set.
            t_s: (T,) stamps, rising.

        Raises:
            ArrayError: another shape, or stamps that are not finite.
            MotionError: stamps that do not rise, labels that cannot be right, or a segment that no frame determines.
        """
        points = checked("points_m", points_m, ("T", len(self.markers.names), 3), finite=False)
        stamps = checked("t_s", t_s, (len(points),))
        if not len(points) or (np.diff(stamps) <= 0).any():
            raise MotionError(f"markers: wanted at least one frame and rising stamps, got {len(points)} frames")
        points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
        shapes = self._measured(points) if self.shapes is None else self.shapes
        filled = fill_markers(self.markers, points, stamps, shapes, self.longest_gap_s)
        anatomical = [[self.markers.index[name] for name in ANATOMICAL[segment]] for segment in LINK_OF_SEGMENT]
        lost = np.stack([~np.isfinite(filled.points_m[:, own]).all(axis=(1, 2)) for own in anatomical], axis=1)
        for segment, never in zip(LINK_OF_SEGMENT, np.asarray(lost.all(axis=0)), strict=True):
            if never:
                columns = self.markers.of_segment[segment]
                seen = seen_in(points[:, columns]).sum(axis=1)
                raise MotionError(
                    f"markers: no frame determines the {segment}: wanted at least 3 of {len(columns)} markers "
                    f"({self.markers.labels(segment)}), 1 of 2 for the shoulder, got at most {seen.max()} in "
                    f"{len(points)} frames; look for wrong labels, or calibrate on a trial that shows all of them"
                )
        frames = segment_frames(self.markers, filled.points_m)
        # A waist that stands on its head or faces backwards has its left and right, or front and back, swapped.
        waist, torso = frames.rotation["waist"], frames.rotation["torso"]
        for axis, what in ((2, "left and right"), (0, "front and back")):
            against = (waist[:, :, axis] * torso[:, :, axis]).sum(axis=1) < 0  # NaN compares false
            if against.any():
                raise MotionError(
                    f"markers: waist and torso point opposite ways in frame {int(np.argmax(against))}; the labels of "
                    f"{what} are swapped at one of them: correct them"
                )
        return MarkerPostures(postures_of(frames, self.model, self.upright_pelvis), filled, lost, self.markers)

    def _measured(self, points: FloatArray) -> dict[str, FloatArray]:
        """Measure the shapes and compare them with the marker set's (MotionError if the labels cannot be right)."""
        shapes = measure_shapes(self.markers, points)
        for segment, shape in shapes.items():
            labels = [self.markers.names[i] for i in self.markers.of_segment[segment]]
            wanted = self.markers.local_m[self.markers.of_segment[segment]]
            size, usual = (float(np.linalg.norm(at - at.mean(axis=0))) for at in (shape, wanted))
            scaled = wanted * (size / usual)
            swap: tuple[int, ...] | None = swapped_pair(scaled, shape, PLAUSIBLE_PLACE_M)
            if segment == "shoulder" and float((shape[0] - shape[1]) @ (wanted[0] - wanted[1])) < 0:
                swap = (0, 1)
            if swap is not None:
                raise MotionError(
                    f"markers: the {segment} has its markers where the marker set has them only with "
                    f"{labels[swap[0]]} and {labels[swap[1]]} exchanged; the labels are swapped: correct them"
                )
            ratio = (pairwise_m(shape[None]) / pairwise_m(wanted[None]))[0]
            wrong = (ratio < PLAUSIBLE_RATIO[0]) | (ratio > PLAUSIBLE_RATIO[1])
            if wrong.any():
                k = int(np.argmax(wrong))
                a, b = (labels[i[k]] for i in np.triu_indices(len(labels), 1))
                raise MotionError(
                    f"markers: {a} and {b} of the {segment} are {pairwise_m(shape[None])[0, k]:.3f} m apart, the "
                    f"marker set has {pairwise_m(wanted[None])[0, k]:.3f} m; wrong labels, or lengths not in metres"
                )
        return shapes
