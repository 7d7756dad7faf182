"""The people around an arm as the guard sees them: every body a tracker tells of, and what is wrong with it.

Somebody who was seen is there until the tracker says that nobody is: a body that falls silent, or whose topic goes, is
lost, not gone.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable

from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, HumanPredError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import TRACKER_FRAMES, HumanModel
from humanpred_ros.human.plausible import PlausibilityCheck, PlausibilitySettings
from humanpred_ros.human.stamps import StampCheck, StampSettings
from humanpred_ros.motion.motion import placed_postures
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.frames import TrackerFrames, tf_lookup
from humanpred_ros.planning.protective_distance import SeenBody
from humanpred_ros.robot.scene import Scene
from humanpred_ros.settings import setting

#: A place for the name of a body in the name of a topic.
_ANY = "ANY_BODY"
_KIND = "sensor_msgs/msg/JointState"


class PeopleSettings(PlausibilitySettings, StampSettings):
    """Whom the guard watches, and what it takes of a tracker."""

    human: str = setting("kinect12", "whose postures come: kinect12 (12 DoFs) or mocap23 (23 DoFs)")
    human_frame: str = setting(
        "", "frame the postures must be in; empty: the scene's, else the human's own; with TF, others are moved there"
    )
    bodies: tuple[str, ...] = setting(
        ("",), "REP-155 body ids, each of which must be seen; ['']: all bodies that appear, from then on"
    )
    room_m: float = setting(
        5.0, "people may be so far outside the scene's lattice and are watched", unit="m", low=0.0, high=100.0
    )
    max_human_age_s: float = setting(0.3, "postures older than this are a stop", unit="s", low=0.02, high=60.0)


class WatchedBody:
    """One body: its newest posture, and why it is not to be relied on.

    Attributes:
        seen: its postures.
        trouble: why the newest posture is not one; empty if it is.
        came_s: when the newest good posture came, on a steady clock; -inf before the first.
        late_s: how old it was then, by its stamp.
        stamp_ns: of that posture.
        held: whether the tracker repeats it on purpose.
        gone: whether a tracker has said since then that nobody is there.
    """

    def __init__(self, name: str, plausibility: PlausibilityCheck, settings: StampSettings) -> None:
        self.name, self.gone = name, False
        self.seen, self.trouble, self.held = SeenBody(), "", False
        self.came_s, self.late_s, self.stamp_ns = -math.inf, 0.0, 0
        self.plausibility, self.stamps = plausibility, StampCheck(settings)
        self._first_ns = 0

    def take(self, message: JointState, human: HumanModel, frames: TrackerFrames, now_ns: int) -> str:
        """Take a posture; return why it is refused. Raises HumanPredError where that is told at once."""
        stamp_ns, now_s = conversions.stamp_ns(message.header.stamp), time.monotonic()
        verdict = self.stamps.judge(stamp_ns, now_ns, now_s)
        if verdict.refusal:
            if verdict.tell:
                raise ArrayError(verdict.refusal)
            return verdict.refusal
        if verdict.begins:
            self.plausibility.start()
            self.seen, self._first_ns = SeenBody(), stamp_ns
        t_s = (stamp_ns - self._first_ns) * 1e-9
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
        self.seen.see(q, t_s)
        self.came_s, self.late_s, self.stamp_ns = now_s, max((now_ns - stamp_ns) * 1e-9, 0.0), stamp_ns
        self.trouble = ""
        return ""

    def age_s(self, now_s: float) -> float:
        """Return how old what is known of the body is."""
        return now_s - self.came_s + self.late_s


class WatchedPeople:
    """All bodies in the node's namespace, or those of a list.

    Attributes:
        bodies: by id, those that have left included.
        frames: where their trackers' frames are.
    """

    def __init__(
        self,
        node: GraphNode,
        human: HumanModel,
        scene: Scene,
        settings: PeopleSettings,
        changed: Callable[[int], object],
    ) -> None:
        """Take the node that listens, the model of all bodies, the scene, the settings, and what follows a posture.

        The last is called with the time at which the posture was sent, ns, by the sender's clock.
        """
        self._node, self._human, self._scene, self._settings, self._changed = node, human, scene, settings, changed
        grid, room_m = scene.grid, settings.room_m
        nx, ny, nz = (math.ceil(n * grid.resolution_m + 2.0 * room_m) for n in grid.shape)
        x, y, z = (origin - room_m for origin in grid.origin_m)
        self._room = VoxelGrid((x, y, z), 1.0, (nx, ny, nz))
        frame = settings.human_frame or scene.human_frame or TRACKER_FRAMES[settings.human]
        self.frames = TrackerFrames(frame.lstrip("/"), scene.T_world_human, tf_lookup(node))
        self.bodies: dict[str, WatchedBody] = {}
        self._nobody_s, self._nobody_ns = -math.inf, 0
        pattern = re.escape(node.resolve_topic_name(topics.human_joint_states(_ANY)))
        self._pattern = re.compile(pattern.replace(_ANY, "([^/]+)"))
        self._listed = [body for body in settings.bodies if body]
        node.listen(Header, topics.NOBODY, self._on_nobody, qos.SENSOR_SUBSCRIBER)
        for name in self._listed:
            self._watch(name)

    @property
    def present(self) -> list[WatchedBody]:
        """The bodies that are there, as far as anybody knows."""
        return [body for body in self.bodies.values() if not body.gone]

    def look_for_bodies(self) -> None:
        """Watch the bodies that have appeared, too."""
        if self._listed:
            return
        for topic, kinds in self._node.get_topic_names_and_types():
            found = self._pattern.fullmatch(topic)
            if found and found[1] not in self.bodies and _KIND in kinds and self._node.count_publishers(topic):
                self._watch(found[1])

    def trouble(self, now_s: float) -> str:
        """Return why it is not known where everybody is; empty if it is."""
        most_s, present = self._settings.max_human_age_s, self.present
        for body in present:
            if body.trouble:
                return f"invalid human data: {body.name}: {body.trouble}"
            if body.came_s == -math.inf:
                return f"no human data: {body.name}: no posture has come yet"
            age_s = body.age_s(now_s)
            if age_s > most_s:
                return (
                    f"stale human data: {body.name}: its last posture is {age_s:.2f} s old, allowed are {most_s:g} s; "
                    f"nobody has said that it left"
                )
        if present or now_s - self._nobody_s <= most_s:
            return ""
        return (
            f"no people: nobody publishes {topics.human_joint_states('<id>')}, or says on {topics.NOBODY} that all left"
        )

    def age_s(self, now_s: float) -> float:
        """Return the age of the oldest of what is known of the bodies."""
        return max((body.age_s(now_s) for body in self.present), default=0.0)

    def _watch(self, name: str) -> None:
        settings = self._settings
        plausibility = PlausibilityCheck(
            self._human, self._room, self._scene.T_world_human, settings.part(PlausibilitySettings)
        )
        topic = self._node.resolve_topic_name(topics.human_joint_states(name))
        body = self.bodies[name] = WatchedBody(name, plausibility, settings.part(StampSettings))

        def on_posture(message: JointState) -> None:
            now_ns = self._node.get_clock().now().nanoseconds
            try:
                refusal = body.take(message, self._human, self.frames, now_ns)
            except HumanPredError as error:
                refusal = body.trouble = str(error)
            if refusal:
                self._node.refuse(refusal)
            elif body.stamp_ns > self._nobody_ns:
                body.gone = False
            self._changed(self._node.inputs[topic].sent_ns)

        def on_held(message: Bool) -> None:
            body.held = message.data

        self._node.listen(Bool, topics.human_held(name), on_held, qos.LATCHED)
        self._node.listen(JointState, topic, on_posture, qos.SENSOR_SUBSCRIBER)

    def _on_nobody(self, message: Header) -> None:
        """Let all bodies have left that were last seen before."""
        stamp_ns, now_ns = conversions.stamp_ns(message.stamp), self._node.get_clock().now().nanoseconds
        late_s = (now_ns - stamp_ns) * 1e-9
        if not -self._settings.max_ahead_s <= late_s <= self._settings.max_human_age_s:
            self._node.refuse(f"nobody there: wanted this said now, got a stamp {late_s:.3g} s ago")
            return
        self._nobody_s, self._nobody_ns = time.monotonic() - max(late_s, 0.0), stamp_ns
        for body in self.bodies.values():
            if body.stamp_ns < stamp_ns:
                body.gone, body.trouble = True, ""
