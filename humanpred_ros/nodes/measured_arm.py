"""Where an arm is, from its joint states: whose they are, how late they come, and whether the arm follows."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.nodes import conversions
from humanpred_ros.nodes.inputs import Least
from humanpred_ros.planning.following import ArmFollowing, FollowingSettings

#: What comes later than this tells of the past, s.
LONGEST_DELAY_S = 0.3
#: How late messages come at least is looked for in so much time, s.
_WINDOW_S = 1.0


class Delay:
    """How late messages come, although their sender's clock may be another one.

    What the quickest of the last seconds took is the difference of the clocks, unless it is small enough to be a delay.
    """

    def __init__(self) -> None:
        self._least = Least(_WINDOW_S)

    def of(self, age_s: float, now_s: float) -> float:
        """Return the delay of a message that is `age_s` old by its stamp and came at `now_s`, on a steady clock."""
        self._least.add(age_s, now_s)
        clocks_s = min(self._least.now, self._least.before)
        return age_s if 0.0 <= clocks_s <= LONGEST_DELAY_S else age_s - clocks_s


class MeasuredArm:
    """An arm of D joints, as it was measured last.

    Attributes:
        q, v: (D,) position and velocity; `q` is None before the first joint state.
        came_s: when the newest joint state came, on the steady clock.
        late_s: how long it was under way.
        speed_known: whether `v` is the driver's word, or seen for long enough.
        following: compares it with what was commanded.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        settings: FollowingSettings,
        difference: Callable[[FloatArray, FloatArray], FloatArray],
    ) -> None:
        """Take the joints and the shorter way (D,) between two configurations."""
        self.following = ArmFollowing(joint_names, settings)
        self.q: FloatArray | None = None
        self.v: FloatArray = np.zeros(len(joint_names))
        self.came_s = time.monotonic()
        self.late_s = 0.0
        self.speed_known = False
        self._names, self._difference = joint_names, difference
        self._delay = Delay()

    def take(self, message: Any, now_ns: int) -> bool:
        """Take a joint state at a time of the node's clock; return whether it tells of now.

        Raises:
            ArrayError: as `conversions.ordered_positions`.
        """
        q = conversions.ordered_positions(message, self._names)
        v = conversions.ordered_velocities(message, self._names)
        now_s, stamp_ns = time.monotonic(), conversions.stamp_ns(message.header.stamp)
        # A stamp of zero is none.
        late_s = self._delay.of((now_ns - stamp_ns) * 1e-9, now_s) if stamp_ns else 0.0
        if late_s > LONGEST_DELAY_S:
            return False
        self.came_s, self.late_s = now_s, late_s
        if self.q is not None:
            # A driver that was restarted may count the turns of a continuous joint otherwise.
            q = self.q + self._difference(self.q, q)
        self.following.see(q, now_s)
        self.q, self.v = q, self.following.velocity if v is None else v
        self.speed_known = v is not None or self.following.known
        return True

    def sent_since(self, t_s: float) -> bool:
        """Return whether the newest joint state was sent after `t_s` on the steady clock."""
        return self.came_s - self.late_s >= t_s

    def position_now(self) -> FloatArray:
        """Return where the arm is by now (D,): it moved on while the joint state was under way, though not far."""
        assert self.q is not None
        tolerance = self.following.tolerance_rad
        return self.q + np.clip(self.late_s * self.v, -tolerance, tolerance)
