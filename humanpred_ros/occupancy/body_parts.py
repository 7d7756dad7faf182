"""A body is a handful of parts that move rigidly: five poses say where it is, and thirty links need not be moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel

Float32Array = NDArray[np.float32]
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
