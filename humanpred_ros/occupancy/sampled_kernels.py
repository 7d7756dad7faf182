"""The voxels that sampled futures touch, compiled: a hundred futures of a body in some milliseconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.occupancy.body_parts import Float32Array
from humanpred_ros.occupancy.point_kernels import BitArray, chain, holds_ball, most_in_a_round, voxels, voxels_within


@exact
def sweep(
    poses: FloatArray,
    T_grid_human: FloatArray,
    points: tuple[Float32Array, Float32Array, Float32Array],
    rounds: NDArray[np.int64],
    balls: FloatArray,
    step_m: float,
    shape: tuple[int, int, int],
    touched: BitArray,
) -> None:
    """Set bit s of every voxel that future s touches.

    A part of the body that moved less than `step_m` since it was last marked is not marked again, but at the end.
    Successive markings take successive rounds of the part's points.

    Args:
        poses: (S, N, P, 4, 4) of the parts in N postures of S futures, 32 at most, tracker's frame.
        T_grid_human: (4, 4) from the tracker's frame to the grid in units of voxels.
        points: coordinates of the parts' points.
        rounds: (P, R + 1) as `first` in `BodyParts`.
        balls: (P, 4) centre and radius of a ball around each part, metres, part's frame.
        step_m: greatest way that may be skipped.
        shape: of the grid.
        touched: (V + 1,) bits, and a last place that takes what lies outside.
    """
    x, y, z = points
    n_rounds = rounds.shape[1] - 1
    index = np.empty(most_in_a_round(rounds), np.uint32)
    M = np.empty((3, 4))
    per_voxel = np.sqrt(T_grid_human[0, 0] ** 2 + T_grid_human[0, 1] ** 2 + T_grid_human[0, 2] ** 2)
    n_futures, n_postures, n_parts = poses.shape[:3]
    for s in range(n_futures):
        bit = np.uint32(1) << np.uint32(s)
        for p in range(n_parts):
            last, turn = -1, 0
            for n in range(n_postures):
                if last >= 0 and n < n_postures - 1 and _way(poses[s, last, p], poses[s, n, p], balls[p]) < step_m:
                    continue
                last = n
                begin, end = rounds[p, turn % n_rounds], rounds[p, turn % n_rounds + 1]
                turn += 1
                chain(T_grid_human, poses[s, n, p], M)
                if holds_ball(shape, M, balls[p], per_voxel):
                    voxels_within(M, x[begin:end], y[begin:end], z[begin:end], shape, index)
                else:
                    voxels(M, x[begin:end], y[begin:end], z[begin:end], shape, index)
                for j in range(end - begin):
                    touched[index[j]] |= bit


@exact
def add_share(touched: BitArray, probability: FloatArray, share: Float32Array, busy: NDArray[np.bool_]) -> None:
    """Add to each voxel's share the probability of the futures that touch it.

    Args:
        touched: (V + 1,) bits; cleared.
        probability: (S,) of the futures.
        share: (X + 2, Y + 2, Z + 2) shares; grow.
        busy: (X + 2, Y + 2) columns of voxels with any share; grow.
    """
    n_x, n_y, n_z = share.shape[0] - 2, share.shape[1] - 2, share.shape[2] - 2
    table = np.zeros((4, 256), dtype=np.float32)
    for s in range(len(probability)):
        for bits in range(256):
            if (bits >> (s % 8)) & 1:
                table[s // 8, bits] += np.float32(probability[s])
    byte, low, middle, high = np.uint32(255), np.uint32(8), np.uint32(16), np.uint32(24)
    v = 0
    for i in range(1, n_x + 1):
        for j in range(1, n_y + 1):
            for k in range(1, n_z + 1):
                bits = touched[v]
                if bits:
                    p = table[0, bits & byte] + table[1, (bits >> low) & byte]
                    share[i, j, k] += p + table[2, (bits >> middle) & byte] + table[3, bits >> high]
                    touched[v] = 0
                    busy[i, j] = True
                v += 1
    touched[v] = 0


@exact
def add_body(now: NDArray[np.bool_], share: Float32Array, busy: NDArray[np.bool_]) -> None:
    """Set the share of every voxel that the body is in, `now` (X, Y, Z), to 1."""
    n_x, n_y, n_z = now.shape
    for i in range(n_x):
        for j in range(n_y):
            for k in range(n_z):
                if now[i, j, k]:
                    share[i + 1, j + 1, k + 1] = np.float32(1.0)
                    busy[i + 1, j + 1] = True


@exact_part
def _way(A: FloatArray, B: FloatArray, ball: FloatArray) -> float:
    """Return at least how far any point of a ball moves between two poses (4, 4) of its part."""
    centre, turn = 0.0, 0.0
    for a in range(3):
        d = B[a, 3] - A[a, 3]
        for b in range(3):
            d += (B[a, b] - A[a, b]) * ball[b]
            turn += (B[a, b] - A[a, b]) ** 2
        centre += d * d
    # Rotating by an angle moves a point at distance r by at most 2 r sin(angle / 2); the matrices differ by
    # sqrt(8) sin(angle / 2) in the Frobenius norm.
    return float(np.sqrt(centre) + ball[3] * np.sqrt(0.5 * turn))
