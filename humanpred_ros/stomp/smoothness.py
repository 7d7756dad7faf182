"""Smoothness of trajectories: the finite differences A, R = AᵀA, what follows from R, and the acceleration cost.

Notation (docs/papers.md, P1 STOMP): A q are accelerations, noise is drawn from N(0, R⁻¹), M is R⁻¹ with every
column scaled to a largest element of 1/n. R = L Lᵀ is banded, so N(0, R⁻¹) and M are applied by O(n) sweeps over L;
a dense R⁻¹ exists only in tests.

In compiled functions lanes (columns of a right-hand side, or waypoint and joint pairs) are contiguous in memory and
innermost, so that every loop over lanes packs into vector instructions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.geometry.compiled import Array, fast, fast_part

Float32Array = NDArray[np.float32]

#: 5-point rule of the second derivative, in units of one waypoint step (docs/papers.md, P1 STOMP).
ACCELERATION_RULE = (-1.0 / 12.0, 16.0 / 12.0, -30.0 / 12.0, 16.0 / 12.0, -1.0 / 12.0)
#: Rows of A that lie outside the trajectory and still see a free waypoint, at each end.
PADDING = 1
BANDWIDTH = 4
_A, _B, _C = (np.float32(c) for c in ACCELERATION_RULE[:3])
_HALF = np.float32(0.5)
#: Violations of limits below this are rounding, rad; and how often a joint is pushed back within them.
_LIMIT_TOLERANCE, _LIMIT_ITERATIONS = 1e-6, 10


@dataclass(frozen=True)
class Smoothness:
    """R = AᵀA over the free waypoints of a trajectory whose two ends are fixed.

    The trajectory is continued by copies of its start and goal, so that A sees a robot at rest at both
    ends and the ends themselves never move.
    """

    n_waypoints: int  #: N, with start and goal
    #: (5, N-2) lower Cholesky factor of R in bands: `factor[k, i] = L[i + k, i]`, zeros past the end
    factor: FloatArray
    column_scale: FloatArray  #: (N-2,) what scales column i of R⁻¹ to a largest element of 1/(N-2)

    @property
    def n_free(self) -> int:
        """Number of waypoints that may move."""
        return self.n_waypoints - 2


def accelerations_matrix(n_waypoints: int) -> FloatArray:
    """Return the dense A, (N + 2, N): accelerations of a trajectory continued by copies of its ends.

    Row r is the acceleration at waypoint r - 1: one row before the start and one after the goal still
    see a free waypoint.
    """
    A = np.zeros((n_waypoints + 2 * PADDING, n_waypoints))
    for row in range(len(A)):
        for offset, factor in zip(range(-2, 3), ACCELERATION_RULE, strict=True):
            A[row, min(max(row - PADDING + offset, 0), n_waypoints - 1)] += factor
    return A


@lru_cache(maxsize=16)
def smoothness(n_waypoints: int) -> Smoothness:
    """Return the smoothness of trajectories with `n_waypoints` waypoints (kept for the next caller).

    Raises:
        PlanningError: for fewer than 5 waypoints, which the 5-point rule cannot see.
    """
    if n_waypoints < 5:
        raise PlanningError(f"smoothness: wanted at least 5 waypoints, got {n_waypoints}")
    A = accelerations_matrix(n_waypoints)[:, 1:-1]
    R = A.T @ A
    n = n_waypoints - 2
    bands = np.zeros((BANDWIDTH + 1, n))
    for k in range(min(BANDWIDTH, n - 1) + 1):
        bands[k, : n - k] = np.diagonal(R, -k)
    factor = frozen(np.ascontiguousarray(cholesky_banded(bands, lower=True)))
    inverse = np.eye(n)
    solve(factor, inverse)
    scale = 1.0 / (n * np.abs(inverse).max(axis=0))
    return Smoothness(n_waypoints, factor, frozen(scale))  # type: ignore[arg-type]


@fast
def colour(factor: Array, x: Array) -> None:
    """Solve Lᵀ x = z in place, z (n, L): white noise becomes N(0, R⁻¹)."""
    n, lanes = x.shape
    for i in range(n - 1, -1, -1):
        for k in range(1, min(5, n - i)):
            below = factor[k, i]
            for lane in range(lanes):
                x[i, lane] -= below * x[i + k, lane]
        scale = 1.0 / factor[0, i]
        for lane in range(lanes):
            x[i, lane] *= scale


@fast
def solve(factor: Array, x: Array) -> None:
    """Solve R x = b in place, b (n, L)."""
    n, lanes = x.shape
    for i in range(n):
        for k in range(1, min(5, i + 1)):
            left = factor[k, i - k]
            for lane in range(lanes):
                x[i, lane] -= left * x[i - k, lane]
        scale = 1.0 / factor[0, i]
        for lane in range(lanes):
            x[i, lane] *= scale
    colour(factor, x)


@fast_part
def solve_unit(factor: Array, j: int, x: Array) -> None:
    """Write column j of R⁻¹ into x (n,)."""
    n = len(x)
    for i in range(n):
        x[i] = 0.0
    x[j] = 1.0
    for i in range(j, n):
        value = x[i]
        for k in range(1, min(5, i - j + 1)):
            value -= factor[k, i - k] * x[i - k]
        x[i] = value / factor[0, i]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(1, min(5, n - i)):
            value -= factor[k, i] * x[i + k]
        x[i] = value / factor[0, i]


@fast
def keep_within_limits(x: Array, lower: Array, upper: Array, factor: Array) -> int:
    """Push the free waypoints of x (N, D) inside the limits, in place; return how many joints were clipped.

    The worst waypoint of a joint is moved onto its limit together with its neighbours, along the column of
    R⁻¹ that belongs to it, which keeps the trajectory smooth (docs/papers.md, P1 STOMP). What is still outside after
    ten such pushes is clipped.
    """
    n, n_joints = x.shape
    column = np.empty(n - 2, dtype=np.float64)
    clipped = 0
    for d in range(n_joints):
        outside = False
        for t in range(1, n - 1):
            outside |= x[t, d] > upper[d] or x[t, d] < lower[d]
        if not outside:
            continue
        for attempt in range(_LIMIT_ITERATIONS + 1):
            worst, where = 0.0, -1
            for t in range(1, n - 1):
                over = max(x[t, d] - upper[d], lower[d] - x[t, d])
                if over > worst:
                    worst, where = over, t
            if worst <= _LIMIT_TOLERANCE:
                break
            if attempt == _LIMIT_ITERATIONS:
                clipped += 1
                break
            solve_unit(factor, where - 1, column)
            push = (worst if x[where, d] < lower[d] else -worst) / column[where - 1]
            for t in range(1, n - 1):
                x[t, d] += push * column[t - 1]
        for t in range(1, n - 1):
            x[t, d] = min(max(x[t, d], lower[d]), upper[d])
    return clipped


@fast_part
def _half_squared_accelerations(flat: Array, n_joints: int, out: Array) -> None:
    """Write the costs of all waypoints but the two at each end, (waypoint, joint) pairs in one row."""
    lanes = len(flat) - 4 * n_joints
    p, q, r = flat[:lanes], flat[n_joints : n_joints + lanes], flat[2 * n_joints : 2 * n_joints + lanes]
    s, t = flat[3 * n_joints : 3 * n_joints + lanes], flat[4 * n_joints :]
    middle = out[2 * n_joints : 2 * n_joints + lanes]
    for k in range(lanes):
        value = _A * (p[k] + t[k]) + _B * (q[k] + s[k]) + _C * r[k]
        middle[k] = _HALF * value * value


@fast
def acceleration_costs(q: Array, out: Array) -> None:
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
