"""Futures counted per voxel and slice of time, compiled; see `future_kernels` for what is not described here.

A part of the body is in a pose from when it gets there until it goes on, and marks the voxels it touches in all slices
of that while. What the arguments have in common:

- edges: (S + 1,) where slices begin and end, seconds after the present, ascending from 0; the last one is infinite;
- room: what is worked in, clean between calls (`SliceRoom`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.occupancy.future_kernels import (
    MOMENTS,
    NEVER_CERTAIN,
    BitArray,
    Float32Array,
    Ways,
    most_in_a_round,
    turn_between,
    turned_pose,
    voxels_of,
)
from humanpred_ros.occupancy.voxeliser import chain


class SliceRoom(NamedTuple):
    """Room for V voxels and S slices."""

    bits: BitArray  #: (V + 1, S) bit s of a voxel and slice is set if future s touches it then
    share: Float32Array  #: (V + 1, S) probability of the futures that touch it, and of its neighbours'
    known: NDArray[np.bool_]  #: (V + 1,) whether a voxel is in the list
    listed: NDArray[np.uint32]  #: (V + 1,) the voxels that anything is known of, as they came
    known_count: NDArray[np.int64]  #: (1,) how many those are

    @classmethod
    def of(cls, n_voxels: int, n_slices: int) -> SliceRoom:
        """Return clean room."""
        return cls(
            np.zeros((n_voxels + 1, n_slices), np.uint32),
            np.zeros((n_voxels + 1, n_slices), np.float32),
            np.zeros(n_voxels + 1, np.bool_),
            np.zeros(n_voxels + 1, np.uint32),
            np.zeros(1, np.int64),
        )


@exact
def follow_in_time(
    chosen: NDArray[np.int64],
    now: FloatArray,
    ways: Ways,
    moment_s: FloatArray,
    edges: FloatArray,
    kept: float,
    fade: float,
    T_grid_library: FloatArray,
    points: tuple[Float32Array, Float32Array, Float32Array],
    rounds: NDArray[np.int64],
    balls: FloatArray,
    shape: tuple[int, int, int],
    room: SliceRoom,
) -> None:
    """Set bit i of every voxel and slice in which future i touches it; else as `future_kernels.follow`.

    Each future takes the time that its motion took: how much that differs from person to person is in the library.

    Args:
        moment_s: (K,) seconds between two moments of each motion.
    """
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
            chain(T_grid_library, now[p], M)
            since_s, mark = 0.0, 0
            for n in range(ways.first[k, p], ways.first[k, p + 1]):
                lag = ways.moment[n] - present_moment
                if lag <= 0:
                    continue
                until_s = lag * moment_s[k]
                _mark(M, since_s, until_s, mark, bit, edges, points, rounds[p], balls[p], per_voxel, shape, index, room)
                turned_pose(
                    ways.pose[n], exemplar, now[p], turn, kept + (1.0 - kept) * np.exp(-lag / fade_moments), R, pose
                )
                chain(T_grid_library, pose, M)
                since_s, mark = until_s, n
            _mark(M, since_s, np.inf, mark, bit, edges, points, rounds[p], balls[p], per_voxel, shape, index, room)


@exact_part
def _mark(
    M: FloatArray,
    since_s: float,
    until_s: float,
    turn: int,
    bit: np.uint32,
    edges: FloatArray,
    points: tuple[Float32Array, Float32Array, Float32Array],
    rounds: NDArray[np.int64],
    ball: FloatArray,
    per_voxel: float,
    shape: tuple[int, int, int],
    index: BitArray,
    room: SliceRoom,
) -> None:
    """Set a bit of all voxels that a part in pose M (3, 4) touches, in the slices from `since_s` to `until_s`.

    A pose that lasts from one slice into another is alone in at least one of them: it is covered densely.
    """
    x, y, z = points
    first = int(np.searchsorted(edges, since_s, side="right")) - 1
    last = max(first, min(int(np.searchsorted(edges, until_s, side="left")) - 1, len(edges) - 2))
    n_rounds = len(rounds) - 1
    for r in range(n_rounds if last > first else 1):
        begin, end = rounds[(turn + r) % n_rounds], rounds[(turn + r) % n_rounds + 1]
        voxels_of(M, x[begin:end], y[begin:end], z[begin:end], ball, per_voxel, shape, index)
        for j in range(end - begin):
            v = int(index[j])
            if not room.known[v]:
                _list(v, room)
            for s in range(first, last + 1):
                room.bits[v, s] |= bit


@exact_part
def _list(v: int, room: SliceRoom) -> None:
    room.known[v] = True
    room.listed[room.known_count[0]] = v
    room.known_count[0] += 1


@exact
def collect_slices(
    probability: FloatArray, now: NDArray[np.bool_], spread: float, room: SliceRoom
) -> tuple[NDArray[np.int64], Float32Array]:
    """Return the voxels (N,) that anybody may be in, ascending, and their probabilities (N, S); cleans the room.

    Args:
        probability: (F,) of the futures.
        now: (X, Y, Z) where the body is: probability 1 in the first slice, which nothing else gets.
        spread: share of its probability that a voxel gives to its six neighbours.
    """
    n_x, n_y, n_z = now.shape
    n_slices = room.bits.shape[1]
    outside = n_x * n_y * n_z
    own, sixth = np.float32(1.0 - spread), np.float32(spread / 6.0)
    table = np.zeros((4, 256), dtype=np.float32)
    for s in range(len(probability)):
        for bits in range(256):
            if (bits >> (s % 8)) & 1:
                table[s // 8, bits] += np.float32(probability[s])
    byte, low, middle, high = np.uint32(255), np.uint32(8), np.uint32(16), np.uint32(24)
    touched = room.known_count[0]
    row = np.empty(n_slices, np.float32)
    for i in range(touched):
        v = int(room.listed[i])
        before = np.uint32(0)
        p = np.float32(0.0)
        for s in range(n_slices):
            bits = room.bits[v, s]
            room.bits[v, s] = 0
            if bits != before:
                p = table[0, bits & byte] + table[1, (bits >> low) & byte]
                p += table[2, (bits >> middle) & byte] + table[3, bits >> high]
                before = bits
            row[s] = p
        if v == outside:
            continue
        x, y, z = v // (n_y * n_z), v // n_z % n_y, v % n_z
        for s in range(n_slices):
            room.share[v, s] += own * row[s]
        for d in range(6):
            a = x + (d == 0) - (d == 1)
            b = y + (d == 2) - (d == 3)
            c = z + (d == 4) - (d == 5)
            if 0 <= a < n_x and 0 <= b < n_y and 0 <= c < n_z:
                w = (a * n_y + b) * n_z + c
                if not room.known[w]:
                    _list(w, room)
                for s in range(n_slices):
                    room.share[w, s] += sixth * row[s]
    flat = now.ravel()
    for u in range(outside):
        if flat[u] and not room.known[u]:
            _list(u, room)
    voxels = np.sort(room.listed[: room.known_count[0]].astype(np.int64))
    if len(voxels) and voxels[-1] == outside:
        voxels = voxels[:-1]
    out = np.empty((len(voxels), n_slices), np.float32)
    for i in range(len(voxels)):
        v = voxels[i]
        for s in range(n_slices):
            out[i, s] = min(room.share[v, s], NEVER_CERTAIN)
            room.share[v, s] = 0.0
        if flat[v]:
            out[i, 0] = 1.0
        room.known[v] = False
    room.known[outside] = False
    room.known_count[0] = 0
    return voxels, out
