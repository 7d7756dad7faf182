"""Over DDS, a planner that commands by FollowJointTrajectory: what the controller does not carry out is a hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from control_messages import control_msgs  # noqa: F401 -- a fixture
from planner_client import PlannerClient, nobody
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from waiting import wait_until

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.trajectory_action import TrajectoryActionServer

pytestmark = pytest.mark.usefixtures("control_msgs")
SCENE = load_scene("face_to_face")
PARAMETERS = {
    "scene": "face_to_face",
    "iterations": 5,
    "waypoints": 40,
    "period_s": 0.2,
    "velocity_scale": 0.05,
    "command_by": "action",
    "follow_tolerance_rad": 0.5,  # here the controller is to notice first
    "max_arm_age_s": 10.0,  # a busy machine may keep the arm from telling where it is
}
ARM = {"scene": "face_to_face", "path_tolerance_rad": 0.03}


class Graph(PlannerClient):
    """A planner that commands a simulated arm; the test plays the human.

    Attributes:
        q, v: where the arm is, and how fast it moves.
    """

    q = v = np.zeros(0)

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.arm = self.group.start("simulated_arm", ARM)
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_joints, qos.LOSSLESS)
        return super().connect(node)

    def go_on(self, condition: Callable[[], bool], what: str) -> None:
        """Send occupancies until a condition holds."""

        def send() -> None:
            self.send_cloud(conversions.occupancy_cloud(nobody(SCENE), 0.0, self.now_ns()))

        self.send_until(send, condition, what, timeout_s=120.0)

    def until(self, action: str, reason: str = "") -> None:
        self.go_on(self.told(action, reason), f"{action}: {reason}")

    def told(self, action: str, reason: str) -> Callable[[], bool]:
        """Return a function that says whether such a decision has come since."""
        since = len(self.decisions)
        return lambda: any(d.action == action and d.reason.startswith(reason) for d in self.decisions[since:])

    def until_moving(self) -> None:
        self.until("keep")
        self.go_on(lambda: np.abs(self.v).max(initial=0.0) > 0.05, "the arm to be on its way")

    def _on_joints(self, message: JointState) -> None:
        self.q, self.v = np.asarray(message.position), np.asarray(message.velocity)


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    with Graph(tmp_path, SCENE, PARAMETERS) as client:
        client.wait(lambda: client.diagnostics[0] == "ready", "the planner to know the arm")
        yield client


def distance_to_goal(graph: Graph) -> float:
    """Return how far the arm is from the nearest configuration of a goal, rad."""
    goals = [q for goal in SCENE.goals for q in goal.configurations]
    return min(float(np.abs(SCENE.arm.difference(graph.q, q)).max()) for q in goals)


def test_an_aborted_goal_is_a_hold_every_time_and_the_arm_arrives_all_the_same(graph: Graph) -> None:
    for _ in range(2):
        graph.until_moving()
        graph.set_parameter("stuck", True, "simulated_arm")
        graph.until("hold", "the controller aborted the trajectory, path tolerance violated")
        graph.set_parameter("stuck", False, "simulated_arm")
    # Nobody but the second planner uses the topic, and it sees who uses the action.
    second = graph.group.start("stomp_planner", PARAMETERS | {"command_by": "topic"})
    graph.until("hold", "two planners: /stomp_planner commands this arm already")
    assert second.running
    second.process.terminate()
    graph.until("arrived")
    assert graph.trajectories == []
    assert distance_to_goal(graph) < 0.02


def test_a_planner_that_ends_stops_the_arm(graph: Graph) -> None:
    graph.until_moving()
    graph.process.process.terminate()
    wait_until(lambda: graph.spin() or not graph.process.running, "the planner to end")
    seen = graph.q
    wait_until(lambda: graph.spin() or np.abs(graph.v).max() == 0.0, "the arm to rest")
    assert np.abs(graph.q - seen).max() < 0.2
    assert distance_to_goal(graph) > 0.2  # the motion would have gone on


def test_a_controller_that_goes_is_a_hold(graph: Graph) -> None:
    graph.until_moving()
    graph.arm.process.terminate()
    graph.until("hold", "the controller has gone")
    graph.group.start("simulated_arm", ARM)
    graph.until_moving()


class OwnController(Graph):
    """A planner that commands an arm of the test's own, whose controller may be told to reject everything."""

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        node.refuse = lambda reason: None  # type: ignore[attr-defined]
        server = TrajectoryActionServer(node, self.controller)  # type: ignore[arg-type]
        node.create_timer(0.02, lambda: server.tell(self.now_ns()))
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_joints, qos.LOSSLESS)
        return PlannerClient.connect(self, node)


def test_a_rejected_goal_is_a_hold_and_the_one_before_is_cancelled(tmp_path: Path) -> None:
    with OwnController(tmp_path, SCENE, PARAMETERS) as graph:
        graph.settle_arm()
        for _ in range(2):
            graph.until_moving()
            graph.controller.joint_names = ("elbow",) * len(graph.q)
            # No people are seen any more; the stop that follows is rejected.
            graph.wait(graph.told("hold", "the controller rejected the trajectory"), "a hold")
            graph.wait(lambda: np.abs(graph.v).max() == 0.0, "the arm to rest")
            graph.controller.joint_names = graph.joint_names
