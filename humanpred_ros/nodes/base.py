"""What every node of the graph shares: diagnostics with readiness, and an orderly main()."""

from __future__ import annotations

import signal
import sys
from collections import Counter
from collections.abc import Callable
from types import FrameType

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from humanpred_ros import topics
from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.nodes import qos

READY = "ready"
_STATUS_PERIOD_S = 0.2
_SIGNAL_PERIOD_S = 0.1


class GraphNode(Node):
    """A node that tells on /diagnostics whether it is ready, and counts what it refused and why.

    Readiness is a matter of the graph, not of a node alone: a node is ready once the peers it cannot do
    without have been matched, so that nothing sent from then on is lost (`waiting_for`).
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.refused: Counter[str] = Counter()
        self.warnings: dict[str, str] = {}
        self.failure: HumanPredError | None = None
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.COMMAND)
        # Steady time: a paused or stepped /clock must not silence the diagnostics.
        self._status_timer = self.create_timer(
            _STATUS_PERIOD_S, self.publish_status, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def waiting_for(self) -> str:
        """Return what the node still waits for, or an empty string when it is ready."""
        return ""

    def holding_because(self) -> str:
        """Return why the node does not do its work now, although nothing is missing; empty if it does."""
        return ""

    def unmatched(self, publisher: Publisher, listener: str) -> str:
        """Return what a publisher still lacks before nothing it sends is lost; empty when it lacks nothing.

        It must be matched with every subscription the graph knows of, at least one, and `listener`, if a name
        is given, must be among their nodes: a recorder alone does not make a graph.
        """
        known = self.get_subscriptions_info_by_topic(publisher.topic_name)
        if listener and listener not in {subscription.node_name for subscription in known}:
            return f"{listener} to subscribe to {publisher.topic_name}"
        if publisher.get_subscription_count() < max(1, len(known)):
            return f"a match with the subscribers of {publisher.topic_name}"
        return ""

    def refuse(self, reason: str) -> None:
        """Count a refused input under a named reason; logged the first time only."""
        kind = reason.split(":", 1)[0]
        if not self.refused[kind]:
            self.get_logger().warning(f"refused {reason} (further ones of this kind are only counted)")
        self.refused[kind] += 1

    def warn(self, warnings: dict[str, str]) -> None:
        """Let these be the warnings that stand, by what they are about; one about something new is logged."""
        for about in warnings.keys() - self.warnings.keys():
            self.get_logger().warning(warnings[about])
        self.warnings = dict(warnings)

    def publish_status(self) -> None:
        """Publish readiness, the counts of refused inputs, and the warnings that stand."""
        waiting, holding = self.waiting_for(), self.holding_because()
        status = DiagnosticStatus(
            name=self.get_name(),
            level=DiagnosticStatus.WARN if waiting or holding or self.refused or self.warnings else DiagnosticStatus.OK,
            message=f"waiting for {waiting}" if waiting else f"holding: {holding}" if holding else READY,
            values=[
                *(KeyValue(key=f"refused/{kind}", value=str(count)) for kind, count in self.refused.items()),
                *(KeyValue(key=f"warning/{about}", value=text) for about, text in self.warnings.items()),
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def stop_with(self, error: HumanPredError) -> None:
        """End the process with this error: called from callbacks, where raising would only print a trace."""
        self.failure = error
        rclpy.try_shutdown()

    def close(self) -> None:
        """Release what must not be lost when the process ends; called once, whatever ended it."""


class _Signals:
    """Lets SIGINT and SIGTERM end the spinning between two callbacks.

    rclpy's own handlers end the context under a running callback, whose next publish then fails.
    """

    def __init__(self) -> None:
        self.came = False
        self.spinning = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        if not self.spinning:  # still loading, training or compiling: nothing to save yet
            raise KeyboardInterrupt


def run_node(make_node: Callable[[], GraphNode], arguments: list[str] | None = None) -> int:
    """Spin the node until a signal or its own end; return the process's exit status.

    Status 0 after a signal or a finished job, 2 with one line on stderr for a HumanPredError and for
    arguments that cannot be used.
    """
    node: GraphNode | None = None
    failure: HumanPredError | None = None
    signals = _Signals()
    try:
        _initialise(sys.argv if arguments is None else arguments)
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        signals.spinning = True
        while rclpy.ok() and not signals.came:
            executor.spin_once(timeout_sec=_SIGNAL_PERIOD_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except HumanPredError as error:
        failure = error
    except NameValidationException as error:
        failure = UsageError(str(error))
    finally:
        # A second Ctrl-C must not interrupt what close() saves.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if node is not None:
            failure = failure or node.failure
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    if failure is not None:
        print(f"{sys.argv[0]}: {' '.join(str(failure).split())}", file=sys.stderr)
        return 2
    return 0


def entry_point(make_node: Callable[[], GraphNode]) -> Callable[[], None]:
    """Return the function that a node's executable calls."""
    return lambda: sys.exit(run_node(make_node))


def _initialise(arguments: list[str]) -> None:
    """Start rclpy, with one-line errors for arguments it cannot read, or that nobody would read."""
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as trouble:  # the common base of rclpy's several errors about arguments
        raise UsageError(
            f"ROS arguments: {trouble}; write --ros-args -p NAME:=VALUE or --params-file FILE"
        ) from trouble
    unread = remove_ros_args(arguments)[1:]
    if unread:
        raise UsageError(f"arguments: got {' '.join(unread)}; parameters are given as --ros-args -p NAME:=VALUE")
