"""Sources that wait for the graph: for every peer to be ready, and in stepped runs for every decision."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMessage

from humanpred_ros import topics
from humanpred_ros.errors import PlanningError, UsageError
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode

#: How often it is looked whether a posture is due in real time, and whether anything else is to be waited for.
_DUE_PERIOD_S, _WAIT_PERIOD_S = 0.004, 0.04


class SteppedSource(GraphNode):
    """A node that feeds the graph once its peers are ready, optionally one decision at a time.

    Subclasses implement `publish_next`, which sends the next item and calls `sent`, or `finish` when
    nothing is left.

    Attributes:
        stepped: the next item goes out only after the decision on the last one has come back.
        begun: whether feeding has begun.
        begun_s: steady time at which it began.
        finished: nothing more is to be sent.
    """

    def wait_for_graph(self, *, stepped: bool, clock: bool, peers: str, patience_s: tuple[float, float]) -> None:
        """Begin as soon as the peers are ready; the last thing a subclass does when it is activated.

        Args:
            stepped: wait for each decision.
            clock: this source publishes /clock.
            peers: comma-separated names of nodes.
            patience_s: the longest waits for readiness and for one decision.
        """
        self.stepped = stepped
        self.begun = self.finished = False
        self.begun_s = 0.0
        self._ready_timeout_s, self._decision_timeout_s = patience_s
        self._wanted = self.peers(peers)
        self._ready: set[str] = set()
        self._awaited_ns: int | None = None
        self._waiting_since_s = time.monotonic()
        self._clock_publisher = self.create_publisher(ClockMessage, topics.CLOCK, qos.COMMAND) if clock else None
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.COMMAND)
        self.listen(DiagnosticArray, topics.DECISION, self._on_decision, qos.LOSSLESS)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(_WAIT_PERIOD_S, self._poll, clock=self._steady)

    def waiting_for(self) -> str:
        return "" if self.begun else ", ".join(peer for peer in self._wanted if peer not in self._ready)

    def working(self) -> str:
        return "replaying" if self.begun else super().working()

    def begin(self) -> None:
        """Called once when everybody is ready."""

    def publish_next(self) -> None:
        """Publish the next item and call `sent`, or `finish`."""
        raise NotImplementedError

    def publish_due(self) -> None:
        """Publish what time has come for; called every few milliseconds in runs that are not stepped."""

    def arrived(self) -> None:
        """Called when the planner says the arm has arrived and rests."""

    def sent(self, stamp_ns: int) -> None:
        """Note that an item with this stamp is out and wait for the decision on it, in stepped runs."""
        self._waiting_since_s = time.monotonic()
        self._awaited_ns = stamp_ns if self.stepped else None

    def publish_clock(self, t_ns: int) -> None:
        """Publish simulated time, if this source is the clock."""
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=conversions.time_message(t_ns)))

    def finish(self, reason: str) -> None:
        """End the work: nothing more is to be sent."""
        self.finished = True
        self.get_logger().info(f"replay ends: {reason}")
        self.end()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # Whatever a peer does now: one that holds, or whose inputs are silent, waits for this node to begin.
        for status in message.status:
            ready = any(item.key == "ready" and item.value == "true" for item in status.values)
            (self._ready.add if ready else self._ready.discard)(status.name)

    def _on_decision(self, message: DiagnosticArray) -> None:
        if message.status and message.status[0].message == "arrived":
            self.arrived()
        if self.finished:
            return
        if self._awaited_ns is not None and conversions.stamp_ns(message.header.stamp) >= self._awaited_ns:
            self._awaited_ns = None
            self.publish_next()

    def _poll(self) -> None:
        if self.finished:
            return
        waited_s = time.monotonic() - self._waiting_since_s
        if not self.begun:
            waiting = self.waiting_for()
            if not waiting:
                self.begun, self.begun_s = True, time.monotonic()
                self.begin()
                if self.stepped:
                    self.publish_next()
                else:
                    self._timer.cancel()
                    self._timer = self.create_timer(_DUE_PERIOD_S, self._poll, clock=self._steady)
            elif waited_s > self._ready_timeout_s:
                self.stop_with(UsageError(f"waited {self._ready_timeout_s:.0f} s for {waiting}; is it running?"))
        elif not self.stepped:
            self.publish_due()
        elif self._awaited_ns is not None and waited_s > self._decision_timeout_s:
            self.stop_with(
                PlanningError(
                    f"wanted a decision on stamp {self._awaited_ns} ns within {self._decision_timeout_s:.0f} s, "
                    "none came; is stomp_planner running, with lossless set?"
                )
            )
