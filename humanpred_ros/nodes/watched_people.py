"""The people that trackers tell of, for those who watch or predict them: every body, and what is wrong with it.

Somebody who was seen is there until the tracker says that this body has left, or that nobody is there: a body that
falls silent, or whose topic goes, is lost, not gone.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import TRACKER_FRAMES, HumanModel
from humanpred_ros.human.plausible import PlausibilityCheck, PlausibilitySettings
from humanpred_ros.human.stamps import StampCheck, StampSettings
from humanpred_ros.motion.motion import placed_postures
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.frames import TrackerFrames, tf_lookup
from humanpred_ros.robot.scene import Scene
from humanpred_ros.settings import setting

#: A place for the name of a body in the name of a topic.
_ANY = "ANY_BODY"
#: Of a tracker that names people itself.
_FIRST = "body_0"
_KIND = "sensor_msgs/msg/JointState"


class PeopleSettings(PlausibilitySettings, StampSettings):
    """Which people are looked at, and what is taken of a tracker."""

    human: str = setting("kinect12", "whose postures come: kinect12 (P1, 12 DoFs) or mocap23 (P2, 23 DoFs)",
                         restart="what is known of people is of this one")  # fmt: skip
    human_frame: str = setting(
        "", "frame the postures must be in; empty: the scene's, else the library's or the human's own; with TF, others "
        "are moved there"
    )  # fmt: skip
    bodies: tuple[str, ...] = setting(
        ("",), "REP-155 body ids, each of which must be seen; ['']: all bodies that appear, from then on"
    )
    room_m: float = setting(5.0, "people may be so far outside the scene's lattice", unit="m", low=0.0, high=100.0)
    max_human_age_s: float = setting(0.3, "a body whose postures are older is lost", unit="s", low=0.02, high=60.0)


class WatchedBody:
    """One body: its newest posture, and why it is not to be relied on.

    Attributes:
        q: (D,) its newest good posture, tracker's frame of the scene.
        t_s: its stamp, counted from the first posture of the motion.
        begins: whether it is the first after a fault or a silence: nothing is known of how the body came there.
        trouble: why the newest posture is not one; empty if it is.
        trouble_ns: stamp under which that is told.
        came_s: when the newest good posture came, on a steady clock; -inf before the first.
        late_s: how old it was then, by its stamp.
        stamp_ns, before_ns: stamps of that posture and of the one before.
        appeared: whether somebody publishes its postures, or it must be seen.
        gone: whether a tracker has said since then that the body has left, or that nobody is there.
        foreign: whether its joints are those of another tracker's human model; `served`: somebody turns them into ours.
    """

    def __init__(self, name: str, topic: str, plausibility: PlausibilityCheck, stamps: StampCheck) -> None:
        self.name, self.topic, self.plausibility, self.stamps = name, topic, plausibility, stamps
        self.appeared = self.gone = self.foreign = self.served = self.held = self.begins = False
        self.q: FloatArray = np.zeros(0)
        self.t_s, self.trouble, self.trouble_ns = 0.0, "", 0
        self.came_s, self.late_s, self.stamp_ns, self.before_ns = -math.inf, 0.0, 0, 0
        self._first_ns, self._origin_ns, self._doubted = 0, 0, True

    def take(self, message: JointState, human: HumanModel, frames: TrackerFrames, now_ns: int, now_s: float) -> str:
        """Take a posture; return why it is refused. Raises HumanPredError where that is told at once."""
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        self.foreign = bool(message.name) and all(name.endswith(f"_{self.name}") for name in message.name)
        if self.foreign:
            self.trouble_ns = now_ns
            raise ArrayError(
                f"foreign body: {self.topic} is of another tracker (ROS4HRI: {message.name[0]:.40}); turn it into "
                "postures (skeleton_tracker, skeleton: ros4hri), or name the bodies that are meant (bodies)"
            )
        verdict = self.stamps.judge(stamp_ns, now_ns, now_s)
        if verdict.refusal:
            if verdict.tell:
                self.trouble_ns = now_ns
                raise ArrayError(verdict.refusal)
            return verdict.refusal
        if verdict.begins:
            self.plausibility.start()
            self._first_ns, self._doubted = stamp_ns, True
        t_s, self.trouble_ns = (stamp_ns - self._first_ns) * 1e-9, stamp_ns
        try:
            q = conversions.ordered_positions(message, human.dof_names)
            T = frames.placement(message.header.frame_id)
        except ArrayError as error:
            self.plausibility.unread(t_s, str(error).split(":", 1)[0])
            raise
        if T is not None:
            q = placed_postures(q, human.dof_names, T)
        doubt = self.plausibility.refusal(q, t_s, self.held)
        if doubt is not None:
            raise ArrayError(str(doubt))
        self.begins, self._doubted = self._doubted, False
        if self.begins:
            self._origin_ns = stamp_ns
        self.q, self.t_s, self.trouble = q, (stamp_ns - self._origin_ns) * 1e-9, ""
        self.before_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        self.came_s, self.late_s = now_s, max((now_ns - stamp_ns) * 1e-9, 0.0)
        return ""

    def doubt(self, trouble: str) -> None:
        """Do not rely on the newest posture; what comes next begins anew."""
        self.trouble, self._doubted = trouble, True

    def age_s(self, now_s: float) -> float:
        """Return how old what is known of the body is."""
        return now_s - self.came_s + self.late_s


class WatchedPeople:
    """All bodies in the node's namespace, or those of a list.

    Attributes:
        bodies: by id, those that have left included.
        frames: where their trackers' frames are.
        steady_s: a clock that nobody sets, s.
    """

    steady_s: Callable[[], float] = staticmethod(time.monotonic)

    def __init__(
        self,
        node: GraphNode,
        human: HumanModel,
        scene: Scene,
        settings: PeopleSettings,
        changed: Callable[[WatchedBody, str], object],
        *,
        frame: str = "",
        profile: QoSProfile = qos.SENSOR_SUBSCRIBER,
        max_age_s: float = math.inf,
        lossless: bool = False,
        left: Callable[[int, bool], object] = lambda stamp_ns, nobody: None,
    ) -> None:
        """Take the node that listens, the model of all bodies, the scene, the settings, and what follows.

        Args:
            changed: called with a body after each of its postures, and why that was refused.
            frame: the postures' where neither settings nor scene name one; empty: the human's own.
            profile: with which postures are listened to.
            max_age_s: a body that is there and falls silent for longer keeps the node from its work.
            lossless: ages mean nothing (stepped runs).
            left: called with the stamp when somebody has left, and whether nobody is there.
        """
        self._node, self._human, self._scene, self._settings, self._changed = node, human, scene, settings, changed
        self._profile, self._max_age_s, self._lossless, self._left = profile, max_age_s, lossless, left
        grid, room_m = scene.grid, settings.room_m
        self._room = grid
        if room_m > 0.0:
            nx, ny, nz = (math.ceil(n * grid.resolution_m + 2.0 * room_m) for n in grid.shape)
            x, y, z = (origin - room_m for origin in grid.origin_m)
            self._room = VoxelGrid((x, y, z), 1.0, (nx, ny, nz))
        frame = settings.human_frame or scene.human_frame or frame or TRACKER_FRAMES[settings.human]
        self.frames = TrackerFrames(frame.lstrip("/"), scene.T_world_human, tf_lookup(node))
        self.bodies: dict[str, WatchedBody] = {}
        self._nobody_s = -math.inf
        pattern = re.escape(node.resolve_topic_name(topics.human_joint_states(_ANY)))
        self._pattern = re.compile(pattern.replace(_ANY, "([^/]+)"))
        self._listed = [body for body in settings.bodies if body]
        node.listen(Header, topics.NOBODY, self._on_nobody, qos.SENSOR_SUBSCRIBER)
        for name in self._listed:
            self._watch(name).appeared = True
        if not self._listed:
            self._watch(_FIRST)  # which may be remapped

    @property
    def present(self) -> list[WatchedBody]:
        """The bodies that are there, as far as anybody knows, by name."""
        return [
            body
            for _, body in sorted(self.bodies.items())
            if body.appeared and not (body.gone or (body.foreign and body.served))
        ]

    def look_for_bodies(self) -> None:
        """Watch the bodies that have appeared, too; find out who turns foreign ones into ours."""
        for body in self.bodies.values():
            body.appeared = body.appeared or self._node.count_publishers(body.topic) > 0
            if body.foreign:
                body.served = self._is_served(body.topic)
        if self._listed:
            return
        for topic, kinds in self._node.get_topic_names_and_types():
            found = self._pattern.fullmatch(topic)
            if found and found[1] not in self.bodies and _KIND in kinds and self._node.count_publishers(topic):
                self._watch(found[1]).appeared = True

    def _is_served(self, topic: str) -> bool:
        """Return whether a node listens to a foreign body, and publishes a body that is none."""
        own = [body.topic for body in self.bodies.values() if not body.foreign]
        readers = {(i.node_name, i.node_namespace) for i in self._node.get_subscriptions_info_by_topic(topic)}
        return any(
            (info.node_name, info.node_namespace) in readers
            for mine in own
            for info in self._node.get_publishers_info_by_topic(mine)
        )

    def trouble(self, now_s: float) -> str:
        """Return why it is not known where everybody is; empty if it is."""
        most_s, present = self._settings.max_human_age_s, self.present
        for body in present:
            if body.trouble:
                return f"invalid human data: {body.name}: {body.trouble}"
            lost = self.lost(body, now_s)
            if lost:
                return lost
        if present or now_s - self._nobody_s <= most_s:
            return ""
        return (
            f"no people: nobody publishes {topics.human_joint_states('<id>')}, or says on {topics.NOBODY} that all left"
        )

    def lost(self, body: WatchedBody, now_s: float) -> str:
        """Return that a body is not seen any more, or not yet; empty if it is seen."""
        if body.came_s == -math.inf:
            return f"no human data: {body.name}: no posture has come yet"
        age_s, most_s = body.age_s(now_s), self._settings.max_human_age_s
        if self._lossless or age_s <= most_s:
            return ""
        return (
            f"stale human data: {body.name}: its last posture is {age_s:.2f} s old, allowed are {most_s:g} s; nobody "
            "has said that it left"
        )

    def age_s(self, now_s: float) -> float:
        """Return the age of the oldest of what is known of the bodies."""
        return max((body.age_s(now_s) for body in self.present), default=0.0)

    def warnings(self) -> dict[str, str]:
        """Return what deserves a warning of trackers' clocks and frames, by what it is about."""
        about = {"tracker frame": self.frames.warning}
        about |= {f"clock of {body.name}": body.stamps.behind() for body in self.present}
        return {what: text for what, text in about.items() if text}

    def _watch(self, name: str) -> WatchedBody:
        settings = self._settings
        plausibility = PlausibilityCheck(
            self._human, self._room, self._scene.T_world_human, settings.part(PlausibilitySettings)
        )
        topic = self._node.resolve_topic_name(topics.human_joint_states(name))
        stamps = StampCheck(settings.part(StampSettings), self._lossless)
        body = self.bodies[name] = WatchedBody(name, topic, plausibility, stamps)

        def on_held(message: Bool) -> None:
            body.held = message.data

        def on_left(message: Header) -> None:
            self._leave([body], message, nobody=False)

        self._node.listen(Bool, topics.human_held(name), on_held, qos.LATCHED)
        self._node.listen(Header, topics.human_left(name), on_left, qos.SENSOR_SUBSCRIBER)
        self._node.listen(JointState, topic, partial(self.take, body), self._profile)
        return body

    def take(self, body: WatchedBody, message: JointState) -> None:
        """Take a posture of a body."""
        try:
            now_ns = self._node.get_clock().now().nanoseconds
            refusal = body.take(message, self._human, self.frames, now_ns, self.steady_s())
            if not refusal:
                body.gone = False
        except HumanPredError as error:
            refusal = str(error)
            body.doubt(refusal)
            body.gone = False  # whoever comes back with bad data is there
        body.appeared, self._node.inputs[body.topic].max_age_s = True, self._max_age_s
        if refusal and not (body.foreign and body.served):
            self._node.refuse(refusal)
        self._changed(body, refusal)

    def _on_nobody(self, message: Header) -> None:
        self._leave(list(self.bodies.values()), message, nobody=True)

    def _leave(self, bodies: list[WatchedBody], message: Header, nobody: bool) -> None:
        """Let bodies have left that were last seen before."""
        stamp_ns, now_ns = conversions.stamp_ns(message.stamp), self._node.get_clock().now().nanoseconds
        late_s = (now_ns - stamp_ns) * 1e-9
        if not (self._lossless or -self._settings.max_ahead_s <= late_s <= self._settings.max_human_age_s):
            self._node.refuse(f"nobody there: wanted this said now, got a stamp {late_s:.3g} s ago")
            return
        if nobody:
            self._nobody_s = self.steady_s() - max(late_s, 0.0)
        for body in bodies:
            if body.stamp_ns < stamp_ns and body.trouble_ns < stamp_ns:
                body.gone, body.trouble = True, ""
                self._node.inputs[body.topic].max_age_s = math.inf
        self._left(stamp_ns, nobody)
