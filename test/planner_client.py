"""A stomp_planner in a process of its own, and a node of the test's that plays its human and its arm over DDS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from node_client import NodeClient
from numpy.typing import ArrayLike, NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState, PointCloud2
from sent_trajectories import trajectory_from_message
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.evaluation.processes import ParameterValue
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.trajectory_controller import TrajectoryController
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.scene import Scene

NS = conversions.NS_PER_S


@dataclass(frozen=True)
class Answer:
    """A decision as it came: its action, its values, and the values of each goal by name."""

    stamp_ns: int
    action: str
    values: Mapping[str, str]
    goals: Mapping[str, Mapping[str, str]]

    @property
    def reason(self) -> str:
        return self.values["reason"]


class PlannerClient(NodeClient):
    """Use as a context manager: the process and everything of ROS end with it.

    Attributes:
        decisions, trajectories, rollouts: what came, in order; `rollouts` only after `watch_rollouts`.
        gaps_rad: how far each of the trajectories began from where the arm was when it came.
        controller: an arm that follows what it is sent; its joint states are published while `arm_runs`.
    """

    def __init__(self, folder: Path, scene: Scene, parameters: Mapping[str, ParameterValue]) -> None:
        super().__init__(folder, "stomp_planner", parameters)
        self.scene, self.joint_names = scene, scene.arm.chain.joint_names
        self.decisions: list[Answer] = []
        self.trajectories: list[JointTrajectory] = []
        self.rollouts: list[MarkerArray] = []
        self.gaps_rad: list[float] = []
        self.controller = TrajectoryController(self.joint_names, scene.start)
        self.arm_runs = False

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        node.create_subscription(DiagnosticArray, topics.DECISION, self._on_decision, qos.LOSSLESS)
        node.create_subscription(JointTrajectory, topics.TRAJECTORY, self._on_trajectory, qos.LOSSLESS)
        node.create_timer(0.02, self._move_arm)
        self._human = node.create_publisher(PointCloud2, topics.OCCUPANCY, qos.SENSOR_PUBLISHER)
        self._arm = node.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        return (self._human, self._arm)

    def connected(self, node: Node) -> bool:
        return bool(node.get_publishers_info_by_topic(topics.DECISION))

    def send_arm(self, q: ArrayLike | None = None, n_joints: int | None = None) -> None:
        """Publish the joint states of an arm at `q`, or at the scene's start; the first `n_joints` of them only."""
        positions = np.asarray(self.scene.start if q is None else q, dtype=np.float64)[:n_joints]
        self._arm.publish(conversions.joint_state(self.joint_names[:n_joints], positions, self.now_ns()))

    def settle_arm(self) -> None:
        """Let the planner know an arm at the scene's start, which from now on follows what it is sent."""
        self.arm_runs = True
        self.send_until(lambda: None, lambda: self.diagnostics[0] == "ready", "the planner to know the arm")

    def _move_arm(self) -> None:
        if self.arm_runs:
            self.controller.update(self.now_ns())
            arm = self.controller
            self._arm.publish(conversions.joint_state(self.joint_names, arm.q, self.now_ns(), v=arm.v))

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self.trajectories.append(message)
        self.controller.update(self.now_ns())
        self.gaps_rad.append(float(np.abs(np.array(message.points[0].positions) - self.controller.q).max()))
        self.controller.command(message, self.now_ns())

    def send_cloud(self, cloud: PointCloud2) -> None:
        self._human.publish(cloud)

    def ask(self, occupancy: Occupancy, stamp_ns: int) -> Answer:
        """Send one occupancy and return the decision on it; for planners that listen reliably."""
        n_before = len(self.decisions)
        self.send_cloud(conversions.occupancy_cloud(occupancy, 0.0, stamp_ns))
        self.wait(lambda: any(d.stamp_ns == stamp_ns for d in self.decisions[n_before:]), "a decision")
        return next(d for d in self.decisions[n_before:] if d.stamp_ns == stamp_ns)

    def executing(self, origin_ns: int) -> TimedTrajectory:
        """Return the trajectory sent last, in seconds after `origin_ns`."""
        return trajectory_from_message(self.trajectories[-1], self.joint_names, origin_ns)

    def watch_rollouts(self) -> None:
        """Subscribe to the rollouts; returns when the planner has noticed."""
        node = self.node
        node.create_subscription(MarkerArray, topics.ROLLOUTS, self.rollouts.append, qos.MARKERS)
        self.wait(lambda: bool(node.get_publishers_info_by_topic(topics.ROLLOUTS)), "the planner's rollouts")

    def _on_decision(self, message: DiagnosticArray) -> None:
        head, *goals = message.status
        self.decisions.append(
            Answer(
                conversions.stamp_ns(message.header.stamp),
                head.message,
                {item.key: item.value for item in head.values},
                {goal.name: {item.key: item.value for item in goal.values} for goal in goals},
            )
        )


def nobody(scene: Scene) -> Occupancy:
    """Return an occupancy with a person far away from everything."""
    probability = np.zeros(scene.grid.shape, dtype=np.float32)
    probability[0, 0, 0] = 1.0
    return Occupancy(scene.grid, probability)


def somebody(scene: Scene, flat: NDArray[np.int64]) -> Occupancy:
    """Return an occupancy with a person in these voxels for certain."""
    probability = np.zeros(scene.grid.size, dtype=np.float32)
    probability[flat] = 1.0
    return Occupancy(scene.grid, probability.reshape(scene.grid.shape))


def voxels_near(scene: Scene, q: ArrayLike, distance_m: float) -> NDArray[np.int64]:
    """Return the voxels whose centres are within a distance of the arm's covering spheres at `q` (D,)."""
    spheres = scene.arm.spheres()
    centres = spheres.world_m(scene.arm.chain, np.asarray(q, dtype=np.float64)[None])[0]
    voxels = scene.grid.centres_m(np.arange(scene.grid.size))
    gap = np.full(len(voxels), np.inf)
    for centre, radius in zip(centres, spheres.radius_m, strict=True):
        np.minimum(gap, np.linalg.norm(voxels - centre, axis=1) - radius, out=gap)
    return np.flatnonzero(gap <= distance_m)


def least_gap_m(scene: Scene, trajectory: TimedTrajectory, flat: NDArray[np.int64], from_s: float) -> float:
    """Return how close the arm's covering spheres come to the centres of these voxels on its way."""
    spheres, centres = scene.arm.spheres(), scene.grid.centres_m(flat)
    t = np.linspace(from_s, max(trajectory.end_s, from_s), 200)
    world = spheres.world_m(scene.arm.chain, trajectory.sample(t)[0])
    gaps = np.linalg.norm(world[:, :, None] - centres, axis=3).min(axis=2) - spheres.radius_m
    return float(gaps.min())
