"""A PR2 right arm without a PR2: follows trajectories exactly and reports its joint states."""

from __future__ import annotations

import sys

from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from humanpred_ros.errors import PlanningError
from humanpred_ros.nodes import conversions, qos, topics
from humanpred_ros.nodes.base import GraphNode, run_node
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.settings import SimulatedPr2Settings
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.pr2 import RIGHT_ARM_JOINTS
from humanpred_ros.robot.scene import load_scene


class SimulatedPr2(GraphNode):
    """Starts at the scene's start configuration and tracks what it is sent, as an ideal controller would.

    A new trajectory takes over at its first point's time (header.stamp); until then the old one goes on.
    """

    def __init__(self) -> None:
        super().__init__("simulated_pr2")
        settings = declare(self, SimulatedPr2Settings)
        self.rest_q = load_scene(settings.scene).start
        self.origin_ns: int | None = None
        self.active: TimedTrajectory | None = None
        self.next: TimedTrajectory | None = None
        # Made first, so that a trajectory and a clock tick that wait together are taken in this order.
        self.create_subscription(JointTrajectory, topics.TRAJECTORY, self.on_trajectory, qos.COMMAND)
        self.publisher = self.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        self.create_timer(1.0 / settings.rate_hz, self.publish_state)
        # Before /clock ticks (it may wait for us), the start configuration must already be known.
        self.startup_timer = self.create_timer(0.1, self.publish_start, clock=self._status_timer.clock)

    def waiting_for(self) -> str:
        return self.unmatched(self.publisher, "")

    def on_trajectory(self, message: JointTrajectory) -> None:
        """Take a trajectory a controller would accept; refuse any other and stay with the old one."""
        if self.origin_ns is None:
            self.origin_ns = conversions.stamp_ns(message.header.stamp)
        try:
            self.next = conversions.trajectory_from_message(message, RIGHT_ARM_JOINTS, self.origin_ns)
        except PlanningError as error:
            self.refuse(str(error))

    def publish_start(self) -> None:
        """Publish the start configuration until the first trajectory comes, whatever the clock does."""
        if self.origin_ns is not None:
            self.startup_timer.cancel()
            return
        self.publish_state()

    def publish_state(self) -> None:
        """Publish where the arm is now."""
        now_ns = self.get_clock().now().nanoseconds
        q, v = self.rest_q, None
        if self.origin_ns is not None:
            t_s = (now_ns - self.origin_ns) * 1e-9
            if self.next is not None and t_s >= self.next.t_s[0]:
                self.active, self.next = self.next, None
            if self.active is not None:
                q, v, _ = self.active.sample(t_s)
        self.publisher.publish(conversions.joint_state(RIGHT_ARM_JOINTS, q, now_ns, v=v))


def main() -> None:
    """Console entry point."""
    sys.exit(run_node(SimulatedPr2))


if __name__ == "__main__":
    main()
