"""A recorder that is killed loses less than a second; one whose disk refuses says so, and keeps what it has."""

from __future__ import annotations

import os
import resource
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.salvage import check_bag, salvage_bag

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from diagnostic_msgs.msg import DiagnosticStatus
from node_client import NodeClient
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos

LOSS_S = 1.0


class RecorderClient(NodeClient):
    """Sends joint states, 100 a second, each stamped with when it was sent."""

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self._arm = node.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
        node.create_timer(0.01, self._send)
        self.sent_ns = 0
        return (self._arm,)

    def _send(self) -> None:
        self.sent_ns = self.now_ns()
        self._arm.publish(conversions.joint_state(["a"], [0.0], self.sent_ns))


@pytest.mark.parametrize("after_bytes", [4_000, 15_000, 22_000])
def test_a_killed_recorder_loses_less_than_a_second(tmp_path: Path, after_bytes: int) -> None:
    with RecorderClient(tmp_path, "run_recorder", {"output": str(tmp_path / "bag")}) as client:
        file = tmp_path / "bag" / "bag_0.mcap"
        client.wait(lambda: file.stat().st_size > after_bytes, "something to be recorded")
        # What was recorded first may be diagnostics only.
        n_bytes, topic = file.stat().st_size, topics.JOINT_STATES.encode()
        client.wait(lambda: topic in file.read_bytes() and file.stat().st_size > n_bytes, "the arm to be recorded")
        os.kill(client.process.process.pid, signal.SIGKILL)
        sent_ns = client.sent_ns
        client.process.process.wait()
        client.group.nodes.clear()
    salvage_bag(tmp_path / "bag", tmp_path / "saved")
    *_, (_, last) = BagReader(tmp_path / "saved").decoded(topics.JOINT_STATES)
    assert sent_ns - conversions.stamp_ns(last.header.stamp) < LOSS_S * conversions.NS_PER_S


def fill_disk(client: RecorderClient, bag: Path) -> None:
    """Stand in for a full disk: no file of the recorder may grow."""
    limit = next(bag.glob("*.mcap")).stat().st_size + 2000
    resource.prlimit(client.process.process.pid, resource.RLIMIT_FSIZE, (limit, limit))


def remove(client: RecorderClient, bag: Path) -> None:
    shutil.rmtree(bag)


@pytest.mark.parametrize(("spoil", "words"), [(fill_disk, "File too large"), (remove, "was removed")])
def test_a_recorder_whose_disk_refuses_says_so_and_stays(
    tmp_path: Path, spoil: Callable[[RecorderClient, Path], None], words: str
) -> None:
    bag = tmp_path / "bag"
    with RecorderClient(tmp_path, "run_recorder", {"output": str(bag), "wait_for": ""}) as client:
        client.wait(lambda: client.diagnostics[0] == "recording", "the recording")
        assert client.level == DiagnosticStatus.OK
        client.wait(lambda: next(bag.glob("*.mcap")).stat().st_size > 12_000, "something to be recorded")
        spoil(client, bag)
        client.wait(lambda: client.level == DiagnosticStatus.ERROR, "the recorder to say so")
        assert client.diagnostics[0].startswith("not recording: ")
        assert words in client.diagnostics[0]
        client.process.process.send_signal(signal.SIGINT)
        assert client.process.process.wait(timeout=20) == 2
        log = client.process.log.read_text(encoding="utf-8")
        assert log.count("not recording: ") == 1
        assert "Traceback" not in log
    if spoil is fill_disk:
        assert check_bag(bag).ok
        assert BagReader(bag).require_topic(topics.JOINT_STATES).count > 0


def test_without_stay_it_ends(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with RecorderClient(tmp_path, "run_recorder", {"output": str(bag), "stay": False}) as client:
        fill_disk(client, bag)
        assert client.process.process.wait(timeout=20) == 2
        assert "cannot be written" in client.process.tail().splitlines()[-1]
