"""The compiled acceleration cost: half the squared second difference of every joint at every waypoint."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import fast

# The 5-point rule of the second derivative (facts section 4).
_A, _B, _C = (np.float32(c) for c in (-1 / 12, 16 / 12, -30 / 12))
_HALF = np.float32(0.5)


@fast
def _half_squared_accelerations(flat: NDArray[Any], n_joints: int, out: NDArray[Any]) -> None:
    """Write the costs of all waypoints but the two at each end, (waypoint, joint) pairs in one row."""
    lanes = len(flat) - 4 * n_joints
    p, q, r = flat[:lanes], flat[n_joints : n_joints + lanes], flat[2 * n_joints : 2 * n_joints + lanes]
    s, t = flat[3 * n_joints : 3 * n_joints + lanes], flat[4 * n_joints :]
    middle = out[2 * n_joints : 2 * n_joints + lanes]
    for k in range(lanes):
        value = _A * (p[k] + t[k]) + _B * (q[k] + s[k]) + _C * r[k]
        middle[k] = _HALF * value * value


@fast
def acceleration_costs(q: NDArray[Any], out: NDArray[Any]) -> None:
    """Write half the squared acceleration per joint; q, out (R, N, D), rad per squared step.

    The accelerations just before the start and just after the goal, where copies of the ends continue the
    trajectory, are counted at the ends.
    """
    n_rollouts, n, n_joints = q.shape
    for r in range(n_rollouts):
        _half_squared_accelerations(q[r].reshape(-1), n_joints, out[r].reshape(-1))
        for t in (0, 1, n - 2, n - 1):
            for d in range(n_joints):
                value = (
                    _A * (q[r, max(t - 2, 0), d] + q[r, min(t + 2, n - 1), d])
                    + _B * (q[r, max(t - 1, 0), d] + q[r, min(t + 1, n - 1), d])
                    + _C * q[r, t, d]
                )
                out[r, t, d] = _HALF * value * value
        for d in range(n_joints):
            before = _A * (q[r, 1, d] - q[r, 0, d])
            after = _A * (q[r, n - 2, d] - q[r, n - 1, d])
            out[r, 0, d] += _HALF * before * before
            out[r, n - 1, d] += _HALF * after * after
