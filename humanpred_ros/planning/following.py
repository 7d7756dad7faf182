"""Is the arm where it was commanded to be? Asked at every message of its joints.

An arm in an emergency stop, one that is pushed, paused or slowed down, or a driver that was restarted does not say so:
it stands somewhere else. What is planned from where it should be is then wrong, and dangerous.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.settings import Settings, setting

#: Moments between now and the longest lag at which the commanded motion is looked at.
_MOMENTS = 9
#: Stamps are whole nanoseconds, times of rest are not.
_ROUNDING_S = 1e-6


class FollowingSettings(Settings):
    """When an arm follows its trajectory, and when it rests."""

    follow_tolerance_rad: float | tuple[float, ...] = setting(
        0.05, "an arm farther from its trajectory does not follow it; one number, or one for each joint", unit="rad",
        low=1e-4, high=1.0,
    )  # fmt: skip
    follow_lag_s: float = setting(
        0.15, "an arm may be so much later than its trajectory: what controller and messages take", unit="s",
        low=0.0, high=2.0,
    )  # fmt: skip
    rest_s: float = setting(0.2, "an arm that has not moved for so long rests", unit="s", low=0.02, high=5.0)
    rest_rad: float = setting(
        0.003, "smaller movements of a joint in that time are none", unit="rad", low=1e-6, high=0.1
    )


class ArmFollowing:
    """Compares where an arm is with where it was commanded to be.

    Attributes:
        tolerance_rad: (D,) of each joint.
        settings: as given.
        error_rad: largest distance of a joint from its trajectory in the last comparison.
    """

    def __init__(self, joint_names: tuple[str, ...], settings: FollowingSettings | None = None) -> None:
        """Take the joints of the arm, D of them.

        Raises:
            PlanningError: for another number of tolerances.
        """
        self.settings = settings or FollowingSettings()
        tolerance = np.asarray(self.settings.follow_tolerance_rad, dtype=np.float64)
        if tolerance.shape not in ((), (1,), (len(joint_names),)):
            raise PlanningError(
                f"follow_tolerance_rad: wanted one number or {len(joint_names)} of them, got {len(tolerance)}"
            )
        self.tolerance_rad: FloatArray = np.broadcast_to(tolerance, (len(joint_names),)).astype(np.float64)
        self.error_rad = 0.0
        self._names = joint_names
        self._seen: deque[tuple[float, FloatArray]] = deque()

    def see(self, q: FloatArray, t_s: float) -> None:
        """Remember where the arm was measured (D,) at `t_s`; a time set back begins anew."""
        if self._seen and t_s < self._seen[-1][0]:
            self._seen.clear()
        self._seen.append((t_s, q))
        # One older than the time of rest is kept: only then is that time covered.
        while len(self._seen) > 2 and self._seen[1][0] <= t_s - self.settings.rest_s:
            self._seen.popleft()

    def forget(self) -> None:
        """Begin anew: the arm was not looked at for some time."""
        self._seen.clear()

    @property
    def known(self) -> bool:
        """Whether the arm has been seen for long enough to tell if it rests."""
        return bool(self._seen) and self._seen[-1][0] - self._seen[0][0] >= self.settings.rest_s - _ROUNDING_S

    @property
    def at_rest(self) -> bool:
        """Whether the arm is known not to have moved for `rest_s`."""
        if not self.known:
            return False
        q = np.array([q for _, q in self._seen])
        return bool(np.ptp(q, axis=0).max() <= self.settings.rest_rad)

    @property
    def seen_s(self) -> float:
        """How long the time is in which rest is looked for, by what was seen, s."""
        return self._seen[-1][0] - self._seen[0][0] if self._seen else 0.0

    @property
    def velocity(self) -> FloatArray:
        """(D,) mean velocity in the time in which rest is looked for, rad/s."""
        if len(self._seen) < 2 or self._seen[-1][0] <= self._seen[0][0]:
            return np.zeros_like(self.tolerance_rad)
        (before_s, before), (now_s, now) = self._seen[0], self._seen[-1]
        change: FloatArray = (now - before) / (now_s - before_s)
        return change

    def trouble(
        self, commanded_at: Callable[[FloatArray], FloatArray], q: FloatArray, t_s: float, delay_s: float = 0.0
    ) -> str:
        """Return which joint is not where it was commanded to be, and by how much; empty if the arm follows.

        Args:
            commanded_at: gives the positions (T, D) that were commanded at increasing times (T,) of the same clock.
            q: (D,) where the arm was measured.
            t_s: now.
            delay_s: how long ago it was measured, at most.
        """
        commanded = commanded_at(t_s - np.linspace(self.settings.follow_lag_s + delay_s, 0.0, _MOMENTS))
        low, high = commanded.min(axis=0), commanded.max(axis=0)
        error = np.maximum(np.maximum(low - q, q - high), 0.0)
        self.error_rad = float(error.max())
        worst = int(np.argmax(error - self.tolerance_rad))
        if error[worst] <= self.tolerance_rad[worst]:
            return ""
        return (
            f"the arm does not follow: {self._names[worst]} is at {q[worst]:.3f} rad, commanded were "
            f"{low[worst]:.3f} to {high[worst]:.3f}, allowed are {self.tolerance_rad[worst]:g} rad more"
        )
