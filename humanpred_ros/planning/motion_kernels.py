"""The compiled search of `motion_check`: between two moments, how close can a sphere of the arm have come?

Movements come as Bézier pieces of degree 5, control points (6, D) per piece. A joint turns during a piece by
at most the sum of its control points' steps, and halving a piece (de Casteljau) only lowers that sum; so a
sphere's way is bounded by turns times lever arms, and the bound becomes exact as pieces become short.

Distances to obstacles are 1-Lipschitz: a sphere with clearances d0 and d1 at the ends of a way of length w
keeps at least (d0 + d1 - w) / 2 in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.chain_kernels import joint_frames
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.joints import Joints
from humanpred_ros.geometry.lattice_kernels import Lattice, value_at

#: A piece is never halved more often: 2^-40 of a second moves nothing.
_DEEPEST = 40


class SphereArm(NamedTuple):
    """An arm of D joints and the S spheres that cover it, in the order of joints."""

    joints: Joints  #: of the arm
    spheres: FloatArray  #: (S, 4) centre in the joint's frame and radius
    first: NDArray[np.int64]  #: (D + 1,) where each joint's spheres begin
    lever: FloatArray  #: (D, S) distance of each sphere from each joint's axis, at most


@exact_part
def clearances(q: FloatArray, arm: SphereArm, field: Lattice, frames: FloatArray, out: FloatArray) -> None:
    """Write each sphere's distance to obstacles less its radius (S,) at q (D,); frames (D + 1, 3, 4) to work in."""
    joint_frames(q, arm.joints, frames)
    for j in range(len(arm.joints.table)):
        A = frames[j + 1]
        for k in range(arm.first[j], arm.first[j + 1]):
            x, y, z = arm.spheres[k, 0], arm.spheres[k, 1], arm.spheres[k, 2]
            u = A[0, 0] * x + A[0, 1] * y + A[0, 2] * z + A[0, 3]
            v = A[1, 0] * x + A[1, 1] * y + A[1, 2] * z + A[1, 3]
            w = A[2, 0] * x + A[2, 1] * y + A[2, 2] * z + A[2, 3]
            out[k] = value_at(u, v, w, field) - arm.spheres[k, 3]


@exact_part
def ways(piece: FloatArray, lever: FloatArray, out: FloatArray) -> None:
    """Write how far each sphere can travel at most (S,) during a piece (6, D), given lever arms (D, S)."""
    for k in range(len(out)):
        out[k] = 0.0
    for j in range(piece.shape[1]):
        turn = 0.0
        for i in range(5):
            turn += abs(piece[i + 1, j] - piece[i, j])
        for k in range(len(out)):
            out[k] += turn * lever[j, k]


@exact_part
def halve(piece: FloatArray, early: FloatArray, late: FloatArray) -> None:
    """Write the first and second half of a piece (6, D); `late` may be the piece itself."""
    for j in range(piece.shape[1]):
        c0, c1, c2, c3, c4, c5 = piece[0, j], piece[1, j], piece[2, j], piece[3, j], piece[4, j], piece[5, j]
        early[0, j], late[5, j] = c0, c5
        c0, c1, c2, c3, c4 = 0.5 * (c0 + c1), 0.5 * (c1 + c2), 0.5 * (c2 + c3), 0.5 * (c3 + c4), 0.5 * (c4 + c5)
        early[1, j], late[4, j] = c0, c4
        c0, c1, c2, c3 = 0.5 * (c0 + c1), 0.5 * (c1 + c2), 0.5 * (c2 + c3), 0.5 * (c3 + c4)
        early[2, j], late[3, j] = c0, c3
        c0, c1, c2 = 0.5 * (c0 + c1), 0.5 * (c1 + c2), 0.5 * (c2 + c3)
        early[3, j], late[2, j] = c0, c2
        c0, c1 = 0.5 * (c0 + c1), 0.5 * (c1 + c2)
        early[4, j], late[1, j] = c0, c1
        early[5, j] = late[0, j] = 0.5 * (c0 + c1)


@exact
def search(
    pieces: FloatArray, arm: SphereArm, field: Lattice, padding: float, resolution: float, find_least: bool
) -> tuple[int, float, int, float, float]:
    """Walk through pieces (K, 6, D) in order of time, halving where the padding is not proven.

    Args:
        field: distances to what is kept away from.
        padding: clearance wanted, m; with `find_least` the one to begin looking below.
        resolution: ways shorter than this are not halved, m.
        find_least: look for the least clearance instead of the first lack of it.

    Returns:
        Piece (-1 where there is none), place in it from 0 to 1, sphere, its clearance there, and a clearance
        that no sphere falls below. Without `find_least` the last is about the piece found alone.
    """
    n_pieces, _, n_joints = pieces.shape
    n = len(arm.spheres)
    stack = np.empty((_DEEPEST + 2, 6, n_joints))
    ends = np.empty((_DEEPEST + 2, n))
    until, depth = np.empty(_DEEPEST + 2), np.empty(_DEEPEST + 2, dtype=np.int64)
    left, way, frames = np.empty(n), np.empty(n), np.empty((n_joints + 1, 3, 4))
    found, at, which, least, floor = -1, 0.0, -1, padding, np.inf
    clearances(pieces[0, 0], arm, field, frames, left)
    if find_least:
        # Knots first: a low clearance found early spares halving elsewhere.
        for p in range(n_pieces + 1):
            if p > 0:
                here = pieces[p - 1, 5]
                clearances(here, arm, field, frames, way)
            else:
                for k in range(n):
                    way[k] = left[k]
            for k in range(n):
                if not way[k] >= least:
                    found, at, which, least = max(p - 1, 0), 1.0 if p else 0.0, k, way[k]
    for p in range(n_pieces):
        for i in range(6):
            for j in range(n_joints):
                stack[0, i, j] = pieces[p, i, j]
        clearances(pieces[p, 5], arm, field, frames, ends[0])
        until[0], depth[0], began, top = 1.0, 0, 0.0, 0
        while top >= 0:
            piece, right = stack[top], ends[top]
            ways(piece, arm.lever, way)
            worst, low, longest = -1, np.inf, 0.0
            for k in range(n):
                bound = 0.5 * (left[k] + right[k] - way[k])
                longest = max(longest, way[k])
                # Written so that a NaN counts as the worst.
                if not bound >= low:
                    worst, low = k, bound
            wanted = least - resolution if find_least else padding
            if low >= wanted or (find_least and (longest <= resolution or depth[top] >= _DEEPEST)):
                floor = min(floor, low)
                for k in range(n):
                    left[k] = right[k]
                began = until[top]
                top -= 1
                continue
            if longest <= resolution or depth[top] >= _DEEPEST:
                if left[worst] <= right[worst] or not left[worst] >= padding:
                    return p, began, worst, left[worst], low
                return p, until[top], worst, right[worst], low
            middle = 0.5 * (began + until[top])
            halve(piece, stack[top + 1], piece)
            here = stack[top + 1, 5]
            clearances(here, arm, field, frames, ends[top + 1])
            depth[top] += 1
            depth[top + 1], until[top + 1] = depth[top], middle
            top += 1
            if find_least:
                for k in range(n):
                    if ends[top, k] < least:
                        found, at, which, least = p, middle, k, ends[top, k]
    return found, at, which, least, min(floor, least)
