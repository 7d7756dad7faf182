"""What two nodes of one process hand over in memory: the newest only, to an active node, in the listener's thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2

from humanpred_ros import topics
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.base import GraphNode


class Listener(GraphNode):
    """Remembers what it hears, and in which thread."""

    profile = qos.NEWEST_ONLY

    def activate(self) -> None:
        self.heard: list[tuple[int, int]] = []
        self.listen(PointCloud2, topics.OCCUPANCY, self.on_cloud, self.profile)

    def on_cloud(self, message: PointCloud2) -> None:
        self.heard.append((message.width, threading.get_ident()))


class Speaker(GraphNode):
    """Publishes when it is told to."""

    def activate(self) -> None:
        self.publisher = self.create_publisher(PointCloud2, topics.OCCUPANCY, qos.SENSOR_PUBLISHER)


@pytest.fixture
def pair(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(domain_id=free_domain_id())
    speaker, listener = Speaker("speaker"), Listener("listener")
    speaker.links = listener.links = {}
    try:
        yield speaker, listener
    finally:
        for node in (speaker, listener):
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def spin(node: GraphNode) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin_once(timeout_sec=10.0)
    executor.remove_node(node)


@pytest.mark.parametrize(("profile", "expected"), [(qos.NEWEST_ONLY, [5]), (qos.LOSSLESS, [1, 2, 3, 4, 5])])
def test_as_many_wait_as_the_listener_wants(pair: tuple[Any, Any], profile: Any, expected: list[int]) -> None:
    speaker, listener = pair
    listener.profile = profile
    speaker.start()
    assert speaker.unmatched("listener", speaker.publisher).startswith("listener to subscribe")
    listener.start()
    assert speaker.unmatched("listener", speaker.publisher) == ""
    assert not speaker.get_subscriptions_info_by_topic(speaker.publisher.topic_name)  # nothing goes over DDS

    def publish() -> None:
        for width in range(1, 6):
            speaker.publisher.publish(PointCloud2(width=width))

    thread = threading.Thread(target=publish)
    thread.start()
    thread.join()
    while not listener.heard:
        spin(listener)
    assert listener.heard == [(width, threading.get_ident()) for width in expected]
    assert listener.inputs["/human_occupancy"].came_s is not None


def test_a_node_that_is_not_active_hears_nothing_and_is_no_match(pair: tuple[Any, Any]) -> None:
    speaker, listener = pair
    speaker.start()
    listener.start()
    listener.trigger_deactivate()
    speaker.publisher.publish(PointCloud2(width=1))
    assert speaker.unmatched("listener", speaker.publisher).startswith("listener to subscribe")
    listener.trigger_activate()
    speaker.publisher.publish(PointCloud2(width=2))
    while not listener.heard:
        spin(listener)
    assert [width for width, _ in listener.heard] == [2]
    speaker.trigger_deactivate()
    assert listener.inputs["/human_occupancy"].silence().endswith("nobody publishes it")
