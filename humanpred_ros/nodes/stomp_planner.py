"""Keeps the arm working on the task that disturbs the person least."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.markers import candidate_markers, rollout_markers
from humanpred_ros.nodes.parameters import declare, plugin_parameters
from humanpred_ros.planning.decision import HOLD, Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import Given
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import Settings, setting, setting_of
from humanpred_ros.stomp.config import StompConfig

_WATCH_PERIOD_S = 0.05
#: Share of a step after its occupancy's stamp that STOMP may take in real time: few goals answer sooner.
_SHARE_PER_GOAL, _LEAST_SHARE = 0.16, 0.25


class StompPlannerSettings(Settings):
    """Parameters of `stomp_planner`."""

    scene: str = setting("face_to_face", "scene name in config/scenes, or a YAML file")
    period_s: float = setting_of(ReplannerConfig, "period_s")
    seed: int = setting_of(ReplannerConfig, "seed")
    threads: int = setting_of(ReplannerConfig, "threads")
    waypoints: int = setting_of(StompConfig, "waypoints")
    iterations: int = setting_of(StompConfig, "iterations", low=1)
    rollouts: int = setting_of(
        StompConfig, "rollouts", description="noisy rollouts per iteration, half of them reused", low=2
    )
    noise_std: float = setting_of(StompConfig, "noise_std")
    cost_terms: tuple[str, ...] = setting_of(ReplannerConfig, "cost_terms")
    noise_decay: float = setting_of(StompConfig, "noise_decay")
    velocity_scale: float = setting_of(ReplannerConfig, "velocity_scale")
    acceleration_limit: float = setting_of(ReplannerConfig, "acceleration_limit")
    min_improvement: float = setting_of(ReplannerConfig, "min_improvement")
    padding_m: float = setting_of(ReplannerConfig, "padding_m")
    human_margin_m: float = setting_of(ReplannerConfig, "human_margin_m")
    min_separation_m: float = setting_of(ReplannerConfig, "min_separation_m")
    likely_probability: float = setting_of(ReplannerConfig, "likely_probability")
    controller: str = setting("", "node that must be listening to the trajectories before this one is ready")
    listener: str = setting("", "node that must be listening to the decisions before this one is ready")
    max_human_age_s: float = setting(0.5, "older human occupancy leads to a hold", unit="s", low=0.02, high=60.0)
    stomp_share: float = setting(
        0.6,
        "share of a step after which STOMP must stop in real time, with many goals; sooner with few",
        low=0.05,
        high=0.95,
    )
    lossless: bool = setting(False, "subscribe reliably and keep every occupancy (stepped runs)")

    def replanner_config(self, cost_terms: Given | None = None) -> ReplannerConfig:
        """Return the replanner's settings these parameters, and those of cost terms, stand for."""
        stomp = self.part(StompConfig, reused=self.rollouts // 2)
        return self.part(ReplannerConfig, stomp=stomp, cost_term_settings=dict(cost_terms or {}))


class StompPlannerNode(GraphNode):
    """P1's Algorithm 1 on topics: an occupancy comes in, a decision goes out, and a trajectory when due.

    Every occupancy is answered by exactly one decision with the same stamp. Human data that are stale,
    or that cannot be used, lead to a hold with a named reason, never to planning as if nobody were there.
    """

    def __init__(self) -> None:
        super().__init__("stomp_planner")
        self.settings = settings = declare(self, StompPlannerSettings)
        self.scene = load_scene(settings.scene)
        with compiled.announced("STOMP planner", self.get_logger().info):
            config = settings.replanner_config(plugin_parameters(self, settings.cost_terms))
            self.replanner = Replanner.for_scene(self.scene, config)
            self.replanner.warm_up()
        self.arm_q: FloatArray | None = None
        self.begun = self.holding = False
        self.origin_ns = self.last_ns = self.last_now_ns = 0

        self.trajectory_publisher = self.create_publisher(JointTrajectory, topics.TRAJECTORY, qos.COMMAND)
        self.decision_publisher = self.create_publisher(DiagnosticArray, topics.DECISION, qos.SENSOR_PUBLISHER)
        self.candidate_publisher = self.create_publisher(MarkerArray, topics.CANDIDATES, qos.MARKERS)
        self.rollout_publisher = self.create_publisher(MarkerArray, topics.ROLLOUTS, qos.MARKERS)
        self.add_on_set_parameters_callback(self.on_parameters)
        self.create_subscription(JointState, topics.JOINT_STATES, self.on_joint_state, qos.NEWEST_ONLY)
        self.create_subscription(
            PointCloud2,
            topics.OCCUPANCY,
            self.on_occupancy,
            qos.sensor_subscription(settings.lossless, newest_only=True),
        )
        self.create_timer(_WATCH_PERIOD_S, self.watch)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take the noise of the rollouts at run time; everything else is read-only."""
        for parameter in parameters:
            if parameter.name == "noise_std":
                self.replanner.set_noise(parameter.value)
        return SetParametersResult(successful=True)

    def waiting_for(self) -> str:
        if self.arm_q is None:
            return f"the arm's joints on {topics.JOINT_STATES}"
        listening = self.unmatched(self.decision_publisher, self.settings.listener) if self.settings.listener else ""
        return self.unmatched(self.trajectory_publisher, self.settings.controller) or listening

    def on_joint_state(self, message: JointState) -> None:
        """Remember where the arm is: planning begins there, and begins anew when the clock jumps back."""
        try:
            self.arm_q = conversions.ordered_positions(message, self.replanner.joint_names)
        except ArrayError as error:
            self.refuse(str(error))

    def on_occupancy(self, message: PointCloud2) -> None:
        """Answer one occupancy with one decision."""
        received_s = time.perf_counter()
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        if self.arm_q is None:
            self.refuse("no arm: an occupancy came before the arm's joint states")
            return
        now_ns = self.get_clock().now().nanoseconds
        age_s = (now_ns - stamp_ns) * 1e-9
        stale = age_s > self.settings.max_human_age_s and not self.settings.lossless
        back = self.begun and stamp_ns < self.last_ns
        if not self.begun or (back and (self.settings.lossless or now_ns < self.last_now_ns)):
            try:
                self.replanner.start(self.arm_q, 0.0)
            except PlanningError as error:
                self.refuse(str(error))
                return
            self.begun, self.origin_ns, self.last_ns = True, stamp_ns, stamp_ns
        elif back and not stale:  # overtaken by a newer one: the clock has not jumped back, so neither has the arm
            self.refuse("stamp not increasing: an occupancy came after a newer one")
            return
        self.last_ns, self.last_now_ns = max(self.last_ns, stamp_ns), now_ns
        t_s = (stamp_ns - self.origin_ns) * 1e-9
        try:
            occupancy = conversions.occupancy_from_cloud(message, self.scene.grid, t_s)
        except ArrayError as error:
            self.refuse(str(error))
            self.publish(self.replanner.hold(self.now_s(), f"invalid human data: {error}"), stamp_ns, received_s)
            return
        if stale:
            self.publish(self.replanner.hold(self.now_s(), self.stale(age_s)), stamp_ns, received_s)
            return
        self.holding = False
        self.publish(self.decide(occupancy), stamp_ns, received_s)

    def decide(self, occupancy: Occupancy) -> Decision:
        """Replan when a step is due or called for; a plan that comes too late to be switched to is not sent.

        In real time STOMP stops iterating when time runs out, so that an overloaded machine gets a poorer plan
        rather than none. Stepped runs take the time they need, which makes them the same on every machine.
        """
        self.replanner.keep_rollouts = self.rollout_publisher.get_subscription_count() > 0
        if self.settings.lossless:
            return self.replanner.respond(occupancy)
        share = max(_SHARE_PER_GOAL * len(self.replanner.goal_names), _LEAST_SHARE)
        enough_s = occupancy.t_s + min(share, self.settings.stomp_share) * self.settings.period_s
        return self.replanner.respond(occupancy, self.now_s, lambda: self.now_s() >= enough_s)

    def stale(self, age_s: float) -> str:
        """Return the reason of a hold because human data are too old."""
        return f"stale human data: {age_s:.2f} s old, at most {self.settings.max_human_age_s:g} s allowed"

    def now_s(self) -> float:
        """Return the node's time in seconds after the first occupancy."""
        return (self.get_clock().now().nanoseconds - self.origin_ns) * 1e-9

    def watch(self) -> None:
        """Hold when the last human data have become too old to act on; an arm at rest holds already."""
        if not self.begun or self.holding or self.replanner.at_rest(self.now_s()):
            return
        age_s = (self.get_clock().now().nanoseconds - self.last_ns) * 1e-9
        if age_s > self.settings.max_human_age_s:
            self.holding = True
            self.publish(self.replanner.hold(self.now_s(), self.stale(age_s)), self.last_ns, time.perf_counter())

    def publish(self, decision: Decision, stamp_ns: int, received_s: float) -> None:
        """Send the trajectory first, then the decision: who waits for the decision finds the arm informed."""
        compute_ms = 1e3 * (time.perf_counter() - received_s)
        if decision.trajectory is not None:
            self.trajectory_publisher.publish(
                conversions.trajectory_message(self.replanner.joint_names, decision.trajectory, self.origin_ns)
            )
        if decision.goals or decision.action == HOLD:
            # People want to see what changes; that a goal is kept is only worth a look when searching a fault.
            log = self.get_logger().debug if decision.action == "keep" else self.get_logger().info
            log(f"t {decision.stamp_s:5.2f} s  {decision.summary()}")
        self.decision_publisher.publish(conversions.decision_message(decision, stamp_ns, compute_ms))
        if decision.goals and self.candidate_publisher.get_subscription_count():
            paths = [
                (goal.name, self.replanner.tool_path(goal.path), goal.name == decision.chosen)
                for goal in decision.goals
            ]
            self.candidate_publisher.publish(candidate_markers(paths, conversions.time_message(stamp_ns)))
        if decision.goals and self.replanner.rollouts:
            noisy = [
                (name, [self.replanner.tool_path(path) for path in paths])
                for name, paths in self.replanner.rollouts.items()
            ]
            self.rollout_publisher.publish(rollout_markers(noisy, conversions.time_message(stamp_ns)))


main = entry_point(StompPlannerNode)

if __name__ == "__main__":
    main()
