"""Cost terms: what a trajectory is charged for, and which configurations it may not contain.

A term takes a batch of trajectories and returns their costs, and whether each configuration is allowed at all. Cost
and validity are apart, so that a cheap path through the table is never mistaken for a good one. Terms are immutable and
may be shared by threads; where the world changes, a new term is made.

A package of your own adds a term by deriving a class from `CostTerm` and naming it in the entry points
`humanpred_ros.cost_terms`; `ReplannerConfig.cost_terms` chooses terms by name. The built-in ones are registered in the
same way.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.joints import flatten
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.settings import Settings
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.cost_kernels import Obstacles, Occupied, obstacle_sums, occupancy_sums
from humanpred_ros.stomp.smoothness import acceleration_costs

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

#: P1 sums the occupancy over its sample points, about 87 of them. Here the mean over however many points
#: is multiplied by this, so that costs and weights compare with P1's whatever the sampling density.
POINTS_OF_P1 = 87.0


@dataclass(frozen=True, eq=False)
class CostTermRequest:
    """What the replanner makes a cost term from."""

    chain: KinematicChain  #: kinematics of the arm, with its joint limits
    points: BodyPoints  #: points on the arm's surface
    spheres: BodySpheres  #: spheres that cover the arm
    field: SignedDistanceField  #: signed distance to obstacles, world frame
    padding_m: float  #: clearance that every configuration must keep from obstacles
    stomp: StompConfig  #: settings of STOMP, with the weights of the built-in terms
    settings: Settings  #: of the term, of its `settings_type`
    #: predicted human occupancy, widened by the margin. None for a term that is not `per_occupancy`.
    occupancy: Occupancy | None = None


class CostTerm(ABC):
    """One reason why a configuration on a trajectory is bad.

    Attributes:
        name: how plans report the term's share; no two terms of a planner have the same.
        weight: factor of the term in the total.
        per_occupancy: whether the replanner makes the term anew for every predicted occupancy, or once.
        settings_type: class of the term's own settings; those of the built-in terms are in `StompConfig`.
    """

    settings_type: ClassVar[type[Settings]] = Settings
    per_occupancy: ClassVar[bool] = False

    def __init__(self, name: str, weight: float, n_joints: int | None = None) -> None:
        """Take name and weight, and the number of joints D if the term is made for one arm.

        Raises:
            PlanningError: for a weight that is negative or not finite.
        """
        if not (np.isfinite(weight) and weight >= 0.0):
            raise PlanningError(f"cost term {name}: wanted a weight >= 0, got {weight}")
        self.name = name
        self.weight = float(weight)
        self._n_joints = n_joints

    @classmethod
    def build(cls, request: CostTermRequest) -> CostTerm:
        """Return the term for an arm in its surroundings; every term that is chosen by name has this.

        Raises:
            PlanningError: for a term that cannot be made from a request.
        """
        raise PlanningError(f"cost term {cls.__name__}: wanted a class with its own `build`, got none; write one")

    @abstractmethod
    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the unweighted costs of a batch, and which configurations are allowed.

        Args:
            q: (R, N, D) R trajectories of N waypoints, rad, contiguous; not to be changed.

        Returns:
            Costs (R, N), or (R, N, D) where each joint's part is known, so that STOMP weighs joints apart; whether
            each configuration is allowed (R, N), or None where the term never forbids any.
        """

    def costs(self, q: ArrayLike) -> Float32Array:
        """Return the unweighted costs (R, N) of trajectories q (R, N, D), rad.

        Raises:
            PlanningError: for another number of axes or joints, or values that are not finite.
        """
        return _summed(self.evaluate(as_batch(q, self._n_joints))[0])

    def valid(self, q: ArrayLike) -> BoolArray:
        """Return which configurations (R, N) of trajectories q (R, N, D) the term allows; raises as `costs`."""
        batch = as_batch(q, self._n_joints)
        allowed = self.evaluate(batch)[1]
        return np.ones(batch.shape[:2], dtype=np.bool_) if allowed is None else allowed


class SmoothnessCost(CostTerm):
    """Half the squared acceleration of every joint, of a trajectory at rest at both ends (docs/papers.md, 1.11)."""

    def __init__(self, weight: float = 10000.0) -> None:
        super().__init__("smoothness", weight)

    @classmethod
    def build(cls, request: CostTermRequest) -> SmoothnessCost:
        return cls(request.stomp.smoothness_weight)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the costs (R, N, D), (rad per squared step)^2; see `CostTerm.evaluate`."""
        if q.shape[1] < 5:
            raise PlanningError(f"smoothness: wanted at least 5 waypoints, got {q.shape[1]}")
        out = np.empty_like(q)
        acceleration_costs(q, out)
        return out, None


class HumanOccupancyCost(CostTerm):
    """How many of P1's body points would be inside of predicted human occupancy (docs/papers.md, 1.10).

    The mean of the occupancy over the robot's body points, times `POINTS_OF_P1`; points outside of the grid
    count zero. Only the box of occupied voxels is kept.
    """

    per_occupancy = True

    def __init__(self, chain: KinematicChain, points: BodyPoints, occupancy: Occupancy, weight: float = 0.1) -> None:
        super().__init__("human", weight, chain.n_joints)
        self.occupancy = occupancy
        self.points = points
        lattice, first = _cropped(occupancy.probability)
        grid = occupancy.grid
        origin = np.asarray(grid.origin_m) + (np.asarray(first) - 1.0) * grid.resolution_m  # -1: the border
        arm = flatten(chain, points.link, points.local_m, np.zeros(len(points)), origin, grid.resolution_m)
        factor = POINTS_OF_P1 / max(len(points), 1)
        #: What the compiled loop wants of this term.
        self.table = Occupied(
            arm, lattice.ravel(), lattice.shape, np.float32(1.0 / grid.resolution_m), np.float32(factor),
            np.float32(self.weight),
        )  # fmt: skip

    @classmethod
    def build(cls, request: CostTermRequest) -> HumanOccupancyCost:
        if request.occupancy is None:
            raise PlanningError("human cost: wanted an occupancy, got none")
        return cls(request.chain, request.points, request.occupancy, request.stomp.human_weight)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the costs (R, N), in body points; see `CostTerm.evaluate`."""
        out = np.empty(q.shape[0] * q.shape[1], dtype=np.float32)
        occupancy_sums(q.reshape(out.size, -1), self.table, out)
        out *= self.table.factor
        return out.reshape(q.shape[:2]), None


class ObstacleCost(CostTerm):
    """Potential of every sphere's distance to obstacles, times the sphere's speed (docs/papers.md, 1.9).

    The speed is in m/s of a trajectory that takes `duration_s`, so the sum over waypoints does not depend on how many
    there are. Distances are interpolated, exactly as `SignedDistanceField.distance` does; the field must be one
    (neighbouring nodes differ by no more than their distance), because links far from everything are skipped.

    A configuration is valid while the distance of every sphere is at least `margin_m`.
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
        super().__init__("obstacle", weight, chain.n_joints)
        if not 0.0 <= margin_m < clearance_m or not duration_s > 0.0:
            raise PlanningError(
                f"obstacle cost: wanted 0 <= margin < clearance and a duration > 0, "
                f"got {margin_m} m, {clearance_m} m, {duration_s} s"
            )
        self.spheres, self.field = spheres, field
        self.clearance_m, self.margin_m, self.duration_s = clearance_m, margin_m, duration_s
        arm = flatten(chain, spheres.link, spheres.local_m, spheres.radius_m, field.origin_m, field.resolution_m)
        self._table = Obstacles(
            arm, field.values.ravel(), field.values.shape, np.float32(field.resolution_m), np.float32(0.0),
            np.float32(clearance_m), np.float32(margin_m), np.float32(self.weight),
        )  # fmt: skip

    @classmethod
    def build(cls, request: CostTermRequest) -> ObstacleCost:
        weight, padding_m = request.stomp.obstacle_weight, request.padding_m
        return cls(request.chain, request.spheres, request.field, weight, margin_m=padding_m)

    def table(self, n_waypoints: int) -> Obstacles:
        """Return what the compiled loop wants of this term for trajectories of `n_waypoints`."""
        return self._table._replace(speed_scale=np.float32((n_waypoints - 1) / self.duration_s))

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the costs (R, N), m²/s, and whether the margin is kept; see `CostTerm.evaluate`."""
        costs, nearest = self._run(q)
        return costs, np.asarray(nearest >= np.float32(self.margin_m))

    def costs_and_distances(self, q: ArrayLike) -> tuple[Float32Array, Float32Array]:
        """Return costs (R, N) and the smallest distance of any sphere, cut off at the clearance (R, N), m."""
        return self._run(as_batch(q, self._n_joints))

    def _run(self, q: Float32Array) -> tuple[Float32Array, Float32Array]:
        n_rollouts, n = q.shape[:2]
        out, nearest = np.empty((2, n_rollouts * n), dtype=np.float32)
        obstacle_sums(q.reshape(out.size, -1), n, self.table(n), out, nearest)
        return out.reshape(n_rollouts, n), nearest.reshape(n_rollouts, n)


class JointLimitCost(CostTerm):
    """Squared depth into a margin before each joint limit, rad²; beyond a limit nothing is allowed."""

    def __init__(self, lower: ArrayLike, upper: ArrayLike, weight: float = 1.0, margin_rad: float = 0.1) -> None:
        self._lower = checked("lower limits", lower, ("D",), finite=False).astype(np.float32)
        self._upper = checked("upper limits", upper, (len(self._lower),), finite=False).astype(np.float32)
        super().__init__("joint_limits", weight, len(self._lower))
        if not (self._lower < self._upper).all() or not margin_rad >= 0.0:
            raise PlanningError(
                f"joint limit cost: wanted lower < upper and a margin >= 0, got {lower!r}, {upper!r}, {margin_rad}"
            )
        self._margin = np.float32(margin_rad)

    @classmethod
    def build(cls, request: CostTermRequest) -> JointLimitCost:
        return cls(request.chain.lower, request.chain.upper)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the costs (R, N, D) and whether every joint is within its limits; see `CostTerm.evaluate`."""
        below = np.maximum(self._lower + self._margin - q, np.float32(0.0))
        above = np.maximum(q - (self._upper - self._margin), np.float32(0.0))
        outside = (q < self._lower) | (q > self._upper)
        return below * below + above * above, ~np.asarray(outside.any(axis=2))


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


def evaluated(term: CostTerm, batch: Float32Array) -> tuple[Float32Array, BoolArray | None]:
    """Return what a term says of a batch (R, N, D), checked, because terms come from other packages too.

    Raises:
        PlanningError: for costs or validity of another shape, or costs that are not finite.
    """
    costs, allowed = term.evaluate(batch)
    if costs.shape not in (batch.shape[:2], batch.shape) or (allowed is not None and allowed.shape != batch.shape[:2]):
        raise PlanningError(
            f"cost term {term.name}: wanted costs {batch.shape[:2]} or {batch.shape} and validity {batch.shape[:2]} or "
            f"None, got {costs.shape} and {None if allowed is None else allowed.shape}"
        )
    if not np.isfinite(costs).all():
        raise PlanningError(f"cost term {term.name}: wanted finite costs, got NaN or infinity")
    return costs, allowed


def _summed(costs: Float32Array) -> Float32Array:
    """Return costs (R, N), summed over joints where they are (R, N, D)."""
    total: Float32Array = costs.sum(axis=2) if costs.ndim == 3 else costs
    return total


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
