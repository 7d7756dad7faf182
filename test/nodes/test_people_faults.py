"""On the running predictor every kind of bad people's data is a hold that names it, ends by itself, and comes again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.errors import ArrayError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from node_client import NodeClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos

HUMAN = HumanModel.kinect12()
SCENE = load_scene("four_places", check=False)
POSTURE = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q[0]
S = conversions.NS_PER_S


class Person(NodeClient):
    """A person at rest, 20 postures a second, for an occupancy_predictor in a process of its own.

    Attributes:
        said: of the newest occupancy, why nobody knows where people are, "" if that is known, or "nobody".
        voxels: of the occupancies that came, how many each holds.
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.said: str | None = None
        self.voxels: list[int] = []
        self.count, self.rng = 0, np.random.default_rng(0)
        node.create_subscription(PointCloud2, topics.OCCUPANCY, self._take, qos.LOSSLESS)
        self._postures = node.create_publisher(JointState, topics.human_joint_states("body_0"), qos.SENSOR_PUBLISHER)
        return (self._postures,)

    def _take(self, message: PointCloud2) -> None:
        try:
            conversions.occupancy_from_cloud(message, SCENE.grid, 0.0)
        except ArrayError as error:
            self.said = str(error).removeprefix("where people are is not known: ")
        else:
            nobody = conversions.says_nobody(message)
            assert message.width or nobody, "an empty occupancy"
            self.said = "nobody" if nobody else ""
            self.voxels.append(message.width)

    def good(self) -> JointState:
        q = POSTURE + 1e-4 * self.rng.standard_normal(len(POSTURE))
        return conversions.joint_state(HUMAN.dof_names, q, self.now_ns(), "kinect")

    def send(self, fault: str = "") -> None:
        """Send the next posture, with a fault."""
        self.count += 1
        message: Any = self.good()
        q = np.array(message.position)
        if fault == "not finite":
            message.position[5] = np.nan
        elif fault == "missing joints":
            message.name = message.name[:-1]
        elif fault == "joint twice":
            message.name = [*message.name[:-1], message.name[0]]
        elif fault == "units":
            message.position = (q * np.where(["Trans" in name for name in HUMAN.dof_names], 1000.0, 1.0)).tolist()
        elif fault == "outside the lattice":
            message.position[0] = 30.0
        elif fault == "jump":
            message.position[0] += 0.7 * (self.count % 2)
        elif fault == "two people":
            message.position[0] += 0.15 * (self.count % 2)
        elif fault == "frozen":
            message.position = POSTURE.tolist()
        elif fault == "wrong frame":
            message.header.frame_id = ""
        elif fault.startswith("stamp"):
            now_ns = self.now_ns()
            stamps = {"ahead": now_ns + 3 * S, "zero": 0, "back": now_ns - S // 2, "equal": self.first_ns}
            message.header.stamp = conversions.time_message(stamps[fault.split()[1]])
        else:
            self.first_ns = self.now_ns()
            message.header.stamp = conversions.time_message(self.first_ns)
        self._postures.publish(message)

    def until(self, fault: str) -> None:
        """Send postures with a fault until this is said of them; good ones until nothing is, for no fault."""
        self.said = None
        self.send_until(
            lambda: self.send(fault),
            lambda: self.said is not None and self.said.split(":")[0] == fault,
            fault or "an ordinary occupancy",
        )


def test_every_fault_is_a_named_hold_that_ends_and_comes_again(tmp_path: Path) -> None:
    faults = ("not finite", "missing joints", "joint twice", "units", "outside the lattice", "jump", "two people",
              "frozen", "wrong frame", "stamp ahead", "stamp zero", "stamp back", "stamp equal")  # fmt: skip
    with Person(tmp_path, "occupancy_predictor", {"scene": SCENE.name, "predictor": "current"}) as person:
        for _ in range(2):
            for fault in faults:
                person.until("")
                person.until(fault)
                person.wait(lambda: person.diagnostics[0].startswith("holding: "), f"diagnostics of {fault}")
        person.until("")
        person.wait(lambda: person.diagnostics[0] == "predicting", "diagnostics of the end")
        assert all(person.refused(fault) >= 2 for fault in faults)


def test_what_is_wrong_with_one_of_two_people_is_a_hold_until_it_is_right_or_they_left(tmp_path: Path) -> None:
    """Two people, of whom one loses postures, sends bad ones, leaves and comes back; the other goes on."""
    moved = {"body_0": 0.0, "body_1": -0.7}
    with Person(tmp_path, "occupancy_predictor", {"scene": SCENE.name, "predictor": "current"}) as person:
        postures = {"body_0": person._postures}
        postures["body_1"] = person.node.create_publisher(
            JointState, topics.human_joint_states("body_1"), qos.SENSOR_PUBLISHER
        )
        left = person.node.create_publisher(Header, topics.human_left("body_1"), qos.SENSOR_PUBLISHER)
        nobody = person.node.create_publisher(Header, topics.NOBODY, qos.SENSOR_PUBLISHER)

        def frame(*bodies: str, bad: str = "", leaves: bool = False) -> None:
            stamp_ns = person.now_ns()
            for body in bodies:
                message = person.good()
                message.header.stamp = conversions.time_message(stamp_ns)
                message.position[0] += moved[body] + (5000.0 if body == bad else 0.0)
                postures[body].publish(message)
            header = Header(stamp=conversions.time_message(stamp_ns))
            if leaves:
                left.publish(header)
            if not bodies:
                nobody.publish(header)

        def until(condition: Callable[[], bool], what: str, *bodies: str, bad: str = "", leaves: bool = False) -> None:
            person.said, person.voxels = None, []
            person.send_until(lambda: frame(*bodies, bad=bad, leaves=leaves), condition, what)

        def occupied() -> int:
            return person.voxels[-1] if person.voxels and not person.said else 0

        until(lambda: occupied() > 0, "one person", "body_0")
        one = occupied()
        until(lambda: occupied() > 1.5 * one, "both", "body_0", "body_1")
        both = occupied()
        for _ in range(2):
            # A dropout: the last that is known counts, then nobody knows; never is it one person's occupancy.
            until(lambda: (person.said or "").startswith("stale human data: body_1"), "a lost body", "body_0")
            assert all(n > 1.5 * one for n in person.voxels), "the lost one was forgotten"
            until(lambda: occupied() > 1.5 * one, "both again", "body_0", "body_1")
            until(lambda: (person.said or "").startswith("joint limit"), "bad data", "body_0", "body_1", bad="body_1")
            assert "body_1" in person.said
            until(lambda: occupied() > 1.5 * one, "both again", "body_0", "body_1")
            assert abs(occupied() - both) < 0.2 * both
            until(lambda: 0 < occupied() < 1.5 * one, "the one who stayed", "body_0", leaves=True)
            until(lambda: person.said == "nobody", "nobody")
            until(lambda: occupied() > 1.5 * one, "both again", "body_0", "body_1")
        assert person.diagnostics[1]["people"] == "body_0 body_1"
        # A body of another tracker, whose joints are others: told, until somebody turns it into one of ours.
        topic = topics.human_joint_states("rxkdf")
        other = person.node.create_publisher(JointState, topic, qos.SENSOR_PUBLISHER)

        def both_and_other() -> None:
            other.publish(conversions.joint_state(("waist_rxkdf", "p_head_rxkdf"), np.zeros(2), person.now_ns(), ""))
            frame("body_0", "body_1")

        person.said, person.voxels = None, []
        person.send_until(both_and_other, lambda: (person.said or "").startswith("foreign body"), "a foreign body")
        person.node.create_subscription(JointState, topic, lambda message: None, qos.SENSOR_SUBSCRIBER)
        person.send_until(both_and_other, lambda: occupied() > 1.5 * one, "a foreign body that is served")
        person.wait(lambda: person.diagnostics[1]["people"] == "body_0 body_1", "two people")
