"""Small rotation helpers for sequences, so that angle conventions stand in one place.

Matrices are (T, 3, 3), angles (T,); NaN passes through, which is how lost points spread to what depends on them.
"""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray


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
    """Return the vectors (T, 3) as seen in the rotated frames R (T, 3, 3)."""
    seen: FloatArray = np.einsum("tji,tj->ti", R, vectors)
    return seen


def frame_of(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the orthonormal frames (T, 3, 3) with x along `first` and z normal to both; NaN if parallel."""
    x, z = _unit(first), _unit(np.cross(first, second))
    return np.stack([x, np.cross(z, x), z], axis=-1)


def wrapped(angle: FloatArray) -> FloatArray:
    """Return the angles within [-pi, pi)."""
    within: FloatArray = (angle + np.pi) % (2 * np.pi) - np.pi
    return within


def _unit(vectors: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: FloatArray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
