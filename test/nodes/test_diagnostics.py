"""What a node says of itself on /diagnostics is what it does: OK only while it works, and what it waits for by name."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from paths import REPOSITORY

from humanpred_ros.motion.library_io import load_library

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from diagnostic_msgs.msg import DiagnosticStatus
from node_client import NodeClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from reference import node_settings
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos

MOTION = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0]
POSTURES = f"/{topics.human_joint_states('body_0')}"
OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


class TrackerClient(NodeClient):
    """Plays the tracker and the planner of a predictor."""

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        node.create_subscription(conversions.PointCloud2, topics.OCCUPANCY, lambda _: None, qos.LOSSLESS)
        self._human = node.create_publisher(JointState, POSTURES, qos.SENSOR_PUBLISHER)
        self.frame = 0
        return (self._human,)

    def send(self, spoil: bool = False) -> None:
        """Send the next posture of the motion, over and over, or one without its last joint."""
        q = MOTION.q[self.frame % len(MOTION)]
        self.frame += 1
        names = MOTION.dof_names[:-1] if spoil else MOTION.dof_names
        self._human.publish(conversions.joint_state(names, q[: len(names)], self.now_ns(), MOTION.frame_id))

    def value(self, name: str) -> float:
        return float(self.diagnostics[1].get(f"input{POSTURES}/{name}", "nan"))


@pytest.mark.core
def test_a_predictor_is_ok_only_while_postures_come(tmp_path: Path) -> None:
    parameters = {"predictor": "current", "max_hand_speed_m_s": 100.0, "max_pelvis_speed_m_s": 100.0}
    with TrackerClient(tmp_path, "occupancy_predictor", parameters) as client:
        client.wait(lambda: client.diagnostics[0] == "ready", "readiness")
        assert client.level == OK
        assert client.diagnostics[1][f"input{POSTURES}/age_s"] == "none came"
        for _ in range(2):
            n_refused = client.refused("missing joints")
            client.send_until(client.send, lambda: client.level == OK and client.value("rate_hz") > 2.0, "predictions")
            assert client.diagnostics[0] == "predicting"
            assert client.value("age_s") < 1.0
            assert client.value("latency_ms") > 0.0
            client.send_until(
                lambda: client.send(spoil=True),
                lambda n=n_refused: client.refused("missing joints") > n + 3,
                "refusals",
            )
            assert client.level == WARN, "something was refused lately"
            client.send_until(client.send, lambda: client.level == OK, "the refusals to be past")
            client.wait(lambda: client.level == WARN, "the silence to be noticed")
            assert client.diagnostics[0].startswith(f"waiting for {POSTURES}: its publisher is there, but nothing")
            assert client.diagnostics[1]["ready"] == "true", "whoever waits for it may begin"
        log = client.process.log.read_text(encoding="utf-8")
        assert log.count("refused missing joints") == 2, "once each time they begin"


@pytest.mark.parametrize("namespace", ["", "/robot1/"])
def test_every_node_is_in_one_group_of_the_aggregator(namespace: str) -> None:
    written = yaml.safe_load((REPOSITORY / "config" / "diagnostics.yaml").read_text(encoding="utf-8"))
    groups = {name: group for name, group in written["analyzers"]["ros__parameters"].items() if name != "path"}
    assert set(groups) == {"robot", "people", "planning", "recording"}
    for node in node_settings():
        status = f"{namespace}{node}"
        found = [name for name, group in groups.items() if any(part in status for part in group["contains"])]
        assert len(found) == 1, (status, found)
