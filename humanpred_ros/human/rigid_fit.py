"""Rotations of sequences, and placing a rigid cluster of points on measured ones.

Matrices are (T, 3, 3), angles (T,). NaN passes through: what depends on a lost point becomes NaN.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray

#: A cluster whose points stray less than this (m) from a line shows no rotation about it.
THICKNESS_M = 0.01


def rotation(axis: str, angle: FloatArray) -> FloatArray:
    """Return the right-handed rotations (T, 3, 3) by `angle` (T,) about the axis "x", "y" or "z"."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.zeros((len(angle), 3, 3))
    R[:, i, i] = 1.0
    R[:, j, j] = R[:, k, k] = np.cos(angle)
    R[:, k, j] = np.sin(angle)
    R[:, j, k] = -R[:, k, j]
    return R


def rotate_back(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the vectors (T, 3) in the rotated frames R (T, 3, 3)."""
    return np.asarray(np.einsum("tji,tj->ti", R, vectors))


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
