"""Gives names to unnamed marker positions: cameras detect points, not labels.

The first frame is labelled by shape: a segment's markers keep their distances, so the detections with just these
distances are its markers, wherever the person stands and in whatever posture. Waist and torso are distinguished from
their mirror images by being upright.

The frames after it are labelled by closest distance (P2 IV-B). Each frame's detections are matched to where the
markers are expected: at their last place, moved by the last step of their segment; hidden ones move with the other
markers of their segment, and a hidden segment with its parent. The match minimises the sum of squared distances, so
that a common motion of all markers does not mislead it. Then every segment must have its shape: one that has not is
searched by its shape nearby, and hidden (NaN) if it is not found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.marker_set import MarkerSet, is_spread, misfit_m, pairwise_m, place, seen_in

# What counts as the same marker. A hand that accelerates by 100 m/s² is 0.01 m off after 0.01 s, a marker next to it
# 0.04 m away.
FARTHEST_M = 0.04  #: most between a detection and its marker's expected place
SEARCH_M_S = 2.0  #: how fast this distance grows for a hidden segment
SEARCH_M = 0.25  #: the most it grows to, for all markers of a segment together
MISFIT_M = 0.01  #: how far labelled markers may be from their segment's shape
#: Segments that are upright whenever a person stands or sits, and how far (m) a shoulder is from the torso's centre.
UPRIGHT = ("waist", "torso")
SHOULDER_REACH_M = 0.45


@dataclass(frozen=True)
class ShapeMatch:
    """Which detections are a segment's markers."""

    detection: NDArray[np.int64]  #: (K,) number of each marker's detection, -1 where there is none
    off_m: float  #: greatest distance of one of them from the shape, or from where it is expected

    @property
    def count(self) -> int:
        """How many of the markers were found."""
        return int((self.detection >= 0).sum())


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

    The result has as many markers as possible, and of such results the best fit, or the one nearest to what is
    expected. It is a tree search: the next marker is tried on detections whose distances to those already named are
    right to twice the limit.

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
        shapes: the segments' shapes on this person (`measure_shapes` of a labelled trial); the marker set's
            if left out, which fits only markers put within the limit of where the set has them.
        limit_m: how far a marker may be from its place in the shape.

    Raises:
        ArrayError: another shape.
        MotionError: segments of which fewer than three markers (one of the shoulder's) are recognised.
    """
    seen = checked("detections_m", detections_m, ("P", 3), finite=False)
    seen = seen[seen_in(seen)]
    shapes = {**markers.shapes, **(shapes or {})}
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
        said = "; ".join(f"{segment} ({markers.labels(segment)})" for segment in unfound)
        raise MotionError(
            f"marker labels: wanted detections in which every segment can be recognised by its shape, got "
            f"{len(seen)} for {len(markers.names)} markers and too few for: {said}; start with a frame that shows "
            "them, or measure the shapes on a labelled trial of this person"
        )
    return labelled


def _shoulder(shape: FloatArray, seen: FloatArray, R: FloatArray, centre: FloatArray, limit_m: float) -> FloatArray:
    """Return the two shoulder markers (2, 3): the pair that the torso's orientation fits."""
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


def label_markers(
    markers: MarkerSet,
    detections_m: Sequence[ArrayLike],
    t_s: ArrayLike,
    start_m: ArrayLike,
    shapes: Mapping[str, FloatArray] | None = None,
) -> FloatArray:
    """Return labelled markers (T, M, 3), NaN where hidden, of T frames of detections (P, 3) in any order.

    Args:
        markers: the labels to give.
        detections_m: the frames; detections with a coordinate that is not finite are dropped.
        t_s: (T,) their stamps, rising.
        start_m: (M, 3) where the markers are in the first frame (`find_start`, or a labelled frame), NaN where hidden.
        shapes: each segment's shape (see `find_start`); the first frames' if left out.

    Raises:
        ArrayError: another shape.
        MotionError: no frames, stamps that do not rise, or a segment of which the first frame shows too little.
    """
    stamps = checked("t_s", t_s, (len(detections_m),))
    if not len(stamps) or (np.diff(stamps) <= 0.0).any():
        raise MotionError(f"marker labels: wanted at least one frame and rising stamps, got {len(stamps)} frames")
    start = checked("start_m", start_m, (len(markers.names), 3), finite=False)
    labeller = _Labeller(markers, start, shapes)
    frames = [checked("detections_m", frame, ("P", 3), finite=False) for frame in detections_m]
    labelled = [labeller.update(seen[seen_in(seen)], float(t)) for seen, t in zip(frames, stamps, strict=True)]
    return np.stack(labelled)


class _Labeller:
    """Labels a recording frame by frame; keeps the last places of the markers. Arguments as of `label_markers`."""

    def __init__(
        self,
        markers: MarkerSet,
        start: FloatArray,
        shapes: Mapping[str, FloatArray] | None,
    ) -> None:
        self.markers = markers
        self._shapes = {**markers.shapes, **(shapes or {})}
        self._places = self._completed(start)
        self._learn = shapes is None
        if shapes is None:
            self._shapes = {segment: self._places[own].copy() for segment, own in markers.of_segment.items()}
        self._looks = dict.fromkeys(markers.of_segment, 1)
        self._step = np.zeros_like(self._places)
        self._t_s = -np.inf
        self._sighted_s = dict.fromkeys(markers.of_segment, -np.inf)

    def update(self, seen: FloatArray, t_s: float) -> FloatArray:
        """Return the labelled markers (M, 3), NaN where hidden, of finite detections (P, 3) at time `t_s`."""
        self._t_s = t_s
        expected = self._places + self._step
        number = _match(expected, seen)
        labelled = np.full_like(expected, np.nan)
        labelled[number >= 0] = seen[number[number >= 0]]
        for segment, own in self.markers.of_segment.items():
            if not self._keeps_shape(segment, labelled[own]):
                labelled[own], number[own] = np.nan, -1
        before = self._places.copy()
        parent = self.markers.of_segment["waist"]
        for segment, own in self.markers.of_segment.items():
            here = seen_in(labelled[own])
            if not here.any():  # hidden: where it would be if it moved with its parent
                expected[own] = _carried(before[own], before[parent], self._places[parent])
            if len(own) > 2 and not here.all():
                self._search(segment, seen, number, labelled, expected[own])
            if seen_in(labelled[own]).any():
                self._sighted_s[segment] = self._t_s
            now = self._now(segment, labelled[own], before[own], expected[own])
            self._step[own] = (now - before[own]).mean(axis=0)
            self._places[own] = now
            parent = own if len(own) > 2 else parent  # the shoulder's two markers carry nothing
        return labelled

    def _keeps_shape(self, segment: str, labelled: FloatArray) -> bool:
        """Return whether what is seen of a segment has its shape."""
        here = seen_in(labelled)
        shape = self._shapes[segment][here]
        if is_spread(shape):
            return bool(misfit_m(shape, labelled[None, here]).max() <= MISFIT_M)
        longer = pairwise_m(labelled[None, here]) - pairwise_m(shape[None])
        return bool((np.abs(longer) <= 2 * MISFIT_M).all())

    def _search(
        self,
        segment: str,
        seen: FloatArray,
        number: NDArray[np.int64],
        labelled: FloatArray,
        expected: FloatArray,
    ) -> None:
        """Look for a segment by its shape among the detections nearby that no other marker has; in place.

        Also where three markers have been found: a wrong three may fit by chance, the right four fit better.
        """
        own = self.markers.of_segment[segment]
        hidden_s = self._t_s - self._sighted_s[segment]
        near = np.linalg.norm(seen[:, None] - expected[None], axis=2).min(axis=1) <= SEARCH_M
        near[np.setdiff1d(number[number >= 0], number[own])] = False
        candidates, count = np.flatnonzero(near), int((number[own] >= 0).sum())
        if len(candidates) <= count:
            return
        # All markers in their shape are accepted anywhere; three of them may be false detections.
        reach_m = min(FARTHEST_M + SEARCH_M_S * hidden_s, SEARCH_M)
        shape, upright = self._shapes[segment], segment in UPRIGHT
        match = match_shape(shape, seen[candidates], MISFIT_M, upright, expected, SEARCH_M, len(own))
        if match is None:
            match = match_shape(shape, seen[candidates], MISFIT_M, upright, expected, reach_m)
        if match is not None and match.count > count:
            found = match.detection >= 0
            number[own], labelled[own] = -1, np.nan
            number[own[found]] = candidates[match.detection[found]]
            labelled[own[found]] = seen[number[own[found]]]

    def _now(self, segment: str, labelled: FloatArray, before: FloatArray, expected: FloatArray) -> FloatArray:
        """Return where a segment's markers (K, 3) are, the hidden ones by the others."""
        here = seen_in(labelled)
        shape = self._shapes[segment]
        now = np.where(here[:, None], labelled, expected)
        if here.all() and self._learn and len(now) > 2:
            self._average(segment, now)
        if is_spread(shape[here]):
            now[~here] = _carried(shape, shape[here], labelled[here])[~here]
        elif here.any():
            now[~here] = before[~here] + (labelled - before)[here].mean(axis=0)
        return now

    def _average(self, segment: str, now: FloatArray) -> None:
        """Let a segment's shape be the mean over the frames that show it whole: the first alone is noisy."""
        shape = self._shapes[segment]
        self._looks[segment] += 1
        R, p = place(shape, now[None])
        shape += ((now - p[0]) @ R[0] - shape) / self._looks[segment]

    def _completed(self, start: FloatArray) -> FloatArray:
        """Return the start (M, 3) with hidden markers put where their segment's others place them."""
        places = start.copy()
        for segment, own in self.markers.of_segment.items():
            here = seen_in(start[own])
            shape = self._shapes[segment]
            if here.all():
                continue
            if is_spread(shape[here]):
                places[own[~here]] = _carried(shape, shape[here], start[own[here]])[~here]
            elif segment == "shoulder" and here.any():
                torso, local = self.markers.of_segment["torso"], self.markers.local_m
                R, _ = place(local[torso], places[None, torso])
                places[own[~here]] = start[own[here]] + (local[own[~here]] - local[own[here]]) @ R[0].T
            else:
                hidden = ", ".join(self.markers.names[i] for i in own[~here])
                raise MotionError(
                    f"marker labels: wanted a first frame that shows every segment, but of the {segment} {hidden} are "
                    "hidden; start with a frame that shows at least three markers of each segment (one of the shoulder)"
                )
        return places


def _match(expected: FloatArray, seen: FloatArray) -> NDArray[np.int64]:
    """Return the number of the detection (M,) of each expected marker, -1 if none is near enough."""
    off = np.linalg.norm(expected[:, None] - seen[None], axis=2)
    # Detections beyond the limit all cost the same, so that they do not pull the other matches away.
    rows, columns = linear_sum_assignment(np.minimum(off, FARTHEST_M + 1e-9) ** 2)
    number = np.full(len(expected), -1, dtype=np.int64)
    near = off[rows, columns] <= FARTHEST_M
    number[rows[near]] = columns[near]
    return number


def _carried(points: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the points (K, 3) moved as the cluster `before` (L, 3) moved to `after`."""
    R, p = place(before, after[None])
    return np.asarray(points @ R[0].T + p[0])
