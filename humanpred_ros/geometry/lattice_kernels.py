"""Look-ups in a lattice of values, compiled: of voxels, of the nearest node, and interpolated between eight nodes.

In single precision 64 places are looked up at a time. They stand in rows X, Y and Z of the scratch array of
`chain_kernels`, in cells of the lattice. Cells are computed in one loop and looked up in the next. Places outside are
moved onto the lattice instead of being tested for; a lattice whose values outside are zero has a border of zeros.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.chain_kernels import BLOCK, FREE, Scalar, X, Y, Z
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part, fast_part

_PART_X, _PART_Y, _PART_Z = FREE * BLOCK, (FREE + 1) * BLOCK, (FREE + 2) * BLOCK
#: Where `interpolate` writes the values found, and the first row that is free then.
VALUE, FREE_ROWS = (FREE + 3) * BLOCK, FREE + 4

_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


@fast_part
def voxels(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    """Write the flat number of the voxel each place is in."""
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    for i in range(BLOCK):
        x = np.int32(min(max(w[X + i], _0), mx))
        y = np.int32(min(max(w[Y + i], _0), my))
        z = np.int32(min(max(w[Z + i], _0), mz))
        # Every product is brought back to 32 bits: 64-bit ones would halve the vector width.
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def nearest_nodes(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    """Write the flat number of the node nearest to each place."""
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    for i in range(BLOCK):
        x = np.int32(min(max(w[X + i] + _HALF, _0), mx))
        y = np.int32(min(max(w[Y + i] + _HALF, _0), my))
        z = np.int32(min(max(w[Z + i] + _HALF, _0), mz))
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def all_above(cell: NDArray[Any], lattice: NDArray[Any], least: Scalar) -> bool:
    """Return whether the value at every node looked up is more than `least`."""
    near = _0
    for i in range(BLOCK):
        near += _0 if lattice[cell[i]] > least else _1
    return bool(near == _0)


@fast_part
def corners(w: NDArray[Any], cell: NDArray[Any], nx: int, ny: int, nz: int) -> None:
    """Write the lowest of the eight nodes around each place, and the parts of a cell beyond it."""
    mx, my, mz = np.float32(nx - 1), np.float32(ny - 1), np.float32(nz - 1)
    row, layer = np.int32(nz), np.int32(ny * nz)
    lx, ly, lz = np.int32(nx - 2), np.int32(ny - 2), np.int32(nz - 2)
    for i in range(BLOCK):
        px, py, pz = min(max(w[X + i], _0), mx), min(max(w[Y + i], _0), my), min(max(w[Z + i], _0), mz)
        x, y, z = min(np.int32(px), lx), min(np.int32(py), ly), min(np.int32(pz), lz)
        w[_PART_X + i] = px - np.float32(x)
        w[_PART_Y + i] = py - np.float32(y)
        w[_PART_Z + i] = pz - np.float32(z)
        cell[i] = np.uint32(np.int32(np.int32(x * layer) + np.int32(y * row)) + z)


@fast_part
def interpolate(w: NDArray[Any], cell: NDArray[Any], lattice: NDArray[Any], ny: int, nz: int) -> None:
    """Write the value at each place, linear along each axis between the nodes that `corners` found, to row VALUE."""
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
        w[VALUE + i] = a + x * (b - a)


class Lattice(NamedTuple):
    """Values at nodes (nx, ny, nz), place of the first node (3,), nodes per metre; outside, the border goes on."""

    values: NDArray[np.float32]
    origin: FloatArray
    cells_per_m: float


@exact_part
def value_at(x: float, y: float, z: float, lattice: Lattice) -> float:
    """Return the value at one place in double precision, linear along each axis between eight nodes."""
    values, origin = lattice.values, lattice.origin
    nx, ny, nz = values.shape
    x = min(max((x - origin[0]) * lattice.cells_per_m, 0.0), nx - 1.0)
    y = min(max((y - origin[1]) * lattice.cells_per_m, 0.0), ny - 1.0)
    z = min(max((z - origin[2]) * lattice.cells_per_m, 0.0), nz - 1.0)
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


@exact
def values_at(points: FloatArray, lattice: Lattice) -> FloatArray:
    """Return the values (N,) at points (N, 3), as `value_at` does."""
    out = np.empty(len(points))
    for n in range(len(points)):
        out[n] = value_at(points[n, 0], points[n, 1], points[n, 2], lattice)
    return out
