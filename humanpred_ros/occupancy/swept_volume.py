"""The space a body sweeps during a motion, as voxels: what P1 takes a class of motions to occupy (P1 IV).

P1 samples the surfaces of the body's solids 0.02 m apart and marks the voxels of 0.05 m that hold a sample, for each
posture of the motion (facts 3). All bodies count: legs and the resting arm are in the way like the reaching one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.checks import FloatArray, checked
from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.grid import VoxelGrid

#: Arrays of this many postures stay in the processor's cache; more at once is slower.
_POSTURES_AT_ONCE = 8


@dataclass(frozen=True)
class SweptVolumeConfig:
    """How finely bodies and motions are sampled.

    Attributes:
        spacing_m: distance between points on the surface (P1: 0.02 m).
        n_postures: postures a motion is thinned to; 100 is P1's normal case, and as good as it gets for motions of
            100 frames (10, used when P1 was submitted, loses 6 to 10 % of the voxels, facts 3).
    """

    spacing_m: float = 0.02
    n_postures: int = 100

    def __post_init__(self) -> None:
        if not 0 < self.spacing_m < np.inf or self.n_postures < 1:
            raise UsageError(
                "swept volume: wanted a positive spacing and at least one posture, "
                f"got spacing_m={self.spacing_m}, n_postures={self.n_postures}"
            )


class BodyVoxeliser:
    """Finds the voxels that a human's body touches; safe to use from several threads.

    World placement, grid origin and resolution are folded into the links' poses, so that a point's voxel is
    one affine map and a truncation away.
    """

    def __init__(self, human: HumanModel, grid: VoxelGrid, T_world_human: ArrayLike, spacing_m: float = 0.02) -> None:
        """Prepare for one human, grid and placement.

        Args:
            human: the model; its points are in the tracker's frame.
            grid: the lattice, in the world frame.
            T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
            spacing_m: distance between points on the body's surface.

        Raises:
            ArrayError: a placement that is not a rigid transform.
        """
        self.human, self.grid = human, grid
        T_grid_human = checked_placement(T_world_human).copy()
        T_grid_human[:3, 3] -= grid.origin_m
        T_grid_human[:3] /= grid.resolution_m
        # One voxel of margin all around takes whatever lies outside the grid.
        T_grid_human[:3, 3] += 1.0
        self._T_grid_human = T_grid_human
        surface = human.surface(spacing_m)
        order = np.argsort(surface.link, kind="stable")
        points = surface.local_m[order]
        #: (4, P) homogeneous points in their links' frames, link after link.
        self._points = np.vstack([points.T, np.ones(len(points))])
        links, first = np.unique(surface.link[order], return_index=True)
        last = [*first[1:], len(points)]
        self._spans = [(int(m), slice(int(a), int(b))) for m, a, b in zip(links, first, last, strict=True)]
        self._padded_shape = (grid.shape[0] + 2, grid.shape[1] + 2, grid.shape[2] + 2)

    def mask(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return the boolean grid of voxels touched in posture (D,), or in any of the postures (T, D).

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        poses = self._T_grid_human @ self.human.link_poses(np.atleast_2d(np.asarray(q, dtype=np.float64)))
        padded = np.zeros(self._padded_shape, dtype=np.bool_)
        for start in range(0, len(poses), _POSTURES_AT_ONCE):
            padded.reshape(-1)[self._touched(poses[start : start + _POSTURES_AT_ONCE])] = True
        return padded[1:-1, 1:-1, 1:-1].copy()

    def _touched(self, poses: FloatArray) -> NDArray[np.intp]:
        """Return the padded grid's flat index of every point for link poses (T, L, 4, 4) in voxels."""
        _, n_y, n_z = self._padded_shape
        cell = np.empty((len(poses), 3, self._points.shape[1]))
        for link, span in self._spans:
            np.matmul(poses[:, link, :3], self._points[:, span], out=cell[:, :, span])
        np.maximum(cell, 0.0, out=cell)
        np.minimum(cell, np.array(self._padded_shape)[:, None] - 1.0, out=cell)
        ijk = cell.astype(np.intp)  # truncation rounds down, as nothing is negative any more
        return ((ijk[:, 0] * n_y + ijk[:, 1]) * n_z + ijk[:, 2]).ravel()


def swept_volume(voxeliser: BodyVoxeliser, q: ArrayLike, config: SweptVolumeConfig | None = None) -> NDArray[np.bool_]:
    """Return the boolean grid of voxels the body touches during a motion (P1 IV).

    Args:
        voxeliser: human, grid and placement.
        q: (T, D) postures in order.
        config: how many of them count.

    Raises:
        HumanModelError: wrong shape or values that are not finite.
    """
    config = SweptVolumeConfig() if config is None else config
    postures = np.atleast_2d(np.asarray(q, dtype=np.float64))
    if len(postures) > config.n_postures:
        postures = postures[np.round(np.linspace(0, len(postures) - 1, config.n_postures)).astype(np.intp)]
    return voxeliser.mask(postures)


def checked_placement(T_world_human: ArrayLike) -> FloatArray:
    """Return the (4, 4) placement of the tracker's frame in the world after checking that it is rigid."""
    T = checked("T_world_human", T_world_human, (4, 4))
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0 or (T[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise ArrayError(f"T_world_human: wanted a rotation, a translation and the row 0 0 0 1, got {T.tolist()}")
    return T
