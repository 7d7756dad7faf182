"""What a person minimises while reaching, as cost terms of STOMP: the planner of the PR2 then plans for the human.

Summed over waypoints, the terms without the obstacles are `weights . features` of `ReachFeatures` to float32's
rounding. The smoothness of the posture is known for each DoF, so STOMP weighs DoFs apart; what wrist, partner and
obstacles add is one term, because they need the same kinematics.

The authors' code counts the posture's features with weight 1 in roll-outs and with the learned weights only where the
best trajectory is chosen (facts section 4). Here the learned weights apply everywhere, unless one asks for theirs.
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
from humanpred_ros.reaching.body import MOVING_BODIES, BodyCapsules
from humanpred_ros.reaching.features import (
    LINK_POINTS,
    N_FEATURES,
    N_SMOOTHNESS,
    SCALES,
    FeatureConfig,
    ReachSituation,
)
from humanpred_ros.stomp.costs import CostTerm, JointCostTerm, as_batch

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
#: P2's clearance, and the weight of its parameter files of September 2014 (facts sections 3 and 9: 4 or 80).
CLEARANCE_M = 0.05
OBSTACLE_WEIGHT = 4.0
#: Spheres along a bone stand at most this many radii apart.
_SPACING = 1.0


class PostureSmoothness(JointCostTerm):
    """Length, velocity, acceleration and jerk of the posture, by DoF; features 0 to 3 (P2 III-A).

    Args:
        weights: (4,) of the features.
        duration_s: of the reach.
        n_waypoints: N of the reaches that will be costed.
        first: (J,) posture at the first waypoint, which stands in for what came before without a history.
        history: (H, J) postures at the waypoints' spacing before the first one, H >= 2.
        rollout_weights: (4,) that all trajectories of a batch but the last are costed with; STOMP puts the noiseless
            one last.

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
        rollout_weights: ArrayLike | None = None,
    ) -> None:
        super().__init__("posture", 1.0)
        self._first = checked("first posture", first, ("J",), error=PlanningError)
        self._weights = _per_waypoint(weights, SCALES[:4], duration_s, n_waypoints)
        self._of_rollouts = (
            None if rollout_weights is None else _per_waypoint(rollout_weights, SCALES[:4], duration_s, n_waypoints)
        )
        self._n = n_waypoints
        self._before = _before(self._first if history is None else history)

    def joint_costs(self, q: ArrayLike) -> Float32Array:
        batch = as_batch(q, len(self._first))
        if batch.shape[1] != self._n:
            raise PlanningError(f"posture smoothness: wanted {self._n} waypoints, got {batch.shape[1]}")
        return self.evaluate_joints(batch)[0]

    def evaluate_joints(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        out = np.empty_like(q)
        noiseless = 0
        if self._of_rollouts is not None:
            noiseless = len(q) - 1
            kernels.difference_costs(q[:noiseless], self._before, self._of_rollouts, out[:noiseless])
        kernels.difference_costs(q[noiseless:], self._before, self._weights, out[noiseless:])
        return out, None


class ReachBody:
    """Points of one human that costs look at: the four of the features, and the ends of the body's capsules.

    Shared by all reaches of the human; immutable.

    Attributes:
        model: the human.
        feature_points, all_points: (4,) rows of `LINK_POINTS` among the points without and with the body.
        capsules: (C, 4) rows of both ends among the points, and where its spheres begin and end.
        spheres: (S, 2) place along the bone, 0 to 1, and radius in metres.
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

    def points(self, q: Float32Array, *, with_body: bool) -> Float32Array:
        """Return the points (M, P, 3) of postures (M, J); without the body those of the features only."""
        points: Float32Array = (self._all if with_body else self._features).positions(q)
        return points


class BodyCost(CostTerm):
    """Smoothness of the wrist (features 4 to 7), closeness to the partner (8 to 23), and obstacles.

    The obstacle potential of a sphere at distance d from table and partner is 0 beyond the clearance c, (d - c)^2 / 2c
    within it, c/2 - d inside (facts section 3); it is summed over the spheres of trunk and arm, times the way each
    goes. P2's code sums its partial sums once more and leaves the way out where the best trajectory is chosen; here
    neither is so. Nothing is forbidden: people touch what they reach for.

    Args:
        body: of the reaching human.
        weights: (24,) of all features; the first four are not used.
        situation: duration, partner, history.
        n_waypoints: N of the reaches that will be costed.
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
        features: FeatureConfig | None = None,
    ) -> None:
        super().__init__("body", 1.0)
        settings = features or FeatureConfig()
        w = checked("weights", weights, (N_FEATURES,), error=PlanningError)
        if not (obstacle_weight >= 0.0 and clearance_m > 0.0):
            raise PlanningError(
                f"obstacles: wanted a weight >= 0 and a clearance > 0, got {obstacle_weight} and {clearance_m} m"
            )
        self._body, self._n = body, n_waypoints
        self._n_dofs = len(body.model.dof_names)
        self._obstacles = field is not None and obstacle_weight > 0.0
        history = np.asarray(first, dtype=np.float64)[None] if situation.history is None else situation.history
        wrist = LINK_POINTS.index("right_wrist")
        earlier = body.points(history.astype(np.float32), with_body=False)[:, body.feature_points[wrist]]
        rows = body.all_points if self._obstacles else body.feature_points
        smooth = _per_waypoint(w[4:N_SMOOTHNESS], SCALES[4:N_SMOOTHNESS], situation.duration_s, n_waypoints)
        self._wrist = (int(rows[wrist]) if smooth.any() else -1, _before(earlier), smooth)
        self._partner = _closeness(w[N_SMOOTHNESS:], situation, n_waypoints, settings, rows)
        self._obstacle = _obstacles(body, field, obstacle_weight, clearance_m, self._obstacles)
        self._idle = not (smooth.any() or len(self._partner[1]) or self._obstacles)

    def costs(self, q: ArrayLike) -> Float32Array:
        return self.evaluate(as_batch(q, self._n_dofs))[0]

    def evaluate(self, q: Float32Array) -> tuple[Float32Array, BoolArray | None]:
        shares = self._run(q)
        return shares[0] + shares[1] + shares[2], None

    def shares(self, q: ArrayLike) -> dict[str, Float32Array]:
        """Return the costs (R, N) of trajectories (R, N, J) by reason: wrist, partner, obstacle."""
        return dict(zip(("wrist", "partner", "obstacle"), self._run(as_batch(q, self._n_dofs)), strict=True))

    def _run(self, q: Float32Array) -> Float32Array:
        n_reaches, n = q.shape[:2]
        if n != self._n:
            raise PlanningError(f"body cost: wanted {self._n} waypoints, got {n}")
        if self._idle:
            return np.zeros((3, n_reaches, n), dtype=np.float32)
        points = self._body.points(q.reshape(-1, self._n_dofs), with_body=self._obstacles)
        out = np.empty((3, n_reaches * n), dtype=np.float32)
        kernels.body_costs(points, n, self._wrist, self._partner, self._obstacle, out)
        return out.reshape(3, n_reaches, n)


def _in_order(model: HumanModel, links: Sequence[str], local_m: FloatArray) -> tuple[ChainPoints, NDArray[np.int64]]:
    """Return points in the order of the chain, which is the fastest, and at which row each of the given ones is."""
    order = np.argsort(model.link_joint[[model.link_names.index(link) for link in links]], kind="stable")
    return ChainPoints(model, [links[k] for k in order], local_m[order]), np.argsort(order)


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
    settings: FeatureConfig,
    rows: NDArray[np.int64],
) -> tuple[Any, ...]:
    if not (weights >= 0.0).all():
        raise PlanningError(f"closeness to the partner: wanted weights >= 0, got {weights.min()}")
    dt_s = situation.duration_s / (n_waypoints - 1)
    used = np.flatnonzero(weights)
    count = len(LINK_POINTS)
    pairs = np.stack([rows[used // count], used % count], axis=1)
    factors = (settings.closeness_height * dt_s * weights[used]).astype(np.float32)
    decay = np.float32(np.log(settings.closeness_base) / settings.closeness_range_m)
    return pairs, factors, situation.partner_m.astype(np.float32), decay, np.float32(settings.closeness_cutoff_m)


def _obstacles(
    body: ReachBody, field: SignedDistanceField | None, weight: float, clearance_m: float, used: bool
) -> tuple[Any, ...]:
    single = np.float32
    if field is None or not used:
        none = np.zeros((2, 2, 2), dtype=np.float32)
        none.setflags(write=False)  # numba tells read-only arrays apart
        return body.capsules[:0], body.spheres, none, np.zeros(3, single), single(1.0), single(1.0), single(0.0)
    origin, resolution = field.origin_m.astype(single), single(field.resolution_m)
    return body.capsules, body.spheres, field.values, origin, resolution, single(clearance_m), single(weight)
