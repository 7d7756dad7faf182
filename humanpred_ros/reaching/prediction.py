"""Predicts a reach whose goal and duration are known, by planning it once or again and again (P2 III-D).

P2 re-plans every 0.1 s beside the partner's posture of that moment. The person is taken to follow each plan until the
next one, which starts where the person then is; what lies behind counts for velocity, acceleration and jerk. So a
prediction can react to a partner who comes in the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError, PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.demonstrations import resampled
from humanpred_ros.reaching.features import PADDING
from humanpred_ros.reaching.first_guess import ShortShoulder
from humanpred_ros.reaching.planner import PlannedReach, ReachPlanner, ReachPlannerSettings, unit_deviation
from humanpred_ros.reaching.posture_bounds import BoundsSettings, PostureBounds, posture_variation
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import Settings, setting

#: Time between plans, and the time before the end within which the last plan is followed (docs/papers.md).
STEP_S, LEAST_S = 0.1, 0.05
#: STOMP needs some noise for every DoF.
LEAST_NOISE = 1e-6


@dataclass(frozen=True, eq=False)
class ReachTask:
    """One reach to predict. As in P2, the predictor knows the goal posture and the duration.

    Attributes:
        name: of the recording.
        dof_names: J names.
        t_s: (n,) stamps, seconds since the reach's start, at which the prediction is wanted.
        start, goal: (J,) first and last posture; angles continuous from one to the other as the person went.
        partner: who sits beside, at the same stamps. A predictor must not look at a posture later than the moment it
            predicts at.

    Raises:
        MotionError: arrays that do not fit each other.
    """

    name: str
    dof_names: tuple[str, ...]
    t_s: FloatArray
    start: FloatArray
    goal: FloatArray
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

    Attributes:
        planner: plans the reaches.
        step_s: time between plans; None to plan once.

    Raises:
        PlanningError: a step that is not positive.
    """

    planner: ReachPlanner
    step_s: float | None = None

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


def planned_prediction(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    *,
    step_s: float | None = None,
    surroundings: Surroundings | None = None,
    settings: ReachPlannerSettings | None = None,
    bounds: BoundsSettings | None = None,
) -> PlannedPrediction:
    """Return P2's predictor with given weights (24,).

    Args:
        recordings: what bounds of the postures are taken from; leave out the tested one.
        model: the human.
        weights: learned, or of `NAMED_WEIGHTS`.
        step_s: time between plans (P2: `STEP_S`); None to plan once.
        surroundings: table and region; P2's if None.
        settings: of the planning.
        bounds: how the recordings bound postures; P2's way if None.

    Raises:
        PlanningError: negative weights, or an array of another shape.
        MotionError: no recordings.
    """
    limits = PostureBounds.from_recordings(recordings, model, bounds)
    return PlannedPrediction(ReachPlanner(model, weights, limits, surroundings, settings), step_s)


class ImprovedSettings(Settings):
    """What the improved predictor does differently from P2; chosen on P2's seven recordings, leaving one out.

    It begins with a `ShortShoulder` instead of the straight line, and stays nearer to it. Its bounds are relative to
    the reach: planned again and again, the trunk would drift to where others stood. No number has to be exact: half or
    double of each changes the distance in joint centres by at most 6 %, in task space by at most 10 %.
    """

    variation_share: float = setting(
        1.0, "Noise of a DoF in the middle of a reach, as a share of how much people vary it", low=0.0
    )
    most_noise: float = setting(
        0.0003, "But never more than this, in units of 1/R (P2: 0.001 for all)", low=LEAST_NOISE
    )
    n_iterations: int = setting(25, "Updates of each plan (P2: 100)", low=0)
    averaged: int = setting(2, "Plans of which the mean is taken (P2: 1)", low=1)
    obstacle_weight: float = setting(40.0, "Between the two of P2's parameter files, 4 and 80", low=0.0)


def improved_planner(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: ArrayLike,
    surroundings: Surroundings | None = None,
    settings: ImprovedSettings | None = None,
) -> ReachPlanner:
    """Return the planner of the improved predictor; arguments and errors as in `planned_prediction`.

    The recordings also say how much people vary each DoF.
    """
    improved, plain = settings or ImprovedSettings(), ReachPlannerSettings()
    deviation = improved.variation_share * posture_variation(recordings) / unit_deviation(plain.stomp.waypoints)
    noise = np.clip(deviation, LEAST_NOISE, improved.most_noise)
    planning = plain.replaced(
        stomp=plain.stomp.replaced(iterations=improved.n_iterations, noise_std=tuple(noise.tolist())),
        obstacle_weight=improved.obstacle_weight,
        averaged=improved.averaged,
    )
    bounds = PostureBounds.from_recordings(recordings, model, BoundsSettings(relative=True))
    return ReachPlanner(model, weights, bounds, surroundings, planning, ShortShoulder(model))
