"""Futures drawn, followed and counted per voxel, compiled: some thousand poses and a million points in a millisecond.

Points are in single precision, which is 0.01 mm here. The arithmetic is in one fixed order without fused operations, so
that machines agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.occupancy.body_parts import Float32Array
from humanpred_ros.occupancy.point_kernels import (
    BitArray,
    chain,
    holds_ball,
    most_in_a_round,
    spread_out,
    voxels,
    voxels_within,
)
from humanpred_ros.occupancy.recorded_futures import MOMENTS, Ways


@exact
def draw(
    weight: FloatArray, label: NDArray[np.int64], n_classes: int, n_futures: int, least_share: float
) -> tuple[NDArray[np.int64], FloatArray]:
    """Choose exemplars whose futures stand for all, and return their numbers and probabilities, each (n_futures,).

    Every class keeps its exact probability, shared evenly among its futures; a class gets one at least if it has
    `least_share`, and the rest go to where each stands for most. Within a class they are drawn at even distances
    along the cumulated weights, so the same weights give the same futures.

    Nothing is drawn if no exemplar weighs anything.

    Args:
        weight: (M,) of the exemplars, not negative.
        label: (M,) classes of the exemplars, 0 to `n_classes` - 1.
        n_classes, n_futures, least_share: how many, and which classes are left out.
    """
    share = np.zeros(n_classes)
    for m in range(len(weight)):
        share[label[m]] += weight[m]
    whole, most_probable = 0.0, 0.0
    for c in range(n_classes):
        whole += share[c]
        most_probable = max(most_probable, share[c])
    if not most_probable > 0.0:
        return np.empty(0, np.int64), np.empty(0)
    least = min(least_share * whole, most_probable)
    count = np.zeros(n_classes, np.int64)
    for _ in range(n_futures):
        # Largest share per future next; classes without a future come first.
        best, most = -1, -1.0
        for c in range(n_classes):
            each = share[c] / count[c] if count[c] else 2.0 * whole + share[c]
            if share[c] >= least and share[c] > 0.0 and each > most:
                best, most = c, each
        count[best] += 1
    total = 0.0
    for c in range(n_classes):
        total += share[c] if count[c] else 0.0
    chosen, probability = np.empty(n_futures, np.int64), np.empty(n_futures)
    begin = np.zeros(n_classes, np.int64)
    for c in range(1, n_classes):
        begin[c] = begin[c - 1] + count[c - 1]
    drawn = np.zeros(n_classes, np.int64)
    passed = np.zeros(n_classes)
    for m in range(len(weight)):
        c = label[m]
        if weight[m] <= 0.0 or not count[c]:
            continue
        passed[c] += weight[m]
        # The class's last one must not be lost to rounding.
        while drawn[c] < count[c] and (drawn[c] + 0.5) * share[c] < passed[c] * count[c] * (1.0 + 1e-12):
            chosen[begin[c] + drawn[c]] = m
            probability[begin[c] + drawn[c]] = share[c] / (count[c] * total)
            drawn[c] += 1
    return chosen, probability


@exact
def follow(
    chosen: NDArray[np.int64],
    now: FloatArray,
    ways: Ways,
    kept: float,
    fade: float,
    T_grid_library: FloatArray,
    points: tuple[Float32Array, Float32Array, Float32Array],
    rounds: NDArray[np.int64],
    balls: FloatArray,
    shape: tuple[int, int, int],
    touched: BitArray,
) -> None:
    """Set bit i of every voxel that future i touches after the present.

    A future goes as its exemplar went on. The difference between the person's present pose and the exemplar's, of each
    part of the body, stays to a share `kept` and else fades.

    Args:
        chosen: (F,) exemplars, at most 32.
        now: (P, 3, 4) present poses of the parts, library frame.
        ways: how the exemplars went on.
        kept, fade: as in `ForecastConfig`.
        T_grid_library: (4, 4) from the library's frame to the grid in units of voxels.
        points: coordinates of the parts' points.
        rounds: (P, R + 1) as `first` in `BodyParts`.
        balls: (P, 4) centre and radius of a ball around each part, metres, part's frame.
        shape: of the grid.
        touched: (V + 1,) bits, and a last place that takes what lies outside.
    """
    x, y, z = points
    n_rounds = rounds.shape[1] - 1
    index = np.empty(most_in_a_round(rounds), np.uint32)
    turn, R, pose, M = np.empty(3), np.empty((3, 3)), np.empty((3, 4)), np.empty((3, 4))
    per_voxel = np.sqrt(T_grid_library[0, 0] ** 2 + T_grid_library[0, 1] ** 2 + T_grid_library[0, 2] ** 2)
    for i in range(len(chosen)):
        bit = np.uint32(1) << np.uint32(i)
        e = chosen[i]
        k = np.searchsorted(ways.begin, e, side="right") - 1
        present_moment = (e - ways.begin[k]) * MOMENTS
        fade_moments = fade * max(1, (ways.begin[k + 1] - ways.begin[k] - 1) * MOMENTS)
        for p in range(len(now)):
            exemplar = ways.present[e, p]
            _turn_between(exemplar, now[p], turn)
            for n in range(ways.first[k, p], ways.first[k, p + 1]):
                lag = ways.moment[n] - present_moment
                if lag <= 0:
                    continue
                left = kept + (1.0 - kept) * np.exp(-lag / fade_moments)
                _rotation(turn, left, R)
                for a in range(3):
                    for b in range(3):
                        pose[a, b] = (
                            R[a, 0] * ways.pose[n, 0, b] + R[a, 1] * ways.pose[n, 1, b] + R[a, 2] * ways.pose[n, 2, b]
                        )
                    pose[a, 3] = ways.pose[n, a, 3] + left * (now[p, a, 3] - exemplar[a, 3])
                chain(T_grid_library, pose, M)
                begin, end = rounds[p, n % n_rounds], rounds[p, n % n_rounds + 1]
                xs, ys, zs = x[begin:end], y[begin:end], z[begin:end]
                if holds_ball(shape, M, balls[p], per_voxel):
                    voxels_within(M, xs, ys, zs, shape, index)
                else:
                    voxels(M, xs, ys, zs, shape, index)
                for j in range(end - begin):
                    touched[index[j]] |= bit


@exact
def count(
    touched: BitArray,
    probability: FloatArray,
    now: NDArray[np.bool_],
    spread: float,
    share: Float32Array,
    out: Float32Array,
) -> None:
    """Turn bits into probabilities: those of the futures that touch a voxel, a little of them moved to its neighbours.

    Args:
        touched: (V + 1,) bits; cleared.
        probability: (F,) of the futures.
        now: (X, Y, Z) where the body is: probability 1.
        spread: as in `ForecastConfig`.
        share: (X + 2, Y + 2, Z + 2) room to work in, all zero; left so.
        out: (X, Y, Z) zeros; filled.
    """
    n_x, n_y, n_z = now.shape
    table = np.zeros((4, 256), dtype=np.float32)
    for i in range(len(probability)):
        for bits in range(256):
            if (bits >> (i % 8)) & 1:
                table[i // 8, bits] += np.float32(probability[i])
    byte, low, middle, high = np.uint32(255), np.uint32(8), np.uint32(16), np.uint32(24)
    one = np.float32(1.0)
    # Most columns of voxels are empty; what follows looks only at those that are not.
    busy = np.zeros((n_x + 2, n_y + 2), dtype=np.bool_)
    v = 0
    for i in range(1, n_x + 1):
        for j in range(1, n_y + 1):
            some = np.uint32(0)
            for k in range(n_z):
                some |= touched[v + k] | np.uint32(now[i - 1, j - 1, k])
            if some:
                busy[i, j] = True
                for k in range(n_z):
                    bits = touched[v + k]
                    if bits:
                        p = table[0, bits & byte] + table[1, (bits >> low) & byte]
                        share[i, j, k + 1] = p + table[2, (bits >> middle) & byte] + table[3, bits >> high]
                        touched[v + k] = 0
                    if now[i - 1, j - 1, k]:
                        share[i, j, k + 1] = one
            v += n_z
    touched[v] = 0
    spread_out(share, busy, now, spread, out)


@exact_part
def _turn_between(A: Float32Array, B: FloatArray, out: FloatArray) -> None:
    """Write the rotation vector (3,) that turns pose A (3, 4) into B; zero where they are nearly opposite."""
    C = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            C[a, b] = B[a, 0] * A[b, 0] + B[a, 1] * A[b, 1] + B[a, 2] * A[b, 2]
    angle = np.arccos(min(max((C[0, 0] + C[1, 1] + C[2, 2] - 1.0) / 2.0, -1.0), 1.0))
    scale = 0.5
    if angle > 1e-3:
        scale = 0.5 * angle / np.sin(angle) if angle < 3.0 else 0.0
    out[0], out[1], out[2] = scale * (C[2, 1] - C[1, 2]), scale * (C[0, 2] - C[2, 0]), scale * (C[1, 0] - C[0, 1])


@exact_part
def _rotation(turn: FloatArray, share: float, R: FloatArray) -> None:
    """Write the rotation (3, 3) by a share of a rotation vector (Rodrigues)."""
    x, y, z = share * turn[0], share * turn[1], share * turn[2]
    angle = np.sqrt(x * x + y * y + z * z)
    s, c = 1.0, 0.5
    if angle > 1e-6:
        s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
