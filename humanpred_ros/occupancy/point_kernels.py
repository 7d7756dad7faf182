"""From points fixed to moving parts to voxels, and from shares per voxel to probabilities: what all futures need.

Points are in single precision, which is 0.01 mm here. The arithmetic is in one fixed order without fused operations, so
that machines agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.occupancy.body_parts import Float32Array

BitArray = NDArray[np.uint32]

#: The most that is said of a place the body is not in yet: 1 is for where it is now, which a planner may rely on.
NEVER_CERTAIN = np.float32(1.0 - 2.0**-10)


@exact
def spread_out(
    share: Float32Array,
    busy: NDArray[np.bool_],
    now: NDArray[np.bool_],
    spread: float,
    out: Float32Array,
) -> None:
    """Turn shares of futures into probabilities: a little of each goes to the voxel's neighbours.

    Args:
        share: (X + 2, Y + 2, Z + 2) share of the futures that touch each voxel, 1 where the body is; cleared.
        busy: (X + 2, Y + 2) columns of voxels with any share.
        now: (X, Y, Z) where the body is: probability 1, which nothing else gets.
        spread: share of its probability that a voxel gives to its six neighbours.
        out: (X, Y, Z) zeros; filled.
    """
    n_x, n_y, n_z = now.shape
    one = np.float32(1.0)
    own, sixth = np.float32(1.0 - spread), np.float32(spread / 6.0)
    for i in range(1, n_x + 1):
        for j in range(1, n_y + 1):
            if busy[i, j] or busy[i - 1, j] or busy[i + 1, j] or busy[i, j - 1] or busy[i, j + 1]:
                for k in range(1, n_z + 1):
                    beside = share[i - 1, j, k] + share[i + 1, j, k] + share[i, j - 1, k] + share[i, j + 1, k]
                    beside += share[i, j, k - 1] + share[i, j, k + 1]
                    p = min(own * share[i, j, k] + sixth * beside, NEVER_CERTAIN)
                    out[i - 1, j - 1, k - 1] = one if now[i - 1, j - 1, k - 1] else p
    for i in range(1, n_x + 1):
        for j in range(1, n_y + 1):
            if busy[i, j]:
                for k in range(n_z + 2):
                    share[i, j, k] = 0.0


@exact_part
def most_in_a_round(rounds: NDArray[np.int64]) -> int:
    """Return how many points the largest round has, with rounds (P, R + 1) as `first` in `BodyParts`."""
    most = 0
    for p in range(rounds.shape[0]):
        for r in range(rounds.shape[1] - 1):
            most = max(most, rounds[p, r + 1] - rounds[p, r])
    return most


@exact_part
def chain(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Write the upper three rows of the product of transforms A (4, 4) and B (3, 4)."""
    for a in range(3):
        for b in range(4):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
        out[a, 3] += A[a, 3]


@exact_part
def holds_ball(shape: tuple[int, int, int], M: FloatArray, ball: FloatArray, per_voxel: float) -> bool:
    """Return whether a ball (4,) moved by M (3, 4) lies within the grid."""
    radius = ball[3] * per_voxel + 1e-3  # more than single precision gets wrong
    for a in range(3):
        centre = M[a, 0] * ball[0] + M[a, 1] * ball[1] + M[a, 2] * ball[2] + M[a, 3]
        if centre - radius < 0.0 or centre + radius > shape[a]:
            return False
    return True


@exact_part
def voxels_within(
    M: FloatArray, x: Float32Array, y: Float32Array, z: Float32Array, shape: tuple[int, int, int], out: BitArray
) -> None:
    """Write the flat voxels of points (n,) that are all within the grid, where truncation rounds down."""
    a, b, c, d = np.float32(M[0, 0]), np.float32(M[0, 1]), np.float32(M[0, 2]), np.float32(M[0, 3])
    e, f, g, h = np.float32(M[1, 0]), np.float32(M[1, 1]), np.float32(M[1, 2]), np.float32(M[1, 3])
    i, j, k, m = np.float32(M[2, 0]), np.float32(M[2, 1]), np.float32(M[2, 2]), np.float32(M[2, 3])
    n_y, n_z = np.int32(shape[1]), np.int32(shape[2])
    for p in range(len(x)):
        u = np.int32(a * x[p] + b * y[p] + c * z[p] + d)
        v = np.int32(e * x[p] + f * y[p] + g * z[p] + h)
        w = np.int32(i * x[p] + j * y[p] + k * z[p] + m)
        out[p] = (u * n_y + v) * n_z + w


@exact_part
def voxels(
    M: FloatArray, x: Float32Array, y: Float32Array, z: Float32Array, shape: tuple[int, int, int], out: BitArray
) -> None:
    """Write the flat voxels of points (n,); one outside gets the number after the last voxel."""
    n_x, n_y, n_z = shape
    for p in range(len(x)):
        u = np.floor(M[0, 0] * x[p] + M[0, 1] * y[p] + M[0, 2] * z[p] + M[0, 3])
        v = np.floor(M[1, 0] * x[p] + M[1, 1] * y[p] + M[1, 2] * z[p] + M[1, 3])
        w = np.floor(M[2, 0] * x[p] + M[2, 1] * y[p] + M[2, 2] * z[p] + M[2, 3])
        inside = u >= 0.0 and u < n_x and v >= 0.0 and v < n_y and w >= 0.0 and w < n_z
        out[p] = np.uint32((u * n_y + v) * n_z + w) if inside else np.uint32(n_x * n_y * n_z)
