"""What a predictor of reaches is told, and what it answers: one interface for trivial, learned and planned ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording


@dataclass(frozen=True, eq=False)
class ReachTask:
    """One reach to predict: from where, to where, when, beside whom. As in P2, the predictor knows goal and duration.

    Attributes:
        name: of the recording.
        dof_names: J names.
        t_s: (n,) stamps, seconds since the reach's start, at which the prediction is wanted.
        start, goal: (J,) first and last posture; angles continuous from one to the other as the person went.
        partner: who sits beside, at the same stamps. A predictor that looks at a posture later than the moment it
            predicts at cheats.

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


class ReachPredictor(Protocol):
    """Predicts reaches; `rng` is the only source of chance."""

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J) at the task's stamps."""
        ...
