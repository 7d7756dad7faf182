"""The compiled costs of reaches in float32: 600 reaches of 100 postures are costed for one prediction.

Loops over waypoints (or waypoint and DoF pairs) are innermost and contiguous, so that they vectorise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import fast, fast_part

# P2's rules over offsets -2..+3 (facts section 4); see `stencils.RULES`.
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
    w = np.empty((8, n_waypoints), dtype=np.float32)
    cell = np.empty(n_waypoints, dtype=np.uint32)
    for first in range(0, len(points), n_waypoints):
        for t in range(n_waypoints):
            for p in range(n_points):
                for a in range(3):
                    place[p, a, t] = points[first + t, p, a]
        moved, close, near = (
            out[0, first : first + n_waypoints],
            out[1, first : first + n_waypoints],
            out[2, first : first + n_waypoints],
        )
        if wrist_point >= 0:
            for t in range(n_waypoints):
                for a in range(3):
                    track[0, t, a] = place[wrist_point, a, t]
            difference_costs(track, before, wrist_weights, by_axis)
            for t in range(n_waypoints):
                moved[t] = by_axis[0, t, 0] + by_axis[0, t, 1] + by_axis[0, t, 2]
        else:
            for t in range(n_waypoints):
                moved[t] = _0
        _closeness(place, partner, close)
        _obstacles(place, obstacle, w, cell, near)


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
def _obstacles(place: NDArray[Any], obstacle: Any, w: NDArray[Any], cell: NDArray[Any], out: NDArray[Any]) -> None:
    capsules, spheres, lattice, origin, resolution, clearance, weight = obstacle
    nx, ny, nz = lattice.shape
    flat = lattice.reshape(-1)
    per_cell = _1 / resolution
    n = len(out)
    for t in range(n):
        out[t] = _0
    # Nearest node instead of the place itself, and interpolation: each is off by at most 0.87 cells.
    slack = clearance + np.float32(1.75) * resolution
    for k in range(len(capsules)):
        a, b = capsules[k, 0], capsules[k, 1]
        begin, end = capsules[k, 2], capsules[k, 3]
        _along(place[a], place[b], _HALF, origin, per_cell, w)
        _nearest(w, cell, nx, ny, nz)
        # The bone may bend no more than it is long: half of it lies on each side of its middle.
        half = _0
        for t in range(n):
            x, y, z = place[a, 0, t] - place[b, 0, t], place[a, 1, t] - place[b, 1, t], place[a, 2, t] - place[b, 2, t]
            half = max(half, x * x + y * y + z * z)
        if _all_beyond(cell, flat, _HALF * np.sqrt(half) + spheres[begin, 1] + slack):
            continue
        for s in range(begin, end):
            _along(place[a], place[b], spheres[s, 0], origin, per_cell, w)
            _nearest(w, cell, nx, ny, nz)
            if _all_beyond(cell, flat, spheres[s, 1] + slack):
                continue
            _corners(w, cell, nx, ny, nz)
            _interpolate(w, cell, flat, ny, nz)
            _add_potential(w, spheres[s, 1], clearance, weight * resolution, out)


@fast_part
def _along(a: NDArray[Any], b: NDArray[Any], share: Any, origin: NDArray[Any], per_cell: Any, w: NDArray[Any]) -> None:
    """Write places between a and b (3, N) in cells of the lattice to rows 0 to 2."""
    for axis in range(3):
        u, v, row, low = a[axis], b[axis], w[axis], origin[axis]
        for t in range(len(row)):
            row[t] = (u[t] + share * (v[t] - u[t]) - low) * per_cell


@fast_part
def _nearest(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    x, y, z = w[0], w[1], w[2]
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    for t in range(len(cell)):
        i = np.int32(min(max(x[t] + _HALF, _0), mx))
        j = np.int32(min(max(y[t] + _HALF, _0), my))
        k = np.int32(min(max(z[t] + _HALF, _0), mz))
        cell[t] = np.uint32(np.int32(np.int32(i * layer) + np.int32(j * row)) + k)


@fast_part
def _all_beyond(cell: NDArray[Any], lattice: NDArray[Any], reach: Any) -> bool:
    near = _0
    for t in range(len(cell)):
        near += _0 if lattice[cell[t]] > reach else _1
    return bool(near == _0)


@fast_part
def _corners(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    """Write the lowest of the eight nodes around each place, and to rows 3 to 5 the parts of a cell beyond it."""
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    lx, ly, lz = np.int32(nx - 2), np.int32(ny - 2), np.int32(nz - 2)
    x, y, z, u, v, s = w[0], w[1], w[2], w[3], w[4], w[5]
    for t in range(len(cell)):
        px, py, pz = min(max(x[t], _0), mx), min(max(y[t], _0), my), min(max(z[t], _0), mz)
        i, j, k = min(np.int32(px), lx), min(np.int32(py), ly), min(np.int32(pz), lz)
        u[t] = px - np.float32(i)
        v[t] = py - np.float32(j)
        s[t] = pz - np.float32(k)
        cell[t] = np.uint32(np.int32(np.int32(i * layer) + np.int32(j * row)) + k)


@fast_part
def _interpolate(w: NDArray[Any], cell: NDArray[Any], lattice: NDArray[Any], ny: int, nz: int) -> None:
    """Write distances to row 6."""
    row, layer, one = np.uint32(nz), np.uint32(ny * nz), np.uint32(1)
    u, v, s, distance = w[3], w[4], w[5], w[6]
    for t in range(len(cell)):
        c = cell[t]
        low, high = lattice[c], lattice[c + one]
        a = low + s[t] * (high - low)
        low, high = lattice[c + row], lattice[c + row + one]
        a += v[t] * (low + s[t] * (high - low) - a)
        low, high = lattice[c + layer], lattice[c + layer + one]
        b = low + s[t] * (high - low)
        low, high = lattice[c + layer + row], lattice[c + layer + row + one]
        b += v[t] * (low + s[t] * (high - low) - b)
        distance[t] = a + u[t] * (b - a)


@fast_part
def _add_potential(w: NDArray[Any], radius: Any, clearance: Any, weight: Any, out: NDArray[Any]) -> None:
    """Add potential times the way between the neighbouring waypoints, halved; row 7 holds the way, in cells."""
    x, y, z, distance, way = w[0], w[1], w[2], w[6], w[7]
    n = len(out)
    for t in range(1, n - 1):
        a, b, c = x[t + 1] - x[t - 1], y[t + 1] - y[t - 1], z[t + 1] - z[t - 1]
        way[t] = _HALF * np.sqrt(a * a + b * b + c * c)
    for t, before, after in ((0, 0, 1), (n - 1, n - 2, n - 1)):
        a, b, c = x[after] - x[before], y[after] - y[before], z[after] - z[before]
        way[t] = _HALF * np.sqrt(a * a + b * b + c * c)
    inverse, half = _HALF / clearance, _HALF * clearance
    for t in range(n):
        d = distance[t] - radius
        near = min(d - clearance, _0)
        potential = half - d if d < _0 else near * near * inverse
        out[t] += weight * potential * way[t]


@fast
def lower_to_capsules(
    values: NDArray[Any],
    origin: NDArray[Any],
    resolution: Any,
    ends: NDArray[Any],
    radius: NDArray[Any],
    cap: Any,
) -> None:
    """Lower the distances at the nodes of a lattice (nx, ny, nz) to those from capsules, up to `cap`."""
    for k in range(len(radius)):
        reach = radius[k] + cap
        low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
        for a in range(3):
            near, far = min(ends[k, 0, a], ends[k, 1, a]), max(ends[k, 0, a], ends[k, 1, a])
            low[a] = max(0, int(np.floor((near - reach - origin[a]) / resolution)))
            high[a] = min(values.shape[a], int(np.ceil((far + reach - origin[a]) / resolution)) + 1)
        bx, by, bz = ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1], ends[k, 1, 2] - ends[k, 0, 2]
        length2 = max(bx * bx + by * by + bz * bz, np.float32(1e-12))
        for i in range(low[0], high[0]):
            x = origin[0] + np.float32(i) * resolution - ends[k, 0, 0]
            for j in range(low[1], high[1]):
                y = origin[1] + np.float32(j) * resolution - ends[k, 0, 1]
                row = values[i, j]
                for m in range(low[2], high[2]):
                    z = origin[2] + np.float32(m) * resolution - ends[k, 0, 2]
                    s = min(max((x * bx + y * by + z * bz) / length2, _0), _1)
                    u, v, w = x - s * bx, y - s * by, z - s * bz
                    row[m] = min(row[m], np.sqrt(u * u + v * v + w * w) - radius[k])
