"""Predicting a reach step by step: plan again every 0.1 s beside the partner's posture of that moment (P2 III-D).

What was planned first is taken to be done until the next plan; the person then goes on from there, and what lies behind
counts for velocity, acceleration and jerk. So a prediction can react to a partner who comes in the way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.features import PADDING
from humanpred_ros.reaching.planner import PlannedReach, ReachPlanner, resampled
from humanpred_ros.reaching.reach_task import ReachTask


@dataclass(frozen=True)
class ReplanningConfig:
    """When a reach is planned again (facts section 6).

    Attributes:
        step_s: between plans.
        least_s: less than this before the end the last plan is followed.

    Raises:
        UsageError: times that are not positive.
    """

    step_s: float = 0.1
    least_s: float = 0.05

    def __post_init__(self) -> None:
        if not (self.step_s > 0.0 and self.least_s > 0.0):
            raise UsageError(f"re-planning: wanted times > 0 s, got {self.step_s} and {self.least_s}")


@dataclass(frozen=True)
class Replanned:
    """Predicts a reach by plans every 0.1 s, each beside the partner as he is then."""

    planner: ReachPlanner
    config: ReplanningConfig = field(default_factory=ReplanningConfig)

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J) at the task's stamps.

        Raises:
            HumanModelError: a task for another human.
        """
        planner, t_s = self.planner, task.t_s - task.t_s[0]
        planner.model.check_dofs(task.dof_names)
        done = np.tile(task.start, (len(t_s), 1))
        n = planner.config.stomp.waypoints
        plan: PlannedReach | None = None
        begin_s = 0.0
        for now in self.frames(t_s):
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

    def frames(self, t_s: FloatArray) -> list[int]:
        """Return the frames at which plans are made: the first of every step, but none shortly before the end.

        Args:
            t_s: (n,) stamps of the frames, the first 0.
        """
        # A frame that comes a hair before its step belongs to it.
        steps = np.arange(0.0, t_s[-1], self.config.step_s) - 1e-3 * self.config.step_s
        first = np.searchsorted(t_s, steps)
        return sorted({0, *(int(k) for k in first[t_s[-1] - t_s[first] >= self.config.least_s])})
