"""Over DDS: the guard slows and stops the arm near people, and for whatever it does not see, or not believe."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from node_client import NodeClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, Int16, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.planning.decision import HOLD, Decision

HUMAN = HumanModel.kinect12()
SCENE = load_scene("four_places", check=False)
ARM_JOINTS = SCENE.arm.chain.joint_names
POSTURE = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q[0]
S = conversions.NS_PER_S
#: Behind the person's place, far from the arm; and the way from there to the arm.
FAR_M, NEAR_M, STEP_M = -1.5, 0.9, 0.08


WAITING = conversions.decision_message(Decision(0.0, 0, HOLD, "looking around", None, None), 0, 0.0, waits=True)


class Surroundings(NodeClient):
    """People, an arm that stands, and a planner, for a separation_guard in a process of its own.

    Attributes:
        factor, stop: what the guard said last.
        people: where they stand, by body id, m from the scene's place.
        spoilt: what to do to messages before they are sent, by their senders' names; None sends none.
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.factor, self.stop, self._said = -1, "", ""
        self.factors: list[int] = []
        self.people: dict[str, float] = {}
        self.spoilt: dict[str, Callable[[JointState], JointState | None]] = {}
        self.planner = self.nobody = False
        self.left: set[str] = set()
        self.decision = DiagnosticArray()
        self.rng = np.random.default_rng(0)
        self._bodies: dict[str, Publisher] = {}
        self._left: dict[str, Publisher] = {}
        self._at_m: dict[str, float] = {}
        node.create_subscription(String, topics.GUARD_STOP, self._on_stop, qos.COMMAND)
        node.create_subscription(Int16, topics.SPEED_FACTOR, self._on_factor, qos.COMMAND)
        self._arm = node.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        self._decisions = node.create_publisher(DiagnosticArray, topics.DECISION, qos.SENSOR_PUBLISHER)
        self._nobody = node.create_publisher(Header, topics.NOBODY, qos.SENSOR_PUBLISHER)
        node.create_timer(0.03, self._send)
        return (self._arm, self._decisions)

    def _on_stop(self, message: String) -> None:
        self._said = message.data

    def _on_factor(self, message: Int16) -> None:
        self.factor, self.stop = message.data, self._said
        self.factors.append(message.data)

    def _send(self) -> None:
        at_start = conversions.joint_state(ARM_JOINTS, SCENE.start, self.now_ns(), v=np.zeros(len(ARM_JOINTS)))
        self._publish(self._arm, "arm", at_start)
        for body, goal_m in self.people.items():
            before_m = self._at_m.get(body, goal_m)
            away_m = self._at_m[body] = before_m + float(np.clip(goal_m - before_m, -STEP_M, STEP_M))
            if body not in self._bodies:
                topic = topics.human_joint_states(body)
                self._bodies[body] = self.node.create_publisher(JointState, topic, qos.SENSOR_PUBLISHER)
            q = POSTURE + 1e-4 * self.rng.standard_normal(len(POSTURE))
            q[HUMAN.dof_names.index("PelvisTransY")] += away_m
            message = conversions.joint_state(HUMAN.dof_names, q, self.now_ns(), "kinect")
            self._publish(self._bodies[body], body, message)
        if self.planner:
            self._decisions.publish(self.decision)
        for body in self.left - self._left.keys():
            self._left[body] = self.node.create_publisher(Header, topics.human_left(body), qos.SENSOR_PUBLISHER)
        for body in self.left:
            self._left[body].publish(Header(stamp=conversions.time_message(self.now_ns())))
        if self.nobody:
            self._nobody.publish(Header(stamp=conversions.time_message(self.now_ns())))

    def _publish(self, publisher: Publisher, whose: str, message: JointState) -> None:
        spoilt = self.spoilt.get(whose, lambda message: message)(message)
        if spoilt is not None:
            publisher.publish(spoilt)

    def stops(self, reason: str) -> None:
        self.wait(lambda: self.factor == 0 and reason in self.stop, f"a stop that says {reason}")

    def moves(self) -> None:
        self.wait(lambda: self.factor > 50 and not self.stop, f"the arm to move, not: {self.stop}")


@pytest.fixture
def around(tmp_path: Path) -> Iterator[Surroundings]:
    with Surroundings(tmp_path, "separation_guard", {"scene": "four_places", "rise_per_s": 2.0}) as surroundings:
        yield surroundings


def without_first(message: JointState) -> JointState:
    message.name, message.position = message.name[1:], message.position[1:]
    return message


def an_hour_ahead(message: JointState) -> JointState:
    message.header.stamp.sec += 3600
    return message


def nowhere(message: JointState) -> JointState:
    message.header.frame_id = "nowhere"
    return message


def not_a_number(message: JointState) -> JointState:
    message.position[2] = np.nan
    return message


def test_the_arm_may_move_only_while_everything_is_seen_and_nobody_is_near(around: Surroundings) -> None:
    around.stops("no people")
    around.people["anna"] = FAR_M
    around.moves()
    for _ in range(2):
        around.people["anna"] = NEAR_M
        around.stops("too close: ")
        around.people["anna"] = FAR_M
        around.moves()
    for whose, spoil, reason in (
        ("anna", lambda message: None, "stale human data: anna"),
        ("anna", without_first, "missing joints"),
        ("anna", not_a_number, "not finite"),
        ("anna", an_hour_ahead, "stamp ahead"),
        ("anna", nowhere, "wrong frame"),
        ("arm", lambda message: None, "silent arm"),
        ("arm", without_first, "missing joints"),
        ("arm", not_a_number, "not finite"),
    ):
        for _ in range(2):
            around.spoilt[whose] = spoil
            around.stops(reason)
            del around.spoilt[whose]
            around.moves()


def test_every_body_counts_and_has_left_only_if_a_tracker_says_so(around: Surroundings) -> None:
    around.people |= {"anna": FAR_M, "bert": FAR_M}
    around.moves()
    around.people["bert"] = NEAR_M
    around.stops("too close")
    assert " of bert is " in around.stop
    del around.people["bert"]
    around.stops("stale human data: bert")
    around.left.add("bert")  # and not the other one
    around.moves()
    around.left.clear()
    around.people["bert"] = NEAR_M
    around.stops("too close")
    around.factors.clear()
    around.people["bert"] = FAR_M
    around.moves()
    del around.people["bert"]
    around.left.add("bert")
    around.wait(lambda: around.factors[-30:].count(100) == 30, "the arm to go on although one has left")
    around.left.clear()
    around.people["bert"] = FAR_M
    around.wait(lambda: around.diagnostics[1].get("people") == "2", "both to be seen")
    del around.people["bert"]
    around.stops("stale human data: bert")
    around.people.clear()
    around.nobody = True
    around.moves()
    around.nobody = False
    around.stops("no people")
    around.people["anna"] = FAR_M
    around.moves()


def test_a_planner_that_falls_silent_and_a_second_factor_are_stops_and_the_terms_are_told(
    around: Surroundings,
) -> None:
    around.people["anna"] = FAR_M
    around.moves()  # nobody has heard of a planner
    around.planner = True
    around.wait(lambda: "0" <= around.diagnostics[1].get("input/stomp_planner/decision/age_s", "none")[:1] <= "9", "it")
    around.moves()
    around.planner = False
    around.stops("silent planner")
    # Another one is there, but does not command the arm yet: it would go on with what the dead one has sent.
    around.planner, around.decision = True, WAITING
    n_before = len(around.factors)
    around.wait(lambda: len(around.factors) > n_before + 30, "the guard to hear it")
    assert not any(around.factors[n_before:])
    around.decision = DiagnosticArray()
    around.moves()
    second = around.node.create_publisher(Int16, topics.SPEED_FACTOR, qos.COMMAND)
    around.stops("two speed factors: /separation_guard_client")
    around.node.destroy_publisher(second)
    around.moves()
    pictures: list[MarkerArray] = []
    around.node.create_subscription(MarkerArray, topics.GUARD_MARKERS, pictures.append, qos.MARKERS)
    around.wait(lambda: bool(pictures), "the terms as markers")
    around.wait(lambda: "S_p_m" in around.diagnostics[1], "the terms on /diagnostics")
    terms = {name: around.diagnostics[1][name] for name in ("S_h_m", "S_r_m", "S_s_m", "C_m", "Z_d_m", "Z_r_m")}
    assert abs(sum(map(float, terms.values())) - float(around.diagnostics[1]["S_p_m"])) < 0.01, terms
    assert around.process.running


def test_the_arm_stands_while_the_guard_is_not_heard(around: Surroundings) -> None:
    speeds: list[float] = []
    around.spoilt["arm"] = lambda message: None
    around.group.start("simulated_arm", {"scene": "four_places", "guard": True})
    around.node.create_subscription(
        JointState, topics.JOINT_STATES, lambda message: speeds.append(np.abs(message.velocity).max()), qos.ARM
    )
    commands = around.node.create_publisher(JointTrajectory, topics.TRAJECTORY, qos.COMMAND)
    around.wait(lambda: commands.get_subscription_count() > 0, "the arm to listen")
    around.people["anna"] = FAR_M
    around.moves()
    there = SCENE.start + 0.5 * (np.arange(len(ARM_JOINTS)) == 0)
    points = [JointTrajectoryPoint(positions=q.tolist(), time_from_start=Duration(sec=t))
              for q, t in ((SCENE.start, 1), (there, 300))]  # fmt: skip
    commands.publish(JointTrajectory(joint_names=list(ARM_JOINTS), points=points))

    def moving() -> bool:
        return bool(speeds) and speeds[-1] > 1e-4

    def standing() -> bool:
        speeds.clear()
        around.wait(lambda: len(speeds) >= 5, "the arm to say where it is")
        return max(speeds) <= 1e-4

    around.wait(moving, "the arm to move")
    pid = around.process.process.pid
    for _ in range(2):
        os.kill(pid, signal.SIGSTOP)
        around.wait(standing, "the arm to stand while the guard hangs")
        os.kill(pid, signal.SIGCONT)
        around.wait(moving, "the arm to go on")
    os.kill(pid, signal.SIGKILL)
    around.process = around.group.start("separation_guard", {"scene": "four_places"})
    around.wait(standing, "the arm to stand without a guard")
    around.wait(moving, "the arm to go on with another guard", timeout_s=60.0)
