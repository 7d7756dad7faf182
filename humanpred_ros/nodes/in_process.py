"""Messages that go from one node to another in the same process, in memory; to all others they go over DDS as ever."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile

from humanpred_ros import topics

if TYPE_CHECKING:
    from humanpred_ros.nodes.base import GraphNode

#: What is handed over, by relative names.
HANDED_OVER = (topics.COMPACT_OCCUPANCY,)


class Link:
    """One topic between a node that publishes it and one that listens, each in a thread of its own.

    The listener's callbacks are called by its own executor, in the order in which messages were published. As over DDS,
    as many wait as the listener's quality of service says, and older ones are dropped.

    Attributes:
        listener, publisher: the nodes; None if there is none.
    """

    def __init__(self) -> None:
        self.listener: GraphNode | None = None
        self.publisher: GraphNode | None = None
        self._waiting: deque[tuple[Any, int]] = deque()
        self._wake: Callable[[], None] = lambda: None

    def listen(self, node: GraphNode, callback: Callable[[Any, Any], None], profile: QoSProfile) -> None:
        """Let the node's executor call `callback` with each message and its times; replaces the listener before."""
        keeps_all = profile.history == HistoryPolicy.KEEP_ALL
        waiting = self._waiting = deque(maxlen=None if keeps_all else profile.depth)

        def take() -> None:
            while waiting and node.connected:
                message, put_ns = waiting.popleft()
                callback(message, {"source_timestamp": put_ns, "received_timestamp": put_ns})

        def wake() -> None:
            executor = node.executor
            if executor is not None:
                executor.create_task(take)

        self._wake = wake
        self.listener = node

    def listening(self) -> GraphNode | None:
        """Return the node that listens; None while none does, or it is not active."""
        return self.listener if self.listener is not None and self.listener.connected else None

    def put(self, message: Any) -> None:
        """Hand a message over; it must not be changed any more."""
        if self.listening() is not None:
            self._waiting.append((message, time.time_ns()))
            self._wake()

    def get_publisher_count(self) -> int:
        """Return 1 while there is a publisher that is active."""
        return int(self.publisher is not None and self.publisher.connected)


class LinkedPublisher:
    """A publisher that also hands its messages over; it publishes over DDS only while somebody else listens."""

    def __init__(self, publisher: Publisher, node: GraphNode, link: Link) -> None:
        self._publisher, self.link = publisher, link
        link.publisher = node

    def __getattr__(self, name: str) -> Any:
        return getattr(self._publisher, name)

    def publish(self, message: Any) -> None:
        """Publish a message."""
        if self._publisher.get_subscription_count():
            self._publisher.publish(message)
        self.link.put(message)

    def get_subscription_count(self) -> int:
        """Return how many listeners are matched."""
        return int(self._publisher.get_subscription_count()) + (self.link.listening() is not None)
