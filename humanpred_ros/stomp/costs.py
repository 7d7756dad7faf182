"""What a trajectory is charged for: one class per term, all batch in, batch out.

A term turns configurations (R, N, D) into costs (R, N), float32, and may also say which configurations are
not allowed at all. Validity and cost are apart, so that a cheap path through the table is never mistaken
for a good one. Terms are immutable and may be shared by threads; where the world changes, a new term is made.

In P1 a waypoint costs 0.1 x (obstacle + human) + 10000 x smoothness (facts section 4); `StompConfig` says why
our obstacle weight is another.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.stomp import cost_kernels
from humanpred_ros.stomp.accelerations import acceleration_costs
from humanpred_ros.stomp.flat_chain import flatten

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

#: P1 sums the occupancy over its sample points, about 87 of them. Here the mean over however many points
#: is multiplied by this, so that costs and weights compare with P1's whatever the sampling density.
POINTS_OF_P1 = 87.0


class CostTerm(ABC):
    """One reason why a configuration on a trajectory is bad.

    Attributes:
        name: how plans report the term's share.
        weight: factor of the term in the total.
    """

    def __init__(self, name: str, weight: float) -> None:
        if not (np.isfinite(weight) and weight >= 0.0):
            raise PlanningError(f"cost term {name}: wanted a weight >= 0, got {weight}")
        self.name = name
        self.weight = float(weight)

    @abstractmethod
    def costs(self, q: ArrayLike) -> Float32Array:
        """Return the unweighted costs (R, N) of trajectories q (R, N, D) in rad."""

    def valid(self, q: ArrayLike) -> BoolArray:
        """Return which configurations (R, N) this term allows; all of them unless it says otherwise."""
        return np.ones(np.shape(q)[:2], dtype=np.bool_)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return costs and validity in one go; None where the term never forbids anything.

        This is what planners call, with a batch that `as_batch` would leave as it is; it need not check.
        """
        return self.costs(q), self.valid(q) if self._forbids() else None

    def _forbids(self) -> bool:
        return type(self).valid is not CostTerm.valid


class JointCostTerm(CostTerm):
    """A cost term that knows each joint's part, so that STOMP can weigh joints apart (control costs)."""

    @abstractmethod
    def joint_costs(self, q: ArrayLike) -> Float32Array:
        """Return the unweighted costs (R, N, D) per joint."""

    def evaluate_joints(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return costs per joint and validity in one go; like `evaluate`, it need not check the batch."""
        return self.joint_costs(q), self.valid(q) if self._forbids() else None

    def costs(self, q: ArrayLike) -> Float32Array:
        """Return the costs (R, N): the sum over joints."""
        total: Float32Array = self.joint_costs(q).sum(axis=2)
        return total

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        costs, allowed = self.evaluate_joints(q)
        return costs.sum(axis=2), allowed


class SmoothnessCost(JointCostTerm):
    """Half the squared acceleration, rad per squared step, of the trajectory at rest at both ends (facts 4)."""

    def __init__(self, weight: float = 10000.0) -> None:
        super().__init__("smoothness", weight)

    def joint_costs(self, q: ArrayLike) -> Float32Array:
        batch = as_batch(q)
        if batch.shape[1] < 5:
            raise PlanningError(f"smoothness: wanted at least 5 waypoints, got {batch.shape[1]}")
        return self.evaluate_joints(batch)[0]

    def evaluate_joints(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        out = np.empty_like(q)
        acceleration_costs(q, out)
        return out, None


class HumanOccupancyCost(CostTerm):
    """How many of P1's body points would be inside predicted human occupancy (P1 IV; facts section 4).

    The mean of the occupancy over the robot's body points, times `POINTS_OF_P1`; points outside the grid
    count zero. Only the box of occupied voxels is kept.
    """

    def __init__(self, chain: KinematicChain, points: BodyPoints, occupancy: Occupancy, weight: float = 0.1) -> None:
        super().__init__("human", weight)
        self.occupancy = occupancy
        self.points = points
        self._n_joints = chain.n_joints
        self._factor = np.float32(POINTS_OF_P1 / max(len(points), 1))
        lattice, first = _cropped(occupancy.probability)
        self._shape = lattice.shape
        self._lattice = lattice.ravel()
        grid = occupancy.grid
        origin = np.asarray(grid.origin_m) + (np.asarray(first) - 1.0) * grid.resolution_m  # -1: the border
        self._arm = flatten(chain, points.link, points.local_m, np.zeros(len(points)), origin, grid.resolution_m)
        self._cells_per_m = np.float32(1.0 / grid.resolution_m)

    def for_kernel(self) -> tuple[Any, ...]:
        """Return what the compiled loop of `arm_loop` wants of this term."""
        arm = self._arm
        weight = np.float32(self.weight)
        return (
            arm.root, arm.joints, arm.points, self._cells_per_m, self._lattice, *self._shape, self._factor, weight,
        )  # fmt: skip

    def costs(self, q: ArrayLike) -> Float32Array:
        return self.evaluate(as_batch(q, self._n_joints))[0]

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        arm, (nx, ny, nz) = self._arm, self._shape
        out = np.empty(q.shape[0] * q.shape[1], dtype=np.float32)
        cost_kernels.occupancy_sums(
            q.reshape(-1, self._n_joints), arm.root, arm.joints, arm.points, self._cells_per_m, self._lattice,
            nx, ny, nz, out,
        )  # fmt: skip
        out *= self._factor
        return out.reshape(q.shape[:2]), None


class ObstacleCost(CostTerm):
    """Potential of every sphere's distance to obstacles, times the sphere's speed (P1 after CHOMP; facts 4).

    With d the distance from a sphere's surface: 0 beyond the clearance c, (d - c)² / 2c within it,
    c/2 - d inside an obstacle. The speed is in m/s of a trajectory that takes `duration_s`, so the sum over
    waypoints does not depend on how many there are. Distances are interpolated, exactly as
    `SignedDistanceField.distance` does; the field must be one (neighbouring nodes differ by no more than
    their distance), because links far from everything are skipped on the strength of it.

    A configuration is valid while every d >= `margin_m`.
    """

    def __init__(
        self,
        chain: KinematicChain,
        spheres: BodySpheres,
        field: SignedDistanceField,
        weight: float = 100.0,
        clearance_m: float = 0.10,
        margin_m: float = 0.0,
        duration_s: float = 5.0,
    ) -> None:
        super().__init__("obstacle", weight)
        if not 0.0 <= margin_m < clearance_m or not duration_s > 0.0:
            raise PlanningError(
                f"obstacle cost: wanted 0 <= margin < clearance and a duration > 0, "
                f"got {margin_m} m, {clearance_m} m, {duration_s} s"
            )
        self.spheres, self.field = spheres, field
        self.clearance_m, self.margin_m, self.duration_s = clearance_m, margin_m, duration_s
        self._n_joints = chain.n_joints
        self._shape = field.values.shape
        self._lattice = field.values.ravel()
        self._arm = flatten(chain, spheres.link, spheres.centre_m, spheres.radius_m, field.origin_m, field.resolution_m)

    def for_kernel(self, n_waypoints: int) -> tuple[Any, ...]:
        """Return what the compiled loop of `arm_loop` wants of this term for trajectories of `n_waypoints`."""
        arm, float32 = self._arm, np.float32
        return (
            arm.root, arm.joints, arm.points, float32(self.field.resolution_m),
            float32((n_waypoints - 1) / self.duration_s), float32(self.clearance_m), self._lattice, *self._shape,
            float32(self.margin_m), float32(self.weight),
        )  # fmt: skip

    def costs(self, q: ArrayLike) -> Float32Array:
        return self.costs_and_distances(q)[0]

    def valid(self, q: ArrayLike) -> BoolArray:
        return self._allowed(self.costs_and_distances(q)[1])

    def costs_and_distances(self, q: ArrayLike) -> tuple[Float32Array, Float32Array]:
        """Return costs (R, N) and the smallest distance of any sphere, cut off at the clearance (R, N), m."""
        return self._run(as_batch(q, self._n_joints))

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        costs, nearest = self._run(q)
        return costs, self._allowed(nearest)

    def _allowed(self, nearest: Float32Array) -> BoolArray:
        allowed: BoolArray = nearest >= np.float32(self.margin_m)
        return allowed

    def _run(self, q: Float32Array) -> tuple[Float32Array, Float32Array]:
        n_rollouts, n = q.shape[:2]
        arm, (nx, ny, nz) = self._arm, self._shape
        out, nearest = np.empty((2, n_rollouts * n), dtype=np.float32)
        cost_kernels.obstacle_sums(
            q.reshape(-1, self._n_joints), n, arm.root, arm.joints, arm.points,
            np.float32(self.field.resolution_m), np.float32((n - 1) / self.duration_s),
            np.float32(self.clearance_m), self._lattice, nx, ny, nz, out, nearest,
        )  # fmt: skip
        return out.reshape(n_rollouts, n), nearest.reshape(n_rollouts, n)


class JointLimitCost(JointCostTerm):
    """Squared depth into a margin before each joint limit, rad², so that plans do not lean on the stops."""

    def __init__(self, lower: ArrayLike, upper: ArrayLike, weight: float = 1.0, margin_rad: float = 0.1) -> None:
        super().__init__("joint_limits", weight)
        self._lower = checked("lower limits", lower, ("D",), finite=False).astype(np.float32)
        self._upper = checked("upper limits", upper, (len(self._lower),), finite=False).astype(np.float32)
        if not (self._lower < self._upper).all() or not margin_rad >= 0.0:
            raise PlanningError(
                f"joint limit cost: wanted lower < upper and a margin >= 0, got {lower!r}, {upper!r}, {margin_rad}"
            )
        self._margin = np.float32(margin_rad)

    def joint_costs(self, q: ArrayLike) -> Float32Array:
        batch = as_batch(q, len(self._lower))
        below = np.maximum(self._lower + self._margin - batch, np.float32(0.0))
        above = np.maximum(batch - (self._upper - self._margin), np.float32(0.0))
        costs: Float32Array = below * below + above * above
        return costs

    def valid(self, q: ArrayLike) -> BoolArray:
        batch = as_batch(q, len(self._lower))
        outside = (batch < self._lower) | (batch > self._upper)
        return ~np.asarray(outside.any(axis=2))


def as_batch(q: ArrayLike, n_joints: int | None = None) -> Float32Array:
    """Return trajectories as a contiguous float32 array (R, N, D).

    Raises:
        PlanningError: for another number of axes or joints, or values that are not finite (a compiled
            lookup must never see them).
    """
    batch = np.ascontiguousarray(q, dtype=np.float32)
    if batch.ndim != 3 or (n_joints is not None and batch.shape[2] != n_joints):
        raise PlanningError(f"trajectories: wanted shape (R, N, {n_joints or 'D'}), got {batch.shape}")
    if not np.isfinite(batch).all():
        raise PlanningError("trajectories: wanted finite angles, got NaN or infinity; check the start configuration")
    return batch


def _cropped(probability: Float32Array) -> tuple[Float32Array, tuple[int, int, int]]:
    """Return the box of occupied voxels with a border of zeros, and its lowest voxel."""
    low, high = [], []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        used = np.flatnonzero(probability.any(axis=others))
        low.append(int(used[0]) if len(used) else 0)
        high.append(int(used[-1]) + 1 if len(used) else 1)
    box = probability[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    return np.pad(box, 1), (low[0], low[1], low[2])


__all__ = [
    "POINTS_OF_P1",
    "CostTerm",
    "HumanOccupancyCost",
    "JointCostTerm",
    "JointLimitCost",
    "ObstacleCost",
    "SmoothnessCost",
    "as_batch",
]
