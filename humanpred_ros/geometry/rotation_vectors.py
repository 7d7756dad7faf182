"""Rotations as vectors (axis times angle) and back, many at once: how far a tool is turned from where it should be."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray

_HALF_TURN = 1e-7
"""Sine below which the antisymmetric part no longer tells the axis of a half turn."""


def rotation_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) by vectors (..., 3) rad."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)
    # np.sinc(t) is sin(pi t) / (pi t), so these hold at angle 0 as well: sin(a) / a and (1 - cos(a)) / a^2.
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rotation: FloatArray = np.eye(3) + sine * cross + versine * (cross @ cross)
    return rotation


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the vectors (..., 3), no longer than pi, of rotations (..., 3, 3)."""
    twice_sine = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    length = np.linalg.norm(twice_sine, axis=-1, keepdims=True)
    angle = np.arctan2(length, np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1.0)
    half_turn = length[..., 0] < _HALF_TURN
    vector: FloatArray = np.where(
        half_turn[..., None], twice_sine / 2.0, twice_sine * angle / np.maximum(length, 1e-300)
    )
    half_turn &= angle[..., 0] > 1.0
    if half_turn.any():
        # There R = 2 a a^T - 1: any column of R + 1 is along the axis, the longest one is the most exact.
        columns = rotation[half_turn] + np.eye(3)
        longest = np.argmax(np.linalg.norm(columns, axis=-2), axis=-1)
        along = np.take_along_axis(columns, longest[:, None, None], axis=-1)[..., 0]
        vector[half_turn] = along / np.linalg.norm(along, axis=-1, keepdims=True) * angle[half_turn]
    return vector
