"""Turns the points of a live body tracker into postures, as `skeleton_tracker_replay` publishes them."""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header, String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, HumanPredError, UsageError
from humanpred_ros.human.kinect import KinectSkeleton
from humanpred_ros.human.model import TRACKER_FRAMES, HumanModel
from humanpred_ros.human.skeleton_tracker import SkeletonTracker, TrackedPeople, TrackedPosture, TrackingSettings
from humanpred_ros.human.skeletons import load_skeleton, pose_of
from humanpred_ros.human.stamps import StampCheck, StampSettings
from humanpred_ros.human.tracker_messages import (
    READERS,
    Bodies,
    Ros4HriBody,
    SeenBodies,
    bodies_in_markers,
    seen_bodies,
)
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.frames import TrackerFrames, tf_lookup
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.markers import skeleton_markers
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import setting

#: How often it is looked for the tracker's topics, s.
_LOOK_S = 0.25
#: A body of ROS4HRI that was told of so lately is there, s.
_PRESENT_S = 0.5
_MARKER_PERIOD_NS = 100_000_000
#: Topics that are named where the wanted one does not come.
_NAMED = 8
_JOINT_STATE = "sensor_msgs/msg/JointState"
_MARKERS = "visualization_msgs/msg/MarkerArray"


class SkeletonTrackerSettings(TrackingSettings, StampSettings, NodeSettings):
    """Parameters of `skeleton_tracker`."""

    skeleton: str = setting(
        "azure_kinect",
        "which point is which: a name in config/skeletons, or a YAML file; ros4hri takes bodies with URDF",
    )
    topic: str = setting(
        "body_tracking_data",
        "of the tracker: MarkerArray, PoseArray, PointCloud2, or of zed_msgs or yolo_msgs; for ros4hri what stands "
        "before the bodies' ids, as humans/bodies",
    )
    scene: str = setting("face_to_face", "scene name in config/scenes, or a YAML file: where the tracker stands")
    tracker_frame: str = setting(
        "",
        "frame of the points; stands where the scene's tracker does, if TF does not place it; empty: the skeleton's",
    )
    tracker_pose: str = setting(
        "", "'x y z roll pitch yaw' (m, rad) of the camera (x forward, z up) there; empty: no offset, not turned"
    )
    axes: str = setting("", "where the points' x, y, z point, as 'right down forward'; empty: as the skeleton says")
    unit: str = setting("", "of the points: m, cm, mm; empty: as the skeleton says")
    leave_s: float = setting(
        0.2, "a body that the tracker's frames have not shown for so long is told to have left; lost until then",
        unit="s", low=0.0, high=10.0,
    )  # fmt: skip
    listener: str = setting("", "node that must be listening to the postures before this one is ready")


class SkeletonTrackerNode(GraphNode):
    """A posture of body_0, body_1 and so on for each body in each message.

    Points that cannot be a person's, a hand that is lost for longer than `hold_s`, stamps and frames that cannot be
    used lead to no posture, with a counted reason on /diagnostics: whoever plans then holds. A body that the frames do
    not show any more is told to have left, again and again.
    """

    def __init__(self) -> None:
        super().__init__("skeleton_tracker")

    def configure(self) -> None:
        self.settings = settings = declare(self, SkeletonTrackerSettings)
        changes: dict[str, Any] = {"unit": settings.unit} if settings.unit else {}
        if settings.axes:
            changes["axes"] = tuple(settings.axes.replace(",", " ").split())
        self.skeleton = load_skeleton(settings.skeleton, **changes)
        if self.skeleton.centred and not settings.tracker_pose:
            raise UsageError(
                f"parameter tracker_pose: wanted where the person stands, as 'x y z roll pitch yaw': the points of "
                f"{settings.skeleton} are about the body's own middle"
            )
        self.scene = load_scene(settings.scene)
        self.T_scene_camera = pose_of(settings.tracker_pose)
        self.human = HumanModel.kinect12()
        warm = SkeletonTracker("openni15")
        for t_s in (0.0, 0.1):  # what is compiled, is compiled now
            warm.update(KinectSkeleton(self.human).points(np.full(len(self.human.dof_names), t_s)), t_s)

    def activate(self) -> None:
        settings = self.settings
        self.people = TrackedPeople(self.skeleton, self.T_scene_camera, settings.part(TrackingSettings))
        frame = (settings.tracker_frame or self.skeleton.frame).lstrip("/")
        self.frames = TrackerFrames(frame, self.scene.T_world_human, tf_lookup(self))
        self.frame_id = self.scene.human_frame or TRACKER_FRAMES["kinect12"]
        self.stamps: dict[str, StampCheck] = {}
        #: Bodies of ROS4HRI by id, None until their URDF has come; and when each was told of last, steady time.
        self.hri: dict[str, Ros4HriBody | None] = {}
        self.came_s: dict[str, float] = {}
        self.last_ns = 0
        self.trouble = ""
        self.published: dict[str, tuple[Any, ...]] = {}
        #: Stamp of the last frame that showed a body, with a posture or without.
        self.shown_ns: dict[str, int] = {}
        self.said_lost: dict[str, str] = {}
        self.marked_ns: dict[str, int] = {}
        self.newest: dict[str, TrackedPosture] = {}
        self.by_bodies = settings.skeleton == "ros4hri"
        self.topic = self.resolve_topic_name(settings.topic)
        self.hardware_id = self.topic
        self.nobody = self.create_publisher(Header, topics.NOBODY, qos.SENSOR_PUBLISHER)
        self._publishers_of("body_0")
        self.create_timer(_LOOK_S, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.look()

    def _publishers_of(self, body: str) -> tuple[Any, ...]:
        """Return what speaks of a body: postures, markers, lost points, leaving; its URDF is said at the first call."""
        if body not in self.published:
            held = self.create_publisher(Bool, topics.human_held(body), qos.LATCHED)
            held.publish(Bool(data=False))
            urdf = self.create_publisher(String, topics.human_urdf(body), qos.LATCHED)
            urdf.publish(String(data=self.human.urdf))
            self.published[body] = (
                self.create_publisher(JointState, topics.human_joint_states(body), qos.SENSOR_PUBLISHER),
                self.create_publisher(MarkerArray, topics.human_markers(body), qos.MARKERS),
                self.create_publisher(String, topics.human_lost(body), qos.LATCHED),
                self.create_publisher(Header, topics.human_left(body), qos.SENSOR_PUBLISHER),
            )
        return self.published[body]

    def look(self) -> None:
        """Listen to the tracker's topics as soon as somebody publishes them: their type says how they are read."""
        if self.by_bodies:
            self._look_for_bodies()
            return
        if self.topic in self.inputs:
            return
        kinds = {info.topic_type for info in self.get_publishers_info_by_topic(self.topic)}
        if not kinds:
            return
        kind = min(kinds)
        if len(kinds) > 1 or kind not in READERS:
            self.trouble = f"{self.topic}: wanted one of {', '.join(READERS)}, got {', '.join(sorted(kinds))}"
            return
        package, _, name = kind.split("/")
        try:
            message_type = getattr(importlib.import_module(f"{package}.msg"), name)
        except ImportError:
            self.stop_with(UsageError(
                f"{self.topic} is of type {kind}, and {package} is not installed here; install it where this node runs "
                f"(ros-jazzy-{package.replace('_', '-')}), or send the points as a PointCloud2"
            ))  # fmt: skip
            return
        self.trouble = ""
        self.listen(
            message_type,
            self.settings.topic,
            partial(self.on_markers, message_type) if kind == _MARKERS else partial(self.on_message, kind),
            qos.SENSOR_SUBSCRIBER,
            max_age_s=self.settings.restart_gap_s,
            raw=kind == _MARKERS,
        )

    def _look_for_bodies(self) -> None:
        pattern = re.compile(f"{re.escape(self.topic)}/([^/]+)/joint_states")
        for topic, kinds in self.get_topic_names_and_types():
            found = pattern.fullmatch(topic)
            if not found or found[1] in self.hri or _JOINT_STATE not in kinds or not self.count_publishers(topic):
                continue
            if topic in {self.resolve_topic_name(topics.human_joint_states(own)) for own in self.published}:
                continue
            body = found[1]
            self.hri[body] = None
            self.listen(String, f"{self.topic}/{body}/urdf", partial(self._on_urdf, body), qos.LATCHED)
            self.listen(JointState, topic, partial(self._on_joint_states, body), qos.SENSOR_SUBSCRIBER)

    def _on_urdf(self, body: str, message: String) -> None:
        try:
            self.hri[body] = Ros4HriBody(body, message.data, self.skeleton)
        except HumanPredError as error:
            self.refuse(f"urdf of {body}: {error}")

    def _on_joint_states(self, body: str, message: JointState) -> None:
        told = self.hri[body]
        if told is None:
            self.refuse(f"no urdf: wanted that of {body} before its joint states")
            return
        try:
            points = told.points(list(message.name), np.asarray(message.position))
        except HumanPredError as error:
            self.refuse(str(error))
            return
        seen = SeenBodies(conversions.stamp_ns(message.header.stamp), f"body_{body}", {body: (points, None)})
        now_s = time.monotonic()
        self.came_s[body] = now_s
        self.take(seen, body, [other for other, came_s in self.came_s.items() if now_s - came_s < _PRESENT_S])

    def on_markers(self, kind: Any, data: bytes, _: object) -> None:
        """Publish the postures of markers, or refuse them with a named reason."""
        try:
            seen = bodies_in_markers(bytes(data), self.skeleton)
            if seen is None:
                seen = seen_bodies(deserialize_message(data, kind), _MARKERS, self.skeleton)
        except HumanPredError as error:
            self.refuse(str(error))
            return
        self.take(seen, "")

    def on_message(self, kind: str, message: Any) -> None:
        """Publish the postures of a message, or refuse it with a named reason."""
        try:
            seen = seen_bodies(message, kind, self.skeleton)
        except HumanPredError as error:
            self.refuse(str(error))
            return
        self.take(seen, "")

    def take(self, seen: SeenBodies, source: str, others: Sequence[str] = ()) -> None:
        """Publish the postures of what was seen at one time."""
        now_ns = self.get_clock().now().nanoseconds
        stamp_ns = seen.stamp_ns
        if stamp_ns == 0:
            stamp_ns = now_ns
            if seen.bodies:
                self.warnings["stamps"] = "the tracker does not stamp its messages: the time of arrival is taken"
        check = self.stamps.setdefault(source, StampCheck(self.settings.part(StampSettings)))
        verdict = check.judge(stamp_ns, now_ns, time.monotonic())
        if verdict.refusal:
            self.refuse(verdict.refusal)
            return
        if stamp_ns < self.last_ns - conversions.NS_PER_S:
            self.people.start()
        self.last_ns = stamp_ns
        if not seen.bodies:
            self._tell_leaving(stamp_ns)
            return
        try:
            T = self.frames.pose(seen.frame_id)
        except ArrayError as error:
            self.refuse(f"{error}; set tracker_frame to {seen.frame_id!r} if it stands where the scene's tracker does")
            return
        self.people.place(self.T_scene_camera if T is None else T, frame_axes=T is not None)
        self._publish(seen.bodies, stamp_ns, others)
        self._tell_leaving(stamp_ns)

    def _tell_leaving(self, stamp_ns: int) -> None:
        """Tell of the bodies that a frame and those before it do not show."""
        there = {body for body, shown in self.shown_ns.items() if abs(stamp_ns - shown) <= self.settings.leave_s * 1e9}
        header = Header(frame_id=self.frame_id, stamp=conversions.time_message(stamp_ns))
        if not there:
            self.nobody.publish(header)
        elif not self.by_bodies:
            for body in self.published.keys() - there:
                self.published[body][3].publish(header)
        self.newest = {body: posture for body, posture in self.newest.items() if body in there}

    def _publish(self, bodies: Bodies, stamp_ns: int, others: Sequence[str]) -> None:
        for body in self.newest:  # whose frames are their own
            if self.people.people[body].theirs in others:
                self.shown_ns[body] = stamp_ns
        for body, posture in self.people.update(bodies, stamp_ns * 1e-9, others):
            if posture.q is None:
                self.refuse(posture.refusal)
            if not body:
                continue
            self.newest[body], self.shown_ns[body] = posture, stamp_ns
            postures, markers, lost, _ = self._publishers_of(body)
            said = " ".join(dict.fromkeys((*posture.lost, *posture.held)))
            if said != self.said_lost.get(body):
                self.said_lost[body] = said
                lost.publish(String(data=said))
            if posture.q is None:
                continue
            postures.publish(conversions.joint_state(self.human.dof_names, posture.q, stamp_ns, self.frame_id))
            if markers.get_subscription_count() and stamp_ns - self.marked_ns.get(body, 0) >= _MARKER_PERIOD_NS:
                self.marked_ns[body] = stamp_ns
                where = self.human.forward(posture.q)
                markers.publish(skeleton_markers(where, self.frame_id, conversions.time_message(stamp_ns)))

    def waiting_for(self) -> str:
        if self.by_bodies:
            missing = "" if self.hri else f"{self.topic}/<id>/joint_states"
        else:
            missing = "" if self.topic in self.inputs else self.topic
        if missing:
            own = {publisher.topic_name for publisher in self.publishers}
            others = [
                f"{topic} ({kinds[0]})"
                for topic, kinds in self.get_topic_names_and_types()
                if topic not in own and READERS.keys() & kinds and self.count_publishers(topic)
            ]
            more = ", ".join(others[:_NAMED]) or "no topic of a type that holds points"
            return f"{missing}: nobody publishes it; published are {more}"
        return self.unmatched(self.settings.listener, self.published["body_0"][0])

    def fault(self) -> str:
        return self.trouble

    def working(self) -> str:
        return "tracking" if self.newest else super().working()

    def facts(self) -> dict[str, str]:
        facts = {"people": " ".join(self.newest) or "nobody"}
        for body, posture in self.newest.items():
            facts[f"{body}/id"] = self.people.people[body].theirs
            if posture.refusal:
                facts[f"{body}/refused"] = posture.refusal
            for what in ("lost", "bridged", "held", "swapped"):
                if names := getattr(posture, what):
                    facts[f"{body}/{what}"] = " ".join(names)
        return facts


main = entry_point(SkeletonTrackerNode)

if __name__ == "__main__":
    main()
