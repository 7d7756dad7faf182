"""Data that cannot be used lead to a counted refusal or a hold with a named reason, never to a crash."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import ArrayError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_client import NodeClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.occupancy_predictor import OccupancyPredictorNode
from humanpred_ros.nodes.run_recorder import RunRecorder
from humanpred_ros.nodes.stomp_planner import StompPlannerNode

SCENE = load_scene("face_to_face")
HUMAN = HumanModel.kinect12()
POSTURE = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q[0]
NS = conversions.NS_PER_S


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[type[Any], dict[str, str]], Any]]:
    """Return a maker of nodes on a domain of their own."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    nodes: list[Any] = []

    def make(kind: type[Any], parameters: dict[str, str]) -> Any:
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        rclpy.init(args=arguments, domain_id=free_domain_id())
        nodes.append(kind())
        return nodes[-1]

    try:
        yield make
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def posture(t_ns: int, q: np.ndarray = POSTURE, names: tuple[str, ...] = HUMAN.dof_names) -> Any:
    return conversions.joint_state(names, q, t_ns, "kinect")


def test_the_predictor_refuses_postures_by_name_and_goes_on(ros: Callable[..., Any]) -> None:
    node = ros(OccupancyPredictorNode, {"predictor": "current", "scene": "face_to_face"})
    published: list[int] = []
    unknown: list[str] = []

    def publish(message: Any) -> None:
        if message.width:
            published.append(conversions.stamp_ns(message.header.stamp))
            return
        with pytest.raises(ArrayError) as caught:
            conversions.occupancy_from_cloud(message, SCENE.grid, 0.0)
        unknown.append(str(caught.value))

    node.publisher.publish = publish
    node.on_posture(posture(1 * NS))
    spoiled = POSTURE.copy()
    spoiled[3] = np.nan
    node.on_posture(posture(1 * NS + 1, spoiled))
    node.on_posture(posture(1 * NS + 2, POSTURE[:-1], HUMAN.dof_names[:-1]))
    node.on_posture(posture(1 * NS - 5))
    node.on_posture(posture(1 * NS))
    node.on_posture(posture(1 * NS + 3))
    assert published == [1 * NS, 1 * NS + 3]
    assert dict(node.refused) == {"not finite": 1, "missing joints": 1, "stamp not increasing": 2}
    assert [text.split(":")[1].strip() for text in unknown] == ["not finite", "missing joints"]
    node.on_posture(posture(3 * NS))  # a silence longer than the restart gap: a new motion
    node.on_posture(posture(1 * NS))  # a jump back by more than that: the recording was started again
    assert published[2:] == [3 * NS, 1 * NS]
    millimetres = POSTURE.copy()
    millimetres[:3] *= 1000.0
    node.on_posture(posture(1 * NS + 9, millimetres))
    assert "in millimetres, perhaps" in unknown[-1]
    assert node.refused["units"] == 1


def cloud(t_ns: int, grid: VoxelGrid = SCENE.grid) -> Any:
    probability = np.zeros(grid.shape, dtype=np.float32)
    probability[5, 5, 5] = 0.5
    return conversions.occupancy_cloud(Occupancy(grid, probability), 0.0, t_ns)


def test_the_planner_holds_on_occupancy_it_cannot_use(ros: Callable[..., Any]) -> None:
    node = ros(StompPlannerNode, {"scene": "face_to_face", "lossless": "true", "iterations": "5"})
    decisions: list[Any] = []
    trajectories: list[Any] = []
    node.decision_publisher.publish = decisions.append
    node.trajectory_publisher.publish = trajectories.append
    node.on_occupancy(cloud(1 * NS))
    assert decisions == []  # without the arm's joints there is nothing to plan from
    assert node.refused["no arm"] == 1
    arm = conversions.joint_state(node.replanner.joint_names, SCENE.start, 1)
    arm.position[2] = np.nan
    node.on_joint_state(arm)
    assert node.arm_q is None
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names[:-1], SCENE.start[:-1], 1))
    assert node.arm_q is None
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names, SCENE.start, 1))

    node.on_occupancy(cloud(1 * NS))
    node.on_occupancy(cloud(1 * NS + NS // 5))
    assert [decision.status[0].message for decision in decisions] == ["keep", "replan"]
    spoiled = cloud(1 * NS + NS // 4)
    points = np.frombuffer(bytes(spoiled.data), dtype="<f4").copy()
    points[3] = np.nan
    spoiled.data = points.tobytes()
    node.on_occupancy(spoiled)
    assert decisions[-1].status[0].message == "hold"
    reason = {item.key: item.value for item in decisions[-1].status[0].values}["reason"]
    assert "invalid human data: not finite" in reason
    other = VoxelGrid((-2.01, -3.0, -0.4), 0.05, SCENE.grid.shape)
    node.on_occupancy(cloud(1 * NS + NS // 3, other))
    assert decisions[-1].status[0].message == "hold"
    assert node.refused["other lattice"] == 1
    node.on_occupancy(cloud(2 * NS))
    assert decisions[-1].status[0].message in ("replan", "keep")


def test_rollouts_are_kept_only_for_someone_who_looks(ros: Callable[..., Any]) -> None:
    node = ros(StompPlannerNode, {"scene": "face_to_face", "lossless": "true", "iterations": "5", "rollouts": "6"})
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names, SCENE.start, 1))
    drawn: list[Any] = []
    node.rollout_publisher.publish = drawn.append
    for t_ns in (1 * NS, 1 * NS + NS // 5):
        node.on_occupancy(cloud(t_ns))
    assert node.replanner.rollouts == {}
    assert drawn == []
    node.rollout_publisher.get_subscription_count = lambda: 1
    node.on_occupancy(cloud(1 * NS + 2 * NS // 5))
    assert {paths.shape[0] for paths in node.replanner.rollouts.values()} == {6}
    assert {marker.ns for marker in drawn[0].markers[1:]} == {f"rollouts/{name}" for name in node.replanner.rollouts}
    node.rollout_publisher.get_subscription_count = lambda: 0
    node.on_occupancy(cloud(1 * NS + 3 * NS // 5))
    assert len(drawn) == 1


@pytest.mark.parametrize("markers", [False, True])
def test_the_recorder_asks_for_markers_only_when_told_to(
    ros: Callable[..., Any], tmp_path: Path, markers: bool
) -> None:
    recorder = ros(RunRecorder, {"output": f"'{tmp_path / 'bag'}'", "markers": str(markers).lower()})
    recorder.close()
    pictures = {topics.CANDIDATES, topics.ROLLOUTS, topics.OCCUPANCY_MARKERS}
    assert pictures & recorder.inputs.keys() == (pictures if markers else set())
    assert pictures & BagReader(tmp_path / "bag").topics.keys() == (pictures if markers else set())


class RunListener(NodeClient):
    """Starts the planner and listens to what it decides and to where the arm goes.

    Attributes:
        actions: of the decisions, in order.
        rested_s: for how long the arm has been at rest, by its own stamps.
        rest_q: where the arm was last heard of, (D,).
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.actions: list[str] = []
        self.rested_s = np.inf
        self._moved_ns = 0
        node.create_subscription(
            DiagnosticArray, topics.DECISION, lambda m: self.actions.append(m.status[0].message), qos.LOSSLESS
        )
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_state, qos.SENSOR_SUBSCRIBER)
        return ()

    def _on_state(self, message: JointState) -> None:
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        if np.abs(message.velocity).max(initial=0.0) > 1e-6:
            self._moved_ns = stamp_ns
        self.rested_s = (stamp_ns - self._moved_ns) / NS
        self.rest_q = np.asarray(message.position)


def test_a_tracker_that_dies_stops_the_arm(tmp_path: Path) -> None:
    planner = {"scene": "face_to_face", "controller": "simulated_arm"}
    with RunListener(tmp_path, "stomp_planner", planner) as run:
        run.group.start("run_recorder", {"output": str(tmp_path / "bag")})
        run.group.start("simulated_arm", {"scene": "face_to_face"})
        run.group.start("occupancy_predictor", {"predictor": "current", "listener": "stomp_planner"})
        tracker = run.group.start(
            "skeleton_tracker_replay",
            {
                "trajectory": "3/2",
                "wait_for": "occupancy_predictor,stomp_planner,simulated_arm,run_recorder",
                "listener": "occupancy_predictor",
            },
        )
        run.wait(lambda: "replan" in run.actions and run.rested_s == 0.0, "the arm to move", timeout_s=60.0)
        tracker.process.kill()
        run.group.nodes.remove(tracker)
        run.wait(lambda: run.actions[-1] == "hold" and run.rested_s > 0.5, "the arm to come to rest")
        run.group.check()
    bag = BagReader(tmp_path / "bag")
    actions = [message.status[0].message for _, message in bag.decoded(topics.DECISION)]
    assert actions[-1] == "hold"
    states = [message for _, message in bag.decoded(topics.JOINT_STATES)]
    np.testing.assert_array_equal(states[-1].position, run.rest_q)
    for goal in SCENE.goals:
        assert np.abs(run.rest_q - goal.configuration).max() > 0.05
