"""A stomp_planner in a process of its own, and a node of the test's that plays its human and its arm over DDS."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from unittest.mock import patch

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import ArrayLike, NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from humanpred_ros.experiments.processes import NodeGroup, ParameterValue, free_domain_id
from humanpred_ros.nodes import conversions, qos, topics
from humanpred_ros.occupancy.grid import Occupancy
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.scene import Scene

_SPIN_S = 0.01
_REPEAT_S = 0.05
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


class PlannerClient:
    """Use as a context manager: the process and everything of ROS end with it.

    Attributes:
        decisions, trajectories, rollouts: what came, in order; `rollouts` only after `watch_rollouts`.
        diagnostics: message and values of the planner's last status.
    """

    def __init__(self, folder: Path, scene: Scene, parameters: Mapping[str, ParameterValue]) -> None:
        self.scene, self.joint_names = scene, scene.arm.chain.joint_names
        self.decisions: list[Answer] = []
        self.trajectories: list[JointTrajectory] = []
        self.rollouts: list[MarkerArray] = []
        self.diagnostics: tuple[str, dict[str, str]] = ("", {})
        self.group = NodeGroup(folder / "logs", free_domain_id())
        self._parameters = parameters

    def __enter__(self) -> PlannerClient:
        with ExitStack() as stack:
            stack.enter_context(self.group)
            self.planner = self.group.start("stomp_planner", self._parameters)
            stack.enter_context(patch.dict(os.environ, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}))
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=self.group.domain_id)
            stack.callback(rclpy.try_shutdown, context=context)
            self._node = node = rclpy.create_node("planner_client", context=context)
            stack.callback(node.destroy_node)
            self._executor = SingleThreadedExecutor(context=context)
            stack.callback(self._executor.shutdown)
            self._executor.add_node(node)
            node.create_subscription(DiagnosticArray, topics.DECISION, self._on_decision, qos.LOSSLESS)
            node.create_subscription(JointTrajectory, topics.TRAJECTORY, self.trajectories.append, qos.LOSSLESS)
            node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.COMMAND)
            self._human = node.create_publisher(PointCloud2, topics.OCCUPANCY, qos.SENSOR_PUBLISHER)
            self._arm = node.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
            self._parameter_client = node.create_client(SetParameters, "/stomp_planner/set_parameters")
            heard = (self._human, self._arm)
            self.wait(lambda: all(publisher.get_subscription_count() for publisher in heard), "the planner to listen")
            self.wait(lambda: bool(node.get_publishers_info_by_topic(topics.DECISION)), "the planner's decisions")
            self._ends = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.__exit__(kind, value, trace)

    def wait(self, condition: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
        """Take what comes until `condition` holds; fail with `what`, or with the planner's log if it has ended."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert self.planner.running, f"the planner has ended:\n{self.planner.tail()}"
            assert time.monotonic() < until_s, f"waited {timeout_s} s for {what}:\n{self.planner.tail()}"
            self._executor.spin_once(timeout_sec=_SPIN_S)

    def send_until(self, send: Callable[[], None], condition: Callable[[], bool], what: str) -> None:
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

        self.wait(again, what)

    def now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def send_arm(self, q: ArrayLike | None = None, n_joints: int | None = None) -> None:
        """Publish the joint states of an arm at `q`, or at the scene's start; the first `n_joints` of them only."""
        positions = np.asarray(self.scene.start if q is None else q, dtype=np.float64)[:n_joints]
        self._arm.publish(conversions.joint_state(self.joint_names[:n_joints], positions, self.now_ns()))

    def settle_arm(self) -> None:
        """Let the planner know an arm at the scene's start."""
        self.send_until(self.send_arm, lambda: self.diagnostics[0] == "ready", "the planner to know the arm")

    def send_cloud(self, cloud: PointCloud2) -> None:
        self._human.publish(cloud)

    def ask(self, occupancy: Occupancy, stamp_ns: int) -> Answer:
        """Send one occupancy and return the decision on it; for planners that listen reliably."""
        n_before = len(self.decisions)
        self.send_cloud(conversions.occupancy_cloud(occupancy, 0.0, stamp_ns))
        self.wait(lambda: any(d.stamp_ns == stamp_ns for d in self.decisions[n_before:]), "a decision")
        return next(d for d in self.decisions[n_before:] if d.stamp_ns == stamp_ns)

    def refused(self, kind: str) -> int:
        """Return how often the planner says to have refused something of this kind."""
        return int(self.diagnostics[1].get(f"refused/{kind}", "0"))

    def executing(self, origin_ns: int) -> TimedTrajectory:
        """Return the trajectory sent last, in seconds after `origin_ns`."""
        return conversions.trajectory_from_message(self.trajectories[-1], self.joint_names, origin_ns)

    def set_parameter(self, name: str, value: ParameterValue) -> tuple[bool, str]:
        """Set a parameter of the planner by its service; return whether it did, and why not."""
        self.wait(self._parameter_client.service_is_ready, "the planner's parameters")
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        future = self._parameter_client.call_async(request)
        self.wait(future.done, f"the answer to {name}")
        (result,) = future.result().results
        return bool(result.successful), str(result.reason)

    def watch_rollouts(self) -> None:
        """Subscribe to the rollouts; returns when the planner has noticed."""
        node = self._node
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

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "stomp_planner":
                self.diagnostics = (status.message, {item.key: item.value for item in status.values})


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
