"""How fast the time of the trajectories runs: a controller that a guard slows down runs through them more slowly.

A factor below 1 changes no path and no trajectory, only when the arm is where. Whoever reckons in the controller's own
time is right whatever the factor does; this tells what that time is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray

#: Changes kept; at a hundred a second this is more than looking back at the arm needs.
_REMEMBERED = 128


@dataclass(frozen=True)
class Pace:
    """The controller's time as a function of the clock's: it runs at a factor of 0 to 1, which changes.

    Until the factor is changed for the first time both times are the same, bit for bit.
    """

    #: time, controller's time then, and factor since, by ascending time
    changes: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 1.0),)

    @property
    def factor(self) -> float:
        """The present one."""
        return self.changes[-1][2]

    def changed(self, t_s: float, factor: float) -> Pace:
        """Return the pace with another factor from `t_s` on; a time before the last change counts as that.

        Raises:
            PlanningError: for a factor that is not from 0 to 1, or a time that is not finite.
        """
        if not (0.0 <= factor <= 1.0 and np.isfinite(t_s)):
            raise PlanningError(f"speed factor: wanted 0 to 1 at a finite time, got {factor} at {t_s} s")
        if factor == self.factor:
            return self
        t_s = max(t_s, self.changes[-1][0]) if len(self.changes) > 1 else t_s
        return Pace((*self.changes, (t_s, float(self.progress(t_s)), factor))[-_REMEMBERED:])

    def progress(self, t_s: ArrayLike) -> FloatArray:
        """Return the controller's time (...) at times (...); to come, it runs at the present factor."""
        begin, progress, factor = np.array(self.changes).T
        t = np.asarray(t_s, dtype=np.float64)
        k = np.maximum(np.searchsorted(begin, t, side="right") - 1, 0)
        found: FloatArray = progress[k] + (t - begin[k]) * factor[k]
        return found

    def reached_s(self, progress_s: float) -> float:
        """Return when the controller's time is `progress_s` (NaN for NaN); infinite if it never is at this factor."""
        begin_s, at_s, factor = next(
            (change for change in reversed(self.changes) if change[1] <= progress_s), self.changes[0]
        )
        if factor == 0.0:
            return begin_s if progress_s <= at_s else float("inf")
        return begin_s + (progress_s - at_s) / factor
