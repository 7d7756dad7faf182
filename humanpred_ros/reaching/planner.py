"""Plans the reach of somebody who minimises the learned cost (P2 III-D).

STOMP plans the whole body of the human from where the reach starts to where it ends, beside a partner who stands still.
Every plan is a different one by its random noise; how much plans differ says how certain they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError, PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.body import BodyCapsules, ReachBody
from humanpred_ros.reaching.cost_terms import CLEARANCE_M, OBSTACLE_WEIGHT, BodyCost, PostureSmoothness
from humanpred_ros.reaching.demonstrations import resampled
from humanpred_ros.reaching.features import LINK_POINTS, N_FEATURES, FeatureSettings, ReachSituation
from humanpred_ros.reaching.first_guess import FirstGuess, straight_line
from humanpred_ros.reaching.posture_bounds import PostureBounds
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import Settings, setting
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.planner import StompPlanner
from humanpred_ros.stomp.smoothness import smoothness, solve

#: Beyond the cutoff of every feature.
_FAR_M = 1e3


class ReachPlannerSettings(Settings):
    """How reaches are planned; defaults are P2's (docs/papers.md, "P2 prediction")."""

    stomp: StompConfig = setting(
        StompConfig(waypoints=100, iterations=100, rollouts=10, reused=5, noise_std=0.001),
        "Settings of STOMP; the weights in them are not used",
    )
    noise_share: float = setting(
        0.5,
        "The noise of a DoF in the middle of a reach is at most this share of half its range; a translation that may "
        "go 0.05 m would otherwise get noise of 0.07 m and be pushed back in every rollout",
        low=1e-6,
    )
    obstacle_weight: float = setting(OBSTACLE_WEIGHT, "Weight of table and partner as obstacles", low=0.0)
    clearance_m: float = setting(CLEARANCE_M, "Distance below which an obstacle costs", unit="m", low=1e-6)
    averaged: int = setting(1, "A plan is the mean of this many, each with its own noise", low=1)


@dataclass(frozen=True, eq=False)
class Partner:
    """The person beside the reaching one, in the posture of one moment.

    Attributes:
        points_m: (4, 3) of `LINK_POINTS`, for the features.
        field: distances to table and partner.
    """

    points_m: FloatArray
    field: SignedDistanceField


@dataclass(frozen=True, eq=False)
class PlannedReach:
    """A planned reach.

    Attributes:
        q: (N, J) postures, evenly in time.
        duration_s: from the first to the last.
        cost: shares of the cost: posture, body (wrist, partner and obstacles).
        total: their sum.
        iterations: of STOMP.
    """

    q: FloatArray
    duration_s: float
    cost: dict[str, float]
    total: float
    iterations: int

    def at(self, t_s: ArrayLike) -> FloatArray:
        """Return the postures (T, J) at times (T,) since the reach's start; before it the first, after it the last."""
        return resampled(np.linspace(0.0, self.duration_s, len(self.q)), self.q, np.asarray(t_s, dtype=np.float64))


class ReachPlanner:
    """Plans reaches of one human with one set of weights; holds no state, so threads may share it.

    Args:
        model: the human who reaches; the partner has the same kinematics.
        weights: (24,) of the features, 0 or more.
        bounds: of the postures.
        surroundings: table and region; P2's if None.
        settings: of the planning.
        guess: what planning begins with where nothing else is given.

    Raises:
        PlanningError: negative weights, or an array of another shape.
    """

    def __init__(
        self,
        model: HumanModel,
        weights: ArrayLike,
        bounds: PostureBounds,
        surroundings: Surroundings | None = None,
        settings: ReachPlannerSettings | None = None,
        guess: FirstGuess = straight_line,
    ) -> None:
        w = checked("reach weights", weights, (N_FEATURES,), error=PlanningError)
        if not (w >= 0.0).all():
            raise PlanningError(f"reach weights: wanted 0 or more, got {w.min()}")
        self.model, self.bounds, self.guess = model, bounds, guess
        self.weights: FloatArray = frozen(w)  # type: ignore[assignment]
        self.surroundings = surroundings or Surroundings.of_p2()
        self.settings = settings or ReachPlannerSettings()
        self._features = FeatureSettings(n_waypoints=self.settings.stomp.waypoints)
        self._body = ReachBody(model)
        self._partner_points = ChainPoints(model, LINK_POINTS)
        self._partner_capsules = BodyCapsules.of(model)

    def partner(self, q: ArrayLike) -> Partner:
        """Return a partner in posture (J,); keep it where several reaches are planned beside it."""
        posture = checked("partner", q, (len(self.model.dof_names),), error=MotionError)
        ends = self._partner_capsules.placed(self.model, posture)
        points = np.asarray(self._partner_points.positions(posture), dtype=np.float64)
        return Partner(points, self.surroundings.field_with(ends, self._partner_capsules.radius_m))

    def nobody(self) -> Partner:
        """Return what stands for a partner where there is none: a person too far away to count."""
        return Partner(np.full((len(LINK_POINTS), 3), _FAR_M), self.surroundings.field)

    def plan(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        duration_s: float,
        partner: Partner,
        rng: np.random.Generator,
        history: ArrayLike | None = None,
        initial: ArrayLike | None = None,
    ) -> PlannedReach:
        """Return the best reach that STOMP found.

        Args:
            start, goal: (J,) first and last posture, angles continuous from one to the other.
            duration_s: of the reach.
            partner: who stands still beside.
            rng: source of all randomness.
            history: (6, J) postures at the waypoints' spacing before the start, the latest last; None for a person
                at rest.
            initial: (N, J) reach to begin with; the first guess if None.

        Raises:
            MotionError: arrays or numbers that do not fit.
        """
        n, J = self.settings.stomp.waypoints, len(self.model.dof_names)
        first, last = (checked(k, v, (J,), error=MotionError) for k, v in (("start", start), ("goal", goal)))
        past = None if history is None else checked("history", history, ("H", J), error=MotionError)
        lower, upper = self.bounds.around(first, last)
        if initial is None:
            begin = self.guess(first, last, np.linspace(0.0, 1.0, n))
        else:
            begin = np.array(checked("initial reach", initial, (n, J), error=MotionError))
        begin[0], begin[-1] = first, last
        planner = StompPlanner(self._terms(first, duration_s, partner, past), lower, upper, self.settings.stomp)
        noise = self._noise(lower, upper)
        if self.settings.averaged == 1:
            planned = planner.plan(begin, rng, noise_std=noise)
        else:
            plans = [planner.plan(begin, source, noise_std=noise) for source in rng.spawn(self.settings.averaged)]
            mean = np.mean([plan.waypoints for plan in plans], axis=0)
            planned = planner.assess(mean, sum(plan.iterations for plan in plans))
        return PlannedReach(planned.waypoints, duration_s, planned.cost, planned.total, planned.iterations)

    def _terms(
        self, first: FloatArray, duration_s: float, partner: Partner, past: FloatArray | None
    ) -> tuple[PostureSmoothness, BodyCost]:
        s, n = self.settings, self.settings.stomp.waypoints
        situation = ReachSituation(duration_s, partner.points_m, past)
        return (
            PostureSmoothness(self.weights[:4], duration_s, n, first, past),
            BodyCost(
                self._body, self.weights, situation, n, first, partner.field, s.obstacle_weight, s.clearance_m,
                self._features,
            ),
        )  # fmt: skip

    def _noise(self, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """Return the scale of the noise of each DoF (J,), no more than fits its bounds."""
        most = self.settings.noise_share * 0.5 * (upper - lower) / unit_deviation(self.settings.stomp.waypoints)
        noise: FloatArray = np.minimum(self.settings.stomp.noise_std, most)
        return noise


@lru_cache(maxsize=8)
def unit_deviation(n_waypoints: int) -> float:
    """Return the standard deviation of STOMP's noise of unit scale in the middle of a trajectory (100: 70)."""
    smooth = smoothness(n_waypoints)
    middle = np.zeros((smooth.n_free, 1))
    middle[smooth.n_free // 2] = 1.0
    solve(smooth.factor, middle)
    return float(np.sqrt(middle[smooth.n_free // 2, 0]))
