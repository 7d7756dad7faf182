"""What the arm really did in a run: decisions only say what takes over when, figures need where the arm was."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import MISSED, Decision
from humanpred_ros.planning.timing.trajectory import TimedTrajectory, at_rest
from humanpred_ros.robot.scene import Scene

#: Largest joint error at which a goal counts as reached, rad.
GOAL_TOLERANCE_RAD = 0.02


class ExecutedMotion:
    """All that an arm executed, from the trajectories of a run's decisions.

    Each takes over at its switch time, whatever was executed before; what was to take over at that time or later
    is dropped (as in `planning.schedule.Schedule`, which forgets, and this does not).
    """

    def __init__(self, q_start: ArrayLike, begin_s: float = 0.0) -> None:
        """Begin with an arm at rest at `q_start` (D,) from `begin_s` on."""
        self._begin_s = float(begin_s)
        self._from_s = [self._begin_s]
        self._trajectories = [at_rest(q_start, begin_s)]

    @classmethod
    def of(cls, q_start: ArrayLike, decisions: Iterable[Decision], begin_s: float = 0.0) -> ExecutedMotion:
        """Return what was executed of a run's decisions; those that came too late were not."""
        motion = cls(q_start, begin_s)
        for decision in decisions:
            if decision.trajectory is not None and decision.action != MISSED:
                motion.take_over(decision.t_switch_s, decision.trajectory)
        return motion

    def take_over(self, from_s: float, trajectory: TimedTrajectory) -> None:
        """Let a trajectory be executed from `from_s` on."""
        while len(self._from_s) > 1 and self._from_s[-1] >= from_s:
            self._from_s.pop()
            self._trajectories.pop()
        self._from_s.append(float(from_s))
        self._trajectories.append(trajectory)

    @property
    def begin_s(self) -> float:
        """Since when the arm rests at its start."""
        return self._begin_s

    @property
    def departure_s(self) -> float:
        """When the first trajectory that moves takes over; infinite if none does."""
        moving = (
            from_s
            for from_s, trajectory in zip(self._from_s, self._trajectories, strict=True)
            if trajectory.end_s > from_s and np.ptp(trajectory.q, axis=0).any()
        )
        return next(moving, np.inf)

    @property
    def end_s(self) -> float:
        """Since when the arm rests for good."""
        return max(self._begin_s, self._from_s[-1], self._trajectories[-1].end_s)

    @property
    def q_end(self) -> FloatArray:
        """(D,) where it rests then."""
        last: FloatArray = self._trajectories[-1].q[-1]
        return last

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return the configurations (T, D) at times (T,)."""
        which = np.clip(np.searchsorted(self._from_s, t_s, side="right") - 1, 0, None)
        q = np.empty((len(t_s), len(self.q_end)))
        for k in np.unique(which):
            q[which == k] = self._trajectories[k].sample(t_s[which == k])[0]
        return q

    def samples(self, period_s: float) -> tuple[FloatArray, FloatArray]:
        """Return times (T,) at most `period_s` apart from begin to end, all takeovers among them, and q (T, D)."""
        n = max(1, int(np.ceil((self.end_s - self._begin_s) / period_s - 1e-9)))
        even = np.linspace(self._begin_s, self.end_s, n + 1)
        t = np.unique(np.concatenate([even, self._from_s]))
        return t, self.at(t)

    def rests_since(self) -> float:
        """Return since when the configuration has been the last one: earlier than `end_s` if the end was repeated."""
        t, q = self.samples(0.01)
        moved = np.flatnonzero((np.abs(q - self.q_end) > 1e-9).any(axis=1))
        return float(t[min(moved[-1] + 1, len(t) - 1)]) if len(moved) else self._begin_s


def goal_reached(scene: Scene, q: ArrayLike) -> str | None:
    """Return the goal one of whose configurations the arm is at, None if at none."""
    for goal in scene.goals:
        if (np.abs(scene.arm.difference(q, goal.configurations)).max(axis=-1) <= GOAL_TOLERANCE_RAD).any():
            return goal.name
    return None
