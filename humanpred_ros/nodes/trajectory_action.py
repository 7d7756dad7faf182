"""The action FollowJointTrajectory of an arm's controller: type, name, and a server for a simulated controller."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, ServerGoalHandle
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectoryPoint

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.conversions import NS_PER_S, controller_refusal, stamp_ns, time_message
from humanpred_ros.nodes.trajectory_controller import Tolerances, TrajectoryController


def action_type() -> Any:
    """Return the type of the action.

    Raises:
        UsageError: control_msgs, which defines it, is not installed.
    """
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError as trouble:
        raise UsageError(
            "FollowJointTrajectory: wanted the package control_msgs, but Python does not find it; "
            "install it (apt install ros-jazzy-control-msgs), or command the arm by topic"
        ) from trouble
    return FollowJointTrajectory


def action_name(node: Node) -> str:
    """Return the name of the action: the controller offers it beside its topic, wherever that was remapped to."""
    return f"{node.resolve_topic_name(topics.TRAJECTORY).rpartition('/')[0]}/follow_joint_trajectory"


class TrajectoryActionServer:
    """Lets a simulated controller be commanded by goals, as joint_trajectory_controller does.

    There is one goal at a time: a newer one, or a trajectory on the topic, takes its place, and the older one ends
    as cancelled. A goal that is cancelled makes the arm hold.
    """

    def __init__(self, node: GraphNode, controller: TrajectoryController) -> None:
        """Offer the action of a node for its controller.

        Raises:
            UsageError: as `action_type`.
        """
        self._action = action_type()
        self._node, self._controller = node, controller
        self._goal: ServerGoalHandle | None = None
        ActionServer(
            node,
            self._action,
            action_name(node),
            _never_called,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )

    def replaced(self, why: str) -> None:
        """End the goal under way, if there is one, because something newer has taken its place."""
        if self._goal is not None:
            self._end(self._action.Result.INVALID_GOAL, why)

    def tell(self, now_ns: int) -> None:
        """Send feedback of the goal under way, and its result once the controller has ended it."""
        if self._goal is None:
            return
        self._goal.publish_feedback(self._feedback(now_ns))
        if self._goal.is_cancel_requested:
            self._end(self._action.Result.INVALID_GOAL, "it was cancelled")
        elif self._controller.outcome is not None:
            self._end(self._controller.outcome, self._controller.ended or "the goal is reached")

    def _on_goal(self, goal: Any) -> GoalResponse:
        now_ns = self._node.get_clock().now().nanoseconds
        refusal = controller_refusal(goal.trajectory, self._controller.joint_names, now_ns)
        if refusal:
            self._node.refuse(refusal)
        return GoalResponse.REJECT if refusal else GoalResponse.ACCEPT

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        self.replaced("a newer goal came")
        self._goal = goal
        now_ns = self._node.get_clock().now().nanoseconds
        refusal = self._controller.command(goal.request.trajectory, now_ns, self._tolerances(goal.request))
        if refusal:  # its time has run out since it was accepted
            self._end(self._action.Result.OLD_HEADER_TIMESTAMP, refusal)

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._goal is None or goal.goal_id != self._goal.goal_id:
            return CancelResponse.REJECT
        self._controller.hold()
        return CancelResponse.ACCEPT

    def _end(self, code: int, text: str) -> None:
        def finish(goal: ServerGoalHandle) -> Any:
            if code == self._action.Result.SUCCESSFUL:
                goal.succeed()
            elif code == self._action.Result.INVALID_GOAL:
                if not goal.is_cancel_requested:  # rclpy has no public way to cancel a goal nobody asked to cancel
                    goal._update_state(GoalEvent.CANCEL_GOAL)
                goal.canceled()
            else:
                goal.abort()
            return self._action.Result(error_code=code, error_string=text)

        goal, self._goal = self._goal, None
        assert goal is not None
        # Only now: rclpy's executor of events calls what waits within a goal again and again, without a pause.
        goal.execute(finish)

    def _feedback(self, now_ns: int) -> Any:
        arm = self._controller
        actual, desired = (arm.q, arm.v), (arm.wanted_q, arm.wanted_v)
        error = (desired[0] - actual[0], desired[1] - actual[1])
        feedback = self._action.Feedback(joint_names=list(arm.joint_names))
        feedback.header.stamp = time_message(now_ns)
        feedback.actual, feedback.desired, feedback.error = (_point(*part) for part in (actual, desired, error))
        return feedback

    def _tolerances(self, goal: Any) -> Tolerances:
        """Return the goal's own tolerances: above 0 its own, 0 is the controller's default, below 0 none."""
        default = self._controller.default_tolerances
        seconds = stamp_ns(goal.goal_time_tolerance) / NS_PER_S
        return Tolerances(
            self._own(default.path_rad, goal.path_tolerance),
            self._own(default.goal_rad, goal.goal_tolerance),
            max(seconds, 0.0) if seconds else default.goal_time_s,
        )

    def _own(self, default: FloatArray, given: Any) -> FloatArray:
        own = default.copy()
        for tolerance in given:
            if tolerance.name in self._controller.joint_names and tolerance.position:
                own[self._controller.joint_names.index(tolerance.name)] = max(tolerance.position, 0.0)
        return own


def _never_called(goal: ServerGoalHandle) -> Any:
    raise NotImplementedError


def _point(q: FloatArray, v: FloatArray) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(positions=np.asarray(q).tolist(), velocities=np.asarray(v).tolist())
