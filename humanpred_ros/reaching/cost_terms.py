"""What a person minimises while reaching, as cost terms of STOMP: the planner of arms then plans for a human.

Summed over waypoints, the terms without obstacles equal `weights . features` of `ReachFeatures` up to float32 rounding.
The smoothness of the posture is known for each DoF, so STOMP weighs the DoFs apart. Wrist, partner and obstacles are
one term because they need the same kinematics.

The authors' code counts the posture's features with weight 1 in rollouts, and with the learned weights only when it
chooses the best trajectory. Here the learned weights apply everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching import cost_kernels as kernels
from humanpred_ros.reaching.features import (
    CLOSENESS_CUTOFF_M,
    CLOSENESS_DECAY_PER_M,
    CLOSENESS_HEIGHT,
    LINK_POINTS,
    N_FEATURES,
    N_SMOOTHNESS,
    SCALES,
    ReachSituation,
)
from humanpred_ros.reaching.surroundings import BodyCapsules
from humanpred_ros.stomp.costs import CostTerm

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
#: P2's clearance and obstacle weight; its parameter files have 4 or 80 (docs/papers.md, "P2 scene").
CLEARANCE_M = 0.05
OBSTACLE_WEIGHT = 4.0

#: Bodies that move with a reach: trunk and right arm. P2 leaves out the pelvis, whose joints come first.
MOVING_BODIES = (
    "torso", "shoulders", "right_upper_arm", "right_lower_upper_arm", "right_forearm", "right_lower_forearm",
    "right_hand",
)  # fmt: skip
#: Spheres along a bone are at most this many radii apart.
_SPACING = 1.0


class ReachBody:
    """The points of one human that costs look at: `LINK_POINTS`, and the ends of the capsules of trunk and arm.

    All reaches of the human share it; immutable.

    Attributes:
        model: the human.
        feature_points, all_points: (4,) rows of `LINK_POINTS` among the points without and with the body.
        capsules: (C, 4) rows of both ends among the points, and the first and last + 1 of its spheres.
        spheres: (S, 2) place along the bone, 0 to 1, and radius in metres.
        radius_m: (C,) of the capsules, float32.
    """

    def __init__(self, model: HumanModel) -> None:
        capsules = BodyCapsules.of(model, MOVING_BODIES)
        links = [*LINK_POINTS, *(link for link in capsules.links for _ in range(2))]
        local = np.concatenate([np.zeros((len(LINK_POINTS), 3)), capsules.ends_m.reshape(-1, 3)])
        self.model = model
        self._features, self.feature_points = _in_order(model, links[: len(LINK_POINTS)], local[: len(LINK_POINTS)])
        self._all, number = _in_order(model, links, local)
        self.all_points, ends = number[: len(LINK_POINTS)], number[len(LINK_POINTS) :].reshape(-1, 2)
        rows: list[tuple[int, int, int, int]] = []
        spheres: list[tuple[float, float]] = []
        for (a, b), bone, radius in zip(ends, capsules.ends_m, capsules.radius_m, strict=True):
            count = 1 + int(np.ceil(np.linalg.norm(bone[1] - bone[0]) / (_SPACING * radius) - 1e-9))
            places = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
            rows.append((a, b, len(spheres), len(spheres) + count))
            spheres += [(place, radius) for place in places]
        self.capsules = np.array(rows, dtype=np.int64)
        self.spheres = np.array(spheres, dtype=np.float32)
        self.radius_m = capsules.radius_m.astype(np.float32)

    def points(self, q: Float32Array, *, with_body: bool) -> Float32Array:
        """Return the points (M, P, 3) of postures (M, J); without the body only those of the features."""
        points: Float32Array = (self._all if with_body else self._features).positions(q)
        return points


def _in_order(model: HumanModel, links: Sequence[str], local_m: FloatArray) -> tuple[ChainPoints, NDArray[np.int64]]:
    """Return points in the order of the chain, which is the fastest, and the row of each of the given ones."""
    order = np.argsort(model.link_joint[[model.link_names.index(link) for link in links]], kind="stable")
    return ChainPoints(model, [links[k] for k in order], local_m[order]), np.argsort(order)


class PostureSmoothness(CostTerm):
    """Length, velocity, acceleration and jerk of the posture, by DoF; features 0 to 3 (P2 III-A).

    Args:
        weights: (4,) of the features.
        duration_s: of the reach.
        n_waypoints: N of the reaches.
        first: (J,) posture at the first waypoint; it is repeated before it where there is no history.
        history: (H, J) postures at the waypoints' spacing before the first one, H >= 2.

    Raises:
        PlanningError: arrays that do not fit.
    """

    def __init__(
        self,
        weights: ArrayLike,
        duration_s: float,
        n_waypoints: int,
        first: ArrayLike,
        history: FloatArray | None = None,
    ) -> None:
        self._first = checked("first posture", first, ("J",), error=PlanningError)
        super().__init__("posture", 1.0, len(self._first))
        self._weights = _per_waypoint(weights, SCALES[:4], duration_s, n_waypoints)
        self._n = n_waypoints
        self._before = _before(self._first if history is None else history)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        """Return the costs (R, N, J) by DoF; see `CostTerm.evaluate`."""
        if q.shape[1] != self._n:
            raise PlanningError(f"posture smoothness: wanted {self._n} waypoints, got {q.shape[1]}")
        out = np.empty_like(q)
        kernels.difference_costs(q, self._before, self._weights, out)
        return out, None


class BodyCost(CostTerm):
    """Smoothness of the wrist (features 4 to 7), closeness to the partner (8 to 23), and obstacles.

    The obstacle potential of a sphere at distance d from table and partner is 0 beyond the clearance c, (d - c)^2 / 2c
    within it, c/2 - d inside (docs/papers.md (1.9)). It is summed over the spheres of trunk and arm, times the distance
    each moves. (The authors' code sums the partial sums once more and leaves the distance out when it chooses the best
    trajectory.) Nothing is forbidden: people touch what they reach for.

    Args:
        body: of the reaching human.
        weights: (24,) of all features; the first four are not used.
        situation: duration, partner, history.
        n_waypoints: N of the reaches.
        first: (J,) posture at the first waypoint.
        field: distances to table and partner; None for no obstacles.
        obstacle_weight, clearance_m: of the obstacles.

    Raises:
        PlanningError: arrays or numbers that do not fit.
    """

    def __init__(
        self,
        body: ReachBody,
        weights: ArrayLike,
        situation: ReachSituation,
        n_waypoints: int,
        first: ArrayLike,
        field: SignedDistanceField | None = None,
        obstacle_weight: float = OBSTACLE_WEIGHT,
        clearance_m: float = CLEARANCE_M,
    ) -> None:
        super().__init__("body", 1.0, len(body.model.dof_names))
        w = checked("weights", weights, (N_FEATURES,), error=PlanningError)
        if not (obstacle_weight >= 0.0 and clearance_m > 0.0):
            raise PlanningError(
                f"obstacles: wanted a weight >= 0 and a clearance > 0, got {obstacle_weight} and {clearance_m} m"
            )
        self._body, self._n = body, n_waypoints
        self._n_dofs = len(body.model.dof_names)
        self._with_body = field is not None and obstacle_weight > 0.0
        history = np.asarray(first, dtype=np.float64)[None] if situation.history is None else situation.history
        wrist = LINK_POINTS.index("right_wrist")
        earlier = body.points(history.astype(np.float32), with_body=False)[:, body.feature_points[wrist]]
        rows = body.all_points if self._with_body else body.feature_points
        smooth = _per_waypoint(w[4:N_SMOOTHNESS], SCALES[4:N_SMOOTHNESS], situation.duration_s, n_waypoints)
        self._wrist = (int(rows[wrist]) if smooth.any() else -1, _before(earlier), smooth)
        self._partner = _closeness(w[N_SMOOTHNESS:], situation, n_waypoints, rows)
        self._obstacle = _obstacles(body, field if self._with_body else None, obstacle_weight, clearance_m)
        self._idle = not (smooth.any() or len(self._partner[1]) or self._with_body)

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        n_reaches, n = q.shape[:2]
        if n != self._n:
            raise PlanningError(f"body cost: wanted {self._n} waypoints, got {n}")
        shares = np.zeros((3, n_reaches * n), dtype=np.float32)
        if not self._idle:
            points = self._body.points(q.reshape(-1, self._n_dofs), with_body=self._with_body)
            kernels.body_costs(points, n, self._wrist, self._partner, self._obstacle, shares)
        return (shares[0] + shares[1] + shares[2]).reshape(n_reaches, n), None


def _per_waypoint(weights: ArrayLike, scales: FloatArray, duration_s: float, n_waypoints: int) -> Float32Array:
    """Return weights (4,) for squared differences in units of one waypoint's step."""
    w = checked("smoothness weights", weights, (4,), error=PlanningError)
    if not (w >= 0.0).all() or not duration_s > 0.0:
        raise PlanningError(f"smoothness: wanted weights >= 0 and a duration > 0, got {w} and {duration_s} s")
    dt_s = duration_s / (n_waypoints - 1)
    factors: Float32Array = (w * scales * np.array([1.0, dt_s**-2, dt_s**-4, dt_s**-6])).astype(np.float32)
    return factors


def _before(history: FloatArray | Float32Array) -> Float32Array:
    """Return the last two rows, or one row twice."""
    rows = np.atleast_2d(history)[-kernels.BACK :]
    return np.ascontiguousarray(rows[[0] * (kernels.BACK - len(rows)) + list(range(len(rows)))], dtype=np.float32)


def _closeness(
    weights: FloatArray,
    situation: ReachSituation,
    n_waypoints: int,
    rows: NDArray[np.int64],
) -> tuple[Any, ...]:
    """Return the pairs of points that have a weight and all else that `body_costs` wants of the partner."""
    if not (weights >= 0.0).all():
        raise PlanningError(f"closeness to the partner: wanted weights >= 0, got {weights.min()}")
    dt_s = situation.duration_s / (n_waypoints - 1)
    used = np.flatnonzero(weights)
    count = len(LINK_POINTS)
    pairs = np.stack([rows[used // count], used % count], axis=1)
    factors = (CLOSENESS_HEIGHT * dt_s * weights[used]).astype(np.float32)
    decay, cutoff = np.float32(CLOSENESS_DECAY_PER_M), np.float32(CLOSENESS_CUTOFF_M)
    return pairs, factors, situation.partner_m.astype(np.float32), decay, cutoff


def _obstacles(
    body: ReachBody, field: SignedDistanceField | None, weight: float, clearance_m: float
) -> tuple[Any, ...]:
    """Return all that `body_costs` wants of the obstacles; no capsules if there is no field."""
    single = np.float32
    if field is None:
        none = np.zeros((2, 2, 2), dtype=np.float32)
        none.setflags(write=False)  # numba tells read-only arrays apart
        return body.capsules[:0], body.spheres, none, np.zeros(3, single), single(1.0), single(1.0), single(0.0)
    origin, resolution = field.origin_m.astype(single), single(field.resolution_m)
    return body.capsules, body.spheres, field.values, origin, resolution, single(clearance_m), single(weight)
