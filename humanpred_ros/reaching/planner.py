"""Plans the reach of somebody who minimises the learned cost, and predicts by planning once or again (P2 III-D).

STOMP plans the whole body of the human from where the reach starts to where it ends, beside a partner who stands still.
Every plan is a different one by its random noise; how much plans differ says how certain they are.

P2 re-plans every 0.1 s beside the partner's posture of that moment. The person is taken to follow each plan until the
next one, which starts where the person then is; what lies behind counts for velocity, acceleration and jerk. So a
prediction can react to a partner who comes in the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError, PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.between_ends import (
    FirstGuess,
    PostureBounds,
    ShortShoulder,
    posture_variation,
    straight_line,
)
from humanpred_ros.reaching.cost_terms import OBSTACLE_WEIGHT, BodyCost, PostureSmoothness, ReachBody
from humanpred_ros.reaching.demonstrations import resampled
from humanpred_ros.reaching.features import LINK_POINTS, N_FEATURES, PADDING, ReachSituation
from humanpred_ros.reaching.surroundings import BodyCapsules, Surroundings
from humanpred_ros.settings import Settings, setting
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.planner import StompPlanner
from humanpred_ros.stomp.smoothness import smoothness, solve

#: Time between plans, and the time before the end within which the last plan is followed (docs/papers.md).
STEP_S, LEAST_S = 0.1, 0.05
#: STOMP needs some noise for every DoF.
LEAST_NOISE = 1e-6
#: The noise of a DoF in the middle of a reach is at most this share of half its range; a translation that may go
#: 0.05 m would otherwise get noise of 0.07 m and be pushed back in every rollout.
_NOISE_SHARE = 0.5
#: Beyond the cutoff of every feature.
_FAR_M = 1e3


class ReachPlannerSettings(Settings):
    """How reaches are planned; defaults are P2's (docs/papers.md, "P2 prediction")."""

    stomp: StompConfig = setting(
        StompConfig(waypoints=100, iterations=100, rollouts=10, reused=5, noise_std=0.001),
        "Settings of STOMP; the weights in them are not used",
    )
    obstacle_weight: float = setting(OBSTACLE_WEIGHT, "Weight of table and partner as obstacles", low=0.0)
    averaged: int = setting(1, "A plan is the mean of this many, each with its own noise", low=1)


@dataclass(frozen=True, eq=False)
class Partner:
    """The person beside the reaching one, in the posture of one moment."""

    points_m: FloatArray  #: (4, 3) of `LINK_POINTS`, for the features
    field: SignedDistanceField  #: distances to table and partner


@dataclass(frozen=True, eq=False)
class PlannedReach:
    """A planned reach."""

    q: FloatArray  #: (N, J) postures, evenly in time
    duration_s: float  #: from the first to the last
    cost: dict[str, float]  #: shares of the cost: posture, body (wrist, partner and obstacles)
    total: float  #: their sum

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
            planned = planner.assess(mean)
        return PlannedReach(planned.waypoints, duration_s, planned.cost, planned.total)

    def _terms(
        self, first: FloatArray, duration_s: float, partner: Partner, past: FloatArray | None
    ) -> tuple[PostureSmoothness, BodyCost]:
        s, n = self.settings, self.settings.stomp.waypoints
        situation = ReachSituation(duration_s, partner.points_m, past)
        return (
            PostureSmoothness(self.weights[:4], duration_s, n, first, past),
            BodyCost(self._body, self.weights, situation, n, first, partner.field, s.obstacle_weight),
        )

    def _noise(self, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """Return the scale of the noise of each DoF (J,), no more than fits its bounds."""
        most = _NOISE_SHARE * 0.5 * (upper - lower) / unit_deviation(self.settings.stomp.waypoints)
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


@dataclass(frozen=True, eq=False)
class ReachTask:
    """One reach to predict. As in P2, the predictor knows the goal posture and the duration.

    Raises:
        MotionError: arrays that do not fit each other.
    """

    name: str  #: of the recording
    dof_names: tuple[str, ...]  #: J names
    t_s: FloatArray  #: (n,) stamps, seconds since the reach's start, at which the prediction is wanted
    start: FloatArray  #: (J,) first and last posture; angles continuous from one to the other as the person went
    goal: FloatArray
    #: who sits beside, at the same stamps. A predictor must not look at a posture later than the moment it predicts at.
    partner: Motion

    def __post_init__(self) -> None:
        J = len(self.dof_names)
        t_s = checked(f"{self.name}: t_s", self.t_s, ("n",), error=MotionError)
        if len(t_s) < 2 or (np.diff(t_s) <= 0).any():
            raise MotionError(f"{self.name}: wanted at least 2 increasing stamps, got {len(t_s)}")
        for field, value in (("start", self.start), ("goal", self.goal)):
            object.__setattr__(self, field, frozen(checked(f"{self.name}: {field}", value, (J,), error=MotionError)))
        object.__setattr__(self, "t_s", frozen(t_s))

    @classmethod
    def of(cls, recording: ReachRecording) -> ReachTask:
        """Return the task of predicting a recorded reach at its own stamps."""
        active = recording.active
        return cls(recording.name, active.dof_names, active.t_s, active.q[0], active.q[-1], recording.passive)

    @property
    def duration_s(self) -> float:
        """From the first to the last stamp."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def phase(self) -> FloatArray:
        """(n,) share of the duration that has passed at each stamp, 0 to 1."""
        phase: FloatArray = (self.t_s - self.t_s[0]) / self.duration_s
        return phase


class PredictsReaches(Protocol):
    """Predicts reaches; `rng` is the only source of randomness."""

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J) at the task's stamps."""
        ...


@dataclass(frozen=True)
class PlannedPrediction:
    """Predicts a reach by one plan beside the partner's first posture, or by a plan every `step_s`.

    Raises:
        PlanningError: a step that is not positive.
    """

    planner: ReachPlanner  #: plans the reaches
    step_s: float | None = None  #: time between plans; None to plan once

    def __post_init__(self) -> None:
        if self.step_s is not None and not self.step_s > 0.0:
            raise PlanningError(f"re-planning: wanted a step > 0 s, got {self.step_s}")

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J) at the task's stamps.

        Raises:
            HumanModelError: a task for another human.
        """
        planner, t_s = self.planner, task.t_s - task.t_s[0]
        planner.model.check_dofs(task.dof_names)
        if self.step_s is None:
            partner, source = planner.partner(task.partner.q[0]), rng.spawn(1)[0]
            return planner.plan(task.start, task.goal, task.duration_s, partner, source).at(t_s)
        done = np.tile(task.start, (len(t_s), 1))
        n = planner.settings.stomp.waypoints
        plan: PlannedReach | None = None
        begin_s = 0.0
        for now in planning_frames(t_s, self.step_s):
            now_s, left_s = float(t_s[now]), float(t_s[-1] - t_s[now])
            before_s = now_s + left_s / (n - 1) * np.arange(-PADDING, 0, dtype=np.float64)
            history = resampled(t_s[: now + 1], done[: now + 1], before_s) if now else None
            initial = None if plan is None else plan.at(now_s - begin_s + np.linspace(0.0, left_s, n))
            partner = planner.partner(task.partner.q[now])
            plan = planner.plan(done[now], task.goal, left_s, partner, rng, history, initial)
            begin_s = now_s
            # The plan is followed to its end; the next one overwrites what it replaces.
            done[now:] = plan.at(t_s[now:] - now_s)
        done[-1] = task.goal
        return done


def planning_frames(t_s: FloatArray, step_s: float) -> list[int]:
    """Return the frames of stamps (n,), the first 0, at which plans are made: the first of every step.

    None is made shortly before the end.
    """
    # A frame that comes a hair before its step belongs to it.
    steps = np.arange(0.0, t_s[-1], step_s) - 1e-3 * step_s
    first = np.searchsorted(t_s, steps)
    return sorted({0, *(int(k) for k in first[t_s[-1] - t_s[first] >= LEAST_S])})


#: What the improved predictor does differently from P2, chosen on P2's seven recordings, leaving one out. No number has
#: to be exact: half or double of each changes the distance in joint centres by at most 6 %, in task space by at most
#: 10 %. Its updates of each plan (P2: 100), and of how many plans the mean is taken (P2: 1).
IMPROVED_ITERATIONS, IMPROVED_AVERAGED = 25, 2
#: Its weight of obstacles lies between those of P2's two parameter files, 4 and 80; most noise in units of 1/R (P2:
#: 0.001 for all DoFs).
IMPROVED_OBSTACLE_WEIGHT, _MOST_NOISE = 40.0, 0.0003


def improved_planner(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    surroundings: Surroundings | None = None,
) -> ReachPlanner:
    """Return the planner of the improved predictor.

    It begins with a `ShortShoulder` instead of the straight line, and stays nearer to it. Its bounds are relative to
    the reach: planned again and again, the trunk would drift to where others stood.

    Args:
        recordings: what bounds of the postures are taken from, and how much people vary each DoF; leave out the tested
            one.
        model: the human.
        weights: (24,) learned, or of `NAMED_WEIGHTS`.
        surroundings: table and region; P2's if None.

    Raises:
        PlanningError: negative weights, or an array of another shape.
        MotionError: no recordings.
    """
    plain = ReachPlannerSettings()
    deviation = posture_variation(recordings) / unit_deviation(plain.stomp.waypoints)
    noise = np.clip(deviation, LEAST_NOISE, _MOST_NOISE)
    planning = plain.replaced(
        stomp=plain.stomp.replaced(iterations=IMPROVED_ITERATIONS, noise_std=tuple(noise.tolist())),
        obstacle_weight=IMPROVED_OBSTACLE_WEIGHT,
        averaged=IMPROVED_AVERAGED,
    )
    bounds = PostureBounds.from_recordings(recordings, model, relative=True)
    return ReachPlanner(model, weights, bounds, surroundings, planning, ShortShoulder(model))
