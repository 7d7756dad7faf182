"""The compiled search of `motion_check`: between two moments, how close can a sphere of the arm have come?

Movements come as Bézier pieces of degree 5, control points (6, D) per piece. A joint turns during a piece by
at most the sum of its control points' steps, and halving a piece (de Casteljau) only lowers that sum; so a
sphere's way is bounded by turns times lever arms, and the bound becomes exact as pieces become short.

Distances to obstacles are 1-Lipschitz: a sphere with clearances d0 and d1 at the ends of a way of length w
keeps at least (d0 + d1 - w) / 2 in between.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import exact, exact_part

#: A piece is never halved more often: 2^-40 of a second moves nothing.
_DEEPEST = 40


@exact_part
def _distance(x: float, y: float, z: float, values: NDArray[Any], origin: NDArray[Any], cells_per_m: float) -> float:
    """Return the trilinear interpolation at a world point; points outside the lattice go to its border."""
    nx, ny, nz = values.shape
    x = min(max((x - origin[0]) * cells_per_m, 0.0), nx - 1.0)
    y = min(max((y - origin[1]) * cells_per_m, 0.0), ny - 1.0)
    z = min(max((z - origin[2]) * cells_per_m, 0.0), nz - 1.0)
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    u, v, w = x - i, y - j, z - k
    near = (values[i, j, k] * (1.0 - w) + values[i, j, k + 1] * w) * (1.0 - v) + (
        values[i, j + 1, k] * (1.0 - w) + values[i, j + 1, k + 1] * w
    ) * v
    far = (values[i + 1, j, k] * (1.0 - w) + values[i + 1, j, k + 1] * w) * (1.0 - v) + (
        values[i + 1, j + 1, k] * (1.0 - w) + values[i + 1, j + 1, k + 1] * w
    ) * v
    value: float = near * (1.0 - u) + far * u
    return value


@exact_part
def clearances(
    q: NDArray[Any],
    root: NDArray[Any],
    joints: NDArray[Any],
    spheres: NDArray[Any],
    first: NDArray[Any],
    values: NDArray[Any],
    origin: NDArray[Any],
    cells_per_m: float,
    out: NDArray[Any],
    centres: NDArray[Any],
) -> None:
    """Write each sphere's distance to obstacles less its radius (S,), and its centre (S, 3), at q (D,).

    Args:
        root: (3, 4) pose of the root.
        joints: (D, 15) origin, fixed rotation (row by row) and unit axis of each joint.
        spheres: (S, 4) centre in the joint's frame and radius, in the order of joints.
        first: (D + 1,) where each joint's spheres begin.
        values, origin, cells_per_m: the distance field.
    """
    r00, r01, r02, px = root[0, 0], root[0, 1], root[0, 2], root[0, 3]
    r10, r11, r12, py = root[1, 0], root[1, 1], root[1, 2], root[1, 3]
    r20, r21, r22, pz = root[2, 0], root[2, 1], root[2, 2], root[2, 3]
    f = np.empty((3, 3))
    for j in range(len(joints)):
        row = joints[j]
        px += r00 * row[0] + r01 * row[1] + r02 * row[2]
        py += r10 * row[0] + r11 * row[1] + r12 * row[2]
        pz += r20 * row[0] + r21 * row[1] + r22 * row[2]
        ax, ay, az = row[12], row[13], row[14]
        c, s = np.cos(q[j]), np.sin(q[j])
        d = 1.0 - c
        # Fixed rotation times the rotation about the axis (Rodrigues).
        t00, t01, t02 = c + ax * ax * d, ax * ay * d - az * s, ax * az * d + ay * s
        t10, t11, t12 = ax * ay * d + az * s, c + ay * ay * d, ay * az * d - ax * s
        t20, t21, t22 = ax * az * d - ay * s, ay * az * d + ax * s, c + az * az * d
        for i in range(3):
            a, b, e = row[3 + 3 * i], row[4 + 3 * i], row[5 + 3 * i]
            f[i, 0] = a * t00 + b * t10 + e * t20
            f[i, 1] = a * t01 + b * t11 + e * t21
            f[i, 2] = a * t02 + b * t12 + e * t22
        a, b, e = r00, r01, r02
        r00 = a * f[0, 0] + b * f[1, 0] + e * f[2, 0]
        r01 = a * f[0, 1] + b * f[1, 1] + e * f[2, 1]
        r02 = a * f[0, 2] + b * f[1, 2] + e * f[2, 2]
        a, b, e = r10, r11, r12
        r10 = a * f[0, 0] + b * f[1, 0] + e * f[2, 0]
        r11 = a * f[0, 1] + b * f[1, 1] + e * f[2, 1]
        r12 = a * f[0, 2] + b * f[1, 2] + e * f[2, 2]
        a, b, e = r20, r21, r22
        r20 = a * f[0, 0] + b * f[1, 0] + e * f[2, 0]
        r21 = a * f[0, 1] + b * f[1, 1] + e * f[2, 1]
        r22 = a * f[0, 2] + b * f[1, 2] + e * f[2, 2]
        for k in range(first[j], first[j + 1]):
            x, y, z = spheres[k, 0], spheres[k, 1], spheres[k, 2]
            centres[k, 0] = r00 * x + r01 * y + r02 * z + px
            centres[k, 1] = r10 * x + r11 * y + r12 * z + py
            centres[k, 2] = r20 * x + r21 * y + r22 * z + pz
            found = _distance(centres[k, 0], centres[k, 1], centres[k, 2], values, origin, cells_per_m)
            out[k] = found - spheres[k, 3]


@exact_part
def ways(piece: NDArray[Any], lever: NDArray[Any], out: NDArray[Any]) -> None:
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
def halve(piece: NDArray[Any], early: NDArray[Any], late: NDArray[Any]) -> None:
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
    pieces: NDArray[Any],
    root: NDArray[Any],
    joints: NDArray[Any],
    spheres: NDArray[Any],
    first: NDArray[Any],
    lever: NDArray[Any],
    values: NDArray[Any],
    origin: NDArray[Any],
    cells_per_m: float,
    padding: float,
    resolution: float,
    find_least: bool,
) -> tuple[int, float, int, float, float]:
    """Walk through pieces (K, 6, D) in order of time, halving where the padding is not proven.

    Args:
        lever: (D, S) distance of each sphere from each joint's axis, at most.
        padding: clearance wanted, m; with `find_least` the one to begin looking below.
        resolution: ways shorter than this are not halved, m.
        find_least: look for the least clearance instead of the first lack of it.

    Returns:
        Piece (-1 where there is none), place in it from 0 to 1, sphere, its clearance there, and a clearance
        that no sphere falls below. Without `find_least` the last is about the piece found alone.
    """
    n_pieces, _, n_joints = pieces.shape
    n = len(spheres)
    stack = np.empty((_DEEPEST + 2, 6, n_joints))
    ends = np.empty((_DEEPEST + 2, n))
    until, depth = np.empty(_DEEPEST + 2), np.empty(_DEEPEST + 2, dtype=np.int64)
    left, way, centres = np.empty(n), np.empty(n), np.empty((n, 3))
    found, at, which, least, floor = -1, 0.0, -1, padding, np.inf
    clearances(pieces[0, 0], root, joints, spheres, first, values, origin, cells_per_m, left, centres)
    if find_least:
        # Knots first: a low clearance found early spares halving elsewhere.
        for p in range(n_pieces + 1):
            if p > 0:
                here = pieces[p - 1, 5]
                clearances(here, root, joints, spheres, first, values, origin, cells_per_m, way, centres)
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
        clearances(pieces[p, 5], root, joints, spheres, first, values, origin, cells_per_m, ends[0], centres)
        until[0], depth[0], began, top = 1.0, 0, 0.0, 0
        while top >= 0:
            piece, right = stack[top], ends[top]
            ways(piece, lever, way)
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
            clearances(here, root, joints, spheres, first, values, origin, cells_per_m, ends[top + 1], centres)
            depth[top] += 1
            depth[top + 1], until[top + 1] = depth[top], middle
            top += 1
            if find_least:
                for k in range(n):
                    if ends[top, k] < least:
                        found, at, which, least = p, middle, k, ends[top, k]
    return found, at, which, least, min(floor, least)
