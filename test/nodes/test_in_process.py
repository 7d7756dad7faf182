"""What two nodes of one process hand over in memory: the newest only, to an active node, in the listener's thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CompressedImage

from humanpred_ros import topics
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.base import GraphNode


class Listener(GraphNode):
    """Remembers what it hears, and in which thread."""

    profile = qos.NEWEST_ONLY

    def activate(self) -> None:
        self.heard: list[tuple[str, int]] = []
        self.listen(CompressedImage, topics.COMPACT_OCCUPANCY, self.on_occupancy, self.profile)

    def on_occupancy(self, message: CompressedImage) -> None:
        self.heard.append((message.format, threading.get_ident()))


class Speaker(GraphNode):
    """Publishes when it is told to."""

    def activate(self) -> None:
        self.publisher = self.create_publisher(CompressedImage, topics.COMPACT_OCCUPANCY, qos.SENSOR_PUBLISHER)


@pytest.fixture
def pair(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(domain_id=free_domain_id())
    speaker, listener = Speaker("speaker"), Listener("listener")
    speaker.links = listener.links = {}
    executor = SingleThreadedExecutor()
    executor.add_node(listener)
    try:
        yield speaker, listener
    finally:
        for node in (speaker, listener):
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def spin(node: GraphNode) -> None:
    assert node.executor is not None
    node.executor.spin_once(timeout_sec=10.0)


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
        for k in range(1, 6):
            speaker.publisher.publish(CompressedImage(format=str(k)))

    thread = threading.Thread(target=publish)
    thread.start()
    thread.join()
    while not listener.heard:
        spin(listener)
    assert listener.heard == [(str(k), threading.get_ident()) for k in expected]
    assert listener.inputs["/human_occupancy/compact"].came_s is not None


def test_a_node_that_is_not_active_hears_nothing_and_is_no_match(pair: tuple[Any, Any]) -> None:
    speaker, listener = pair
    speaker.start()
    listener.start()
    listener.trigger_deactivate()
    speaker.publisher.publish(CompressedImage(format="1"))
    assert speaker.unmatched("listener", speaker.publisher).startswith("listener to subscribe")
    listener.trigger_activate()
    speaker.publisher.publish(CompressedImage(format="2"))
    while not listener.heard:
        spin(listener)
    assert [text for text, _ in listener.heard] == ["2"]
    speaker.trigger_deactivate()
    assert listener.inputs["/human_occupancy/compact"].silence().endswith("nobody publishes it")
