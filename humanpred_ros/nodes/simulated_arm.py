"""Stands in for the robot: an arm behind a joint trajectory controller, which reports its joint states."""

from __future__ import annotations

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.guard_listener import GuardListener
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.priority import PrioritySettings, threads_named
from humanpred_ros.nodes.trajectory_action import TrajectoryActionServer
from humanpred_ros.nodes.trajectory_controller import ControllerSettings, TrajectoryController
from humanpred_ros.robot.scene_file import read_scene_file, start_of
from humanpred_ros.settings import setting

_GUARD_PERIOD_S = 0.02


class SimulatedArmSettings(ControllerSettings, PrioritySettings, NodeSettings):
    """Parameters of `simulated_arm`."""

    scene: str = setting("face_to_face", "scene whose start configuration the arm is in")
    rate_hz: float = setting(50.0, "joint states per second", unit="Hz", low=1.0, high=1000.0)
    velocity_limit: float = setting(
        4.0, "no joint is faster, whatever is commanded", unit="rad/s", low=0.01, high=100.0
    )
    speed_factor: float = setting(
        1.0, "speed of the trajectory's time; 0 is a pause", low=0.0, high=1.0, changeable=True
    )
    guard: bool = setting(
        False, "there must be a separation guard: the arm stands until it is heard; one that was heard once must stay"
    )
    stuck: bool = setting(False, "the arm does not move, as in an emergency stop", changeable=True)


class SimulatedArm(GraphNode):
    """Starts at the scene's start configuration and does what a stock controller does with what it is sent.

    It is commanded by topic, and by the action FollowJointTrajectory where control_msgs is installed. It obeys a
    separation guard, whose silence is a stop once it was heard, and the controller's own topic for a speed factor.
    """

    def __init__(self) -> None:
        super().__init__("simulated_arm")

    def configure(self) -> None:
        self.settings = settings = declare(self, SimulatedArmSettings)
        self.joint_names, start = start_of(read_scene_file(settings.scene))
        self.controller = TrajectoryController(
            self.joint_names, start, settings.velocity_limit, settings.part(ControllerSettings)
        )
        self.controller.stuck = settings.stuck
        #: Factors of the trajectory's time by whom they are from.
        self.factors = {"speed_factor": settings.speed_factor}

    def activate(self) -> None:
        rate_hz = self.settings.rate_hz
        self.ended = ""
        # Made first: an executor without events takes a trajectory and a clock tick that wait together in this order.
        commands = self.listen(JointTrajectory, topics.TRAJECTORY, self.on_trajectory, qos.COMMAND)
        self.hardware_id = commands.topic_name.rpartition("/")[0]
        self.action: TrajectoryActionServer | None = None
        try:
            self.action = TrajectoryActionServer(self, self.controller)
        except UsageError as missing:
            self.get_logger().debug(str(missing))
        self.guard = GuardListener(self, self.settings.guard, self.on_guard)
        self.on_guard(self.guard.factor, self.guard.reason)
        steady = self._status_timer.clock
        self.create_timer(_GUARD_PERIOD_S, self.guard.look, clock=steady)
        self._listen_to_scaling()
        self.publisher = self.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        self.period_ns = round(conversions.NS_PER_S / rate_hz)
        self.last_ns = -self.period_ns
        if self.get_parameter("use_sim_time").value:
            # A timer would skip ticks that come close together in wall time; every one matters in a stepped run.
            self.listen(Clock, topics.CLOCK, self.on_clock, qos.LOSSLESS)
        else:
            self.create_timer(1.0 / rate_hz, self.publish_now)
        # Before /clock ticks (it may wait for us), the start configuration must already be known.
        self.come_first(threads_named())  # as the controllers it stands in for do
        self.startup_timer = self.create_timer(0.1, self.publish_start, clock=steady)

    def deactivate(self) -> None:
        """Rest where the arm is."""
        self.controller.hold()

    def waiting_for(self) -> str:
        return self.unmatched("", self.publisher)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Slow down, pause or hold the arm at run time."""
        for parameter in parameters:
            if parameter.name == "speed_factor":
                self._let(parameter.name, parameter.value)
            elif parameter.name == "stuck":
                self.controller.stuck = parameter.value
        return SetParametersResult(successful=True)

    def holding_because(self) -> str:
        return self.guard.reason

    def on_guard(self, factor: float, reason: str) -> None:
        """Do what the guard says."""
        self.tell(factor == 0.0, f"stands: {reason}" if factor == 0.0 else "may move, says the guard")
        self._let("guard", factor)

    def _listen_to_scaling(self) -> None:
        """Listen to the topic of the controller of that name for a factor, where its messages are installed."""
        try:
            from control_msgs.msg import SpeedScalingFactor
        except ImportError:
            return

        def on_scaling(message: SpeedScalingFactor) -> None:
            if 0.0 <= message.factor <= 1.0:
                self._let("controller", message.factor)
            else:
                self.refuse(f"speed scaling: wanted a factor from 0 to 1, got {message.factor:g}")

        self.listen(SpeedScalingFactor, f"{self.hardware_id}/speed_scaling_input", on_scaling, qos.LATCHED)

    def _let(self, whose: str, factor: float) -> None:
        """Let the trajectory's time run at the least of the factors, from now on."""
        self.factors[whose] = factor
        if not self.get_parameter("use_sim_time").value:
            self.controller.update(self.get_clock().now().nanoseconds)
        self.controller.speed_factor = min(self.factors.values())

    def on_trajectory(self, message: JointTrajectory) -> None:
        """Take a trajectory a controller would accept; refuse any other and stay with the old one."""
        refusal = self.controller.command(message, self.get_clock().now().nanoseconds)
        if refusal:
            self.refuse(refusal)
        elif self.action is not None:
            self.action.replaced("a trajectory came on the topic")

    def publish_start(self) -> None:
        """Publish the start configuration until the first trajectory comes, whatever the clock does."""
        if self.controller.commanded:
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
        self.controller.update(now_ns)
        if self.controller.ended != self.ended:
            self.ended = self.controller.ended
            self.warn({"trajectory": f"given up: {self.ended}"} if self.ended else {})
        if self.action is not None:
            self.action.tell(now_ns)
        q, v = self.controller.q, self.controller.v
        self.publisher.publish(conversions.joint_state(self.joint_names, q, now_ns, v=v))


main = entry_point(SimulatedArm)

if __name__ == "__main__":
    main()
