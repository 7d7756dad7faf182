"""From postures to the voxels a body touches: the step that every prediction of occupancy is made of.

P1 samples the surfaces of the body's solids 0.02 m apart and marks the voxels of 0.05 m that hold a sample
(docs/papers.md, P1 occupancy). In the compiled loops the arithmetic is written out in one fixed order without fused
operations, so that every machine, whatever its linear algebra library, puts a point that lies near the face of two
voxels into the same one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel

#: Distance between points on the body's surface (P1; docs/papers.md, P1 occupancy).
DEFAULT_SPACING_M = 0.02

#: Points handled at a time: their coordinates and indices stay in the processor's first cache.
_BLOCK = 512


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
    ) -> None:
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
        # The kernels tell inside from outside after rounding down what is not negative: one voxel of margin.
        T_grid_human[:3, 3] += 1.0
        self._T_grid_human = T_grid_human
        surface = human.surface(spacing_m)
        order = np.argsort(surface.link, kind="stable")
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

    def _poses(self, q: ArrayLike) -> FloatArray:
        return self.human.link_poses(np.atleast_2d(np.asarray(q, dtype=np.float64)))

    def _marked(self, poses: FloatArray, values: NDArray, marks: NDArray) -> NDArray:  # type: ignore[type-arg]
        _mark(
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


@exact
def _mark(
    poses: FloatArray,
    T_grid_human: FloatArray,
    points: tuple[FloatArray, FloatArray, FloatArray],
    link: NDArray[np.int64],
    first: NDArray[np.int64],
    shape: tuple[int, int, int],
    values: NDArray[Any],
    marks: NDArray[Any],
) -> None:
    """Write `values[t]` into every voxel that posture t touches, in the order of the postures.

    Args:
        poses: (T, L, 4, 4) of the links, tracker's frame.
        T_grid_human: (4, 4) from there to the grid in units of voxels, a margin of one voxel included: the first
            voxel begins at (1, 1, 1).
        points: coordinates x, y, z, each (P,), in their links' frames, link after link.
        link: (S,) link of each span of points.
        first: (S + 1,) where each span begins, and where the last one ends.
        shape: of the grid.
        values: (T,) what to write.
        marks: (V + 1,) the grid, flat, and a last place that takes what lies outside.
    """
    x, y, z = points
    M = np.empty((3, 4))
    index = np.empty(_BLOCK, np.int32)
    for t in range(len(poses)):
        value = values[t]
        for s in range(len(link)):
            chain(T_grid_human, poses[t, link[s]], M)
            for begin in range(first[s], first[s + 1], _BLOCK):
                n = min(_BLOCK, first[s + 1] - begin)
                _indices(M, x[begin : begin + n], y[begin : begin + n], z[begin : begin + n], shape, index)
                for p in range(n):
                    marks[index[p]] = value


@exact_part
def chain(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Write the upper three rows of the product of transforms A (4, 4) and B (3 or 4, 4)."""
    for a in range(3):
        for b in range(4):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
        out[a, 3] += A[a, 3]


@exact_part
def _indices(
    M: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray, shape: tuple[int, int, int], out: NDArray[np.int32]
) -> None:
    """Write the flat voxels of points given by coordinates (n,); one outside gets the number after the last voxel."""
    n_x, n_y, n_z = np.int32(shape[0]), np.int32(shape[1]), np.int32(shape[2])
    outside = n_x * n_y * n_z
    far_x, far_y, far_z = float(n_x + 1), float(n_y + 1), float(n_z + 1)
    a, b, c, d = M[0, 0], M[0, 1], M[0, 2], M[0, 3]
    e, f, g, h = M[1, 0], M[1, 1], M[1, 2], M[1, 3]
    i, j, k, m = M[2, 0], M[2, 1], M[2, 2], M[2, 3]
    for p in range(len(x)):
        # Cut off at the margin first: an integer has no room for what is very far away. Truncation rounds down, as
        # nothing is negative any more.
        u = np.int32(min(max(a * x[p] + b * y[p] + c * z[p] + d, 0.0), far_x))
        v = np.int32(min(max(e * x[p] + f * y[p] + g * z[p] + h, 0.0), far_y))
        w = np.int32(min(max(i * x[p] + j * y[p] + k * z[p] + m, 0.0), far_z))
        inside = (u > 0) & (u <= n_x) & (v > 0) & (v <= n_y) & (w > 0) & (w <= n_z)
        flat = ((u - np.int32(1)) * n_y + (v - np.int32(1))) * n_z + (w - np.int32(1))
        out[p] = flat if inside else outside
