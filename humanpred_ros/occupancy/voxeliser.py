"""From postures to the voxels a body touches: the step that every prediction of occupancy is made of.

P1 samples the surfaces of the body's solids 0.02 m apart and marks the voxels of 0.05 m that hold a sample (facts 3).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy import kernels

#: Distance between points on the body's surface (P1, facts 3).
DEFAULT_SPACING_M = 0.02

#: Postures listed at a time; each may need room for as many voxels as there are points.
_POSTURES_AT_ONCE = 128


@dataclass(frozen=True, eq=False)
class PostureVoxels:
    """The voxels touched in each of T postures.

    Attributes:
        flat: flat indices, ascending within a posture, one posture after the other.
        first: (T + 1,) where each posture's voxels begin in `flat`, and where the last one's end.
    """

    flat: NDArray[np.int64]
    first: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.first) - 1

    def of(self, posture: int) -> NDArray[np.int64]:
        """Return the flat indices touched in one posture, ascending."""
        return self.flat[self.first[posture] : self.first[posture + 1]]


class BodyVoxeliser:
    """Finds the voxels that a human's body touches; immutable, and safe to use from several threads.

    World placement, grid origin and resolution are folded into one transform, so that a point's voxel is one affine
    map and a truncation away.
    """

    def __init__(
        self,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        spacing_m: float = DEFAULT_SPACING_M,
        *,
        links: Collection[str] | None = None,
    ) -> None:
        """Prepare for one human, grid and placement.

        Args:
            human: the model; its points are in the tracker's frame.
            grid: the lattice, in the world frame.
            T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
            spacing_m: distance between points on the body's surface.
            links: names of the links whose bodies count; None takes all of them.

        Raises:
            ArrayError: a placement that is not a rigid transform.
            UsageError: a link that the human lacks, or links without any body.
        """
        self.human, self.grid = human, grid
        T_grid_human = checked_placement(T_world_human).copy()
        T_grid_human[:3, 3] -= grid.origin_m
        T_grid_human[:3] /= grid.resolution_m
        # The kernels tell inside from outside after rounding down what is not negative: one voxel of margin.
        T_grid_human[:3, 3] += 1.0
        self._T_grid_human = T_grid_human
        surface = human.surface(spacing_m)
        kept = np.flatnonzero(np.isin(surface.link, _numbers(human, links)))
        if not len(kept):
            raise UsageError(
                f"voxels of {human.name}: wanted links with bodies, {', '.join(links or ())} have none; name "
                f"some of {', '.join(human.link_names[m] for m in np.unique(surface.link))}"
            )
        order = kept[np.argsort(surface.link[kept], kind="stable")]
        x, y, z = np.ascontiguousarray(surface.local_m[order].T)
        self._link, begin = np.unique(surface.link[order], return_index=True)
        self._points, self._first = (x, y, z), np.array([*begin, len(order)], dtype=np.int64)

    def mask(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return the boolean grid of voxels touched in posture (D,), or in any of the postures (T, D).

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        poses = self._poses(q)
        return self._marked(poses, np.ones(len(poses), dtype=np.bool_), np.zeros(self.grid.size + 1, dtype=np.bool_))

    def last_touch(self, q: ArrayLike) -> NDArray[np.int32]:
        """Return a grid of the number of the last posture of (T, D) that touches each voxel, -1 where none does.

        `last_touch(q) >= t` is what the body sweeps from posture t to the end, for every t at once.

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        poses = self._poses(q)
        number = np.arange(len(poses), dtype=np.int32)
        return self._marked(poses, number, np.full(self.grid.size + 1, -1, dtype=np.int32))

    def voxels(self, q: ArrayLike) -> NDArray[np.int64]:
        """Return the flat indices, ascending, of voxels touched in posture (D,), or in any of the postures (T, D).

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        if np.ndim(q) == 1:
            return self.posture_voxels(q).flat
        return np.flatnonzero(self.mask(q)).astype(np.int64)

    def posture_voxels(self, q: ArrayLike) -> PostureVoxels:
        """Return the voxels touched in each of the postures (T, D); one posture (D,) counts as T = 1.

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        poses = self._poses(q)
        flat: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
        n_voxels = np.zeros(len(poses), dtype=np.int64)
        seen = np.zeros(self.grid.size + 1, dtype=np.bool_)
        room = np.empty(min(len(poses), _POSTURES_AT_ONCE) * int(self._first[-1]), dtype=np.int32)
        for start in range(0, len(poses), _POSTURES_AT_ONCE):
            some = slice(start, start + _POSTURES_AT_ONCE)
            kernels.touched(
                poses[some], self._T_grid_human, self._points, self._link, self._first, self.grid.shape, seen,
                room, n_voxels[some],
            )  # fmt: skip
            count = n_voxels[some]
            # The posture's number leads, so that one sort orders the voxels of all postures.
            key = np.repeat(np.arange(len(count)) * self.grid.size, count) + room[: count.sum()]
            flat.append(np.sort(key) % self.grid.size)
        return PostureVoxels(np.concatenate(flat), np.concatenate([[0], np.cumsum(n_voxels)]))

    def _poses(self, q: ArrayLike) -> FloatArray:
        return self.human.link_poses(np.atleast_2d(np.asarray(q, dtype=np.float64)))

    def _marked(self, poses: FloatArray, values: NDArray, marks: NDArray) -> NDArray:  # type: ignore[type-arg]
        kernels.mark(
            poses, self._T_grid_human, self._points, self._link, self._first, self.grid.shape, values, marks
        )  # fmt: skip
        return marks[:-1].reshape(self.grid.shape)


def checked_placement(T_world_human: ArrayLike) -> FloatArray:
    """Return the (4, 4) placement of the tracker's frame in the world after checking that it is rigid."""
    T = checked("T_world_human", T_world_human, (4, 4))
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0 or (T[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise ArrayError(f"T_world_human: wanted a rotation, a translation and the row 0 0 0 1, got {T.tolist()}")
    return T


def _numbers(human: HumanModel, links: Collection[str] | None) -> list[int]:
    if links is None:
        return list(range(len(human.link_names)))
    unknown = sorted(set(links) - set(human.link_names))
    if unknown:
        raise UsageError(
            f"voxels of {human.name}: wanted names of its links, got {', '.join(unknown)}; "
            f"it has {', '.join(human.link_names)}"
        )
    return [human.link_names.index(link) for link in links]
