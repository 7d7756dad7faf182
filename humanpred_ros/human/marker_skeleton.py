"""Converts between labelled markers and the 23 DoFs of P2's human.

Hidden markers are filled (`marker_gaps`); joint centres, frames and angles follow from anatomical markers
(`segment_angles`). What the markers do not determine is NaN in the postures and named in the result, never guessed;
labels that cannot be right are an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.marker_gaps import FilledMarkers, fill_markers, measure_shapes, swapped_pair
from humanpred_ros.human.marker_set import ANATOMICAL, LINK_OF_SEGMENT, MarkerConfig, MarkerSet
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.rigid_fit import pairwise_m, seen_in
from humanpred_ros.human.segment_angles import SegmentFrames, postures_of, segment_frames

#: The DoFs of P2's human, in the order of its recordings' columns (docs/papers.md, P2 human).
MOCAP23_DOFS = (
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotX", "PelvisRotY", "PelvisRotZ",
    "TorsoX", "TorsoZ", "TorsoY", "rShoulderTransX", "rShoulderTransY", "rShoulderTransZ",
    "rShoulderY1", "rShoulderX", "rShoulderY2", "rArmTrans", "rElbowZ", "rElbowX", "rElbowY",
    "rForeArmTrans", "rWristZ", "rWristX", "rWristY",
)  # fmt: skip
#: Distances between a segment's markers, as a share of the marker set's, outside which the labels cannot be right.
PLAUSIBLE_RATIO = (0.4, 2.5)
#: How far (m) a person's markers may sit from the marker set's places before an exchange of two labels is suspected.
PLAUSIBLE_PLACE_M = 0.04


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
            "recording there or allow longer gaps (MarkerConfig.longest_gap_s)"
        )


class MarkerSkeleton:
    """Converts between markers and postures of the 23-DoF human.

    Args:
        model: the 23-DoF human; P2's if left out.
        markers: what the person wears; `UPPER_BODY` if left out.
        config: what is filled.
        shapes: each segment's shape (see `calibrated`); measured on every recording if left out.

    Raises:
        HumanModelError: another set of DoFs, or links that are lacking.
    """

    def __init__(
        self,
        model: HumanModel | None = None,
        markers: MarkerSet | None = None,
        config: MarkerConfig | None = None,
        shapes: Mapping[str, FloatArray] | None = None,
    ) -> None:
        self.model = model or HumanModel.mocap23()
        self.markers = markers or MarkerSet()
        self.config = config or MarkerConfig()
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
        return MarkerSkeleton(self.model, self.markers, self.config, shapes)

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
        filled = fill_markers(self.markers, points, stamps, shapes, self.config)
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
        _check_sides(frames)
        return MarkerPostures(postures_of(frames, self.model, self.config.upright_pelvis), filled, lost, self.markers)

    def _measured(self, points: FloatArray) -> dict[str, FloatArray]:
        """Measure the shapes and compare them with the marker set's (MotionError if the labels cannot be right)."""
        shapes = measure_shapes(self.markers, points)
        for segment, shape in shapes.items():
            labels = [self.markers.names[i] for i in self.markers.of_segment[segment]]
            wanted = self.markers.local_m[self.markers.of_segment[segment]]
            scaled = wanted * (_size_m(shape) / _size_m(wanted))
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


def _size_m(shape: FloatArray) -> float:
    return float(np.linalg.norm(shape - shape.mean(axis=0)))


def _check_sides(frames: SegmentFrames) -> None:
    """Refuse a waist that stands on its head or faces backwards: its left and right, or front and back, are swapped."""
    waist, torso = frames.rotation["waist"], frames.rotation["torso"]
    for axis, what in ((2, "left and right"), (0, "front and back")):
        against = (waist[:, :, axis] * torso[:, :, axis]).sum(axis=1) < 0  # NaN compares false
        if against.any():
            raise MotionError(
                f"markers: waist and torso point opposite ways in frame {int(np.argmax(against))}; the labels of "
                f"{what} are swapped at one of them: correct them"
            )
