"""How far every place is from the voxels a person certainly occupies, anew for every occupancy.

A voxel counts as a solid cube. Exact distances to cubes are separable: the squared gap to a cube is the sum of
three squared gaps along the axes, so three passes of minima along lines give them at all voxel centres. Only
distances up to a cap are wanted, and only where the arm can be, which keeps it to a millisecond or two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import VoxelGrid

#: Interpolated distances exceed the true distance to cubes by at most this many voxels: in front of the corner
#: of a single one. In front of faces they are exact (see the test).
OVERSTATED_VOXELS = 0.5
#: Distances are capped here; what is farther away need not be told apart, m.
DEFAULT_CAP_M = 0.4


@dataclass(frozen=True)
class PersonDistance:
    """Makes distance fields of voxels of one grid, within a box.

    Attributes:
        grid: the lattice of the occupancy.
        lower_m, upper_m: (3,) box that holds every point asked for (the arm's reach), world frame. Points
            outside the box may get too large distances; points outside the grid do not.
        cap_m: larger distances are reported as this.

    Raises:
        PlanningError: for a box that is empty or does not meet the grid, or a cap that is not positive.
    """

    grid: VoxelGrid
    lower_m: FloatArray
    upper_m: FloatArray
    cap_m: float = DEFAULT_CAP_M

    def __post_init__(self) -> None:
        lower = checked("person distance: lower corner", self.lower_m, (3,), error=PlanningError)
        upper = checked("person distance: upper corner", self.upper_m, (3,), error=PlanningError)
        if not (self.cap_m > 0.0 and np.isfinite(self.cap_m)):
            raise PlanningError(f"person distance: wanted a cap > 0 m, got {self.cap_m}")
        # Nodes are voxel centres; one beyond the box on each side, so that it lies between them.
        shape = np.array(self.grid.shape)
        first = np.floor((lower - self.grid.origin_m) / self.grid.resolution_m - 0.5).astype(np.int64)
        last = np.ceil((upper - self.grid.origin_m) / self.grid.resolution_m - 0.5).astype(np.int64)
        first, last = np.clip(first, 0, shape - 1), np.clip(last, 0, shape - 1)
        if not (upper > lower).all() or (last - first < 1).any():
            raise PlanningError(
                f"person distance: wanted a box that overlaps the grid by two voxels or more, got {lower} to {upper} "
                f"in a grid from {self.grid.origin_m} of {self.grid.shape} voxels of {self.grid.resolution_m} m"
            )
        object.__setattr__(self, "_first", first)
        object.__setattr__(self, "_last", last)

    def field(self, flat: NDArray[np.int64]) -> SignedDistanceField:
        """Return the distance to the cubes of voxels given by flat index (M,), as of `Occupancy.voxels_above`.

        Exact at voxel centres outside the cubes and up to the cap; inside it is minus half a voxel however deep.

        Raises:
            PlanningError: for indices outside the grid.
        """
        flat = np.asarray(flat, dtype=np.int64).ravel()
        if len(flat) and (flat.min() < 0 or flat.max() >= self.grid.size):
            raise PlanningError(
                f"person distance: wanted voxels 0 to {self.grid.size - 1}, got {flat.min()} to {flat.max()}"
            )
        first: NDArray[np.int64] = self._first  # type: ignore[attr-defined]
        last: NDArray[np.int64] = self._last  # type: ignore[attr-defined]
        h = self.grid.resolution_m
        reach = int(np.ceil(self.cap_m / h + 0.5))
        cells = _capped(flat, np.array(self.grid.shape, dtype=np.int64), first, last, reach, np.float32(self.cap_m / h))
        origin = np.asarray(self.grid.origin_m) + (first + 0.5) * h
        return SignedDistanceField(origin, h, cells * np.float32(h))


@exact
def _capped(
    flat: NDArray[Any], shape: NDArray[Any], first: NDArray[Any], last: NDArray[Any], reach: int, cap: Any
) -> NDArray[Any]:
    """Return distances in voxels at nodes `first` to `last`; marks more than `reach` away are left out."""
    nx, ny, nz = last[0] - first[0] + 1, last[1] - first[1] + 1, last[2] - first[2] + 1
    far = np.float32(cap * cap)
    # Marks can count from outside the box, up to `reach`; each pass drops that margin along its axis.
    y0, z0 = max(first[1] - reach, 0), max(first[2] - reach, 0)
    y1, z1 = min(last[1] + reach, shape[1] - 1), min(last[2] + reach, shape[2] - 1)
    my, mz = y1 - y0 + 1, z1 - z0 + 1
    gap = np.empty(reach + 1, dtype=np.float32)
    for d in range(reach + 1):
        g = np.float32(max(d - 0.5, 0.0))
        gap[d] = g * g
    a = np.empty((nx, my, mz), dtype=np.float32)
    for x in range(nx):
        for y in range(my):
            _fill(a[x, y], far)
    inside = np.zeros((nx, ny, nz), dtype=np.bool_)
    used = np.zeros((nx, my), dtype=np.bool_)
    for m in range(len(flat)):
        i = flat[m] // (shape[1] * shape[2])
        j = flat[m] // shape[2] % shape[1]
        k = flat[m] % shape[2]
        if j < y0 or j > y1 or k < z0 or k > z1:
            continue
        for x in range(max(i - reach, first[0]), min(i + reach, last[0]) + 1):
            here = a[x - first[0], j - y0, k - z0]
            a[x - first[0], j - y0, k - z0] = min(here, gap[abs(x - i)])
            used[x - first[0], j - y0] = True
        if first[0] <= i <= last[0] and first[1] <= j <= last[1] and first[2] <= k <= last[2]:
            inside[i - first[0], j - first[1], k - first[2]] = True
    out = np.empty((nx, ny, nz), dtype=np.float32)
    line, padded = np.empty(mz, dtype=np.float32), np.empty(nz + 2 * reach, dtype=np.float32)
    shift = first[2] - reach - z0
    for x in range(nx):
        for y in range(ny):
            _fill(line, far)
            some = False
            for j in range(max(y + first[1] - reach, y0), min(y + first[1] + reach, y1) + 1):
                if used[x, j - y0]:
                    some = True
                    _lower(line, a[x, j - y0], gap[abs(j - first[1] - y)])
            if not some:
                _fill(out[x, y], cap)
                continue
            _fill(padded, far)
            for k in range(mz):
                padded[k - shift] = line[k]
            target = out[x, y]
            _fill(target, far)
            for d in range(-reach, reach + 1):
                _lower(target, padded[reach + d : reach + d + nz], gap[abs(d)])
            for k in range(nz):
                target[k] = np.float32(-0.5) if inside[x, y, k] else np.sqrt(target[k])
    return out


@exact_part
def _fill(line: NDArray[Any], value: Any) -> None:
    for k in range(len(line)):
        line[k] = value


@exact_part
def _lower(target: NDArray[Any], source: NDArray[Any], by: Any) -> None:
    for k in range(len(target)):
        value = source[k] + by
        target[k] = value if value < target[k] else target[k]
