"""The running graph in 3D in a browser. It listens while somebody looks, and commands nothing."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rich.console import Console
from sensor_msgs.msg import CompressedImage, JointState, PointCloud2
from std_msgs.msg import Int16, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.human.model import HumanModel, human_named
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import check_namespace, new_executor
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.settings import setting
from humanpred_ros.viewing import recorded
from humanpred_ros.viewing.space import (
    DRAWN,
    LOOKED_AT,
    ServerSettings,
    SpaceMoment,
    SpaceView,
    as_text,
    served,
)

_FRAME_S = 1.0 / 15.0
#: What has not come for so long is not shown any more, s.
_FORGOTTEN_S = 2.0
_LOOK_PERIOD_S = 0.5
_ASKED_S = 5.0
_PATH_POINTS = 30
_GUARD = topics.GUARD_STOP.partition("/")[0]


class LiveViewSettings(ServerSettings):
    """Settings of `humanpred view live`."""

    scene: str = setting("", "scene name in config/scenes, or a YAML file; empty: the running planner's")
    human: str = setting("kinect12", "whose postures come: kinect12 or mocap23")
    operate: bool = setting(False, "let whoever sees the page pause the planner, and enable and disable its tasks")
    namespace: str = setting("", "of the robot, as /robot1")


class Graph:
    """What the graph said last, by topic; it is listened to while `looked_at`."""

    def __init__(self, node: Node, scene: Scene, human: HumanModel) -> None:
        self._node, self._scene, self._human = node, scene, human
        self._names = scene.arm.chain.joint_names
        self._came: dict[str, tuple[float, Any]] = {}
        self._subscriptions: dict[str, Any] = {}
        self._data_s = 0.0  # stamp of the arm's last joint states
        #: What could not be read, by topic.
        self.troubles: dict[str, str] = {}

    def look(self, looked_at: bool, layers: Collection[str] = tuple(DRAWN)) -> None:
        """Subscribe to what there is, of lines those of some layers, or to nothing while nobody looks."""
        wanted: dict[str, tuple[type[Any], Callable[[Any], Any], QoSProfile]] = {}
        if looked_at:
            wanted = {
                topics.JOINT_STATES: (JointState, self._arm, qos.NEWEST_ONLY),
                topics.TRAJECTORY: (JointTrajectory, self._trajectory, qos.COMMAND),
                topics.HUMAN_GOALS: (PointCloud2, _posterior, qos.NEWEST_ONLY),
                topics.DECISION: (DiagnosticArray, self._decision, qos.SENSOR_SUBSCRIBER),
                topics.SPEED_FACTOR: (Int16, lambda message: int(message.data), qos.NEWEST_ONLY),
                topics.GUARD_STOP: (String, lambda message: str(message.data), qos.COMMAND),
                topics.DIAGNOSTICS: (DiagnosticArray, self._separation, qos.SENSOR_SUBSCRIBER),
                **{DRAWN[layer]: (MarkerArray, recorded.lines_of, qos.NEWEST_ONLY) for layer in layers},
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
        track = self._came.get(topics.TRAJECTORY, (0.0, None))[1]
        if track is not None and len(track) and track.t_s[-1] > self._data_s:
            q_goal = track.q[-1]
            times = np.linspace(max(track.t_s[0], self._data_s), track.t_s[-1], _PATH_POINTS)
            path = self._scene.arm.chain.tool_pose(track.at(times))[:, :3, 3]
        return SpaceMoment(
            q_arm=fresh.get(topics.JOINT_STATES),
            q_goal=q_goal,
            tool_path_m=path,
            bodies={topic.split("/")[-2]: fresh[topic] for topic in self._bodies() if topic in fresh},
            lines={layer: fresh[topic] for layer, topic in DRAWN.items() if topic in fresh},
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
            apart = fresh.get(topics.DIAGNOSTICS, "")
            said = "".join(f", {text}" for text in (apart, stop) if text)
            parts.append(f"guard: {fresh[topics.SPEED_FACTOR]} % of the speed{said}")
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
        if found is None:
            return None
        self._data_s = 1e-9 * conversions.stamp_ns(message.header.stamp)
        return found[0]

    def _posture(self, message: JointState) -> Any:
        found = recorded.positions_of(message, self._human.dof_names)
        return None if found is None else found[0]

    def _trajectory(self, message: JointTrajectory) -> recorded.JointTrack | None:
        """Return a trajectory in data time; one without a stamp begins when it comes."""
        begun = conversions.stamp_ns(message.header.stamp)
        track = recorded.trajectory_of(message, 0 if begun else -round(1e9 * self._data_s))
        return track if track.names == self._names else None

    def _separation(self, message: DiagnosticArray) -> str | None:
        """Return what the guard says of distances; other nodes' words, and other robots', are not meant."""
        own = self._node.resolve_topic_name(_GUARD).lstrip("/")
        for status in message.status:
            told = {pair.key: pair.value for pair in status.values}
            if status.name.lstrip("/") == own and "S_p_m" in told:
                return f"{told['distance_m']} m apart, {told['S_p_m']} m needed"
        return None

    def _decision(self, message: DiagnosticArray) -> recorded.RecordedDecision:
        return recorded.decision_of(message, 0.0, 0.0)


def _posterior(message: PointCloud2) -> dict[str, float]:
    _, labels, probability = recorded.posterior_of(message)
    said = dict(zip(labels, probability.tolist(), strict=True))
    return {**said, "none of these": max(0.0, 1.0 - sum(said.values()))}


def run(settings: LiveViewSettings, console: Console) -> int:
    """Show the running graph in 3D in a browser, until Ctrl-C."""

    def tell(text: str) -> None:
        console.print(text, highlight=False)

    human = human_named(settings.human)
    namespace = f"/{settings.namespace.lstrip('/')}"
    check_namespace(namespace)
    rclpy.init(args=[])
    executor = new_executor()
    try:
        node = rclpy.create_node(f"humanpred_view_{os.getpid()}", namespace=namespace)
        executor.add_node(node)
        scene = load_scene(settings.scene or _planners_scene(node, executor))
        with served(settings, tell) as server:
            view = SpaceView(server, scene, human)
            operator = Operator(node, view, scene) if settings.operate else None
            show_graph(view, Graph(node, scene, human), executor, threading.Event(), tell, operator)
    finally:
        executor.shutdown()
        rclpy.try_shutdown()
    return 0


class Operator:
    """Buttons of the page that call the planner's services."""

    def __init__(self, node: Node, view: SpaceView, scene: Scene) -> None:
        from humanpred_ros.nodes.operator_services import service_token  # takes a planner's imports

        self._node, self._wanted = node, deque[tuple[str, Any]]()
        gui, taken = view.server.gui, set[str]()
        with gui.add_folder("planner", order=-1.5):
            for name in ("pause", "resume"):
                gui.add_button(name).on_click(partial(self._ask, name))
            for goal in scene.goals:
                token = service_token(goal.name, taken)
                taken.add(token)
                buttons = gui.add_button_group(goal.name, ("enable", "disable"))
                buttons.on_click(partial(self._ask, f"tasks/{token}/enable"))
            self._answer = gui.add_markdown("")

    def _ask(self, name: str, event: Any) -> None:
        value = getattr(event.target, "value", None)
        self._wanted.append((name, value == "enable" if isinstance(value, str) else None))

    def work(self) -> None:
        """Call what was clicked; what the planner answers is shown."""
        while self._wanted:
            name, enabled = self._wanted.popleft()
            kind = Trigger if enabled is None else SetBool
            client = self._node.create_client(kind, f"{topics.PLANNER}/{name}")
            if not client.service_is_ready() and not client.wait_for_service(_LOOK_PERIOD_S):
                self._answer.content = as_text(f"nobody offers {self._node.resolve_service_name(client.srv_name)}")
                self._node.destroy_client(client)
                continue
            request = Trigger.Request() if enabled is None else SetBool.Request(data=enabled)
            client.call_async(request).add_done_callback(self._tell)

    def _tell(self, answer: Any) -> None:
        self._answer.content = as_text(answer.result().message)


def show_graph(
    view: SpaceView,
    graph: Graph,
    executor: Executor,
    ended: threading.Event,
    tell: Callable[[str], None],
    operator: Operator | None = None,
) -> None:
    """Draw what the graph says, 15 times a second while somebody looks, until told to end."""
    gui = view.server.gui
    with gui.add_folder("time", order=-1.0):
        paused = gui.add_checkbox("pause", False)
        step = gui.add_button("step")
    steps = deque[None]()
    step.on_click(lambda _: steps.append(None))
    looked_s = drawn_s = -np.inf
    while not ended.is_set():
        now_s = time.monotonic()
        looked_at = bool(view.server.get_clients())
        if now_s - looked_s >= _LOOK_PERIOD_S:
            looked_s = now_s
            graph.look(looked_at, [layer for layer in DRAWN if view.shows(layer)])
        if looked_at and now_s - drawn_s >= _FRAME_S:
            if drawn_s < 0.0:
                tell(LOOKED_AT)
            drawn_s = now_s
            if not paused.value or steps:
                view.show(graph.moment())
            steps.clear()
        if operator is not None:
            operator.work()
        executor.spin_once(timeout_sec=_FRAME_S / 4 if looked_at else _LOOK_PERIOD_S)


def _planners_scene(node: Node, executor: Executor) -> str:
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
