"""A body as a few rigid parts, and how the recorded people moved theirs on from each posture of a library.

Five poses say where a body is, and thirty links need not be moved.

Of every motion and part of the body the poses are kept at even steps of movement, not of time: while a part rests, one
pose says it all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.forest import Exemplars

Float32Array = NDArray[np.float32]
#: Moments between two exemplar postures: so many times finer a quick movement can be followed.
MOMENTS = 4

#: Steps of this share of a whole never fall together: points in this order are spread evenly, however many are taken.
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)


@dataclass(frozen=True, eq=False)
class BodyParts:
    """The body's surface in P parts, each dealt out to R rounds that cover it thinly.

    Attributes:
        link: (P,) number of the link in whose frame each part's points are.
        points: coordinates x, y, z, each (N,), part after part, and round after round within a part.
        first: (P, R + 1) where each part's rounds begin, and where its last one ends.
        corners_m: (P, 8, 3) of the box around each part's points; the first and the last are opposite.
    """

    link: NDArray[np.int64]
    points: tuple[Float32Array, Float32Array, Float32Array]
    first: NDArray[np.int64]
    corners_m: FloatArray

    @classmethod
    def of(cls, human: HumanModel, spacing_m: float, n_rounds: int) -> BodyParts:
        """Return the parts of a human, with points `spacing_m` apart if all rounds are taken together."""
        surface = human.surface(spacing_m)
        part_of, T_part_link = rigid_parts(human)
        heads = np.unique(part_of[surface.link])
        points, first, corners = [], [], []
        n = 0
        for head in heads:
            mine = part_of[surface.link] == head
            T = T_part_link[surface.link[mine]]
            local = np.einsum("nab,nb->na", T[:, :3, :3], surface.local_m[mine]) + T[:, :3, 3]
            low, high = local.min(axis=0), local.max(axis=0)
            corners.append([np.where([i & 4, i & 2, i & 1], high, low) for i in range(8)])
            first.append([n])
            for r in range(n_rounds):
                dealt = local[r::n_rounds]
                # Neighbours on the surface mostly share a voxel; marking one voxel twice in a row is slow.
                points.append(dealt[np.argsort(np.arange(len(dealt)) * _GOLDEN_RATIO % 1.0)])
                n += len(dealt)
                first[-1].append(n)
        x, y, z = np.ascontiguousarray(np.concatenate(points).T.astype(np.float32))
        return cls(heads, (x, y, z), np.array(first, dtype=np.int64), np.array(corners))


def rigid_parts(human: HumanModel) -> tuple[NDArray[np.int64], FloatArray]:
    """Return for each of L links the first link (L,) that it is fixed to, and its pose (L, 4, 4) in that one's frame.

    Links are fixed to each other if their relative pose is the same in two postures that differ in every DoF.
    """
    zero = np.zeros(len(human.dof_names))
    poses = human.link_poses(np.stack([zero, np.linspace(0.1, 0.4, len(zero))]))
    part_of = np.arange(len(human.link_names))
    T_part_link = np.tile(np.eye(4), (len(part_of), 1, 1))
    for link in range(1, len(part_of)):
        relative = np.linalg.inv(poses[:, :link]) @ poses[:, link, None]
        fixed = np.flatnonzero(np.abs(relative[0] - relative[1]).max(axis=(1, 2)) < 1e-9)
        if len(fixed):
            part_of[link], T_part_link[link] = fixed[0], relative[0, fixed[0]]
    return part_of, T_part_link


class Ways(NamedTuple):
    """Poses of P parts in K motions, library frame, as compiled code takes them.

    Attributes:
        present: (M, P, 3, 4) poses in the exemplar postures.
        pose: (N, 3, 4) poses on the way, motion by motion, and part by part within a motion.
        moment: (N,) when in its motion each of these is passed, `MOMENTS` to an exemplar posture.
        first: (K, P + 1) where the poses of each motion and part begin, and where the last part's end.
        begin: (K + 1,) where each motion's exemplar postures begin.
    """

    present: Float32Array
    pose: Float32Array
    moment: NDArray[np.int64]
    first: NDArray[np.int64]
    begin: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RecordedFutures:
    """The ways the body's parts went in every motion of a library.

    Attributes:
        ways: the poses.
        label: (M,) number of each exemplar posture's class.
        n_classes: C.
    """

    ways: Ways
    label: NDArray[np.int64]
    n_classes: int

    @classmethod
    def of(cls, exemplars: Exemplars, human: HumanModel, parts: BodyParts, step_m: float) -> RecordedFutures:
        """Prepare the motions of a library.

        Args:
            exemplars: the library's postures.
            human: whose postures they are.
            parts: of this human.
            step_m: a pose is kept as soon as some corner of the part is so far from where it was in the last one kept.
        """
        present, poses, moments, first = [], [], [], []
        n = 0
        for start, end in zip(exemplars.first[:-1], exemplars.first[1:], strict=True):
            on_the_way = human.link_poses(_in_moments(exemplars.q[start:end]))[:, parts.link, :3]
            kept = _steps(np.ascontiguousarray(on_the_way), parts.corners_m, step_m)
            present.append(on_the_way[::MOMENTS])
            first.append([n])
            for part in range(len(parts.link)):
                at = np.flatnonzero(kept[:, part])
                poses.append(on_the_way[at, part])
                moments.append(at)
                n += len(at)
                first[-1].append(n)
        ways = Ways(
            np.concatenate(present).astype(np.float32),
            np.concatenate(poses).astype(np.float32),
            np.concatenate(moments).astype(np.int64),
            np.array(first, dtype=np.int64),
            np.array(exemplars.first, dtype=np.int64),
        )
        label = np.asarray(exemplars.label[exemplars.motion], dtype=np.int64)
        return cls(ways, label, int(exemplars.label.max()) + 1)


def _in_moments(q: FloatArray) -> FloatArray:
    """Return postures (MOMENTS * (T - 1) + 1, D) that lie evenly between postures (T, D)."""
    moment = np.arange(MOMENTS * (len(q) - 1) + 1)
    before = moment // MOMENTS
    after = np.minimum(before + 1, len(q) - 1)
    between: FloatArray = q[before] + (moment % MOMENTS / MOMENTS)[:, None] * (q[after] - q[before])
    return between


@exact
def _steps(poses: FloatArray, corners: FloatArray, step_m: float) -> NDArray[np.bool_]:
    """Return (T, P) which of the poses (T, P, 3, 4) to keep: the first, the last, and where a step is full."""
    n_moments, n_parts = poses.shape[:2]
    kept = np.zeros((n_moments, n_parts), dtype=np.bool_)
    for p in range(n_parts):
        kept[0, p] = kept[n_moments - 1, p] = True
        last = 0
        for t in range(1, n_moments):
            farthest = 0.0
            for c in range(len(corners[p])):
                square = 0.0
                for a in range(3):
                    d = poses[t, p, a, 3] - poses[last, p, a, 3]
                    for b in range(3):
                        d += (poses[t, p, a, b] - poses[last, p, a, b]) * corners[p, c, b]
                    square += d * d
                farthest = max(farthest, square)
            if farthest >= step_m * step_m:
                kept[t, p] = True
                last = t
    return kept
