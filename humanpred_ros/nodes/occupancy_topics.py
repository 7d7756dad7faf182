"""Occupancies on topics, in two forms: compact for whoever knows it, as a cloud of points for everyone else.

The compact form is a sensor_msgs/CompressedImage: its `format` is the text and its `data` the PNG image of
`humanpred_ros.geometry.compact_occupancy`. Both forms of an occupancy say the same, bit for bit.
"""

from __future__ import annotations

import array
import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, PointCloud2

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry import compact_occupancy
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.inputs import Input

#: How often it is looked whether somebody publishes the compact form.
_LOOK_PERIOD_S = 0.2
_SILENT_SHARE = 0.5
#: Type of each form by its topic.
FORMS: dict[str, Any] = {topics.COMPACT_OCCUPANCY: CompressedImage, topics.OCCUPANCY: PointCloud2}


def _compact(text: str, image: bytes, t_ns: int, frame_id: str) -> CompressedImage:
    message = CompressedImage(format=text)
    message.data = array.array("B", image)
    message.header.stamp = conversions.time_message(t_ns)
    message.header.frame_id = frame_id
    return message


def compact_message(occupancy: Occupancy, threshold: float, t_ns: int, frame_id: str = "world") -> CompressedImage:
    """Return the compact form of what `Occupancy.sparse(threshold)` keeps."""
    return _compact(*compact_occupancy.packed(occupancy, threshold), t_ns, frame_id)


def unknown_message(reason: str, t_ns: int, frame_id: str = "world") -> CompressedImage:
    """Return the compact form of `conversions.unknown_cloud`."""
    return _compact(f"{compact_occupancy.UNKNOWN}{reason}", b"", t_ns, frame_id)


def occupancy_of(
    message: PointCloud2 | CompressedImage, grid: VoxelGrid, t_s: float, frame_id: str = "world"
) -> Occupancy:
    """Return the occupancy of a message of either form.

    Raises:
        ArrayError: as `conversions.occupancy_from_cloud`; another frame, or as `compact_occupancy.unpacked`.
    """
    if isinstance(message, PointCloud2):
        return conversions.occupancy_from_cloud(message, grid, t_s, frame_id)
    if message.header.frame_id.lstrip("/") != frame_id:
        raise ArrayError(f"occupancy frame: wanted {frame_id!r}, got {message.header.frame_id!r}")
    return compact_occupancy.unpacked(message.format, message.data, grid, t_s)


def says_nobody(message: PointCloud2 | CompressedImage) -> bool:
    """Return whether an occupancy says that nobody is there, as whoever sees people must."""
    if isinstance(message, PointCloud2):
        return conversions.says_nobody(message)
    return bool(message.format.startswith(compact_occupancy.NOBODY))


class OccupancyPublisher:
    """Publishes both forms; clouds, which are large, only while somebody listens to them.

    Attributes:
        compact: the publisher of the compact form.
    """

    def __init__(self, node: Node, copies: int = 1) -> None:
        """Take the node, and how often the compact form of each occupancy is sent, for links that lose."""
        self._copies = copies
        self.compact = node.create_publisher(CompressedImage, topics.COMPACT_OCCUPANCY, qos.SENSOR_PUBLISHER)
        self.cloud = node.create_publisher(PointCloud2, topics.OCCUPANCY, qos.SENSOR_PUBLISHER)

    def publish(self, occupancy: Occupancy, threshold: float, t_ns: int) -> None:
        """Publish what `Occupancy.sparse(threshold)` keeps."""
        self._publish_compact(compact_message(occupancy, threshold, t_ns))
        if self.cloud.get_subscription_count():
            self.cloud.publish(conversions.occupancy_cloud(occupancy, threshold, t_ns))

    def publish_unknown(self, reason: str, t_ns: int) -> None:
        """Publish that nobody knows where people are, and why."""
        self._publish_compact(unknown_message(reason, t_ns))
        if self.cloud.get_subscription_count():
            self.cloud.publish(conversions.unknown_cloud(reason, t_ns))

    def publish_nobody(self, grid: VoxelGrid, t_ns: int) -> None:
        """Publish that nobody is there, as a tracker has said."""
        text = f"{compact_occupancy.NOBODY}{compact_occupancy.lattice_text(grid)}"
        self._publish_compact(_compact(text, b"", t_ns, "world"))
        if self.cloud.get_subscription_count():
            self.cloud.publish(conversions.nobody_cloud(t_ns))

    def _publish_compact(self, message: CompressedImage) -> None:
        for _ in range(self._copies):
            self.compact.publish(message)


class OccupancyInput:
    """Listens to the compact form, and to clouds while nobody publishes that: clouds nobody needs load a thin link."""

    def __init__(
        self,
        node: GraphNode,
        callback: Callable[..., bool | None],
        profile: QoSProfile,
        *,
        max_age_s: float = math.inf,
        raw: bool = False,
    ) -> None:
        """Take what `GraphNode.listen` takes; where `raw`, the callback is given the topic's name first."""
        self._node, self._callback, self._profile = node, callback, profile
        self._max_age_s, self._raw = max_age_s, raw
        self._last: tuple[int, type[Any], str] = (-1, object, "")
        self._cloud: Subscription | None = None
        self._compact = self._listen(topics.COMPACT_OCCUPANCY)
        self._look()
        node.create_timer(_LOOK_PERIOD_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publishers(self) -> int:
        """Return how many publishers of either form are matched."""
        clouds = self._cloud.get_publisher_count() if self._cloud is not None else 0
        return self._compact.get_publisher_count() + clouds

    @property
    def inputs(self) -> list[Input]:
        """What is listened to."""
        topics_heard = (self._node.resolve_topic_name(topic) for topic in FORMS)
        return [self._node.inputs[topic] for topic in topics_heard if topic in self._node.inputs]

    def clock(self) -> str:
        """Return by how much the publisher's clock differs from this host's; empty where it does not."""
        return next((text for heard in self.inputs if (text := heard.clock())), "")

    def silence(self) -> str:
        """Return why nothing comes, in either form; empty while something comes."""
        # What is known of people is older than the last message: when it is too old, the silence is not yet so long.
        silent = [heard for heard in self.inputs if heard.silent(time.monotonic(), _SILENT_SHARE)]
        matched = [heard for heard in silent if heard.publishers()] or silent
        return matched[0].silence(_SILENT_SHARE) if silent and len(silent) == len(self.inputs) else ""

    def _listen(self, topic: str) -> Subscription:
        def on_bytes(data: bytes, info: Any) -> bool | None:
            return self._callback(topic, data, info)

        heard = on_bytes if self._raw else self._once
        return self._node.listen(FORMS[topic], topic, heard, self._profile, max_age_s=self._max_age_s, raw=self._raw)

    def _once(self, message: PointCloud2 | CompressedImage) -> bool | None:
        """Pass a message on unless the same occupancy came before: in the other form, or as a copy."""
        stamp_ns, form = conversions.stamp_ns(message.header.stamp), type(message)
        text = "" if isinstance(message, PointCloud2) else message.format
        if self._last[0] == stamp_ns and (self._last[1] is not form or (text and self._last[2] == text)):
            return False
        self._last = stamp_ns, form, text
        return self._callback(message)

    def _look(self) -> None:
        there = self._compact.get_publisher_count() > 0
        if there and self._cloud is not None:
            self._node.destroy_subscription(self._cloud)
            self._cloud = None
            self._node.inputs.pop(self._node.resolve_topic_name(topics.OCCUPANCY), None)
        elif not there and self._cloud is None:
            self._cloud = self._listen(topics.OCCUPANCY)
