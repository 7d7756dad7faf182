"""The robot keeps a distance from the person, not just out of them: occupancy is widened before planning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.compiled import exact
from humanpred_ros.errors import PlanningError
from humanpred_ros.occupancy.grid import Occupancy

#: A voxel whose centre is exactly at the margin counts, whatever rounding says.
_ROUNDING = 1e-9


def widened(occupancy: Occupancy, margin_m: float) -> Occupancy:
    """Return the occupancy with every voxel as likely as the likeliest within `margin_m` of its centre.

    The arm is then charged for coming closer to the person than the margin. Voxels whose centres are
    farther apart than the margin do not affect each other, so 0 changes nothing.

    Raises:
        PlanningError: a margin that is negative or not finite.
    """
    if not 0.0 <= margin_m < np.inf:
        raise PlanningError(f"human margin: wanted a distance >= 0 m, got {margin_m}")
    steps = int(margin_m / occupancy.grid.resolution_m + _ROUNDING)
    if steps == 0:
        return occupancy
    reach = np.arange(-steps, steps + 1)
    offsets = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    near = (offsets**2).sum(axis=1) <= (margin_m / occupancy.grid.resolution_m) ** 2 + _ROUNDING
    wide = np.zeros_like(occupancy.probability)
    cells = np.argwhere(occupancy.probability > 0.0)
    _spread(occupancy.probability, cells, offsets[near], wide)
    return Occupancy(occupancy.grid, wide, occupancy.t_s)


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
