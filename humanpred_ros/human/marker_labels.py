"""Giving names to unnamed marker positions, frame by frame by closest distance, because cameras see dots, not labels.

Each frame's detections are matched to where the labelled markers are expected: where they were, moved on by the last
step of their segment; hidden ones move with their segment's others, and a segment out of sight with the one it hangs
on. The match minimises the sum of squared distances, which a common motion of all markers cannot mislead. Then every
segment must have its shape: one that has not is searched by its shape near by, and hidden (NaN) if not found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.rigid_fit import is_spread, misfit_m, pairwise_m, place, seen_in
from humanpred_ros.human.marker_set import MarkerSet
from humanpred_ros.human.marker_shapes import UPRIGHT, match_shape, nominal_shapes


@dataclass(frozen=True)
class LabelConfig:
    """What still counts as the same marker.

    Attributes:
        farthest_m: greatest distance of a detection from where its marker is expected: a hand that accelerates by
            100 m/s² is 0.01 m off after 0.01 s, a marker next to it 0.04 m away.
        search_m_s: how fast this distance grows for a segment that is out of sight.
        search_m: the most it grows to, and how far all markers of a segment together may be.
        misfit_m: how far markers of a segment may be from its shape: noise and skin.
    """

    farthest_m: float = 0.04
    search_m_s: float = 2.0
    search_m: float = 0.25
    misfit_m: float = 0.01


class MarkerLabeller:
    """Labels a recording frame by frame; holds where the markers were last.

    Args:
        markers: the labels to give.
        start_m: (M, 3) labelled markers of the first frame (`find_start` makes them), NaN where hidden.
        t_s: that frame's stamp.
        shapes: each segment's shape (see `find_start`); the first frames' if left out.
        config: what counts as the same marker.

    Raises:
        ArrayError: another shape.
        MotionError: a segment of which the first frame shows too little.
    """

    def __init__(
        self,
        markers: MarkerSet,
        start_m: ArrayLike,
        t_s: float,
        shapes: Mapping[str, FloatArray] | None = None,
        config: LabelConfig = LabelConfig(),
    ) -> None:
        self.markers = markers
        self.config = config
        start = checked("start_m", start_m, (len(markers.names), 3), finite=False)
        self._shapes = {**nominal_shapes(markers), **(shapes or {})}
        self._places = self._completed(start)
        self._learn = shapes is None
        if shapes is None:
            self._shapes = {segment: self._places[own].copy() for segment, own in markers.of_segment.items()}
        self._looks = dict.fromkeys(markers.of_segment, 1)
        self._step = np.zeros_like(self._places)
        self._t_s = t_s
        self._sighted_s = dict.fromkeys(markers.of_segment, t_s)

    def update(self, detections_m: ArrayLike, t_s: float) -> FloatArray:
        """Return the labelled markers (M, 3), NaN where hidden, of detections (P, 3) in any order at time `t_s`.

        Detections with a coordinate that is not finite are dropped.

        Raises:
            ArrayError: another shape.
            MotionError: a stamp that does not rise.
        """
        seen = checked("detections_m", detections_m, ("P", 3), finite=False)
        seen = seen[seen_in(seen)]
        if t_s <= self._t_s:
            raise MotionError(f"marker labels: wanted rising stamps, got {t_s} s after {self._t_s} s")
        self._t_s = t_s
        return self._label(seen)

    def _label(self, seen: FloatArray) -> FloatArray:
        expected = self._places + self._step
        number = _match(expected, seen, self.config.farthest_m)
        labelled = np.where(number[:, None] >= 0, seen[number] if len(seen) else np.nan, np.nan)
        for segment, own in self.markers.of_segment.items():
            if not self._keeps_shape(segment, labelled[own]):
                labelled[own], number[own] = np.nan, -1
        before = self._places.copy()
        parent = self.markers.of_segment["waist"]
        for segment, own in self.markers.of_segment.items():
            here = seen_in(labelled[own])
            if not here.any():  # out of sight: where it would be if it moved with the segment it hangs on
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
            return bool(misfit_m(shape, labelled[None, here]).max() <= self.config.misfit_m)
        longer = pairwise_m(labelled[None, here]) - pairwise_m(shape[None])
        return bool((np.abs(longer) <= 2 * self.config.misfit_m).all())

    def _search(
        self,
        segment: str,
        seen: FloatArray,
        number: NDArray[np.int64],
        labelled: FloatArray,
        expected: FloatArray,
    ) -> None:
        """Look for a segment by its shape among the detections near by that no other marker has; in place.

        Also where three markers have been found: a wrong three may fit by chance, the right four fit better.
        """
        own = self.markers.of_segment[segment]
        search_m, hidden_s = self.config.search_m, self._t_s - self._sighted_s[segment]
        near = np.linalg.norm(seen[:, None] - expected[None], axis=2).min(axis=1) <= search_m
        near[np.setdiff1d(number[number >= 0], number[own])] = False
        candidates, count = np.flatnonzero(near), int((number[own] >= 0).sum())
        if len(candidates) <= count:
            return
        # All markers in their shape are sure enough to be believed anywhere; three may be false detections.
        reach_m = min(self.config.farthest_m + self.config.search_m_s * hidden_s, search_m)
        shape, upright, limit_m = self._shapes[segment], segment in UPRIGHT, self.config.misfit_m
        match = match_shape(shape, seen[candidates], limit_m, upright, expected, search_m, len(own))
        if match is None:
            match = match_shape(shape, seen[candidates], limit_m, upright, expected, reach_m)
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
        """Return the start (M, 3) with hidden markers put where their segment's others want them."""
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


def label_markers(
    markers: MarkerSet,
    detections_m: Sequence[ArrayLike],
    t_s: ArrayLike,
    start_m: ArrayLike,
    shapes: Mapping[str, FloatArray] | None = None,
    config: LabelConfig = LabelConfig(),
) -> FloatArray:
    """Return labelled markers (T, M, 3), NaN where hidden, of T frames of detections (P, 3) in any order.

    Args:
        markers: the labels to give.
        detections_m: the frames.
        t_s: (T,) their stamps, rising.
        start_m: (M, 3) where the markers are in the first frame (`find_start`, or a labelled frame).
        shapes: each segment's shape, as for `MarkerLabeller`.
        config: what counts as the same marker.

    Raises:
        ArrayError, MotionError: as `MarkerLabeller`.
    """
    stamps = checked("t_s", t_s, (len(detections_m),))
    if not len(stamps):
        raise MotionError("marker labels: wanted at least one frame, got none")
    labeller = MarkerLabeller(markers, start_m, -np.inf, shapes, config)
    return np.stack([labeller.update(frame, float(t)) for frame, t in zip(detections_m, stamps, strict=True)])


def _match(expected: FloatArray, seen: FloatArray, farthest_m: float) -> NDArray[np.int64]:
    """Return the number of the detection (M,) of each expected marker, -1 if none is near enough."""
    off = np.linalg.norm(expected[:, None] - seen[None], axis=2)
    # Beyond reach one detection is as bad as another and must not pull the others away.
    rows, columns = linear_sum_assignment(np.minimum(off, farthest_m + 1e-9) ** 2)
    number = np.full(len(expected), -1, dtype=np.int64)
    near = off[rows, columns] <= farthest_m
    number[rows[near]] = columns[near]
    return number


def _carried(points: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the points (K, 3) moved as the cluster `before` (L, 3) moved to `after`."""
    R, p = place(before, after[None])
    return np.asarray(points @ R[0].T + p[0])
