"""What the separation guard says, for those who obey it: a speed factor, which is also the sign that it lives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from std_msgs.msg import Int16, String

from humanpred_ros import topics
from humanpred_ros.errors import one_line
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.measured_arm import LONGEST_DELAY_S, Delay

#: A guard that has said nothing for so long is dead, hangs, or is cut off, s.
SILENCE_S = 0.3


class GuardListener:
    """Listens to the guard of a node's arm: once it was heard, or where there must be one, its silence is a stop.

    Silence is measured by arrival, on the steady clock.

    Attributes:
        factor: 0 to 1; 0 is a stop.
        reason: of the stop; empty while there is none.
        heard: whether there is a guard.
    """

    def __init__(self, node: GraphNode, required: bool, changed: Callable[[float, str], None]) -> None:
        """Take the node that obeys.

        Args:
            node: subscribes.
            required: whether there must be a guard, so that the arm stands until it is heard.
            changed: called with factor and reason when one of them has changed; not while this is made.
        """
        self._node, self._changed = node, changed
        self._topic = node.resolve_topic_name(topics.SPEED_FACTOR)
        self.heard, self.required = False, required
        self.factor, self.reason = (0.0, f"no guard: nothing has come on {self._topic} yet") if required else (
            1.0, "",
        )  # fmt: skip
        self._said, self._came_s, self._sent_s = "", -math.inf, -math.inf
        self._delay = Delay()
        node.listen(String, topics.GUARD_STOP, self._on_reason, qos.COMMAND)
        self._subscription = node.listen(
            Int16, topics.SPEED_FACTOR, self.on_factor, qos.NEWEST_ONLY, max_age_s=SILENCE_S
        )

    def look(self) -> None:
        """Find out that the guard has fallen silent; to be called every few hundredths of a second."""
        silent_s = time.monotonic() - self._came_s
        if self.heard and silent_s > SILENCE_S:
            self._take(0.0, f"guard silent: {self._topic} has not come for {SILENCE_S:g} s")

    def known_since(self, t_s: float) -> bool:
        """Return whether what is known of the guard is from after `t_s` on the steady clock, or it is silent."""
        return not self.heard or self._sent_s >= t_s or time.monotonic() - t_s > SILENCE_S

    def _on_reason(self, message: String) -> None:
        self._said = one_line(message.data)

    def on_factor(self, message: Int16) -> None:
        """Take the guard's word, unless it tells of the past: it lay unread while this process stood still."""
        now_s = time.monotonic()
        sent_ns = self._node.inputs[self._topic].sent_ns  # 0 where the middleware does not tell
        late_s = self._delay.of((time.time_ns() - sent_ns) * 1e-9, now_s) if sent_ns > 0 else 0.0
        if late_s > LONGEST_DELAY_S:
            self._node.refuse("late speed factor: it was under way for too long to tell what the guard says")
            return
        self.heard, self._came_s, self._sent_s = True, now_s, now_s - late_s
        n_guards = self._subscription.get_publisher_count()
        if n_guards > 1:
            self._take(0.0, f"two guards: {n_guards} publish {self._topic}; end all but one")
        elif not 0 <= message.data <= 100:
            reason = f"invalid speed factor: wanted 0 to 100 percent on {self._topic}, got {message.data}"
            self._node.refuse(reason)
            self._take(0.0, reason)
        elif message.data == 0:
            self._take(0.0, f"separation guard: {self._said or 'it stops the arm'}")
        else:
            self._take(message.data / 100.0, "")

    def _take(self, factor: float, reason: str) -> None:
        if (factor, reason) != (self.factor, self.reason):
            self.factor, self.reason = factor, reason
            self._changed(factor, reason)
