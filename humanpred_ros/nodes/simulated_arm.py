"""Stands in for the robot: follows trajectories exactly and reports the joint states."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from humanpred_ros import topics
from humanpred_ros.errors import PlanningError
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.planning.trajectory import Schedule
from humanpred_ros.robot.pr2 import RIGHT_ARM_JOINTS
from humanpred_ros.robot.scene_file import read_scene_file
from humanpred_ros.settings import Settings, setting

#: Before any trajectory: the arm has always rested.
_LONG_AGO_S = -1e9


class SimulatedArmSettings(Settings):
    """Parameters of `simulated_arm`."""

    scene: str = setting("face_to_face", "scene whose start configuration the arm is in")
    rate_hz: float = setting(50.0, "joint states per second", unit="Hz", low=1.0, high=1000.0)


class SimulatedArm(GraphNode):
    """Starts at the scene's start configuration and tracks what it is sent, as an ideal controller would.

    A new trajectory takes over at its first point's time (header.stamp); until then the old one goes on.
    """

    def __init__(self) -> None:
        super().__init__("simulated_arm")
        settings = declare(self, SimulatedArmSettings)
        self.rest_q = read_scene_file(settings.scene).angle("start")
        self.origin_ns: int | None = None
        self.schedule = Schedule(self.rest_q, _LONG_AGO_S)
        # Made first, so that a trajectory and a clock tick that wait together are taken in this order.
        self.create_subscription(JointTrajectory, topics.TRAJECTORY, self.on_trajectory, qos.COMMAND)
        self.publisher = self.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        self.period_ns = round(conversions.NS_PER_S / settings.rate_hz)
        self.last_ns = -self.period_ns
        if self.get_parameter("use_sim_time").value:
            # A timer would skip ticks that come close together in wall time; every one matters in a stepped run.
            self.create_subscription(Clock, topics.CLOCK, self.on_clock, qos.LOSSLESS)
        else:
            self.create_timer(1.0 / settings.rate_hz, self.publish_now)
        # Before /clock ticks (it may wait for us), the start configuration must already be known.
        self.startup_timer = self.create_timer(0.1, self.publish_start, clock=self._status_timer.clock)

    def waiting_for(self) -> str:
        return self.unmatched(self.publisher, "")

    def on_trajectory(self, message: JointTrajectory) -> None:
        """Take a trajectory a controller would accept; refuse any other and stay with the old one."""
        if self.origin_ns is None:
            self.origin_ns = conversions.stamp_ns(message.header.stamp)
        try:
            trajectory = conversions.trajectory_from_message(message, RIGHT_ARM_JOINTS, self.origin_ns)
            self.schedule.add(trajectory.start_s, trajectory)
        except PlanningError as error:
            self.refuse(str(error))

    def publish_start(self) -> None:
        """Publish the start configuration until the first trajectory comes, whatever the clock does."""
        if self.origin_ns is not None:
            self.startup_timer.cancel()
            return
        self.publish_now()

    def on_clock(self, message: Clock) -> None:
        """Publish at every tick of simulated time, but no more often than asked; a clock set back starts anew."""
        now_ns = conversions.stamp_ns(message.clock)
        if not 0 <= now_ns - self.last_ns < self.period_ns:
            self.last_ns = now_ns
            self.publish_state(now_ns)

    def publish_now(self) -> None:
        """Publish where the arm is at the node's own time."""
        self.publish_state(self.get_clock().now().nanoseconds)

    def publish_state(self, now_ns: int) -> None:
        """Publish where the arm is at `now_ns`."""
        q, v = self.rest_q, None
        if self.origin_ns is not None:
            q, v, _ = self.schedule.state_at((now_ns - self.origin_ns) * 1e-9)
        self.publisher.publish(conversions.joint_state(RIGHT_ARM_JOINTS, q, now_ns, v=v))


main = entry_point(SimulatedArm)

if __name__ == "__main__":
    main()
