"""Futures of a body drawn, followed and counted per voxel, compiled: a million points in a millisecond.

Points are in single precision, which is 0.01 mm here. The arithmetic is in one fixed order without fused operations, so
that machines agree. What the arguments have in common:

- points: coordinates x, y, z of the body's points, each (N,), in the frame of their part (`BodyParts`);
- rounds: (P, R + 1) as `first` in `BodyParts`;
- balls: (P, 4) centre and radius of a ball around each part, metres, part's frame;
- shape: of the grid, X, Y, Z;
- touched: (V + 1,) bit s of a voxel is set if future s touches it; the last place takes what lies outside;
- share: (X + 2, Y + 2, Z + 2) share of the futures that touch each voxel; all zero between predictions;
- busy: (X + 2, Y + 2) columns of voxels with any share; most are empty, and only the others are looked at.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.occupancy.voxeliser import chain

BitArray = NDArray[np.uint32]
Float32Array = NDArray[np.float32]
#: Moments between two exemplar postures: so many times finer a quick movement can be followed.
MOMENTS = 4
#: The most that is said of a place the body is not in yet: 1 is for where it is now, which a planner may rely on.
NEVER_CERTAIN = np.float32(1.0 - 2.0**-10)


class Ways(NamedTuple):
    """Poses of P parts in K motions, library frame, as compiled code takes them."""

    present: Float32Array  #: (M, P, 3, 4) poses in the exemplar postures
    pose: Float32Array  #: (N, 3, 4) poses on the way, motion by motion, and part by part within a motion
    moment: NDArray[np.int64]  #: (N,) when in its motion each of these is passed, `MOMENTS` to an exemplar posture
    first: NDArray[np.int64]  #: (K, P + 1) where the poses of each motion and part begin, and where the last part's end
    begin: NDArray[np.int64]  #: (K + 1,) where each motion's exemplar postures begin


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
        kept, fade: as in `ForecastSettings`.
        T_grid_library: (4, 4) from the library's frame to the grid in units of voxels.
        points, rounds, balls, shape, touched: see the module.
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
            turn_between(exemplar, now[p], turn)
            for n in range(ways.first[k, p], ways.first[k, p + 1]):
                lag = ways.moment[n] - present_moment
                if lag <= 0:
                    continue
                left = kept + (1.0 - kept) * np.exp(-lag / fade_moments)
                turned_pose(ways.pose[n], exemplar, now[p], turn, left, R, pose)
                chain(T_grid_library, pose, M)
                begin, end = rounds[p, n % n_rounds], rounds[p, n % n_rounds + 1]
                voxels_of(M, x[begin:end], y[begin:end], z[begin:end], balls[p], per_voxel, shape, index)
                for j in range(end - begin):
                    touched[index[j]] |= bit


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
        step_m: greatest way that may be skipped.
        points, rounds, balls, shape, touched: see the module.
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
                voxels_of(M, x[begin:end], y[begin:end], z[begin:end], balls[p], per_voxel, shape, index)
                for j in range(end - begin):
                    touched[index[j]] |= bit


@exact
def add_share(touched: BitArray, probability: FloatArray, share: Float32Array, busy: NDArray[np.bool_]) -> None:
    """Add to each voxel's share the probability (S,) of the futures that touch it; clears the bits."""
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
        share, busy: see the module; cleared. The share is 1 where the body is.
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
                busy[i, j] = False
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
def voxels_of(
    M: FloatArray,
    x: Float32Array,
    y: Float32Array,
    z: Float32Array,
    ball: FloatArray,
    per_voxel: float,
    shape: tuple[int, int, int],
    out: BitArray,
) -> None:
    """Write the flat voxels of points (n,) of a part moved by M (3, 4); one outside gets the number after the last."""
    if _holds_ball(shape, M, ball, per_voxel):
        _voxels_within(M, x, y, z, shape, out)
    else:
        _voxels(M, x, y, z, shape, out)


@exact_part
def _holds_ball(shape: tuple[int, int, int], M: FloatArray, ball: FloatArray, per_voxel: float) -> bool:
    """Return whether a ball (4,) moved by M (3, 4) lies within the grid."""
    radius = ball[3] * per_voxel + 1e-3  # more than single precision gets wrong
    for a in range(3):
        centre = M[a, 0] * ball[0] + M[a, 1] * ball[1] + M[a, 2] * ball[2] + M[a, 3]
        if centre - radius < 0.0 or centre + radius > shape[a]:
            return False
    return True


@exact_part
def _voxels_within(
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
def _voxels(
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


@exact_part
def turn_between(A: Float32Array, B: FloatArray, out: FloatArray) -> None:
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
def turned_pose(
    recorded: Float32Array,
    exemplar: Float32Array,
    now: FloatArray,
    turn: FloatArray,
    left: float,
    R: FloatArray,
    out: FloatArray,
) -> None:
    """Write the pose (3, 4) of a part on its way: as recorded, with a share `left` of what differs at present.

    Args:
        recorded, exemplar, now: (3, 4) recorded then, recorded at the moment like the present, and present.
        turn: (3,) from the exemplar to the present (`turn_between`).
        left: share.
        R: (3, 3) room to work in.
        out: where to.
    """
    _rotation(turn, left, R)
    for a in range(3):
        for b in range(3):
            out[a, b] = R[a, 0] * recorded[0, b] + R[a, 1] * recorded[1, b] + R[a, 2] * recorded[2, b]
        out[a, 3] = recorded[a, 3] + left * (now[a, 3] - exemplar[a, 3])


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
