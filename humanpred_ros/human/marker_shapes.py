"""Recognising segments among unnamed marker positions by their shape, because a recording has to start somewhere.

A segment's markers keep their distances, so the detections that have just these distances are its markers, wherever
the person stands and in whatever posture. Waist and torso are told from their mirror images by standing upright.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.rigid_fit import is_spread, misfit_m, place, seen_in
from humanpred_ros.human.marker_set import MarkerSet

#: Segments that are upright whenever a person stands or sits, and how far (m) a shoulder is from the torso's centre.
UPRIGHT = ("waist", "torso")
SHOULDER_REACH_M = 0.45


@dataclass(frozen=True)
class ShapeMatch:
    """Which detections are a segment's markers.

    Attributes:
        detection: (K,) number of each marker's detection, -1 where there is none.
        off_m: greatest distance of one of them from the shape, or from where it is expected.
    """

    detection: NDArray[np.int64]
    off_m: float

    @property
    def count(self) -> int:
        """How many of the markers were found."""
        return int((self.detection >= 0).sum())


def nominal_shapes(markers: MarkerSet) -> dict[str, FloatArray]:
    """Return each segment's shape (K, 3) as the marker set states it."""
    return {segment: markers.local_m[own] for segment, own in markers.of_segment.items()}


def match_shape(
    shape_m: FloatArray,
    detections_m: FloatArray,
    limit_m: float,
    upright: bool = False,
    expected_m: FloatArray | None = None,
    reach_m: float = np.inf,
    least: int = 3,
) -> ShapeMatch | None:
    """Return the detections (P, 3) that have the shape (K, 3), or None if too few have it.

    As many markers as possible, and among those the best fit, or the nearest to what is expected. A tree search: each
    next marker only goes to detections whose distances to those already named are right to twice the limit.

    Args:
        shape_m: the segment.
        detections_m: finite positions.
        limit_m: greatest misfit.
        upright: the shape's z axis must not point downwards.
        expected_m: (K, 3) where the markers are expected, if that is known.
        reach_m: greatest distance of a detection from where its marker is expected.
        least: how many of the markers must be found, three or more.
    """
    K = len(shape_m)
    wanted = np.linalg.norm(shape_m[:, None] - shape_m[None], axis=2)
    apart = np.linalg.norm(detections_m[:, None] - detections_m[None], axis=2)
    within = np.ones((K, len(detections_m)), dtype=bool)
    if expected_m is not None:
        within = np.linalg.norm(expected_m[:, None] - detections_m[None], axis=2) <= reach_m
    best: ShapeMatch | None = None

    def extend(named: list[int]) -> None:
        nonlocal best
        k, found = len(named), sum(d >= 0 for d in named)
        if found + K - k < max(least, 0 if best is None else best.count):
            return
        if k == K:
            match = _judged(shape_m, detections_m, np.array(named), limit_m, upright, expected_m)
            best = max(best, match, key=_rank)
            return
        fits = within[k].copy()
        for other, taken in enumerate(named):
            if taken >= 0:
                fits &= np.abs(apart[taken] - wanted[k, other]) <= 2 * limit_m
                fits[taken] = False
        for d in np.flatnonzero(fits).tolist():
            extend([*named, d])
        extend([*named, -1])

    extend([])
    return best


def find_start(
    markers: MarkerSet,
    detections_m: ArrayLike,
    shapes: Mapping[str, FloatArray] | None = None,
    limit_m: float = 0.015,
) -> FloatArray:
    """Return the labels (M, 3), NaN where hidden, of detections (P, 3) in any order, of a person in any posture.

    Args:
        markers: the labels to give.
        detections_m: one frame, in a frame with z up; positions that are not finite are dropped.
        shapes: the segments' shapes on this person (`marker_gaps.measure_shapes` of a labelled trial); the marker set's
            if left out, which fits only markers put within the limit of where the set has them.
        limit_m: how far a marker may be from its place in the shape.

    Raises:
        ArrayError: another shape.
        MotionError: segments of which fewer than three markers (one of the shoulder's) are recognised.
    """
    seen = checked("detections_m", detections_m, ("P", 3), finite=False)
    seen = seen[seen_in(seen)]
    shapes = {**nominal_shapes(markers), **(shapes or {})}
    labelled = np.full((len(markers.names), 3), np.nan)
    free = np.ones(len(seen), dtype=bool)
    unfound = [segment for segment in markers.of_segment if segment != "shoulder"]
    torso: tuple[FloatArray, FloatArray] | None = None
    while unfound:
        # The surest segment first: its detections are then out of the way of the others.
        matches = {s: match_shape(shapes[s], seen[free], limit_m, s in UPRIGHT) for s in unfound}
        sure = max(unfound, key=lambda s: _rank(matches[s]))
        match = matches[sure]
        if match is None:
            break
        own, numbers = markers.of_segment[sure], np.flatnonzero(free)[match.detection[match.detection >= 0]]
        labelled[own[match.detection >= 0]] = seen[numbers]
        free[numbers] = False
        unfound.remove(sure)
        if sure == "torso":
            R, p = place(shapes[sure][match.detection >= 0], seen[None, numbers])
            torso = R[0], p[0] + R[0] @ shapes[sure].mean(axis=0)
    if torso is not None:
        own = markers.of_segment["shoulder"]
        labelled[own] = _shoulder(shapes["shoulder"], seen[free], *torso, limit_m)
    if not np.isfinite(labelled[markers.of_segment["shoulder"]]).any():
        unfound.append("shoulder")
    if unfound:
        said = "; ".join(
            f"{segment} ({', '.join(markers.names[i] for i in markers.of_segment[segment])})" for segment in unfound
        )
        raise MotionError(
            f"marker labels: wanted detections in which every segment can be recognised by its shape, got "
            f"{len(seen)} for {len(markers.names)} markers and too few for: {said}; start with a frame that shows "
            "them, or measure the shapes on a labelled trial of this person"
        )
    return labelled


def _shoulder(shape: FloatArray, seen: FloatArray, R: FloatArray, centre: FloatArray, limit_m: float) -> FloatArray:
    """Return the two shoulder markers (2, 3): the pair that is apart as the torso's orientation wants it."""
    apart = R @ (shape[0] - shape[1])
    off = np.linalg.norm(seen[:, None] - seen[None] - apart, axis=2)
    off[np.linalg.norm(seen - centre, axis=1) > SHOULDER_REACH_M] = np.inf
    pair = np.full((2, 3), np.nan)
    if off.size and off.min() <= 2 * limit_m:
        a, b = np.unravel_index(np.argmin(off), off.shape)
        pair[0], pair[1] = seen[a], seen[b]
    return pair


def _judged(
    shape: FloatArray,
    detections: FloatArray,
    named: NDArray[np.int64],
    limit_m: float,
    upright: bool,
    expected: FloatArray | None,
) -> ShapeMatch | None:
    here = named >= 0
    if not is_spread(shape[here]):
        return None
    points = detections[None, named[here]]
    off = float(misfit_m(shape[here], points).max())
    if off > limit_m or (upright and place(shape[here], points)[0][0, 2, 2] < 0):
        return None
    if expected is not None:
        off = float(np.linalg.norm(points[0] - expected[here], axis=1).max())
    return ShapeMatch(named, off)


def _rank(match: ShapeMatch | None) -> tuple[int, float]:
    return (0, 0.0) if match is None else (match.count, -match.off_m)
