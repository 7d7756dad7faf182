"""The compiled sums of the planner's costs: occupancy at an arm's points, and obstacles near its spheres.

Positions come from `chain_kernels`, look-ups from `lattice_kernels`; links that are surely far from everything are
skipped. No Python objects, so threads run side by side. `test/cost_oracle.py` says the same in plain NumPy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from humanpred_ros.geometry.chain_kernels import BEFORE_X, BLOCK, Scalar, X, Y, Z, next_joint, place, spread, start
from humanpred_ros.geometry.compiled import Array, fast, fast_part
from humanpred_ros.geometry.joints import BOUND, FIRST, LAST, FlatChain
from humanpred_ros.geometry.lattice_kernels import (
    FREE_ROWS,
    VALUE,
    all_above,
    corners,
    interpolate,
    nearest_nodes,
    voxels,
)

#: Rows of the scratch array beyond those of positions and look-ups.
COST, NEAREST = FREE_ROWS * BLOCK, (FREE_ROWS + 1) * BLOCK
_BEFORE, _AFTER, ROWS = (FREE_ROWS + 2) * BLOCK, (FREE_ROWS + 3) * BLOCK, FREE_ROWS + 4
# Speeds are differences of neighbours: written after the positions, they would be read back too soon for the compiler
# to vectorise, so they lie before them.
_SPEED = BEFORE_X

_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


class Occupied(NamedTuple):
    """An arm's points and the occupancy they may meet."""

    arm: FlatChain  #: in cells of the lattice
    lattice: Array  #: (nx·ny·nz,) probabilities with a border of zeros
    shape: tuple[int, int, int]  #: of the lattice
    cells_per_m: np.float32
    factor: np.float32  #: on the sum over points, and on the cost
    weight: np.float32


class Obstacles(NamedTuple):
    """An arm's spheres and the obstacles around it."""

    arm: FlatChain  #: in cells of the lattice
    lattice: Array  #: (nx·ny·nz,) distances, m
    shape: tuple[int, int, int]  #: of the lattice; m
    resolution: np.float32
    speed_scale: np.float32  #: waypoints a second
    clearance: np.float32  #: distance beyond which nothing is charged, and below which nothing is allowed, m
    margin: np.float32
    weight: np.float32  #: on the cost


@fast_part
def _add_voxels(w: Array, cell: Array, lattice: Array) -> None:
    for i in range(BLOCK):
        w[COST + i] += lattice[cell[i]]


@fast_part
def _outside(w: Array, radius: Scalar, nx: int, ny: int, nz: int) -> bool:
    """Whether balls around (X, Y, Z) all stay in the border, in cells."""
    hx, hy, hz = np.float32(nx) * _HALF, np.float32(ny) * _HALF, np.float32(nz) * _HALF
    inside = _0
    for i in range(BLOCK):
        gap = max(abs(w[X + i] - hx) - hx, max(abs(w[Y + i] - hy) - hy, abs(w[Z + i] - hz) - hz)) + _1
        inside += _1 if gap < radius else _0
    return bool(inside == _0)


@fast
def occupancy_sums(q: Array, occupied: Occupied, out: Array) -> None:
    """Write the sum (M,) over body points of the lattice's value at each point, at configurations q (M, J)."""
    root, joints, points = occupied.arm
    lattice, (nx, ny, nz) = occupied.lattice, occupied.shape
    w = np.zeros(ROWS * BLOCK, dtype=np.float32)
    cell = np.zeros(BLOCK, dtype=np.uint32)
    frames = spread(root)
    for first in range(0, len(q), BLOCK):
        start(w, frames)
        for i in range(BLOCK):
            w[COST + i] = _0
        for j in range(q.shape[1]):
            next_joint(w, q, first, j, joints)
            begin, end = int(joints[j, FIRST]), int(joints[j, LAST])
            if begin == end:
                continue
            place(w, joints[j, BOUND], joints[j, BOUND + 1], joints[j, BOUND + 2])
            # The lattice is cropped to what is occupied: a link that stays in its border adds zeros only.
            if _outside(w, joints[j, BOUND + 3] * occupied.cells_per_m + _HALF, nx, ny, nz):
                continue
            for p in range(begin, end):
                place(w, points[p, 0], points[p, 1], points[p, 2])
                voxels(w, cell, nx, ny, nz)
                _add_voxels(w, cell, lattice)
        for i in range(min(BLOCK, len(q) - first)):
            out[first + i] = w[COST + i]


@fast_part
def _speeds(w: Array, scale: Scalar) -> None:
    for i in range(BLOCK):
        a, b = w[_BEFORE + i], w[_AFTER + i]
        x = a * (w[X + i] - w[X - 1 + i]) + b * (w[X + 1 + i] - w[X + i])
        y = a * (w[Y + i] - w[Y - 1 + i]) + b * (w[Y + 1 + i] - w[Y + i])
        z = a * (w[Z + i] - w[Z - 1 + i]) + b * (w[Z + 1 + i] - w[Z + i])
        w[_SPEED + i] = scale * np.sqrt(x * x + y * y + z * z)


@fast_part
def _add_potential(w: Array, radius: Scalar, clearance: Scalar) -> None:
    inverse = _HALF / clearance
    half = _HALF * clearance
    for i in range(BLOCK):
        d = w[VALUE + i] - radius
        near = min(d - clearance, _0)
        potential = half - d if d < _0 else near * near * inverse
        w[COST + i] += potential * w[_SPEED + i]
        w[NEAREST + i] = min(w[NEAREST + i], d)


@fast_part
def mark_ends(w: Array, first: int, n_waypoints: int) -> None:
    """Write the weights of the differences to the waypoints before and after; a rollout's end has but one.

    The block begins at waypoint number `first` of rollouts of `n_waypoints` one after the other.
    """
    t = first % n_waypoints
    for i in range(BLOCK):
        w[_BEFORE + i] = _HALF if t > 0 else _0
        w[_AFTER + i] = _HALF if t < n_waypoints - 1 else _0
        t = t + 1 if t < n_waypoints - 1 else 0


@fast_part
def add_obstacles(
    w: Array, cell: Array, radius: Scalar, slack: Scalar, clearance: Scalar, scale: Scalar, lattice: Array,
    nx: int, ny: int, nz: int,
) -> None:  # fmt: skip
    """Add potential x scale x way of spheres at X, Y, Z to COST, and lower NEAREST to their distances.

    The way is half that between the neighbouring waypoints, in cells. Nothing is done where every nearest node is
    farther than radius and slack.
    """
    nearest_nodes(w, cell, nx, ny, nz)
    if all_above(cell, lattice, radius + slack):
        return
    corners(w, cell, nx, ny, nz)
    interpolate(w, cell, lattice, ny, nz)
    _speeds(w, scale)
    _add_potential(w, radius, clearance)


@fast
def obstacle_sums(q: Array, n_waypoints: int, obstacles: Obstacles, out: Array, nearest: Array) -> None:
    """Write potential x speed summed over spheres (M,), and the nearest distance cut off at the clearance (M,).

    q (M, J) holds whole rollouts of `n_waypoints` one after the other. A block yields 62 results: its first and last
    configurations are only neighbours to take differences with.
    """
    root, joints, spheres = obstacles.arm
    lattice, (nx, ny, nz) = obstacles.lattice, obstacles.shape
    resolution, clearance = obstacles.resolution, obstacles.clearance
    w = np.zeros(ROWS * BLOCK, dtype=np.float32)
    cell = np.zeros(BLOCK, dtype=np.uint32)
    frames = spread(root)
    to_metres = obstacles.speed_scale * resolution
    # The nearest node is off by up to 0.87 cells, the interpolation by as much: beyond this nothing is near.
    slack = clearance + np.float32(1.75) * resolution
    for first in range(0, len(q), BLOCK - 2):
        start(w, frames)
        mark_ends(w, first - 1, n_waypoints)
        for i in range(BLOCK):
            w[COST + i] = _0
            w[NEAREST + i] = clearance
        for j in range(q.shape[1]):
            next_joint(w, q, first - 1, j, joints)
            begin, end = int(joints[j, FIRST]), int(joints[j, LAST])
            if begin == end:
                continue
            place(w, joints[j, BOUND], joints[j, BOUND + 1], joints[j, BOUND + 2])
            nearest_nodes(w, cell, nx, ny, nz)
            if all_above(cell, lattice, joints[j, BOUND + 3] + slack):
                continue
            for p in range(begin, end):
                place(w, spheres[p, 0], spheres[p, 1], spheres[p, 2])
                add_obstacles(w, cell, spheres[p, 3], slack, clearance, to_metres, lattice, nx, ny, nz)
        for i in range(min(BLOCK - 2, len(q) - first)):
            out[first + i] = w[COST + 1 + i]
            nearest[first + i] = w[NEAREST + 1 + i]
