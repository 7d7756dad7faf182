"""STOMP's iterations for an arm among obstacles and people, compiled into one call.

Python between the iterations would hold the threads of other goals up. Only the evaluation of these three cost terms is
here; everything else is the code that plans with any terms (`iteration_kernels`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import fast, fast_inline
from humanpred_ros.stomp.cost_kernels import obstacle_sums, occupancy_sums
from humanpred_ros.stomp.costs import CostTerm, HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.stomp.iteration_kernels import begin_update, converged, finish_update
from humanpred_ros.stomp.smoothness import acceleration_costs

#: The terms that `iterate` evaluates: these three and no others.
COMPILED_TERMS = {ObstacleCost, HumanOccupancyCost, SmoothnessCost}


def arm_terms(terms: Sequence[CostTerm], n_waypoints: int) -> tuple[Any, ...] | None:
    """Return what `iterate` wants of an obstacle, a human and a smoothness term in any order; None for other terms."""
    found: dict[type, Any] = {type(term): term for term in terms}
    if len(terms) != len(found) or found.keys() != COMPILED_TERMS:
        return None
    weight = np.float32(found[SmoothnessCost].weight)
    return found[ObstacleCost].for_kernel(n_waypoints), found[HumanOccupancyCost].for_kernel(), weight


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
    smooth: Any,
    lower: NDArray[Any],
    upper: NDArray[Any],
    settings: Any,
    patience: int,
    terms: Any,
) -> None:
    """Do up to `count` updates of theta (N, D), keeping the best noiseless trajectory, in place.

    Arguments as in `begin_update` and `finish_update`; patience as in `converged`; terms from `arm_terms`.
    """
    sums = np.empty((3, len(rollouts) * len(theta)), dtype=np.float32)
    for _ in range(count):
        if converged(counters, patience):
            return
        first = begin_update(theta, counters, bits, noise, smooth, lower, upper, rollouts)
        allowed = _evaluate(rollouts[first:], state[first:], joint[first:], sums, terms)
        finish_update(
            theta, best, allowed, counters, totals, rollouts, state, joint, settings, smooth, lower, upper
        )  # fmt: skip


@fast_inline
def _evaluate(rollouts: NDArray[Any], state: NDArray[Any], joint: NDArray[Any], sums: NDArray[Any], terms: Any) -> bool:
    """Write the weighted costs of rollouts (K, N, D); return whether the last one is allowed."""
    obstacle, human, smoothness_weight = terms
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
