"""What lies between the nodes in `humanpred bench faults`: it passes their messages on, spoils them, and listens.

A relayed topic is published below `/wire` by the node it comes from, and under its own name from here. Messages that
are not spoilt are passed on as the bytes they came as.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Int16
from trajectory_msgs.msg import JointTrajectory

from faults.catalogue import POSTURES, WATCHED, wired
from faults.spoilt_messages import Spoil
from faults.trials import Command, Heard, TimedText
from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.processes import ParameterValue
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.priority import DDS, come_first, threads_named

_POLL_S = 0.01
_ANSWER_S = 5.0
_PRIORITY = 30
#: Of each relayed topic: type, and whether it is taken from the node that publishes it, or for the one that listens.
RELAYED: Mapping[str, tuple[Any, bool]] = {
    POSTURES: (JointState, True),
    topics.OCCUPANCY: (PointCloud2, True),
    topics.JOINT_STATES: (JointState, True),
    topics.TRAJECTORY: (JointTrajectory, False),
    topics.CLOCK: (Clock, True),
    WATCHED: (JointState, True),
}


class Wire:
    """A node of the bench's own; use as a context manager.

    Attributes:
        name: of the node.
        heard: what came, with steady times.
        arm_offset_rad: how much farther every joint is than the arm's driver says.
    """

    name = "fault_wire"

    def __init__(self, domain_id: int, joint_names: Sequence[str], relayed: Sequence[str] = ()) -> None:
        """Take the arm's joints, and the topics that are relayed, of `RELAYED`."""
        self.heard, self.arm_offset_rad = Heard(), 0.0
        self._domain_id, self._joint_names, self._relayed = domain_id, tuple(joint_names), tuple(relayed)
        self._spoil: dict[str, Spoil] = {}
        self._clients: dict[str, Any] = {}
        self._factor: Publisher | None = None

    def __enter__(self) -> Wire:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain_id)
        self._node: Node = rclpy.create_node(self.name, context=self._context)
        for topic in self._relayed:
            self._relay(topic)
        arm = wired(topics.JOINT_STATES) if topics.JOINT_STATES in self._relayed else topics.JOINT_STATES
        self._node.create_subscription(JointState, arm, self._on_arm, qos.LOSSLESS)
        self._node.create_subscription(JointTrajectory, topics.TRAJECTORY, self._on_trajectory, qos.LOSSLESS)
        self._node.create_subscription(DiagnosticArray, topics.DECISION, self._on_decision, qos.LOSSLESS)
        self._node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.LOSSLESS)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._closing = False
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing = True
        self._thread.join(_ANSWER_S)
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _spin(self) -> None:
        # Who looks on, and passes on, must not be later than those who are looked at.
        come_first(_PRIORITY, [threading.get_native_id(), *threads_named(DDS)])
        while not self._closing:
            self._executor.spin_once(timeout_sec=_POLL_S)

    def spoil(self, topic: str, how: Spoil | None) -> None:
        """Let every message of a relayed topic become those that `how` returns; None passes them on as they are."""
        if how is None:
            self._spoil.pop(topic, None)
        else:
            self._spoil[topic] = how

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Return whether a condition became true in time."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > until_s:
                return False
            time.sleep(_POLL_S)
        return True

    def set_parameter(self, node: str, name: str, value: ParameterValue) -> None:
        """Set a parameter of a node.

        Raises:
            UsageError: it did not, with its reason.
        """
        client = self._clients.setdefault(node, self._node.create_client(SetParameters, f"/{node}/set_parameters"))
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        if not self.wait(client.service_is_ready, _ANSWER_S):
            raise UsageError(f"bench faults: wanted {node} to take parameters, it does not answer; see its log")
        future = client.call_async(request)
        if not self.wait(future.done, _ANSWER_S) or not future.result().results[0].successful:
            raise UsageError(f"bench faults: wanted {node} to take {name} = {value}, it did not; see its log")

    def publish_factor(self, on: bool) -> None:
        """Publish a speed factor beside the guard's, or no longer."""
        if on:
            self._factor = self._node.create_publisher(Int16, topics.SPEED_FACTOR, qos.COMMAND)
            self._factor.publish(Int16(data=100))
        elif self._factor is not None:
            self._node.destroy_publisher(self._factor)
            self._factor = None

    def _relay(self, topic: str) -> None:
        kind, from_publisher = RELAYED[topic]
        source, target = (wired(topic), topic) if from_publisher else (topic, wired(topic))
        publisher = self._node.create_publisher(kind, target, qos.SENSOR_PUBLISHER)

        def pass_on(data: bytes) -> None:
            how = self._spoil.get(topic)
            for message in (data,) if how is None else how(deserialize_message(data, kind)):
                publisher.publish(message)

        self._node.create_subscription(kind, source, pass_on, qos.LOSSLESS, raw=True)

    def _on_arm(self, message: JointState) -> None:
        q = conversions.ordered_positions(message, self._joint_names)
        v = conversions.ordered_velocities(message, self._joint_names)
        speed = 0.0 if v is None else float(np.abs(v).max())
        stamp_s = conversions.stamp_ns(message.header.stamp) * 1e-9
        self.heard.see_arm(time.monotonic(), q + self.arm_offset_rad, speed, stamp_s)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        column = [list(message.joint_names).index(name) for name in self._joint_names]
        first = np.asarray(message.points[0].positions)[column]
        stamp_s, lasts_s = (
            conversions.stamp_ns(stamp) * 1e-9 for stamp in (message.header.stamp, message.points[-1].time_from_start)
        )
        self.heard.commands.append(Command(time.monotonic(), first, stamp_s, lasts_s))

    def _on_decision(self, message: DiagnosticArray) -> None:
        head = message.status[0]
        values = {item.key: item.value for item in head.values}
        age_s = time.time() - conversions.stamp_ns(message.header.stamp) * 1e-9
        took_ms = float(values.get("compute_ms", "nan"))
        self.heard.decisions.append(TimedText(time.monotonic(), head.message, values.get("reason", ""), age_s, took_ms))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = _texts(status.values)
            level = int.from_bytes(status.level, "little")
            text = "; ".join([status.message, *values])
            self.heard.diagnostics.append(TimedText(time.monotonic(), status.name, text, float(level)))


def _texts(values: Iterable[Any]) -> list[str]:
    return [f"{item.key} {item.value}" for item in values]
