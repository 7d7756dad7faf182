"""How a planner commands the arm: trajectories on the controller's topic, or goals of its action."""

from __future__ import annotations

import contextlib
import math
import threading
import time
import uuid
from collections.abc import Callable
from functools import partial
from typing import Protocol

from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory
from unique_identifier_msgs.msg import UUID

from humanpred_ros import topics
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.trajectory_action import action_name, action_type

_WATCH_PERIOD_S = 0.1
#: A controller answers a goal within milliseconds; one that has not after so many looks has not got it.
_LOOKS = 20
#: Others who command the arm are looked for so long before the first command, and after it every so often, s.
_LOOK_AROUND_S, _LOOK_PERIOD_S = 4.0, 0.4
#: For so long after the first command those who are heard of may have been there before, s.
_LATE_S = 2.0
#: The result's error codes, in words.
_ERRORS = {
    0: "no error",
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "old header timestamp",
    -4: "path tolerance violated",
    -5: "goal tolerance violated",
}
_ENDS = {
    GoalStatus.STATUS_UNKNOWN: "does not know the trajectory any more",
    GoalStatus.STATUS_CANCELED: "cancelled the trajectory",
    GoalStatus.STATUS_ABORTED: "aborted the trajectory",
}


class Commander(Protocol):
    """Sends trajectories to the arm's controller; any thread may send."""

    def send(self, message: JointTrajectory) -> None:
        """Send a trajectory, which takes the place of the one sent before."""

    def waiting_for(self) -> str:
        """Return what is missing before a trajectory that is sent arrives; empty if nothing is."""

    def wait_until_heard(self, timeout_s: float) -> bool:
        """Return whether what was sent last has arrived within a time; for the end, when nobody spins the node."""


class TopicCommander:
    """Publishes trajectories on the controller's topic; what the controller does with them stays unknown."""

    def __init__(self, node: GraphNode, controller: str = "") -> None:
        """Take the node that commands, and the name of one that must be listening, if any must."""
        self._node, self._controller = node, controller
        self._publisher = node.create_publisher(JointTrajectory, topics.TRAJECTORY, qos.COMMAND)

    def send(self, message: JointTrajectory) -> None:
        self._publisher.publish(message)

    def waiting_for(self) -> str:
        return self._node.unmatched(self._controller, self._publisher)

    def wait_until_heard(self, timeout_s: float) -> bool:
        heard: bool = self._publisher.wait_for_all_acked(Duration(seconds=timeout_s))
        return heard


class ActionCommander:
    """Sends trajectories as goals of the controller's action FollowJointTrajectory.

    Speaks to the services of which an action consists: rclpy's ActionClient must not be used by several threads.
    """

    def __init__(self, node: Node, failed: Callable[[str], None]) -> None:
        """Take the node that commands, and what is called when the newest trajectory will not be carried out.

        Args:
            node: its executor's thread makes the calls.
            failed: takes the reason: the controller has rejected, aborted or cancelled the trajectory, or has not
                answered, or is gone. Trajectories replaced by newer ones cannot fail.

        Raises:
            UsageError: control_msgs is not installed.
        """
        self._node, self._failed = node, failed
        self._action, self._name = action_type(), action_name(node)
        self._services = self._action.Impl
        self._goals = node.create_client(self._services.SendGoalService, f"{self._name}/_action/send_goal")
        self._results = node.create_client(self._services.GetResultService, f"{self._name}/_action/get_result")
        self._cancels = node.create_client(CancelGoal, f"{self._name}/_action/cancel_goal")
        self._lock = threading.Lock()
        #: The answer to the newest goal that has not ended, and how often it was looked for in vain.
        self._newest: Future | None = None
        self._looks = 0
        self._taken: UUID | None = None  #: goal that was accepted last
        node.create_timer(_WATCH_PERIOD_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def send(self, message: JointTrajectory) -> None:
        goal_id = UUID(uuid=list(uuid.uuid4().bytes))
        request = self._services.SendGoalService.Request(goal_id=goal_id, goal=self._action.Goal(trajectory=message))
        with self._lock:  # the newest must also be the one that was sent last
            answer = self._newest = self._goals.call_async(request)
            self._looks = 0
        answer.add_done_callback(partial(self._on_answer, goal_id))

    def waiting_for(self) -> str:
        ready = self._goals.service_is_ready() and self._results.service_is_ready()
        return "" if ready else f"the action {self._name} of the arm's controller"

    def wait_until_heard(self, timeout_s: float) -> bool:
        answer, executor = self._newest, self._node.executor
        if answer is None or executor is None:
            return answer is None
        executor.spin_until_future_complete(answer, timeout_s)
        return bool(answer.done())

    def _on_answer(self, goal_id: UUID, answer: Future) -> None:
        if not answer.result().accepted:
            if self._taken is not None:  # a controller that rejects a goal goes on with the one before
                self._cancels.call_async(CancelGoal.Request(goal_info=GoalInfo(goal_id=self._taken)))
            self._fail(answer, "the controller rejected the trajectory; its log tells why")
            return
        self._taken = goal_id
        result = self._results.call_async(self._services.GetResultService.Request(goal_id=goal_id))
        result.add_done_callback(partial(self._on_result, answer))

    def _on_result(self, answer: Future, result: Future) -> None:
        status, outcome = result.result().status, result.result().result
        if status == GoalStatus.STATUS_SUCCEEDED:
            self._is_newest(answer)
            return
        code = _ERRORS.get(outcome.error_code, f"error {outcome.error_code}")
        said = f": {outcome.error_string}" if outcome.error_string else ""
        self._fail(answer, f"the controller {_ENDS.get(status, f'ended with status {status}')}, {code}{said}")

    def _watch(self) -> None:
        """Find out that nobody will answer: a server that has gone does not say so."""
        answer = self._newest
        if answer is None:
            return
        missing = self.waiting_for()
        if missing:
            self._fail(answer, f"the controller has gone: {missing} is not there")
        elif not answer.done():
            self._looks += 1  # counted, not timed: where this thread had no time to look, the answer may wait, too
            if self._looks > _LOOKS:
                self._fail(answer, f"the controller has not answered for {_LOOKS * _WATCH_PERIOD_S:g} s")

    def _fail(self, answer: Future, reason: str) -> None:
        if self._is_newest(answer):
            self._failed(reason)

    def _is_newest(self, answer: Future) -> bool:
        """Return whether this answers the newest goal, which then is the newest no longer: it has ended."""
        with self._lock:
            newest = self._newest is answer
            if newest:
                self._newest = None
        return newest


def commander(node: GraphNode, by: str, controller: str, failed: Callable[[str], None]) -> Commander:
    """Return what commands the arm by "topic" or "action"; the rest as the two classes want it."""
    return TopicCommander(node, controller) if by == "topic" else ActionCommander(node, failed)


class OtherCommanders:
    """Finds other nodes that command the same controller, by topic or by action.

    Nodes hear of each other within milliseconds, or, where an announcement gets lost, with the next one 3 s later: a
    node that looks too early believes itself alone.
    """

    def __init__(self, node: Node) -> None:
        """Take the node that is to be the only one."""
        self._node, self._looked_s = node, -math.inf
        self._there_s, self._began_s = time.monotonic(), -math.inf

    def looking(self) -> bool:
        """Return whether the others may not have been heard of yet."""
        return time.monotonic() - self._there_s < _LOOK_AROUND_S

    def begin(self) -> None:
        """Take note that the node begins to command."""
        self._began_s = time.monotonic()

    def late(self) -> str:
        """Return the names of those who were heard of just after this node began; older ones would have been before.

        Somebody who is heard of later has come later, and it is for them to refuse.
        """
        now_s = time.monotonic()
        if now_s - self._began_s > _LATE_S or now_s - self._looked_s < _LOOK_PERIOD_S:
            return ""
        self._looked_s = now_s
        return self.names()

    def names(self) -> str:
        """Return the names of all; empty if there are none."""
        node = self._node
        topic, service = node.resolve_topic_name(topics.TRAJECTORY), f"{action_name(node)}/_action/send_goal"
        own = (node.get_namespace(), node.get_name())
        found = {(info.node_namespace, info.node_name) for info in node.get_publishers_info_by_topic(topic)} - {own}
        everybody = [(namespace, name) for name, namespace in node.get_node_names_and_namespaces()]
        for namespace, name in set(everybody) - {own}:
            with contextlib.suppress(NodeNameNonExistentError):  # it has gone meanwhile
                if service in dict(node.get_client_names_and_types_by_node(name, namespace)):
                    found.add((namespace, name))
        if everybody.count(own) > 1:  # the graph does not tell apart what nodes of one name do
            found.add(own)
        return ", ".join(sorted(f"{namespace.rstrip('/')}/{name}" for namespace, name in found))
