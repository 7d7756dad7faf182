"""What every node of the graph shares: diagnostics that tell the truth, and an orderly main()."""

from __future__ import annotations

import inspect
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any, cast

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException, InvalidTopicNameException, NameValidationException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from rclpy.validate_namespace import validate_namespace

from humanpred_ros import topics
from humanpred_ros.errors import HumanPredError, UsageError, one_line
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.in_process import HANDED_OVER, Link, LinkedPublisher
from humanpred_ros.nodes.inputs import Change, Input, Refusals
from humanpred_ros.nodes.lifecycle import ManagedNode
from humanpred_ros.nodes.priority import come_first

READY = "ready"
_STATUS_PERIOD_S = 0.2
_SIGNAL_PERIOD_S = 0.1
_MESSAGE_AND_TIMES = inspect.Signature(
    [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("message", "info")]
)


class GraphNode(ManagedNode):
    """A managed node that tells on /diagnostics what it does, from what, and what keeps it from doing it.

    Level: OK while the node does its work, or can do it as soon as it is asked; WARN while it waits or holds, while a
    warning stands, and for a few seconds after it refused something: this goes away by itself; also while it is not
    active; ERROR for what somebody must put right. Message: what it does, or its state while it is not active. Values:
    whether it is `ready`, then each input's age, rate and latency, what the node itself has to tell, what it refused,
    and its warnings.

    Readiness is a matter of the graph, not of a node alone: a node is ready once the peers it cannot do
    without have been matched, so that nothing sent from then on is lost (`waiting_for`).

    Attributes:
        inputs: what was subscribed to with `listen`, by the topic's full name.
        refused: how often what was refused, by kind.
        warnings: that stand, by what they are about.
        hardware_id: what the status is about, for those who group by it; the node itself unless set.
    """

    #: What is handed over in memory within the process, by full names of topics; None: nothing.
    links: dict[str, Link] | None = None
    own_process = False  #: whether threads may be put before others

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.inputs: dict[str, Input] = {}
        self._refusals = Refusals()
        self.refused = self._refusals.counts
        self.warnings: dict[str, str] = {}
        self._clock_warning = ""
        self.hardware_id = self.get_fully_qualified_name()
        self._change = Change()
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.COMMAND)
        # Steady time: a paused or stepped /clock must not silence the diagnostics.
        self._status_timer = self.create_timer(
            _STATUS_PERIOD_S, self.publish_status, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def come_first(self, threads: Iterable[int]) -> str:
        """Give threads the node's `real_time_priority`, in a process of its own; return what came of it."""
        return come_first(self.get_parameter("real_time_priority").value if self.own_process else 0, threads)

    def listen(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[..., bool | None],
        profile: QoSProfile,
        *,
        max_age_s: float = math.inf,
        raw: bool = False,
        **others: Any,
    ) -> Subscription:
        """Subscribe to an input of the node: its age, rate and latency are on /diagnostics.

        Args:
            kind: type of the messages.
            topic: name, full or relative to the node's namespace.
            callback: takes a message, or where `raw` its bytes and times; returns False for one that is not meant for
                this node, which does not count.
            profile: quality of service.
            max_age_s: once messages have come, the node cannot do its work after a longer silence.
            raw: the messages are wanted as they travel.
            others: what else `create_subscription` takes.
        """
        name = self.resolve_topic_name(topic)
        heard = self.inputs[name] = Input(name, max_age_s)

        def on_message(*came: Any) -> None:
            if not self.connected:  # what came before it was deactivated may still wait
                return
            came_s = time.monotonic()
            # As two arguments, or from the executor of events as one pair.
            message, info = came if len(came) > 1 else came[0]
            heard.came(came_s, info["source_timestamp"], info["received_timestamp"])
            if (callback(message, info) if raw else callback(message)) is not False:
                # The middleware's time of receipt: a message may have waited for the node.
                heard.handled(came_s, max(time.time_ns() - info["received_timestamp"], 0) * 1e-9)

        # So that rclpy knows that the times of a message are wanted, too.
        on_message.__signature__ = _MESSAGE_AND_TIMES  # type: ignore[attr-defined]
        if topic in HANDED_OVER and self.links is not None:
            link = self.links.setdefault(name, Link())
            link.listen(self, on_message, profile)
            heard.publishers = link.get_publisher_count
            return cast(Subscription, link)
        subscription = self.create_subscription(kind, topic, on_message, profile, raw=raw, **others)
        heard.publishers = subscription.get_publisher_count
        return subscription

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any, **others: Any) -> Any:
        publisher = super().create_publisher(msg_type, topic, qos_profile, **others)
        if topic in HANDED_OVER and self.links is not None:
            return LinkedPublisher(publisher, self, self.links.setdefault(publisher.topic_name, Link()))
        return publisher

    def waiting_for(self) -> str:
        """Return what the node still waits for, or an empty string when it is ready."""
        return ""

    def holding_because(self) -> str:
        """Return why the node does not do its work now, although nothing is missing; empty if it does."""
        return ""

    def fault(self) -> str:
        """Return what somebody must put right before the node does its work again; empty if nothing."""
        return ""

    def working(self) -> str:
        """Return what the node does: `READY` until it is asked to do something."""
        return READY

    def facts(self) -> dict[str, str]:
        """Return what else the node has to tell on /diagnostics."""
        return {}

    def unmatched(self, listener: str, *publishers: Publisher) -> str:
        """Return what publishers of the same content still lack before nothing they send is lost; empty if nothing.

        Each must be matched with every subscription the graph knows of, together at least one, and the nodes that
        `listener` names, if any, must be among them: a recorder alone does not make a graph.
        """
        there: list[str] = []
        late = []
        for publisher in publishers:
            known = self.get_subscriptions_info_by_topic(publisher.topic_name)
            names = [name_of(info.node_namespace, info.node_name) for info in known]
            linked = publisher.link.listening() if isinstance(publisher, LinkedPublisher) else None
            if linked is not None:
                names.append(name_of(linked.get_namespace(), linked.get_name()))
            if publisher.get_subscription_count() < len(names):
                late.append(publisher.topic_name)
            there += names
        topics_text = " or ".join(publisher.topic_name for publisher in publishers)
        missing = [name for name in self.peers(listener) if name not in there]
        if missing:
            return f"{', '.join(missing)} to subscribe to {topics_text}"
        if late or not there:
            return f"a match with the subscribers of {' and '.join(late) or topics_text}"
        return ""

    def peers(self, text: str) -> list[str]:
        """Return the nodes that a text with commas names, as they are called on /diagnostics (`name_of`).

        Names are full, or relative to the namespace of this node: a node of that name elsewhere is another one.

        Raises:
            UsageError: what no node can be called.
        """
        try:
            words = [word.strip() for word in text.split(",") if word.strip()]
            return [expand_topic_name(word, self.get_name(), self.get_namespace()).lstrip("/") for word in words]
        except InvalidTopicNameException as trouble:
            raise UsageError(f"nodes to wait for: wanted names with commas, as stomp_planner, got {text}") from trouble

    def refuse(self, reason: str) -> None:
        """Count a refused input under a named reason; logged when a kind comes that did not come lately."""
        line = self._refusals.add(reason)
        if line:
            self.get_logger().warning(line)

    def warn(self, warnings: dict[str, str]) -> None:
        """Let these be the warnings that stand, by what they are about; one about something new is logged."""
        for about in warnings.keys() - self.warnings.keys():
            self.get_logger().warning(warnings[about])
        self.warnings = dict(warnings)

    def _warnings(self) -> dict[str, str]:
        """Return the warnings that stand, with one about the clock that differs most from this host's."""
        heard = max(self.inputs.values(), key=lambda heard: heard.clock_off_s, default=None)
        text = heard.clock() if heard is not None else ""
        if text and not self._clock_warning:
            self.get_logger().warning(text)
        self._clock_warning = text
        return {**self.warnings, **({"clock": text} if text else {})}

    def tell(self, kind: object, text: str) -> None:
        """Log what the node does, once each time its kind changes."""
        if self._change.to(kind, self.get_clock().now().nanoseconds * 1e-9):
            self.get_logger().info(one_line(text))

    def publish_status(self) -> None:
        """Publish level, state and values, as described above."""
        self.end_if_asked()
        now_s = time.monotonic()
        waiting = self.waiting_for() if self.connected else self.state
        level, message = self._state(waiting, now_s)
        values = {
            "ready": str(not waiting).lower(),
            **{
                f"input{topic}/{name}": text
                for topic, heard in self.inputs.items()
                for name, text in heard.facts(now_s).items()
            },
            **(self.facts() if self.connected else {}),
            # Copies: other threads of a node refuse, too.
            **{f"refused/{kind}": str(count) for kind, count in dict(self.refused).items()},
            **{f"warning/{about}": text for about, text in self._warnings().items()},
        }
        status = DiagnosticStatus(
            name=name_of(self.get_namespace(), self.get_name()),
            level=level,
            message=message,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=one_line(text)) for key, text in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _state(self, waiting: str, now_s: float) -> tuple[bytes, str]:
        if not self.connected:
            if self.failure is None:
                return DiagnosticStatus.WARN, self.state
            return DiagnosticStatus.ERROR, one_line(f"{self.state}: {self.failure}")
        fault, holding = self.fault(), self.holding_because()
        silent = [heard.silence() for heard in self.inputs.values() if heard.silent(now_s)]
        if fault:
            return DiagnosticStatus.ERROR, one_line(fault)
        if holding:
            return DiagnosticStatus.WARN, one_line(f"holding: {holding}")
        if waiting or silent:
            return DiagnosticStatus.WARN, f"waiting for {waiting or ', '.join(silent)}"
        fine = not (self._warnings() or self._refusals.recent())
        return DiagnosticStatus.OK if fine else DiagnosticStatus.WARN, self.working()

    def disconnect(self) -> None:
        super().disconnect()
        self.inputs.clear()
        self.warnings = {}


def name_of(namespace: str, name: str) -> str:
    """Return how a node is called on /diagnostics: by its name, in a namespace as `robot1/stomp_planner`."""
    return f"{namespace}/{name}".lstrip("/")


class _Signals:
    """Lets SIGINT and SIGTERM end the spinning between two callbacks.

    rclpy's own handlers end the context under a running callback, whose next publish then fails.
    """

    def __init__(self) -> None:
        self.came = False
        self.nodes: list[GraphNode] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        if not any(node.connected for node in self.nodes):  # loading, training, compiling: nothing to save yet
            raise KeyboardInterrupt


def run_node(make_node: Callable[[], GraphNode], arguments: list[str] | None = None) -> int:
    """Spin the node, active unless a manager makes it so, until a signal or its own end; return the exit status.

    Status 0 after a signal or a finished job, 2 with one line on stderr for a HumanPredError and for
    arguments that cannot be used.
    """
    return run_nodes(lambda: [make_node()], arguments)


def run_nodes(make_nodes: Callable[[], list[GraphNode]], arguments: list[str] | None = None) -> int:
    """Spin several nodes as `run_node` does one, each in a thread of its own, until one of them ends."""
    nodes: list[GraphNode] = []
    threads: list[threading.Thread] = []
    failure: Exception | None = None
    signals = _Signals()

    def spin(node: GraphNode, executor: Executor) -> None:
        if node is not nodes[0]:
            come_first(0, [threading.get_native_id()])
        try:
            while rclpy.ok() and not signals.came:
                _spin_once(executor, node)
        except ExternalShutdownException:
            pass
        except Exception as error:
            if node is nodes[0]:
                raise
            node.failure = error
            rclpy.try_shutdown()

    try:
        _initialise(sys.argv if arguments is None else arguments)
        nodes = signals.nodes = make_nodes()
        for node in nodes:
            node.own_process = True
        # The others first: whoever is started before its peers would wait for them.
        for node in reversed(nodes):
            if not node.managed:
                node.start()
        executors = [new_executor() for _ in nodes]  # all before one of them works: it may wake another
        for node, executor in zip(nodes, executors, strict=True):
            executor.add_node(node)
        own, *others = zip(nodes, executors, strict=True)
        threads = [threading.Thread(target=spin, args=pair, daemon=True) for pair in others]
        for thread in threads:
            thread.start()
        spin(*own)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except HumanPredError as error:
        failure = error
    except NameValidationException as error:
        failure = UsageError(str(error))
    finally:
        # A second Ctrl-C must not interrupt what close() saves.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signals.came = True
        for k, node in enumerate(nodes):
            for thread in threads[k - 1 : k] if k else ():
                thread.join()
            failure = failure or node.failure
            try:
                node.close()
            except HumanPredError as error:
                failure = failure or error
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    if failure is not None:
        with suppress(OSError):  # of a log on a full disk
            print(f"{Path(sys.argv[0]).stem}: {' '.join(str(failure).split())}", file=sys.stderr, flush=True)
        return 2
    return 0


def new_executor(context: Context | None = None) -> Executor:
    """Return rclpy's executor of events where there is one: its nodes need a third of the processor's time."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor


def _spin_once(executor: Executor, node: GraphNode) -> None:
    """Wait for something to do; an error that nobody foresaw ends a node, or leaves it inactive under a manager."""
    try:
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD_S)
    except ExternalShutdownException:
        raise
    except Exception as error:
        if not node.managed:
            raise
        node.survive(error)


def entry_point(make_node: Callable[[], GraphNode]) -> Callable[[], None]:
    """Return the function that a node's executable calls."""
    return lambda: sys.exit(run_node(make_node))


def _initialise(arguments: list[str]) -> None:
    """Start rclpy, with one-line errors for arguments it cannot read, or that nobody would read."""
    for word in arguments:
        name, _, value = word.partition(":=")
        if name.rpartition(":")[2] == "__ns":
            check_namespace(value)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as trouble:  # the common base of rclpy's several errors about arguments
        raise UsageError(
            f"ROS arguments: {trouble}; write --ros-args -p NAME:=VALUE or --params-file FILE"
        ) from trouble
    unread = remove_ros_args(arguments)[1:]
    if unread:
        raise UsageError(f"arguments: got {' '.join(unread)}; parameters are given as --ros-args -p NAME:=VALUE")


def check_namespace(namespace: str) -> None:
    """Raise UsageError for what no namespace can be called."""
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException as trouble:
        reason = str(trouble).splitlines()[0].removeprefix("Invalid namespace: ").rstrip(":")
        raise UsageError(
            f"namespace: wanted /NAME, or /NAME/NAME and so on, as /robot1, got {namespace} ({reason}); "
            "write -r __ns:=/robot1"
        ) from trouble
