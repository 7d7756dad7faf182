"""Slows the arm near people, and stops it: a process of its own, which hears neither what is predicted nor planned.

Not safety-rated: a formula of a standard, in software that is not certified, on sensors that are not, does not make a
safety function. It is one more line of defence against planners that fail.
"""

from __future__ import annotations

import math
import time
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Int16, String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import human_named
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.inputs import kind_of
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.markers import separation_markers
from humanpred_ros.nodes.measured_arm import MeasuredArm
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.priority import PrioritySettings, threads_named
from humanpred_ros.nodes.watched_people import PeopleSettings, WatchedBody, WatchedPeople
from humanpred_ros.planning.following import FollowingSettings
from humanpred_ros.planning.protective_distance import (
    ProtectiveDistance,
    ProtectiveDistanceSettings,
    SeenBody,
    Separation,
    SpeedFactor,
)
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import setting

_LOOK_AROUND_S = 0.25
#: A reason that stays is repeated so often, for those who come later, s.
_REPEAT_S = 0.5
#: An arm obeys a factor so soon, s.
_OBEYS_S = 0.05
#: Times that are remembered: those of the last 17 s at 30 Hz.
_KEPT = 512


class SeparationGuardSettings(ProtectiveDistanceSettings, PeopleSettings, PrioritySettings, NodeSettings):
    """Parameters of `separation_guard`."""

    scene: str = setting("face_to_face", "scene name in config/scenes, or a YAML file")
    rate_hz: float = setting(
        20.0, "the factor is published so often at least, and with every posture", unit="Hz", low=10.0, high=500.0
    )
    max_arm_age_s: float = setting(
        0.3, "an arm whose joint states have not come for so long is a stop", unit="s", low=0.02, high=60.0
    )
    watch_planner: bool = setting(True, "once a planner was heard, its silence while people are there is a stop")
    max_planner_silence_s: float = setting(
        0.3, "a planner silent for so long is dead, or hangs", unit="s", low=0.05, high=60.0
    )


class SeparationGuard(GraphNode):
    """Publishes what share of its speed the arm may have, so that it stands before a person reaches it.

    The protective distance is that of ISO/TS 15066, for every solid of every body and every sphere of the arm, from
    measured postures and joint states. 0 is a stop, and says why: too close; people or arm that are not seen, or not
    believed; a planner that has fallen silent; somebody else who publishes a factor. The factor falls at once and rises
    slowly. It is published all the time: whoever obeys stops the arm when it does not come.
    """

    def __init__(self) -> None:
        super().__init__("separation_guard")

    def configure(self) -> None:
        self.settings = settings = declare(self, SeparationGuardSettings)
        self.human = human_named(settings.human)
        self.scene = scene = load_scene(settings.scene, check=False)
        self.distance = ProtectiveDistance(
            self.human, scene.arm, scene.T_world_human, settings.part(ProtectiveDistanceSettings)
        )
        # Compiles what is used later.
        person, lower = SeenBody(), self.human.lower
        for k in range(2):
            person.see(lower, 0.1 * k)
        self.distance.separation([person], scene.start, 0.1 + 0.0 * scene.start, 1.0)
        self.real_time = self.come_first(threads_named())  # compiling would keep others waiting

    def activate(self) -> None:
        settings, arm = self.settings, self.scene.arm
        self.arm = MeasuredArm(arm.chain.joint_names, FollowingSettings(), arm.difference)
        self.arm_trouble = ""
        self.pace = SpeedFactor(settings.part(ProtectiveDistanceSettings))
        self.stop, self.others = "nothing has been looked at yet", ""
        self.separation: Separation | None = None
        self.planner_s: float | None = None
        self.said: tuple[str, float] = ("", -math.inf)
        #: From a posture's publication to that of the factor.
        self.took_ms: deque[float] = deque(maxlen=_KEPT)

        self.factor_publisher = self.create_publisher(Int16, topics.SPEED_FACTOR, qos.COMMAND)
        self.stop_publisher = self.create_publisher(String, topics.GUARD_STOP, qos.COMMAND)
        self.marker_publisher = self.create_publisher(MarkerArray, topics.GUARD_MARKERS, qos.MARKERS)
        controller = topics.TRAJECTORY.rpartition("/")[0]
        self.hardware_id = self.resolve_topic_name(controller)
        self.scaling_publisher = None
        try:
            from control_msgs.msg import SpeedScalingFactor
        except ImportError:  # it has no wheel; every robot that runs ros2_controllers has it
            pass
        else:
            self.scaling = SpeedScalingFactor
            self.scaling_publisher = self.create_publisher(
                SpeedScalingFactor, f"{controller}/speed_scaling_input", qos.LATCHED
            )
        self.listen(JointState, topics.JOINT_STATES, self.on_joint_state, qos.ARM, max_age_s=settings.max_arm_age_s)
        if settings.watch_planner:
            self.listen(DiagnosticArray, topics.DECISION, self.on_decision, qos.SENSOR_SUBSCRIBER, raw=True)
        self.seen: dict[str, SeenBody] = {}
        self.compared: list[WatchedBody] = []  #: with the arm, for `separation`
        self.people = WatchedPeople(self, self.human, self.scene, settings.part(PeopleSettings), self.on_people)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a clock that stands still must not silence the guard
        self.timer = self.create_timer(1.0 / settings.rate_hz, self.look, clock=steady)
        self.create_timer(_LOOK_AROUND_S, self.look_around, clock=steady)
        self.look_around()

    def deactivate(self) -> None:
        """Say that the arm has to stand: from now on nobody watches."""
        self._say(0.0, "the guard is ended")

    def waiting_for(self) -> str:
        return f"the arm's joints on {topics.JOINT_STATES}" if self.arm.q is None else ""

    def holding_because(self) -> str:
        return self.stop

    def fault(self) -> str:
        return self.others

    def working(self) -> str:
        return "watching" if self.people.present else super().working()

    def facts(self) -> dict[str, str]:
        facts = {"factor": f"{self.pace.factor:.2f}", "stop": self.stop, "people": str(len(self.people.present))}
        facts["real_time"] = self.real_time
        if self.took_ms:
            for name, share in (("median", 50.0), ("p99", 99.0), ("most", 100.0)):
                facts[f"posture_to_factor_ms/{name}"] = f"{np.percentile(self.took_ms, share):.2f}"
            facts["posture_to_factor_ms/n"] = str(len(self.took_ms))
        found = self.separation
        if found is not None:
            facts |= {
                "wanted_factor": f"{found.factor:.2f}",
                "distance_m": f"{found.distance_m:.3f}",
                "least_distance_m": f"{found.least_m:.3f}",
                "S_p_m": f"{found.protective_m:.3f}",
                "S_h_m": f"{found.person_m:.3f}",
                "S_r_m": f"{found.arm_m:.3f}",
                "S_s_m": f"{found.stopping_m:.3f}",
                "C_m": f"{found.intrusion_m:.3f}",
                "Z_d_m": f"{found.person_uncertainty_m:.3f}",
                "Z_r_m": f"{found.arm_uncertainty_m:.3f}",
                "T_r_s": f"{found.reaction_s:.3f}",
                "T_s_s": f"{found.stopping_s:.3f}",
                "v_h_m_s": f"{found.person_speed_m_s:.3f}",
                "v_r_m_s": f"{found.arm_speed_m_s:.3f}",
                "decided_by": self._pair(found),
            }
        return facts

    def on_joint_state(self, message: JointState) -> bool:
        """Take where the arm is."""
        if not set(message.name) & set(self.scene.arm.chain.joint_names):
            return False  # a gripper's, on the same topic
        try:
            if self.arm.take(message, self.get_clock().now().nanoseconds):
                self.arm_trouble = ""
        except ArrayError as error:
            self.arm_trouble = str(error)
            self.refuse(str(error))
        return True

    def on_decision(self, data: bytes, _: object) -> None:
        """Note that the planner lives, whatever it says, unless it says that it does not command the arm yet.

        Otherwise an arm that was stopped as its planner died would go on with what that one had sent, as soon as
        another one is started.
        """
        now_s = time.monotonic()
        if self.planner_s is None or now_s - self.planner_s > self.settings.max_planner_silence_s:
            decision = deserialize_message(data, DiagnosticArray)
            if any(item.key == conversions.WAITS for status in decision.status[:1] for item in status.values):
                return
        self.planner_s = now_s

    def look_around(self) -> None:
        """Find bodies that have appeared, and others who publish a factor."""
        self.people.look_for_bodies()
        found = self.get_publishers_info_by_topic(topics.SPEED_FACTOR)
        own = (self.get_name(), self.get_namespace())
        others = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found
                  if (info.node_name, info.node_namespace) != own]  # fmt: skip
        if len(found) > max(len(others), 0) + 1:
            others.append("another separation_guard of this name")
        self.others = (
            f"two speed factors: {' and '.join(sorted(others))} publish {topics.SPEED_FACTOR}, too; end all but one"
            if others
            else ""
        )
        self.warn(self.people.warnings())
        self.show()

    def on_people(self, body: WatchedBody, refusal: str) -> None:
        """Compare people and arm because a posture came."""
        if not refusal:
            if body.begins:
                self.seen[body.name] = SeenBody()
            self.seen[body.name].see(body.q, body.t_s)
        self.look()
        self.took_ms.append((time.time_ns() - self.inputs[body.topic].sent_ns) * 1e-6)

    def look(self) -> None:
        """Compare people and arm, and publish what follows."""
        self.timer.reset()
        now_s = time.monotonic()
        self.separation = None
        stop = self._trouble(now_s)
        wanted = 0.0 if stop else 1.0
        self.compared = self.people.present
        if not stop and self.compared:
            assert self.arm.q is not None
            age_s = max(self.people.age_s(now_s), self._arm_age_s(now_s))
            self.separation = found = self.distance.separation(
                [self.seen[body.name] for body in self.compared], self.arm.q, *self._velocity(), age_s
            )
            wanted = found.factor
        factor = self.pace.follow(wanted, now_s)
        if not stop and factor == 0.0:
            stop = f"too close: {self._pair(self.separation)}" if self.separation else "about to set out"
        self._say(factor, stop)

    def _trouble(self, now_s: float) -> str:
        """Return why nobody can say how fast the arm may be; empty if it can be said."""
        settings = self.settings
        if self.others:
            return self.others
        if self.arm_trouble:
            return f"invalid joint states: {self.arm_trouble}"
        if self.arm.q is None:
            return f"no arm: its joints have not come on {topics.JOINT_STATES}"
        age_s = self._arm_age_s(now_s)
        if age_s > settings.max_arm_age_s:
            return f"silent arm: its joint states are {age_s:.2f} s old, allowed are {settings.max_arm_age_s:g} s"
        trouble = self.people.trouble(now_s)
        if trouble:
            return trouble
        if self.planner_s is not None and self.people.present:
            silent_s = now_s - self.planner_s
            if silent_s > settings.max_planner_silence_s:
                return (
                    f"silent planner: no decision has come for {silent_s:.2f} s, allowed are "
                    f"{settings.max_planner_silence_s:g} s"
                )
        return ""

    def _arm_age_s(self, now_s: float) -> float:
        return now_s - self.arm.came_s + self.arm.late_s

    def _velocity(self) -> tuple[FloatArray, float]:
        """Return the arm's velocity (D,), and the factor at which it had it.

        It is what the driver says or what the positions of the last moment show, whichever is faster at factor 1. Both
        are of the past: the present factor would make an arm that is just being slowed down one that hurries.
        """
        arm = self.arm
        told_s, now_s = arm.came_s - arm.late_s, arm.came_s
        told = arm.v, float(self.pace.between(told_s - _OBEYS_S, told_s).max())
        shown = arm.following.velocity, float(self.pace.between(now_s - arm.following.seen_s, now_s).mean())
        return max(shown, told, key=lambda one: abs(one[0]).max() / max(one[1], 0.01))

    def _pair(self, found: Separation) -> str:
        body, joint = self.compared[found.body].name, self.scene.arm.link_names[found.arm_link]
        return (
            f"{found.body_link} of {body} is {found.distance_m:.2f} m from {joint}, protective distance "
            f"{found.protective_m:.2f} m"
        )

    def _say(self, factor: float, stop: str) -> None:
        self.tell((factor == 0.0, kind_of(stop)), f"stop: {stop}" if factor == 0.0 else "the arm may move")
        self.stop = stop
        now_s = time.monotonic()
        if stop != self.said[0] or now_s - self.said[1] > _REPEAT_S:
            # The reason first: whoever hears a stop knows it then.
            self.stop_publisher.publish(String(data=stop))
            self.said = stop, now_s
        self.factor_publisher.publish(Int16(data=round(100.0 * factor)))
        if self.scaling_publisher is not None:
            self.scaling_publisher.publish(self.scaling(factor=factor))

    def show(self) -> None:
        """Publish markers of the pair that decides, while somebody looks."""
        found = self.separation
        if found is not None and self.marker_publisher.get_subscription_count():
            text = "\n".join(f"{name} {value}" for name, value in self.facts().items() if name != "stop")
            stamp = self.get_clock().now().to_msg()
            factor = self.pace.factor
            self.marker_publisher.publish(
                separation_markers(found.body_point_m, found.arm_point_m, text, factor, stamp)
            )


main = entry_point(SeparationGuard)

if __name__ == "__main__":
    main()
