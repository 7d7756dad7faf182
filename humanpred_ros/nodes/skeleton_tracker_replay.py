"""Replays a recorded human motion as a skeleton tracker would deliver it."""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import human_with
from humanpred_ros.motion.library_io import load_library
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
    trajectory: str = setting("0/0", "motion to replay: class/index, or the running number over sorted classes")
    body_id: str = setting("body_0", "REP-155 body id, part of the topic names")
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
        self.motion = library.find(settings.trajectory)
        self.offsets_ns, self.postures = self._timeline()
        self.get_logger().info(
            f"motion {self.motion.name} of {library.name}: {len(self.motion)} postures, {self.motion.duration_s:.2f} s"
        )

    def activate(self) -> None:
        settings = self.settings
        self.next_frame = 0
        self.origin_ns = SIMULATED_ORIGIN_NS
        self.last_clock_ns = self.last_marker_ns = -_MARKER_PERIOD_NS

        body = settings.body_id
        self.hardware_id = self.resolve_topic_name(topics.human_joint_states(body)).rpartition("/")[0]
        self.posture_publisher = self.create_publisher(
            JointState, topics.human_joint_states(body), qos.SENSOR_PUBLISHER
        )
        self.marker_publisher = self.create_publisher(MarkerArray, topics.human_markers(body), qos.MARKERS)
        self.held_publisher = self.create_publisher(Bool, topics.human_held(body), qos.LATCHED)
        self.held_publisher.publish(Bool(data=False))
        self.urdf_publisher = self.create_publisher(String, topics.human_urdf(body), qos.LATCHED)
        self.urdf_publisher.publish(String(data=self.human.urdf))
        self.wait_for_graph(
            stepped=settings.mode == "stepped",
            clock=self.simulated_time,
            peers=settings.wait_for,
            patience_s=(settings.ready_timeout_s, settings.decision_timeout_s),
        )

    def _timeline(self) -> tuple[list[int], FloatArray]:
        """Return the offsets from the start (ns) and the postures, the held last posture included."""
        offsets_ns, recorded = self.motion.timeline(int(self.settings.hold_last_s / self.motion.period_s))
        postures = np.empty_like(recorded)
        postures[:, [self.human.dof_names.index(name) for name in self.motion.dof_names]] = recorded
        return offsets_ns, postures

    def waiting_for(self) -> str:
        return super().waiting_for() or self.unmatched(self.settings.listener, self.posture_publisher)

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
        offset_ns, q = self.offsets_ns[self.next_frame], self.postures[self.next_frame]
        t_ns, frame_id = self.origin_ns + offset_ns, self.motion.frame_id
        self.next_frame += 1
        self.sent(t_ns)
        if self.stepped:
            self.publish_clock(t_ns)
        if self.next_frame == len(self.motion) + 1:  # from now on the last posture is repeated
            self.held_publisher.publish(Bool(data=True))
        self.posture_publisher.publish(conversions.joint_state(self.human.dof_names, q, t_ns, frame_id))
        if self.marker_publisher.get_subscription_count() and offset_ns - self.last_marker_ns >= _MARKER_PERIOD_NS:
            self.last_marker_ns = offset_ns
            markers = skeleton_markers(self.human.forward(q), frame_id, conversions.time_message(t_ns))
            self.marker_publisher.publish(markers)

    def finish(self, reason: str) -> None:
        """End the work once everything sent has arrived."""
        self.posture_publisher.wait_for_all_acked(Duration(seconds=1))
        super().finish(reason)


main = entry_point(SkeletonTrackerReplay)

if __name__ == "__main__":
    main()
