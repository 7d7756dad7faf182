"""The compiled costs of reaches in float32: 600 reaches of 100 postures are costed for one prediction.

Loops over waypoints (or waypoint and DoF pairs) are innermost and contiguous, so that they vectorise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.chain_kernels import BLOCK, X, Y, Z
from humanpred_ros.geometry.compiled import fast, fast_part
from humanpred_ros.geometry.lattice_kernels import all_above, nearest_nodes
from humanpred_ros.stomp.cost_kernels import COST, ROWS, add_obstacles, mark_ends

# P2's rules over offsets -2..+3 (docs/papers.md, P2 features).
_V = tuple(np.float32(c / 6.0) for c in (-2.0, -3.0, 6.0, -1.0))
_A = tuple(np.float32(c / 12.0) for c in (-1.0, 16.0, -30.0, 16.0, -1.0))
_J = tuple(np.float32(c / 12.0) for c in (1.0, -17.0, 46.0, -46.0, 17.0, -1.0))
_V0, _V1, _V2, _V3 = _V
_A0, _A1, _A2 = _A[:3]
_J0, _J1, _J2, _J3, _J4, _J5 = _J
#: How many waypoints the rules look back and ahead.
BACK, AHEAD = 2, 3
_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_E2, _E3, _E4, _E5 = (np.float32(1.0 / k) for k in (2, 6, 24, 120))
_PER_64 = np.float32(1.0 / 64.0)


@fast
def difference_costs(y: NDArray[Any], before: NDArray[Any], weights: NDArray[Any], out: NDArray[Any]) -> None:
    """Write what each waypoint and signal of y (R, N, C) costs by step, velocity, acceleration and jerk; out (R, N, C).

    weights (4,) multiply the squares of the differences, which are in units of one waypoint's step. `before` (2, C)
    came before the first waypoint; after the last one it is repeated, so the last waypoint has no step.
    """
    n_reaches, n, width = y.shape
    lanes = n * width
    padded = np.empty((BACK + n + AHEAD) * width, dtype=np.float32)
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    first = BACK * width
    for k in range(first):
        padded[k] = before[k // width, k % width]
    for r in range(n_reaches):
        flat, costs = y[r].reshape(-1), out[r].reshape(-1)
        for k in range(lanes):
            padded[first + k] = flat[k]
        for k in range(AHEAD * width):
            padded[first + lanes + k] = flat[lanes - width + k % width]
        _differences(padded, width, lanes, w0, w1, w2, w3, costs)


@fast_part
def _differences(
    padded: NDArray[Any], width: int, lanes: int, w0: Any, w1: Any, w2: Any, w3: Any, costs: NDArray[Any]
) -> None:
    a, b, c = padded[:lanes], padded[width : width + lanes], padded[2 * width : 2 * width + lanes]
    d, e = padded[3 * width : 3 * width + lanes], padded[4 * width : 4 * width + lanes]
    f = padded[5 * width : 5 * width + lanes]
    for k in range(lanes):
        step = d[k] - c[k]
        velocity = _V0 * b[k] + _V1 * c[k] + _V2 * d[k] + _V3 * e[k]
        acceleration = _A0 * (a[k] + e[k]) + _A1 * (b[k] + d[k]) + _A2 * c[k]
        jerk = _J0 * a[k] + _J1 * b[k] + _J2 * c[k] + _J3 * d[k] + _J4 * e[k] + _J5 * f[k]
        costs[k] = w0 * step * step + w1 * velocity * velocity + w2 * acceleration * acceleration + w3 * jerk * jerk


@fast
def body_costs(
    points: NDArray[Any],
    n_waypoints: int,
    wrist: Any,
    partner: Any,
    obstacle: Any,
    out: NDArray[Any],
) -> None:
    """Write the three shares of what the body's places cost; points (M, P, 3) of whole reaches; out (3, M).

    wrist is (point, before (2, 3), weights (4,)) as in `difference_costs`; partner (pairs (K, 2) of a point and a
    partner's point, weights (K,), partner's points (B, 3), decay, cutoff); obstacle (capsules (C, 4) of two points, and
    where its spheres begin and end, spheres (S, 2) of place along the bone and radius, lattice (nx, ny, nz) of
    distances, origin, resolution, clearance, weight per metre of way).
    """
    wrist_point, before, wrist_weights = wrist
    n_points = points.shape[1]
    place = np.empty((n_points, 3, n_waypoints), dtype=np.float32)
    track = np.empty((1, n_waypoints, 3), dtype=np.float32)
    by_axis = np.empty((1, n_waypoints, 3), dtype=np.float32)
    for first in range(0, len(points), n_waypoints):
        moved, close = out[0, first : first + n_waypoints], out[1, first : first + n_waypoints]
        for t in range(n_waypoints):
            moved[t] = _0
            for p in range(n_points):
                for a in range(3):
                    place[p, a, t] = points[first + t, p, a]
        if wrist_point >= 0:
            for t in range(n_waypoints):
                for a in range(3):
                    track[0, t, a] = place[wrist_point, a, t]
            difference_costs(track, before, wrist_weights, by_axis)
            for t in range(n_waypoints):
                moved[t] = by_axis[0, t, 0] + by_axis[0, t, 1] + by_axis[0, t, 2]
        _closeness(place, partner, close)
    _obstacles(points, n_waypoints, obstacle, out[2])


@fast_part
def _closeness(place: NDArray[Any], partner: Any, out: NDArray[Any]) -> None:
    pairs, weights, other, decay, cutoff = partner
    for t in range(len(out)):
        out[t] = _0
    for k in range(len(pairs)):
        _add_closeness(
            place[pairs[k, 0], 0], place[pairs[k, 0], 1], place[pairs[k, 0], 2], other[pairs[k, 1], 0],
            other[pairs[k, 1], 1], other[pairs[k, 1], 2], weights[k], decay, cutoff, out,
        )  # fmt: skip


@fast_part
def _add_closeness(
    px: NDArray[Any], py: NDArray[Any], pz: NDArray[Any], ox: Any, oy: Any, oz: Any,
    weight: Any, decay: Any, cutoff: Any, out: NDArray[Any],
) -> None:  # fmt: skip
    """Add weight exp(-decay d), by a polynomial of a 64th of the exponent; relative error 1e-5 down to e^-10."""
    for t in range(len(out)):
        x, y, z = px[t] - ox, py[t] - oy, pz[t] - oz
        d = np.sqrt(x * x + y * y + z * z)
        e = -decay * min(d, cutoff) * _PER_64
        e = _1 + e * (_1 + e * (_E2 + e * (_E3 + e * (_E4 + e * _E5))))
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        out[t] += weight * e if d < cutoff else _0


@fast_part
def _obstacles(points: NDArray[Any], n_waypoints: int, obstacle: Any, out: NDArray[Any]) -> None:
    """Write what nearness to obstacles costs at each posture (M,), in blocks as `stomp.cost_kernels` does."""
    capsules, spheres, lattice, origin, resolution, clearance, weight = obstacle
    (nx, ny, nz), flat = lattice.shape, lattice.reshape(-1)
    n_points, per_cell, last = points.shape[1], _1 / resolution, len(points) - 1
    # Nearest node instead of the place itself, and interpolation: each is off by at most 0.87 cells.
    slack = clearance + np.float32(1.75) * resolution
    place = np.empty((n_points, 3, BLOCK), dtype=np.float32)
    w, cell = np.zeros(ROWS * BLOCK, dtype=np.float32), np.zeros(BLOCK, dtype=np.uint32)
    for first in range(0, len(points), BLOCK - 2):
        mark_ends(w, first - 1, n_waypoints)
        for i in range(BLOCK):
            w[COST + i] = _0
            for p in range(n_points):
                for a in range(3):
                    place[p, a, i] = points[min(max(first - 1 + i, 0), last), p, a]
        for k in range(len(capsules)):
            a, b, begin, end = capsules[k, 0], capsules[k, 1], capsules[k, 2], capsules[k, 3]
            _along(place[a], place[b], _HALF, origin, per_cell, w)
            nearest_nodes(w, cell, nx, ny, nz)
            # Half of the bone lies on each side of its middle.
            longest = _0
            for i in range(BLOCK):
                x, y = place[a, 0, i] - place[b, 0, i], place[a, 1, i] - place[b, 1, i]
                z = place[a, 2, i] - place[b, 2, i]
                longest = max(longest, x * x + y * y + z * z)
            if all_above(cell, flat, _HALF * np.sqrt(longest) + spheres[begin, 1] + slack):
                continue
            for s in range(begin, end):
                _along(place[a], place[b], spheres[s, 0], origin, per_cell, w)
                add_obstacles(w, cell, spheres[s, 1], slack, clearance, weight * resolution, flat, nx, ny, nz)
        for i in range(min(BLOCK - 2, len(points) - first)):
            out[first + i] = w[COST + 1 + i]


@fast_part
def _along(a: NDArray[Any], b: NDArray[Any], share: Any, origin: NDArray[Any], per_cell: Any, w: NDArray[Any]) -> None:
    """Write places between a and b (3, BLOCK), in cells of the lattice, to rows X, Y and Z."""
    for i in range(BLOCK):
        w[X + i] = (a[0, i] + share * (b[0, i] - a[0, i]) - origin[0]) * per_cell
        w[Y + i] = (a[1, i] + share * (b[1, i] - a[1, i]) - origin[1]) * per_cell
        w[Z + i] = (a[2, i] + share * (b[2, i] - a[2, i]) - origin[2]) * per_cell
