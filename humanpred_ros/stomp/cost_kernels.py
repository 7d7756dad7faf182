"""The compiled inner loops of the planner's costs; `cost_oracle` says the same in plain NumPy.

What makes them fast (DESIGN.md, Speed): float32 throughout; 64 configurations at a time, structure of arrays,
in one flat scratch array whose rows lie at constant offsets, so the compiler can prove that they do not
overlap; cells computed in one loop and looked up in the next; sine and cosine by polynomials; clamping onto
the lattice instead of bounds tests (the occupancy has a border of zeros for it); links that are surely far
from everything skipped; no Python objects, so threads run side by side.

Rows of the scratch array (each BLOCK long): 0..8 rotation of the current link in cells per metre, row by row;
9..11 its position in cells; then the named ones below.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import fast, fast_inline, fast_part

Scalar: TypeAlias = Any

BLOCK = 64
#: Columns of the joints of a `FlatChain`: origin (3), fixed rotation (9) and whether there is one, axis, first
#: and last + 1 of the joint's points, centre and radius of a ball around them.
ROTATION, TURNED, AXIS, FIRST, LAST, BOUND, COLUMNS = 3, 12, 13, 14, 15, 16, 20
_SIN, _COS, _ANGLE = 12 * BLOCK, 13 * BLOCK, 14 * BLOCK
_DISTANCE, _COST, _NEAREST, _BEFORE, _AFTER = 15 * BLOCK, 16 * BLOCK, 17 * BLOCK, 18 * BLOCK, 19 * BLOCK
# Speeds are differences of neighbours: written after the positions, they would be read back too soon
# for the compiler to vectorise, so they lie before them.
_SPEED = 20 * BLOCK
_X, _Y, _Z = 22 * BLOCK, 23 * BLOCK, 24 * BLOCK
_PART_X, _PART_Y, _PART_Z = 26 * BLOCK, 27 * BLOCK, 28 * BLOCK
_ROWS = 30

_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
# pi and its rest below float32, so that reducing an angle of many turns stays exact to float32.
_INV_PI = np.float32(1.0 / np.pi)
_PI_HIGH = np.float32(3.140625)
_PI_LOW = np.float32(np.pi - 3.140625)
# Taylor coefficients; the truncation is below 1e-7 on [-pi/2, pi/2].
_S3, _S5, _S7, _S9, _S11 = (np.float32(c) for c in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800))
_C2, _C4, _C6 = (np.float32(c) for c in (-1 / 2, 1 / 24, -1 / 720))
_C8, _C10, _C12 = (np.float32(c) for c in (1 / 40320, -1 / 3628800, 1 / 479001600))


@fast_part
def _sincos(w: NDArray[Any]) -> None:
    for i in range(BLOCK):
        x = w[_ANGLE + i]
        turns = np.rint(x * _INV_PI)
        r = (x - turns * _PI_HIGH) - turns * _PI_LOW
        half = turns * _HALF
        sign = _1 - np.float32(4.0) * abs(half - np.rint(half))
        r2 = r * r
        w[_SIN + i] = sign * r * (_1 + r2 * (_S3 + r2 * (_S5 + r2 * (_S7 + r2 * (_S9 + r2 * _S11)))))
        w[_COS + i] = sign * (_1 + r2 * (_C2 + r2 * (_C4 + r2 * (_C6 + r2 * (_C8 + r2 * (_C10 + r2 * _C12))))))


@fast_part
def _spread(root: NDArray[Any]) -> NDArray[Any]:
    """Repeat the root's 12 numbers for every configuration of a block."""
    frames = np.empty(12 * BLOCK, dtype=np.float32)
    for k in range(12):
        for i in range(BLOCK):
            frames[k * BLOCK + i] = root[k]
    return frames


@fast_part
def _start(w: NDArray[Any], frames: NDArray[Any]) -> None:
    for i in range(12 * BLOCK):
        w[i] = frames[i]


@fast_part
def _translate(w: NDArray[Any], x: Scalar, y: Scalar, z: Scalar) -> None:
    for k in range(3):
        for i in range(BLOCK):
            w[(9 + k) * BLOCK + i] += (
                w[3 * k * BLOCK + i] * x + w[(3 * k + 1) * BLOCK + i] * y + w[(3 * k + 2) * BLOCK + i] * z
            )


@fast_part
def _turn_fixed(w: NDArray[Any], f: NDArray[Any]) -> None:
    for k in range(3):
        for i in range(BLOCK):
            a = w[3 * k * BLOCK + i]
            b = w[(3 * k + 1) * BLOCK + i]
            c = w[(3 * k + 2) * BLOCK + i]
            w[3 * k * BLOCK + i] = a * f[0] + b * f[3] + c * f[6]
            w[(3 * k + 1) * BLOCK + i] = a * f[1] + b * f[4] + c * f[7]
            w[(3 * k + 2) * BLOCK + i] = a * f[2] + b * f[5] + c * f[8]


@fast_inline
def _rotate(w: NDArray[Any], u: int, v: int) -> None:
    for k in range(3):
        for i in range(BLOCK):
            a = w[(3 * k + u) * BLOCK + i]
            b = w[(3 * k + v) * BLOCK + i]
            w[(3 * k + u) * BLOCK + i] = a * w[_COS + i] + b * w[_SIN + i]
            w[(3 * k + v) * BLOCK + i] = b * w[_COS + i] - a * w[_SIN + i]


@fast_part
def _rotate_x(w: NDArray[Any]) -> None:
    _rotate(w, 1, 2)


@fast_part
def _rotate_y(w: NDArray[Any]) -> None:
    _rotate(w, 2, 0)


@fast_part
def _rotate_z(w: NDArray[Any]) -> None:
    _rotate(w, 0, 1)


@fast_part
def _next_link(w: NDArray[Any], q: NDArray[Any], first: int, j: int, joints: NDArray[Any]) -> None:
    """Carry the frames of a block over joint j; the block's configurations start at row `first` of q."""
    last = len(q) - 1
    if first >= 0 and first + BLOCK <= len(q):
        flat = q.reshape(-1)
        # Unsigned indices spare the test for counting from the end.
        at, step = np.uint64(first * q.shape[1] + j), np.uint64(q.shape[1])
        for i in range(BLOCK):
            w[_ANGLE + i] = flat[at + np.uint64(i) * step]
    else:
        for i in range(BLOCK):
            w[_ANGLE + i] = q[min(max(first + i, 0), last), j]
    _sincos(w)
    _translate(w, joints[j, 0], joints[j, 1], joints[j, 2])
    if joints[j, TURNED] != _0:
        _turn_fixed(w, joints[j, ROTATION : ROTATION + 9])
    axis = int(joints[j, AXIS])
    if axis == 0:
        _rotate_x(w)
    elif axis == 1:
        _rotate_y(w)
    else:
        _rotate_z(w)


@fast_part
def _place(w: NDArray[Any], x: Scalar, y: Scalar, z: Scalar) -> None:
    for i in range(BLOCK):
        w[_X + i] = w[i] * x + w[BLOCK + i] * y + w[2 * BLOCK + i] * z + w[9 * BLOCK + i]
        w[_Y + i] = w[3 * BLOCK + i] * x + w[4 * BLOCK + i] * y + w[5 * BLOCK + i] * z + w[10 * BLOCK + i]
        w[_Z + i] = w[6 * BLOCK + i] * x + w[7 * BLOCK + i] * y + w[8 * BLOCK + i] * z + w[11 * BLOCK + i]


@fast_part
def _cells(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    for i in range(BLOCK):
        x = np.int32(min(max(w[_X + i], _0), mx))
        y = np.int32(min(max(w[_Y + i], _0), my))
        z = np.int32(min(max(w[_Z + i], _0), mz))
        # Every product is brought back to 32 bits: 64-bit ones would halve the vector width.
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def _add_cells(w: NDArray[Any], cell: NDArray[Any], lattice: NDArray[Any]) -> None:
    for i in range(BLOCK):
        w[_COST + i] += lattice[cell[i]]


@fast_part
def _outside(w: NDArray[Any], radius: Scalar, nx: int, ny: int, nz: int) -> bool:
    """Whether balls around (_X, _Y, _Z) all stay in the border, in cells."""
    hx, hy, hz = np.float32(nx) * _HALF, np.float32(ny) * _HALF, np.float32(nz) * _HALF
    inside = _0
    for i in range(BLOCK):
        gap = max(abs(w[_X + i] - hx) - hx, max(abs(w[_Y + i] - hy) - hy, abs(w[_Z + i] - hz) - hz)) + _1
        inside += _1 if gap < radius else _0
    return bool(inside == _0)


@fast
def occupancy_sums(
    q: NDArray[Any],
    root: NDArray[Any],
    joints: NDArray[Any],
    points: NDArray[Any],
    cells_per_m: Scalar,
    lattice: NDArray[Any],
    nx: int,
    ny: int,
    nz: int,
    out: NDArray[Any],
) -> None:
    """Write the sum over body points of the lattice value at each point.

    q (M, J) and out (M,); root, joints and points as in `FlatChain`; the lattice (nx·ny·nz,) has a border of
    zeros.
    """
    w = np.zeros(_ROWS * BLOCK, dtype=np.float32)
    cell = np.zeros(BLOCK, dtype=np.uint32)
    frames = _spread(root)
    for first in range(0, len(q), BLOCK):
        _start(w, frames)
        for i in range(BLOCK):
            w[_COST + i] = _0
        for j in range(q.shape[1]):
            _next_link(w, q, first, j, joints)
            begin, end = int(joints[j, FIRST]), int(joints[j, LAST])
            if begin == end:
                continue
            _place(w, joints[j, BOUND], joints[j, BOUND + 1], joints[j, BOUND + 2])
            # The lattice is cropped to what is occupied: a link that stays in its border adds zeros only.
            if _outside(w, joints[j, BOUND + 3] * cells_per_m + _HALF, nx, ny, nz):
                continue
            for p in range(begin, end):
                _place(w, points[p, 0], points[p, 1], points[p, 2])
                _cells(w, cell, nx, ny, nz)
                _add_cells(w, cell, lattice)
        for i in range(min(BLOCK, len(q) - first)):
            out[first + i] = w[_COST + i]


@fast_part
def _speeds(w: NDArray[Any], scale: Scalar) -> None:
    for i in range(BLOCK):
        a, b = w[_BEFORE + i], w[_AFTER + i]
        x = a * (w[_X + i] - w[_X - 1 + i]) + b * (w[_X + 1 + i] - w[_X + i])
        y = a * (w[_Y + i] - w[_Y - 1 + i]) + b * (w[_Y + 1 + i] - w[_Y + i])
        z = a * (w[_Z + i] - w[_Z - 1 + i]) + b * (w[_Z + 1 + i] - w[_Z + i])
        w[_SPEED + i] = scale * np.sqrt(x * x + y * y + z * z)


@fast_part
def _add_potential(w: NDArray[Any], radius: Scalar, clearance: Scalar) -> None:
    inverse = _HALF / clearance
    half = _HALF * clearance
    for i in range(BLOCK):
        d = w[_DISTANCE + i] - radius
        near = min(d - clearance, _0)
        potential = half - d if d < _0 else near * near * inverse
        w[_COST + i] += potential * w[_SPEED + i]
        w[_NEAREST + i] = min(w[_NEAREST + i], d)


@fast_part
def _nearest_nodes(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    for i in range(BLOCK):
        x = np.int32(min(max(w[_X + i] + _HALF, _0), mx))
        y = np.int32(min(max(w[_Y + i] + _HALF, _0), my))
        z = np.int32(min(max(w[_Z + i] + _HALF, _0), mz))
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def _all_beyond(cell: NDArray[Any], lattice: NDArray[Any], reach: Scalar) -> bool:
    """Whether the distance at every node looked up is more than `reach`."""
    near = _0
    for i in range(BLOCK):
        near += _0 if lattice[cell[i]] > reach else _1
    return bool(near == _0)


@fast_part
def _corners(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    """Turn positions into the lowest of the eight nodes around them and the parts of a cell beyond it."""
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    lx, ly, lz = np.int32(nx - 2), np.int32(ny - 2), np.int32(nz - 2)
    for i in range(BLOCK):
        px, py, pz = min(max(w[_X + i], _0), mx), min(max(w[_Y + i], _0), my), min(max(w[_Z + i], _0), mz)
        x, y, z = min(np.int32(px), lx), min(np.int32(py), ly), min(np.int32(pz), lz)
        w[_PART_X + i] = px - np.float32(x)
        w[_PART_Y + i] = py - np.float32(y)
        w[_PART_Z + i] = pz - np.float32(z)
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def _interpolate(w: NDArray[Any], cell: NDArray[Any], lattice: NDArray[Any], ny: int, nz: int) -> None:
    row, layer = np.uint32(nz), np.uint32(ny * nz)
    one = np.uint32(1)
    for i in range(BLOCK):
        c = cell[i]
        x, y, z = w[_PART_X + i], w[_PART_Y + i], w[_PART_Z + i]
        low, high = lattice[c], lattice[c + one]
        a = low + z * (high - low)
        low, high = lattice[c + row], lattice[c + row + one]
        a += y * (low + z * (high - low) - a)
        low, high = lattice[c + layer], lattice[c + layer + one]
        b = low + z * (high - low)
        low, high = lattice[c + layer + row], lattice[c + layer + row + one]
        b += y * (low + z * (high - low) - b)
        w[_DISTANCE + i] = a + x * (b - a)


@fast
def obstacle_sums(
    q: NDArray[Any],
    n_waypoints: int,
    root: NDArray[Any],
    joints: NDArray[Any],
    spheres: NDArray[Any],
    resolution: Scalar,
    speed_scale: Scalar,
    clearance: Scalar,
    lattice: NDArray[Any],
    nx: int,
    ny: int,
    nz: int,
    out: NDArray[Any],
    nearest: NDArray[Any],
) -> None:
    """Write potential x speed summed over spheres, and the nearest distance cut off at the clearance.

    q (M, J) holds whole rollouts of `n_waypoints` one after the other; out and nearest are (M,); root, joints
    and spheres as in `FlatChain`. A block yields 62 results: its first and last configurations are only
    neighbours to take differences with.
    """
    w = np.zeros(_ROWS * BLOCK, dtype=np.float32)
    cell = np.zeros(BLOCK, dtype=np.uint32)
    frames = _spread(root)
    to_metres = speed_scale * resolution
    # The nearest node is off by up to 0.87 cells, the interpolation by as much: beyond this nothing is near.
    slack = clearance + np.float32(1.75) * resolution
    for first in range(0, len(q), BLOCK - 2):
        _start(w, frames)
        t = (first - 1) % n_waypoints
        for i in range(BLOCK):
            w[_BEFORE + i] = _HALF if t > 0 else _0
            w[_AFTER + i] = _HALF if t < n_waypoints - 1 else _0
            t = t + 1 if t < n_waypoints - 1 else 0
        for i in range(BLOCK):
            w[_COST + i] = _0
            w[_NEAREST + i] = clearance
        for j in range(q.shape[1]):
            _next_link(w, q, first - 1, j, joints)
            begin, end = int(joints[j, FIRST]), int(joints[j, LAST])
            if begin == end:
                continue
            _place(w, joints[j, BOUND], joints[j, BOUND + 1], joints[j, BOUND + 2])
            _nearest_nodes(w, cell, nx, ny, nz)
            if _all_beyond(cell, lattice, joints[j, BOUND + 3] + slack):
                continue
            for p in range(begin, end):
                _place(w, spheres[p, 0], spheres[p, 1], spheres[p, 2])
                _nearest_nodes(w, cell, nx, ny, nz)
                if _all_beyond(cell, lattice, spheres[p, 3] + slack):
                    continue
                _corners(w, cell, nx, ny, nz)
                _interpolate(w, cell, lattice, ny, nz)
                _speeds(w, to_metres)
                _add_potential(w, spheres[p, 3], clearance)
        for i in range(min(BLOCK - 2, len(q) - first)):
            out[first + i] = w[_COST + 1 + i]
            nearest[first + i] = w[_NEAREST + 1 + i]
