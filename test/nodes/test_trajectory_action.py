"""Commanding by FollowJointTrajectory, over DDS: the simulated arm's server, and the planner's side of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from humanpred_ros.errors import UsageError
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from action_msgs.msg import GoalStatus
from control_messages import control_msgs  # noqa: F401 -- a fixture
from node_client import NodeClient
from numpy.typing import ArrayLike
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory
from waiting import wait_until

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.commander import ActionCommander, OtherCommanders, TopicCommander
from humanpred_ros.nodes.trajectory_action import action_name, action_type

pytestmark = pytest.mark.usefixtures("control_msgs")
SCENE = load_scene("face_to_face")
CHAIN = SCENE.arm.chain
START = np.asarray(SCENE.start)


class ArmClient(NodeClient):
    """A simulated arm, and a node that commands it.

    Attributes:
        failures: what the commander said of trajectories that were not carried out.
        q: where the arm is.
    """

    def __init__(self, folder: Path, **parameters: Any) -> None:
        super().__init__(folder, "simulated_arm", {"scene": "face_to_face", "path_tolerance_rad": 0.05, **parameters})
        self.failures: list[str] = []
        self.q = START

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.commander = ActionCommander(node, self.failures.append)
        self.by_topic = node.create_publisher(JointTrajectory, topics.TRAJECTORY, qos.COMMAND)
        self.actions = ActionClient(node, action_type(), action_name(node))
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_joints, qos.LOSSLESS)
        return (self.by_topic,)

    def connected(self, node: Node) -> bool:
        return not self.commander.waiting_for() and self.actions.server_is_ready()

    def until_at(self, q: ArrayLike) -> None:
        self.wait(lambda: np.abs(self.q - q).max() < 1e-3, f"the arm to be at {q}")

    def start_goal(self, message: JointTrajectory, feedback: Any = None, **parts: Any) -> Any:
        """Send a goal as other programs do; return its handle once it is accepted."""
        goal = action_type().Goal(trajectory=message, **parts)
        answer = self.actions.send_goal_async(goal, feedback_callback=feedback)
        self.wait(answer.done, "the answer to a goal")
        assert answer.result().accepted
        return answer.result()

    def result(self, goal: Any) -> tuple[int, Any]:
        """Return the final status of a goal and its result."""
        future = goal.get_result_async()
        self.wait(future.done, "the result of a goal")
        return future.result().status, future.result().result

    def _on_joints(self, message: JointState) -> None:
        self.q = np.asarray(message.position)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ArmClient]:
    with ArmClient(tmp_path_factory.mktemp("arm")) as client:
        yield client


@pytest.fixture
def arm(started: ArmClient) -> ArmClient:
    """An arm that is free, and at the scene's start."""
    started.set_parameter("stuck", False)
    started.result(started.start_goal(to_start()))
    started.until_at(START)
    started.failures.clear()
    return started


def motion(offset_rad: float, velocity: float = 0.5, begin: ArrayLike = START) -> JointTrajectory:
    """Return a motion of all joints to an angle from the start, which begins when it arrives."""
    path = straight(begin, START + offset_rad, 20)
    timed = time_parameterise(path, velocity, 4.0, np.zeros(len(START)))
    message = conversions.trajectory_message(CHAIN.joint_names, timed, 0)
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    return message


def to_start() -> JointTrajectory:
    """Return a motion to the start, from anywhere."""
    message = motion(0.1)
    message.points = message.points[-1:]
    message.points[0].positions, message.points[0].time_from_start.sec = list(START), 0
    return message


def test_a_goal_is_reached_with_feedback(arm: ArmClient) -> None:
    heard: list[Any] = []
    goal = arm.start_goal(motion(0.2), heard.append)
    status, result = arm.result(goal)
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
    arm.until_at(START + 0.2)
    last = heard[-1].feedback
    assert last.joint_names == list(CHAIN.joint_names)
    assert np.asarray(last.desired.positions) - last.actual.positions == pytest.approx(last.error.positions)
    assert len({tuple(f.feedback.actual.positions) for f in heard}) > 2


def test_what_is_newer_replaces_a_goal(arm: ArmClient) -> None:
    long = motion(0.5, velocity=0.05)
    first = arm.start_goal(long)
    arm.commander.send(long)
    assert arm.result(first)[0] == GoalStatus.STATUS_CANCELED
    arm.commander.send(long)
    arm.commander.send(motion(0.1))
    arm.until_at(START + 0.1)
    assert arm.failures == []  # what was replaced has not failed
    long = motion(0.5, velocity=0.05, begin=arm.q)
    arm.commander.send(long)
    third = arm.start_goal(long)
    arm.wait(lambda: bool(arm.failures), "the commander to notice that another has taken its place")
    assert "cancelled" in arm.failures[-1]
    arm.by_topic.publish(motion(-0.1, begin=arm.q))
    assert arm.result(third)[0] == GoalStatus.STATUS_CANCELED
    arm.until_at(START - 0.1)


def test_several_threads_may_send(arm: ArmClient) -> None:
    long = motion(1.0, velocity=0.05)
    with ThreadPoolExecutor(4) as pool:
        sent = [pool.submit(arm.commander.send, long) for _ in range(8)]
        arm.wait(lambda: all(future.done() for future in sent), "everything to be sent")
    arm.commander.send(motion(0.1))
    arm.until_at(START + 0.1)
    assert arm.failures == []
    assert [future.exception() for future in sent] == [None] * 8


def test_the_last_trajectory_arrives_although_the_node_ends(arm: ArmClient) -> None:
    topic = TopicCommander(arm.node)
    arm.wait(lambda: topic._publisher.get_subscription_count() > 0, "the arm to listen")
    for commander in (arm.commander, topic):
        arm.commander.send(motion(1.0, velocity=0.1, begin=arm.q))
        commander.send(motion(0.1, begin=arm.q))
        assert commander.wait_until_heard(5.0)
        arm.until_at(START + 0.1)


def test_an_arm_that_is_stuck_aborts_every_time(arm: ArmClient) -> None:
    for n in (1, 2):
        arm.set_parameter("stuck", True)
        arm.commander.send(motion(0.5))
        arm.wait(lambda n=n: len(arm.failures) == n, "the controller to abort")
        assert "path tolerance violated" in arm.failures[-1]
        assert CHAIN.joint_names[0].split("_")[0] in arm.failures[-1]
        arm.set_parameter("stuck", False)
    arm.commander.send(motion(0.1))
    arm.until_at(START + 0.1)
    assert len(arm.failures) == 2


def test_a_goal_may_bring_tolerances(arm: ArmClient) -> None:
    from control_msgs.msg import JointTolerance

    arm.set_parameter("stuck", True)
    nowhere = [JointTolerance(name=name, position=-1.0) for name in CHAIN.joint_names]
    near = [JointTolerance(name=CHAIN.joint_names[2], position=0.01)]
    goal = arm.start_goal(motion(0.1), path_tolerance=nowhere, goal_tolerance=near)
    goal.cancel_goal_async()  # without a time limit it never ends by itself
    assert arm.result(goal)[0] == GoalStatus.STATUS_CANCELED
    limit = action_type().Goal().goal_time_tolerance
    limit.nanosec = 10_000_000
    goal = arm.start_goal(motion(0.1), path_tolerance=nowhere, goal_tolerance=near, goal_time_tolerance=limit)
    status, result = arm.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.error_code == result.GOAL_TOLERANCE_VIOLATED
    assert CHAIN.joint_names[2] in result.error_string


def test_a_cancelled_goal_makes_the_arm_hold(arm: ArmClient) -> None:
    goal = arm.start_goal(motion(1.0, velocity=0.2))
    arm.wait(lambda: np.abs(arm.q - START).max() > 0.02, "the arm to move")
    goal.cancel_goal_async()
    assert arm.result(goal)[0] == GoalStatus.STATUS_CANCELED
    arm.wait(lambda before=arm.q: arm.q is not before, "where it is")
    held = arm.q
    assert np.abs(held - START).max() < 0.5
    arm.until_at(held)


def test_a_trajectory_that_is_rejected_has_failed(arm: ArmClient) -> None:
    wrong = motion(0.1)
    wrong.joint_names[0] = "elbow"
    for n in (1, 2):
        arm.commander.send(wrong)
        arm.wait(lambda n=n: len(arm.failures) == n, "the rejection")
        assert "rejected" in arm.failures[-1]
        arm.wait(lambda n=n: arm.refused("trajectory joints") == n, "the arm to tell why")


def test_a_controller_that_goes_is_named(tmp_path: Path) -> None:
    with ArmClient(tmp_path) as arm:
        arm.commander.send(motion(1.0, velocity=0.05))
        arm.wait(lambda: np.abs(arm.q - START).max() > 0.01, "the arm to move")
        assert arm.failures == []
        arm.process.process.terminate()
        wait_until(lambda: arm.spin() or bool(arm.failures), "the commander to notice")
        assert "has gone" in arm.failures[0]
        assert action_name(arm.node) in arm.commander.waiting_for()
        arm.commander.send(motion(1.0))
        wait_until(lambda: arm.spin() or len(arm.failures) == 2, "the commander to notice again")


def test_who_else_commands_is_known_by_topic_and_by_action(arm: ArmClient) -> None:
    node = arm.node
    arm.wait(lambda: OtherCommanders(node).names() == "", "the graph")
    for name, make in (
        ("by_topic", lambda other: TopicCommander(other)),
        ("by_action", lambda other: ActionCommander(other, arm.failures.append)),
    ):
        other = rclpy.create_node(name, context=node.context)
        try:
            make(other)
            arm.wait(lambda name=name: OtherCommanders(node).names() == f"/{name}", f"{name} to be found")
            seen = OtherCommanders(other)
            arm.wait(lambda seen=seen: seen.names() == "/simulated_arm_client", "the other one to see us")
        finally:
            other.destroy_node()
        arm.wait(lambda: OtherCommanders(node).names() == "", "the graph")


def test_without_control_msgs_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    monkeypatch.setitem(sys.modules, "control_msgs.action", None)
    with pytest.raises(UsageError, match=r"apt install ros-jazzy-control-msgs.*topic"):
        action_type()
