"""The robot keeps a distance from the person, not just out of them: occupancy is widened before planning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid

#: A voxel whose centre is exactly at the margin counts, whatever rounding says.
_ROUNDING = 1e-9


def widened(occupancy: Occupancy, margin_m: float) -> Occupancy:
    """Return the occupancy with every voxel as likely as the likeliest within `margin_m` of its centre.

    The arm is then charged for coming closer to the person than the margin. Voxels whose centres are
    farther apart than the margin do not affect each other, so 0 changes nothing.

    Returns:
        The box of the lattice that holds all of it: beyond, everything is 0.

    Raises:
        PlanningError: a margin that is negative or not finite.
    """
    if not 0.0 <= margin_m < np.inf:
        raise PlanningError(f"human margin: wanted a distance >= 0 m, got {margin_m}")
    grid = occupancy.grid
    steps = int(margin_m / grid.resolution_m + _ROUNDING)
    cells = np.stack(np.unravel_index(occupancy.voxels_above(0.0), grid.shape), axis=1)
    if len(cells) == 0:
        cells = np.zeros((1, 3), dtype=np.int64)
    low = np.maximum(cells.min(axis=0) - steps, 0)
    high = np.minimum(cells.max(axis=0) + steps + 1, grid.shape)
    part = occupancy.probability[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    origin = np.asarray(grid.origin_m) + low * grid.resolution_m
    nx, ny, nz = (int(size) for size in high - low)
    box = VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), grid.resolution_m, (nx, ny, nz))
    if steps == 0:
        return Occupancy(box, part, occupancy.t_s)
    reach = np.arange(-steps, steps + 1)
    offsets = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    near = (offsets**2).sum(axis=1) <= (margin_m / grid.resolution_m) ** 2 + _ROUNDING
    wide = np.zeros(box.shape, dtype=np.float32)
    _spread(np.ascontiguousarray(part), cells - low, offsets[near], wide)
    return Occupancy(box, wide, occupancy.t_s)


@exact
def _spread(probability: NDArray[Any], cells: NDArray[Any], offsets: NDArray[Any], wide: NDArray[Any]) -> None:
    nx, ny, nz = wide.shape
    for c in range(len(cells)):
        x, y, z = cells[c]
        p = probability[x, y, z]
        for k in range(len(offsets)):
            i, j, m = x + offsets[k, 0], y + offsets[k, 1], z + offsets[k, 2]
            if 0 <= i < nx and 0 <= j < ny and 0 <= m < nz and wide[i, j, m] < p:
                wide[i, j, m] = p
