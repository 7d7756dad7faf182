"""A node in a process of its own, and a node of the test's that talks to it over DDS."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any
from unittest.mock import patch

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from humanpred_ros import topics
from humanpred_ros.evaluation.processes import NodeGroup, ParameterValue, free_domain_id
from humanpred_ros.nodes import qos

_SPIN_S = 0.01
_REPEAT_S = 0.05


class NodeClient:
    """Use as a context manager: the process and everything of ROS end with it.

    Attributes:
        diagnostics: message and values of the tested node's last status.
        level: of that status.
        group: the processes; a test may start others.
        node: the test's own.
    """

    def __init__(self, folder: Path, tested: str, parameters: Mapping[str, ParameterValue]) -> None:
        self.diagnostics: tuple[str, dict[str, str]] = ("", {})
        self.level = b""
        self.group = NodeGroup(folder / "logs", free_domain_id())
        self._tested, self._parameters = tested, parameters

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        """Subscribe and advertise; return the publishers that the tested node must be listening to."""
        return ()

    def connected(self, node: Node) -> bool:
        """Return whether everything else is there that a test needs from its first line on."""
        return True

    def __enter__(self) -> Any:
        with ExitStack() as stack:
            stack.enter_context(self.group)
            self.process = self.group.start(self._tested, self._parameters)
            stack.enter_context(patch.dict(os.environ, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}))
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=self.group.domain_id)
            stack.callback(rclpy.try_shutdown, context=context)
            self.node = node = rclpy.create_node(f"{self._tested}_client", context=context)
            stack.callback(node.destroy_node)
            self._executor = SingleThreadedExecutor(context=context)
            stack.callback(self._executor.shutdown)
            self._executor.add_node(node)
            node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.COMMAND)
            heard = self.connect(node)
            self.wait(
                lambda: all(publisher.get_subscription_count() for publisher in heard) and self.connected(node),
                f"{self._tested} to listen and speak",
                timeout_s=300.0,  # a cold cache is compiled first
            )
            self._ends = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.__exit__(kind, value, trace)

    def wait(self, condition: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
        """Take what comes until `condition` holds; fail with `what`, or with the node's log if it has ended."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert self.process.running, f"{self._tested} has ended:\n{self.process.tail()}"
            assert time.monotonic() < until_s, f"waited {timeout_s} s for {what}:\n{self.process.tail()}"
            self.spin()

    def spin(self) -> None:
        """Take what has come."""
        self._executor.spin_once(timeout_sec=_SPIN_S)

    def send_until(
        self, send: Callable[[], None], condition: Callable[[], bool], what: str, timeout_s: float = 30.0
    ) -> None:
        """Send again and again until `condition` holds: best-effort subscriptions may lose some."""
        sent_s = -np.inf

        def again() -> bool:
            nonlocal sent_s
            if condition():
                return True
            if time.monotonic() >= sent_s + _REPEAT_S:
                sent_s = time.monotonic()
                send()
            return False

        self.wait(again, what, timeout_s)

    def now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def refused(self, kind: str) -> int:
        """Return how often the node says to have refused something of this kind."""
        return int(self.diagnostics[1].get(f"refused/{kind}", "0"))

    def set_parameter(self, name: str, value: ParameterValue, node: str = "") -> tuple[bool, str]:
        """Set a parameter of the tested node, or of another, by its service; return whether it did, and why not."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.call(SetParameters, f"/{node or self._tested}/set_parameters", request).results
        return bool(result.successful), str(result.reason)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready, f"the service {name}")
        future = client.call_async(request)
        self.wait(future.done, f"the answer of {name}")
        self.node.destroy_client(client)
        return future.result()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._tested:
                self.diagnostics = (status.message, {item.key: item.value for item in status.values})
                self.level = status.level
