"""Replays recorded human motions as a skeleton tracker would deliver them."""

from __future__ import annotations

import time
from typing import Any, Literal

import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header, String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import human_with
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, placed, resample
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import entry_point
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.markers import skeleton_markers
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.stepping import SteppedSource
from humanpred_ros.resources import locate
from humanpred_ros.settings import setting

#: Where simulated time starts: ROS reads time 0 as "no clock yet".
SIMULATED_ORIGIN_NS = conversions.NS_PER_S
_CLOCK_PERIOD_NS = 5_000_000
#: Slewing does not bring a clock so far from the steady one while a motion lasts.
_CLOCK_STEP_NS = 50_000_000
_MARKER_PERIOD_NS = 100_000_000


class SkeletonTrackerReplaySettings(NodeSettings):
    """Parameters of `skeleton_tracker_replay`."""

    library: str = setting("synthetic_reaches", "motion library: a rosbag2 directory, a CSV folder, or a shipped name")
    trajectory: str = setting(
        "0/0", "motion to replay: class/index, or the running number over sorted classes; with commas those of several "
        "people at once"
    )  # fmt: skip
    body_id: str = setting(
        "body_0", "REP-155 body id, part of the topic names; of several people with commas, else numbered"
    )
    place: str = setting(
        "", "'x y z roll pitch yaw' (m, rad) by which a person is moved, tracker's frame; with commas for several"
    )
    leave_s: float = setting(
        0.0, "all but the first person leave so long after their motions; 0: they stay", unit="s", low=0.0, high=600.0
    )
    mode: Literal["real_time", "stepped"] = setting(
        "real_time", "real_time, or stepped: wait for the planner's decision after every posture"
    )
    rate: float = setting(
        1.0,
        "playback speed in real_time mode; so slow that postures are farther apart than the planner's max_human_age_s, "
        "it holds between them",
        low=0.1,
        high=20.0,
    )
    hold_last_s: float = setting(
        4.0, "time for which the last posture is repeated after the motion's end", unit="s", low=0.0, high=600.0
    )
    wait_for: str = setting("", "comma-separated nodes whose /diagnostics must say ready before the replay starts")
    listener: str = setting("", "node that must be listening to the postures before the replay starts")
    ready_timeout_s: float = setting(180.0, "longest wait for those nodes", unit="s", low=0.1, high=600.0)
    decision_timeout_s: float = setting(
        30.0, "longest wait for one decision in stepped mode", unit="s", low=0.1, high=600.0
    )
    publish_clock: bool = setting(False, "publish /clock; always on in stepped mode")


class SkeletonTrackerReplay(SteppedSource):
    """Publishes one motion's postures at their recorded times, at a rate, or step by step.

    Several people are seen in the same frames, those of the longest motion; one who has ended stays, or leaves.

    In `stepped` mode the next posture goes out only after the planner's decision on the last one came
    back, so that a run does not depend on how fast the machine is.
    """

    def __init__(self) -> None:
        super().__init__("skeleton_tracker_replay")

    def configure(self) -> None:
        self.settings = settings = declare(self, SkeletonTrackerReplaySettings)
        self.simulated_time = settings.mode == "stepped" or settings.publish_clock or settings.rate != 1.0
        library = load_library(locate(settings.library, "bags"))
        self.human = human_with(library.dof_names)
        motions = [library.find(name.strip()) for name in settings.trajectory.split(",")]
        places = []
        if settings.place:
            from humanpred_ros.human.skeletons import pose_of  # rotations of scipy take memory

            places = [pose_of(text) for text in settings.place.split(",")]
        if len(places) > len(motions):
            raise UsageError(f"parameter place: wanted one for each of {len(motions)} motions, got {len(places)}")
        motions = [placed(motion, T) for motion, T in zip(motions, places, strict=False)] + motions[len(places) :]
        self.motion = max(motions, key=lambda motion: motion.duration_s)
        ids = [name.strip() for name in settings.body_id.split(",")]
        ids += [name for k in range(len(motions)) if (name := f"body_{k}") not in ids]
        self.offsets_ns, _ = self._timeline(self.motion)
        self.people = {name: self._of_frames(motion) for name, motion in zip(ids, motions, strict=False)}
        for motion in motions:
            self.get_logger().info(
                f"motion {motion.name} of {library.name}: {len(motion)} postures, {motion.duration_s:.2f} s"
            )

    def activate(self) -> None:
        settings = self.settings
        self.next_frame = 0
        self.origin_ns = SIMULATED_ORIGIN_NS
        self.last_clock_ns = self.last_marker_ns = -_MARKER_PERIOD_NS

        body, *_ = self.people
        self.hardware_id = self.resolve_topic_name(topics.human_joint_states(body)).rpartition("/")[0]
        kinds: tuple[tuple[Any, Any, Any], ...] = (
            (JointState, topics.human_joint_states, qos.SENSOR_PUBLISHER), (MarkerArray, topics.human_markers,
            qos.MARKERS), (Bool, topics.human_held, qos.LATCHED), (Header, topics.human_left, qos.SENSOR_PUBLISHER),
            (String, topics.human_urdf, qos.LATCHED),
        )  # fmt: skip
        self.bodies = {
            name: tuple(self.create_publisher(kind, topic(name), profile) for kind, topic, profile in kinds)
            for name in self.people
        }
        for _, _, held, _, urdf in self.bodies.values():
            held.publish(Bool(data=False))
            urdf.publish(String(data=self.human.urdf))
        self.wait_for_graph(
            stepped=settings.mode == "stepped",
            clock=self.simulated_time,
            peers=settings.wait_for,
            patience_s=(settings.ready_timeout_s, settings.decision_timeout_s),
        )

    def _timeline(self, motion: Motion) -> tuple[list[int], FloatArray]:
        """Return the offsets from the start (ns) and the postures, the held last posture included."""
        offsets_ns, recorded = motion.timeline(int(self.settings.hold_last_s / motion.period_s))
        postures = np.empty_like(recorded)
        postures[:, [self.human.dof_names.index(name) for name in motion.dof_names]] = recorded
        return offsets_ns, postures

    def _of_frames(self, motion: Motion) -> tuple[FloatArray, int]:
        """Return a person's postures in all frames, and how many of them are of the motion; the last one is held."""
        if motion is self.motion:
            return self._timeline(motion)[1], len(motion)
        seen_s = motion.t_s[0] + np.array(self.offsets_ns) * 1e-9
        n = int((seen_s <= motion.t_s[-1]).sum())
        _, postures = self._timeline(resample(motion, t_s=seen_s[:n]))
        return np.vstack([postures[:n], np.repeat(postures[n - 1 : n], len(seen_s) - n, axis=0)]), n

    def waiting_for(self) -> str:
        missing = (self.unmatched(self.settings.listener, body[0]) for body in self.bodies.values())
        return super().waiting_for() or next((text for text in missing if text), "")

    def begin(self) -> None:
        if not self.simulated_time:
            self.origin_ns = self.get_clock().now().nanoseconds
        self.get_logger().info(f"replay starts ({self.settings.mode}, rate {self.settings.rate:g})")

    def arrived(self) -> None:
        if self.next_frame >= len(self.motion) and not self.finished:
            self.finish("the robot has arrived")

    def publish_due(self) -> None:
        elapsed_ns = int((time.monotonic() - self.begun_s) * 1e9 * self.settings.rate)
        if not self.simulated_time:
            self._follow_clock(elapsed_ns)
        if self.simulated_time and elapsed_ns - self.last_clock_ns >= _CLOCK_PERIOD_NS:
            self.last_clock_ns = elapsed_ns
            self.publish_clock(self.origin_ns + elapsed_ns)
        while (
            not self.finished
            and self.next_frame < len(self.offsets_ns)
            and self.offsets_ns[self.next_frame] <= elapsed_ns
        ):
            self.publish_next()
        if self.next_frame == len(self.offsets_ns):
            self.finish("the recording has ended")

    def _follow_clock(self, elapsed_ns: int) -> None:
        """Stamp with the node's time also after that was set, or the machine was asleep."""
        off_ns = self.get_clock().now().nanoseconds - self.origin_ns - elapsed_ns
        if abs(off_ns) > _CLOCK_STEP_NS:
            self.origin_ns += off_ns
            self.get_logger().warning(f"the clock was set by {off_ns * 1e-9:.3f} s: so are the stamps from now on")

    def publish_next(self) -> None:
        """Publish the next posture, or finish after the last."""
        if self.next_frame == len(self.offsets_ns):
            self.finish("the recording has ended")
            return
        frame, offset_ns = self.next_frame, self.offsets_ns[self.next_frame]
        t_ns = self.origin_ns + offset_ns
        self.next_frame += 1
        self.sent(t_ns)
        if self.stepped:
            self.publish_clock(t_ns)
        marked = offset_ns - self.last_marker_ns >= _MARKER_PERIOD_NS
        for k, name in enumerate(self.people):
            self._publish(name, frame, t_ns, marked, stays=k == 0 or not self.settings.leave_s)
        if marked:
            self.last_marker_ns = offset_ns

    def _publish(self, name: str, frame: int, t_ns: int, marked: bool, stays: bool) -> None:
        """Publish what a frame shows of a person: a posture, or that the person has left."""
        (postures, n), (poses, markers, held, left, _) = self.people[name], self.bodies[name]
        q, frame_id = postures[frame], self.motion.frame_id
        if not stays and frame >= n and self.offsets_ns[frame] - self.offsets_ns[n - 1] > self.settings.leave_s * 1e9:
            left.publish(Header(frame_id=frame_id, stamp=conversions.time_message(t_ns)))
            return
        if frame == n:  # from now on the last posture is repeated
            held.publish(Bool(data=True))
        poses.publish(conversions.joint_state(self.human.dof_names, q, t_ns, frame_id))
        if marked and markers.get_subscription_count():
            markers.publish(skeleton_markers(self.human.forward(q), frame_id, conversions.time_message(t_ns)))

    def finish(self, reason: str) -> None:
        """End the work once everything sent has arrived."""
        for postures, *_ in self.bodies.values():
            postures.wait_for_all_acked(Duration(seconds=1))
        super().finish(reason)


main = entry_point(SkeletonTrackerReplay)

if __name__ == "__main__":
    main()
