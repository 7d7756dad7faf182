"""The markers a person wears for the 23-DoF human: places of markers define joint centres.

Anatomical markers come in pairs whose middle is a joint centre, as in P2 IV-B and the ISB's recommendations: xiphoid
process and eighth thoracic vertebra (torso), front and back of the shoulder, both epicondyles (elbow), both styloid
processes (wrist). The others keep a segment's position when one of a pair is hidden.

The local positions are those of an average person. Postures do not depend on them (see `segment_angles`); synthetic
markers and the first labels do. The plates on arm and hand are placed so that no exchange of two labels keeps a
segment's shape (the next best labelling of four markers is 0.021 m off, of three 0.007 m), and so that three markers
determine the fourth well. The waist is its own mirror image; that it is upright resolves this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel

#: The segments, from the root outwards, and the link of the model each moves with.
LINK_OF_SEGMENT = MappingProxyType(
    {
        "waist": "pelvis", "torso": "torso", "shoulder": "right_shoulder",
        "upper_arm": "right_elbow", "forearm": "right_wrist", "hand": "right_hand",
    }
)  # fmt: skip


@dataclass(frozen=True)
class Marker:
    """One marker."""

    name: str  #: its label
    segment: str  #: one of `LINK_OF_SEGMENT`
    local_m: tuple[float, float, float]  #: where it is in the segment's link, metres


#: x forward, y left, z up with hanging arms and palms forward; "lateral" is to the right on the right arm.
UPPER_BODY = (
    Marker("LASI", "waist", (0.120, 0.120, 0.0)),  # left and right front of the pelvis (anterior superior iliac spines)
    Marker("RASI", "waist", (0.120, -0.120, 0.0)),
    Marker("LPSI", "waist", (-0.080, 0.050, 0.0)),  # left and right back of the pelvis
    Marker("RPSI", "waist", (-0.080, -0.050, 0.0)),
    Marker("PX", "torso", (0.115, 0.0, 0.0)),  # xiphoid process
    Marker("T8", "torso", (-0.115, 0.0, 0.0)),  # eighth thoracic vertebra
    Marker("IJ", "torso", (0.075, 0.0, 0.120)),  # jugular notch
    Marker("C7", "torso", (-0.075, 0.0, 0.200)),  # seventh cervical vertebra
    Marker("RSF", "shoulder", (0.055, 0.0, 0.0)),  # front and back of the shoulder
    Marker("RSB", "shoulder", (-0.055, 0.0, 0.0)),
    Marker("REL", "upper_arm", (0.0, -0.045, 0.0)),  # lateral and medial epicondyle
    Marker("REM", "upper_arm", (0.0, 0.045, 0.0)),
    Marker("RUA", "upper_arm", (-0.006, -0.053, 0.161)),  # outside and back of the upper arm
    Marker("RUB", "upper_arm", (-0.049, -0.014, 0.091)),
    Marker("RRS", "forearm", (0.0, -0.032, 0.0)),  # radial and ulnar styloid process
    Marker("RUS", "forearm", (0.0, 0.032, 0.0)),
    Marker("RFA", "forearm", (-0.034, -0.021, 0.076)),  # back and outside of the forearm
    Marker("RFB", "forearm", (-0.006, -0.039, 0.140)),
    Marker("RH2", "hand", (0.0, -0.035, -0.080)),  # heads of the second and fifth metacarpal
    Marker("RH5", "hand", (0.0, 0.035, -0.080)),
    Marker("RHD", "hand", (-0.020, -0.022, -0.026)),  # back of the hand
    Marker("RHT", "hand", (-0.026, -0.056, -0.063)),  # base of the thumb
)


@dataclass(frozen=True)
class MarkerSet:
    """Markers in the order of a recording's columns; `UPPER_BODY` unless stated.

    Raises:
        HumanModelError: doubled names, unknown segments, or anatomical markers that are lacking.
    """

    markers: Sequence[Marker] = UPPER_BODY

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        names = [marker.name for marker in self.markers]
        needed = {name for pair in ANATOMICAL.values() for name in pair}
        for problem, found in (
            ("names given twice", sorted({name for name in names if names.count(name) > 1})),
            ("unknown segments", sorted({m.segment for m in self.markers} - LINK_OF_SEGMENT.keys())),
            ("markers lacking", sorted(needed - set(names))),
            ("markers on another segment than theirs", sorted(
                m.name for m in self.markers for segment, pair in ANATOMICAL.items()
                if m.name in pair and m.segment != segment)),
        ):  # fmt: skip
            if found:
                raise HumanModelError(f"marker set: {problem}: {', '.join(found)}; see human.marker_set.UPPER_BODY")

    @property
    def names(self) -> tuple[str, ...]:
        """The labels, in order."""
        return tuple(marker.name for marker in self.markers)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Column of each marker."""
        return MappingProxyType({name: i for i, name in enumerate(self.names)})

    @cached_property
    def of_segment(self) -> Mapping[str, NDArray[np.int64]]:
        """The columns of each segment's markers, segments from the root outwards."""
        return MappingProxyType(
            {
                segment: np.array([i for i, m in enumerate(self.markers) if m.segment == segment], dtype=np.int64)
                for segment in LINK_OF_SEGMENT
            }
        )

    @cached_property
    def local_m(self) -> FloatArray:
        """(M, 3) the markers in their segments' links."""
        return np.array([marker.local_m for marker in self.markers], dtype=np.float64)

    @property
    def shapes(self) -> dict[str, FloatArray]:
        """Each segment's shape (K, 3), its markers in its link."""
        return {segment: self.local_m[own] for segment, own in self.of_segment.items()}

    def labels(self, segment: str) -> str:
        """Return the labels of a segment's markers, for messages."""
        return ", ".join(self.names[i] for i in self.of_segment[segment])

    def places(self, model: HumanModel, q: ArrayLike) -> FloatArray:
        """Return where the markers are (..., M, 3) for postures (..., 23) of the 23-DoF human.

        Raises:
            HumanModelError: another model, or postures that do not fit it.
        """
        links = [LINK_OF_SEGMENT[marker.segment] for marker in self.markers]
        return np.asarray(ChainPoints(model, links, self.local_m).positions(np.asarray(q, dtype=np.float64)))


#: The markers that define each segment's frame and joint centre (`segment_angles`).
ANATOMICAL = MappingProxyType(
    {
        "waist": ("LASI", "RASI", "LPSI", "RPSI"),
        "torso": ("PX", "T8", "IJ", "C7"),
        "shoulder": ("RSF", "RSB"),
        "upper_arm": ("REL", "REM"),
        "forearm": ("RRS", "RUS"),
        "hand": ("RH2", "RH5"),
    }
)


#: A cluster whose points stray less than this (m) from a line shows no rotation about it.
THICKNESS_M = 0.01


def place(shape_m: FloatArray, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotations (T, 3, 3) and translations (T, 3) that bring the shape (K, 3) nearest to points (T, K, 3).

    Least squares over the K >= 3 points, all finite, by a singular value decomposition.
    """
    centre, middles = shape_m.mean(axis=0), points_m.mean(axis=1)
    spread = np.einsum("tki,kj->tij", points_m - middles[:, None], shape_m - centre)
    U, _, Vt = np.linalg.svd(spread)
    mirrored = np.linalg.det(U @ Vt) < 0
    U[mirrored, :, 2] *= -1.0
    R = U @ Vt
    return R, middles - R @ centre


def is_spread(shape_m: FloatArray) -> bool:
    """Return whether points (K, 3) determine a rotation: at least three, off one line."""
    if len(shape_m) < 3:
        return False
    return bool(np.linalg.svd(shape_m - shape_m.mean(axis=0), compute_uv=False)[1] > THICKNESS_M)


def misfit_m(shape_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return how far each point (T, K, 3) is from the shape (K, 3) placed on all of them: (T, K) metres."""
    R, p = place(shape_m, points_m)
    return np.asarray(np.linalg.norm(np.einsum("tij,kj->tki", R, shape_m) + p[:, None] - points_m, axis=2))


def mean_shape(points_m: FloatArray, rounds: int = 3) -> FloatArray:
    """Return the shape (K, 3) that points (T, K, 3), all finite, T >= 1, have in common, in its own frame.

    Robust: the median of the points placed on each other, so that a minority of displaced ones does not count.
    """
    shape = points_m[_most_usual(points_m)]
    for _ in range(rounds):
        R, p = place(shape, points_m)
        shape = np.median(np.einsum("tji,tkj->tki", R, points_m - p[:, None]), axis=0)
    return np.asarray(shape - shape.mean(axis=0))


def _most_usual(points_m: FloatArray) -> int:
    """Return the frame whose distances between points are nearest to the median ones."""
    distances = pairwise_m(points_m)
    return int(np.argmin(np.abs(distances - np.median(distances, axis=0)).max(axis=1)))


def pairwise_m(points_m: FloatArray) -> FloatArray:
    """Return the distances (T, K * (K - 1) / 2) between the points (T, K, 3) of each frame."""
    i, j = np.triu_indices(points_m.shape[1], 1)
    return np.asarray(np.linalg.norm(points_m[:, i] - points_m[:, j], axis=2))


def seen_in(points_m: FloatArray) -> NDArray[np.bool_]:
    """Return which points (..., 3) have finite coordinates: (...)."""
    return np.asarray(np.isfinite(points_m).all(axis=-1))


def groups_of(mask: NDArray[np.bool_]) -> list[tuple[NDArray[np.bool_], NDArray[np.int64]]]:
    """Return the different rows of `mask` (T, K) and the frames that have them, to treat those at once."""
    rows, which = np.unique(mask, axis=0, return_inverse=True)
    return [(row, np.flatnonzero(which.ravel() == k)) for k, row in enumerate(rows)]
