"""Which trajectory the robot executes when: the one thing that changes while it works."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.timing.trajectory import TimedTrajectory, at_rest

#: Trajectories kept; at ten steps a second this is some seconds of changing movement.
_REMEMBERED = 64


class Schedule:
    """Trajectories and the times from which they are executed, the last few of them."""

    def __init__(self, q: ArrayLike, t_s: float) -> None:
        """Begin with a robot at rest at `q` (D,)."""
        rest = checked("start configuration", q, ("D",), error=PlanningError)
        self._entries = [(float(t_s), at_rest(rest, t_s))]
        self._forgotten = False

    def add(self, from_s: float, trajectory: TimedTrajectory) -> None:
        """Let `trajectory` take over at `from_s`; whatever was to take over then or later is dropped."""
        kept = [entry for entry in self._entries if entry[0] < from_s] or self._entries[:1]
        self._forgotten = self._forgotten or len(kept) >= _REMEMBERED
        self._entries = [*kept, (from_s, trajectory)][-_REMEMBERED:]

    def at(self, t_s: float) -> TimedTrajectory:
        """Return the trajectory executed at `t_s`; before the first, the robot rests where it began.

        Raises:
            PlanningError: for a time so long ago that it has been forgotten.
        """
        for from_s, trajectory in reversed(self._entries):
            if from_s <= t_s:
                return trajectory
        if self._forgotten:
            raise PlanningError(
                f"state of the robot: wanted {self._entries[0][0]:.3f} s or later, got {t_s:.3f} s; "
                "collect the decisions' trajectories to look farther back"
            )
        return self._entries[0][1]

    @property
    def last_from_s(self) -> float:
        """Time from which the newest trajectory is executed."""
        return self._entries[-1][0]

    def pieces(self, from_s: float, to_s: float) -> list[tuple[float, float, TimedTrajectory]]:
        """Return what is executed between two times: (begin, end, trajectory), in order."""
        begins = [from_s, *(begin_s for begin_s, _ in self._entries if from_s < begin_s < to_s)]
        ends = [*begins[1:], to_s]
        return [(begin_s, end_s, self.at(begin_s)) for begin_s, end_s in zip(begins, ends, strict=True)]

    def state_at(self, t_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (D,) at `t_s`."""
        if not np.isfinite(t_s):
            raise PlanningError(f"state of the robot: wanted a finite time, got {t_s}")
        return self.at(t_s).sample(t_s)
