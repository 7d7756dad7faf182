"""Dynamic time warping: how far apart two motions are when one may run late or early, as P2 compares them."""

from __future__ import annotations

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact


def warped_sum(costs: FloatArray) -> float:
    """Return the least sum of `costs` (n, m) over all warpings of two sequences from their first to their last frames.

    costs[i, j] is the distance of frame i of one sequence from frame j of the other. Steps are (1, 0), (0, 1) and
    (1, 1), each with weight 1; no window; the sum is not divided by the path's length (facts section 7). Costs may be
    positive for equal frames, and are not asked to be symmetric.

    Raises:
        MotionError: an empty table, or values that are not finite.
    """
    table = np.ascontiguousarray(checked("costs", costs, ("n", "m"), error=MotionError))
    if table.size == 0:
        raise MotionError(f"time warping: wanted at least one frame on both sides, got {table.shape}")
    return float(_warp(table))


@exact
def _warp(costs: FloatArray) -> float:
    n, m = costs.shape
    row = np.empty(m)
    row[0] = costs[0, 0]
    for j in range(1, m):
        row[j] = row[j - 1] + costs[0, j]
    for i in range(1, n):
        diagonal = row[0]
        row[0] += costs[i, 0]
        for j in range(1, m):
            above = row[j]
            row[j] = costs[i, j] + min(above, row[j - 1], diagonal)
            diagonal = above
    last: float = row[m - 1]
    return last
