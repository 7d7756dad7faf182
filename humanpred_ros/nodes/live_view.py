"""The running graph in 3D in a browser. It listens while somebody looks, and commands nothing."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rich.console import Console
from sensor_msgs.msg import CompressedImage, JointState, PointCloud2
from std_msgs.msg import Int16, String
from trajectory_msgs.msg import JointTrajectory

from humanpred_ros import topics
from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.human.model import HumanModel, human_named
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import check_namespace
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.settings import setting
from humanpred_ros.viewing import recorded
from humanpred_ros.viewing.space import ServerSettings, SpaceMoment, SpaceView, served

_FRAME_S = 1.0 / 15.0
#: What has not come for so long is not shown any more, s.
_FORGOTTEN_S = 1.0
_LOOK_PERIOD_S = 0.5
_ASKED_S = 5.0
_PATH_POINTS = 30


class LiveViewSettings(ServerSettings):
    """Settings of `humanpred view live`."""

    scene: str = setting("", "scene name in config/scenes, or a YAML file; empty: the running planner's")
    human: str = setting("kinect12", "whose postures come: kinect12 or mocap23")
    namespace: str = setting("", "of the robot, as /robot1")


class Graph:
    """What the graph said last, by topic; it is listened to while `looked_at`."""

    def __init__(self, node: Node, scene: Scene, human: HumanModel) -> None:
        self._node, self._scene, self._human = node, scene, human
        self._names = scene.arm.chain.joint_names
        self._came: dict[str, tuple[float, Any]] = {}
        self._subscriptions: dict[str, Any] = {}
        #: What could not be read, by topic.
        self.troubles: dict[str, str] = {}

    def look(self, looked_at: bool) -> None:
        """Subscribe to what there is, or to nothing while nobody looks."""
        wanted: dict[str, tuple[type[Any], Callable[[Any], Any], QoSProfile]] = {}
        if looked_at:
            wanted = {
                topics.JOINT_STATES: (JointState, self._arm, qos.NEWEST_ONLY),
                topics.TRAJECTORY: (JointTrajectory, self._trajectory, qos.COMMAND),
                topics.HUMAN_GOALS: (PointCloud2, _posterior, qos.NEWEST_ONLY),
                topics.DECISION: (DiagnosticArray, self._decision, qos.SENSOR_SUBSCRIBER),
                topics.SPEED_FACTOR: (Int16, lambda message: int(message.data), qos.NEWEST_ONLY),
                topics.GUARD_STOP: (String, lambda message: str(message.data), qos.COMMAND),
                **{topic: (JointState, self._posture, qos.NEWEST_ONLY) for topic in self._bodies()},
            }
            # Clouds are large, and published only while somebody listens to them.
            compact = self._node.count_publishers(topics.COMPACT_OCCUPANCY) > 0
            topic, kind = (topics.COMPACT_OCCUPANCY, CompressedImage) if compact else (topics.OCCUPANCY, PointCloud2)
            wanted[topic] = (kind, recorded.occupied_of, qos.NEWEST_ONLY)
        for topic in self._subscriptions.keys() - wanted.keys():
            self._node.destroy_subscription(self._subscriptions.pop(topic))
            self._came.pop(topic, None)
        for topic in wanted.keys() - self._subscriptions.keys():
            kind, read, profile = wanted[topic]
            self._subscriptions[topic] = self._node.create_subscription(kind, topic, self._taker(topic, read), profile)

    def moment(self) -> SpaceMoment:
        """Return what there is now, without what has not come lately."""
        now_s = time.monotonic()
        fresh = {topic: value for topic, (came_s, value) in self._came.items() if now_s - came_s < _FORGOTTEN_S}
        occupied = fresh.get(topics.COMPACT_OCCUPANCY, fresh.get(topics.OCCUPANCY))
        centres_m, probability = occupied if occupied is not None else (np.zeros((0, 3)), np.zeros(0))
        decision = fresh.get(topics.DECISION)
        q_goal = path = None
        sent = self._came.get(topics.TRAJECTORY)
        if sent is not None:
            begin_s, track = sent[0], sent[1]
            left = track.t_s[-1] - (now_s - begin_s) if len(track) else 0.0
            if left > 0.0:
                q_goal = track.q[-1]
                times = np.linspace(track.t_s[-1] - left, track.t_s[-1], _PATH_POINTS)
                path = self._scene.arm.chain.tool_pose(track.at(np.clip(times, track.t_s[0], None)))[:, :3, 3]
        return SpaceMoment(
            q_arm=fresh.get(topics.JOINT_STATES),
            q_goal=q_goal,
            tool_path_m=path,
            bodies=[
                fresh[topic] for topic in sorted(fresh) if topic in set(self._bodies()) and fresh[topic] is not None
            ],
            centres_m=centres_m,
            probability=probability,
            posterior=fresh.get(topics.HUMAN_GOALS, {}),
            decision=decision,
            state=self._state(fresh),
        )

    def _state(self, fresh: dict[str, Any]) -> str:
        parts = []
        needed = (topics.JOINT_STATES, topics.DECISION, topics.COMPACT_OCCUPANCY)
        missing = [topic for topic in needed if topic not in fresh]
        if topics.OCCUPANCY in fresh:
            missing.remove(topics.COMPACT_OCCUPANCY)
        if missing:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            parts.append(f"waiting for {', '.join(map(self._node.resolve_topic_name, missing))} on domain {domain}")
        if topics.SPEED_FACTOR in fresh:
            stop = fresh.get(topics.GUARD_STOP) or ""
            parts.append(f"guard: {fresh[topics.SPEED_FACTOR]} % of the speed{f', {stop}' if stop else ''}")
        parts += [f"{topic}: {trouble}" for topic, trouble in self.troubles.items()]
        return "; ".join(parts)

    def _bodies(self) -> list[str]:
        """Return the topics, as they are subscribed to, on which people's postures come."""
        own = self._node.get_namespace().rstrip("/") + "/"
        found = (name.removeprefix(own) for name, _ in self._node.get_topic_names_and_types())
        first, last = topics.human_joint_states("\n").split("\n")
        return sorted(name for name in found if name.startswith(first) and name.endswith(last))

    def _taker(self, topic: str, read: Callable[[Any], Any]) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            try:
                value = read(message)
            except HumanPredError as trouble:
                self.troubles[topic] = str(trouble)
                return
            self.troubles.pop(topic, None)
            if value is not None:
                self._came[topic] = (time.monotonic(), value)

        return take

    def _arm(self, message: JointState) -> Any:
        found = recorded.positions_of(message, self._names)
        return None if found is None else found[0]

    def _posture(self, message: JointState) -> Any:
        found = recorded.positions_of(message, self._human.dof_names)
        return None if found is None else found[0]

    def _trajectory(self, message: JointTrajectory) -> recorded.JointTrack | None:
        """Return a trajectory with times from when it came on."""
        start_ns = conversions.stamp_ns(message.header.stamp)
        now_ns = self._node.get_clock().now().nanoseconds
        track = recorded.trajectory_of(message, now_ns if start_ns else 0)
        return track if track.names == self._names else None

    def _decision(self, message: DiagnosticArray) -> recorded.RecordedDecision:
        return recorded.decision_of(message, 0.0, 0.0)


def _posterior(message: PointCloud2) -> dict[str, float]:
    _, labels, probability = recorded.cloud_of(message, "class_id", "probability")
    said = {str(int(label)): float(p) for label, p in zip(np.rint(labels), probability, strict=True)}
    return {**said, "none of these": max(0.0, 1.0 - sum(said.values()))}


def run(settings: LiveViewSettings, console: Console) -> int:
    """Show the running graph in 3D in a browser, until Ctrl-C."""

    def tell(text: str) -> None:
        console.print(text, highlight=False)

    human = human_named(settings.human)
    namespace = f"/{settings.namespace.lstrip('/')}"
    check_namespace(namespace)
    rclpy.init(args=[])
    executor = SingleThreadedExecutor()
    try:
        node = rclpy.create_node(f"humanpred_view_{os.getpid()}", namespace=namespace)
        executor.add_node(node)
        scene = load_scene(settings.scene or _planners_scene(node, executor))
        with served(settings, tell) as server:
            show_graph(SpaceView(server, scene, human), Graph(node, scene, human), executor, threading.Event())
    finally:
        executor.shutdown()
        rclpy.try_shutdown()
    return 0


def show_graph(view: SpaceView, graph: Graph, executor: SingleThreadedExecutor, ended: threading.Event) -> None:
    """Draw what the graph says, 15 times a second while somebody looks, until told to end."""
    looked_s = drawn_s = -np.inf
    while not ended.is_set():
        now_s = time.monotonic()
        looked_at = bool(view.server.get_clients())
        if now_s - looked_s >= _LOOK_PERIOD_S:
            looked_s = now_s
            graph.look(looked_at)
        if looked_at and now_s - drawn_s >= _FRAME_S:
            drawn_s = now_s
            view.show(graph.moment())
        executor.spin_once(timeout_sec=_FRAME_S / 4 if looked_at else _LOOK_PERIOD_S)


def _planners_scene(node: Node, executor: SingleThreadedExecutor) -> str:
    """Return the scene of the running planner.

    Raises:
        UsageError: there is none.
    """
    client = node.create_client(GetParameters, f"{topics.PLANNER}/get_parameters")
    until_s = time.monotonic() + _ASKED_S
    answer = None
    while time.monotonic() < until_s and (answer is None or not answer.done()):
        if answer is None and client.service_is_ready():
            answer = client.call_async(GetParameters.Request(names=["scene"]))
        executor.spin_once(timeout_sec=_FRAME_S)
    node.destroy_client(client)
    if answer is None or not answer.done() or not answer.result().values:
        name = node.resolve_topic_name(topics.PLANNER)
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        raise UsageError(f"view live: wanted {name} to say its scene, it is not on domain {domain}; give --scene NAME")
    return str(answer.result().values[0].string_value)
