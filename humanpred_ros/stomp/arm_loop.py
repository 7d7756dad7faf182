"""STOMP's iterations for an arm, compiled into one call: Python between them would hold the other threads up.

What is computed is what `StompPlanner` computes term by term, with the same kernels. It applies where the terms
are those of an arm among obstacles and people; any other terms are called one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import fast
from humanpred_ros.stomp.accelerations import acceleration_costs
from humanpred_ros.stomp.cost_kernels import obstacle_sums, occupancy_sums
from humanpred_ros.stomp.costs import CostTerm, HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.stomp.iteration_kernels import sample_compiled, update

#: Entries of the counters of a plan in progress: updates done, random bits used, rollouts reused, whether the best
#: trajectory is forbidden, and updates since it last became noticeably better.
DONE, USED, REUSED, FORBIDDEN, STALE, N_COUNTERS = 0, 1, 2, 3, 4, 5
#: Entries of the totals: of the best trajectory, and what it must fall below to count as noticeably better.
BEST, REFERENCE, N_TOTALS = 0, 1, 2


def arm_terms(terms: Sequence[CostTerm], n_waypoints: int) -> tuple[Any, ...] | None:
    """Return what `iterate` wants of an obstacle, a human and a smoothness term; None for any other terms."""
    match terms:
        case [ObstacleCost() as obstacle, HumanOccupancyCost() as human, SmoothnessCost() as smoothness]:
            return obstacle.for_kernel(n_waypoints), human.for_kernel(), np.float32(smoothness.weight)
    return None


@fast
def iterate(
    count: int,
    theta: NDArray[Any],
    best: NDArray[Any],
    counters: NDArray[Any],
    totals: NDArray[Any],
    rollouts: NDArray[Any],
    state: NDArray[Any],
    joint: NDArray[Any],
    bits: NDArray[Any],
    noise: Any,
    smoothness: Any,
    lower: NDArray[Any],
    upper: NDArray[Any],
    settings: Any,
    terms: Any,
) -> None:
    """Do up to `count` updates of theta (N, D), keeping the best noiseless trajectory, in place.

    counters and totals as named above; rollouts (R + 1, N, D), the reused ones first, with their costs; noise is
    (table of quantiles, standard deviations, decay); smoothness (factor, the same in float32, column scale);
    settings (sharpness, rollouts to reuse, patience, tolerance); terms from `arm_terms`.
    """
    table, std, decay = noise
    factor, factor32, column_scale = smoothness
    sharpness, n_reused, patience, tolerance = settings
    obstacle, human, smoothness_weight = terms
    n_rollouts, (n, n_joints) = len(rollouts) - 1, theta.shape
    sums = np.empty((3, (n_rollouts + 1) * n), dtype=np.float32)
    for _ in range(count):
        if patience > 0 and counters[STALE] >= patience and counters[FORBIDDEN] == 0:
            return
        first = counters[REUSED]
        used = counters[USED]
        scaled = std * np.float32(decay ** counters[DONE])
        sample_compiled(theta, bits[used:], table, scaled, lower, upper, factor, factor32, rollouts[first:])
        counters[USED] = used + (n - 2) * n_joints * (n_rollouts - first)
        allowed = _evaluate(rollouts[first:], state[first:], joint[first:], sums, obstacle, human, smoothness_weight)
        total = 0.0
        for t in range(n):
            total += state[n_rollouts, t]
            for d in range(n_joints):
                total += joint[n_rollouts, t, d]
        keep(theta, best, allowed, total, tolerance, counters, totals)
        update(
            theta, rollouts[:n_rollouts], state[:n_rollouts], joint[:n_rollouts], sharpness, factor, column_scale,
            lower, upper, n_reused,
        )  # fmt: skip
        counters[REUSED] = n_reused
        counters[DONE] += 1


@fast
def keep(
    theta: NDArray[Any],
    best: NDArray[Any],
    allowed: bool,
    total: float,
    tolerance: float,
    counters: NDArray[Any],
    totals: NDArray[Any],
) -> None:
    """Keep theta if it ranks before the best so far: allowed before forbidden, then by cost."""
    forbidden = 0 if allowed else 1
    counters[STALE] += 1
    if forbidden < counters[FORBIDDEN] or (forbidden == counters[FORBIDDEN] and total < totals[BEST]):
        if forbidden < counters[FORBIDDEN] or total < totals[REFERENCE]:
            counters[STALE] = 0
            totals[REFERENCE] = (1.0 - tolerance) * total
        best[:] = theta
        counters[FORBIDDEN] = forbidden
        totals[BEST] = total


@fast
def _evaluate(
    rollouts: NDArray[Any],
    state: NDArray[Any],
    joint: NDArray[Any],
    sums: NDArray[Any],
    obstacle: Any,
    human: Any,
    smoothness_weight: Any,
) -> bool:
    """Write the weighted costs of rollouts (K, N, D); return whether the last one is allowed."""
    root, joints, spheres, resolution, speed_scale, clearance, lattice, nx, ny, nz, margin, obstacle_weight = obstacle
    k, n, n_joints = rollouts.shape
    q = rollouts.reshape(k * n, n_joints)
    near, close, hit = sums[0, : k * n], sums[1, : k * n], sums[2, : k * n]
    obstacle_sums(
        q, n, root, joints, spheres, resolution, speed_scale, clearance, lattice, nx, ny, nz, near, close
    )  # fmt: skip
    root, joints, points, cells_per_m, lattice, nx, ny, nz, factor, human_weight = human
    occupancy_sums(q, root, joints, points, cells_per_m, lattice, nx, ny, nz, hit)
    flat = state.reshape(-1)
    for i in range(k * n):
        flat[i] = obstacle_weight * near[i] + human_weight * (factor * hit[i])
    acceleration_costs(rollouts, joint)
    flat = joint.reshape(-1)
    for i in range(k * n * n_joints):
        flat[i] *= smoothness_weight
    allowed = True
    for i in range((k - 1) * n, k * n):
        allowed &= close[i] >= margin
    return allowed
