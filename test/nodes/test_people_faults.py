"""On the running predictor every kind of bad people's data is a hold that names it, ends by itself, and comes again."""

from __future__ import annotations

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

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos

HUMAN = HumanModel.kinect12()
SCENE = load_scene("four_places", check=False)
POSTURE = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q[0]
S = conversions.NS_PER_S


class Person(NodeClient):
    """A person at rest, 20 postures a second, for an occupancy_predictor in a process of its own.

    Attributes:
        said: of the newest occupancy, why nobody knows where people are, "" if that is known.
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.said: str | None = None
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
            assert message.width, "an empty occupancy"
            self.said = ""

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
