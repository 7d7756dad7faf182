"""Voxels touched by a body's points, compiled: a posture has to be turned into voxels many times per frame.

The arithmetic is written out in one fixed order without fused operations, so that every machine, whatever its linear
algebra library, puts a point that lies near the face of two voxels into the same one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part

#: Points handled at a time: their coordinates and indices stay in the processor's first cache.
_BLOCK = 512


@exact
def mark(
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
            _affine(T_grid_human, poses[t, link[s]], M)
            for begin in range(first[s], first[s + 1], _BLOCK):
                n = min(_BLOCK, first[s + 1] - begin)
                _indices(M, x[begin : begin + n], y[begin : begin + n], z[begin : begin + n], shape, index)
                for p in range(n):
                    marks[index[p]] = value


@exact
def touched(
    poses: FloatArray,
    T_grid_human: FloatArray,
    points: tuple[FloatArray, FloatArray, FloatArray],
    link: NDArray[np.int64],
    first: NDArray[np.int64],
    shape: tuple[int, int, int],
    seen: NDArray[np.bool_],
    out: NDArray[np.int32],
    count: NDArray[np.int64],
) -> None:
    """List the voxels that each posture touches, each once, in the order in which they are met.

    Args:
        poses, T_grid_human, points, link, first, shape: as for `mark`.
        seen: (V + 1,) all False; left so.
        out: (N,) voxels of the first posture, then of the second, and so on; N must suffice.
        count: (T,) receives how many voxels each posture touches.
    """
    x, y, z = points
    M = np.empty((3, 4))
    index = np.empty(_BLOCK, np.int32)
    outside = len(seen) - 1
    end = 0
    for t in range(len(poses)):
        start = end
        seen[outside] = True
        for s in range(len(link)):
            _affine(T_grid_human, poses[t, link[s]], M)
            for begin in range(first[s], first[s + 1], _BLOCK):
                n = min(_BLOCK, first[s + 1] - begin)
                _indices(M, x[begin : begin + n], y[begin : begin + n], z[begin : begin + n], shape, index)
                for p in range(n):
                    voxel = index[p]
                    if not seen[voxel]:
                        seen[voxel] = True
                        out[end] = voxel
                        end += 1
        for k in range(start, end):
            seen[out[k]] = False
        seen[outside] = False
        count[t] = end - start


@exact_part
def _affine(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Write the upper three rows of the product of two (4, 4) transforms."""
    for a in range(3):
        for b in range(4):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b] + A[a, 3] * B[3, b]


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
