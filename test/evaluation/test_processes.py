from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import processes_with_environment, wait_until

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.processes import NodeGroup, free_domain_id

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")


def test_a_group_ends_its_nodes_and_keeps_their_logs(tmp_path: Path) -> None:
    with NodeGroup(tmp_path, free_domain_id()) as group:
        node = group.start("simulated_arm", {"scene": "side_by_side", "rate_hz": 50.0})
        marker = f"ROS_LOG_DIR={tmp_path}"
        wait_until(lambda: bool(processes_with_environment(marker)), "the node's process")
        assert node.running
    assert not node.running
    assert processes_with_environment(marker) == []
    assert node.log.exists()


def test_a_node_that_fails_is_reported_with_its_own_words(tmp_path: Path) -> None:
    with NodeGroup(tmp_path, free_domain_id()) as group:
        node = group.start("simulated_arm", {"scene": "no_such_scene"})
        wait_until(lambda: not node.running, "the node to give up")
        assert node.process.returncode == 2
        with pytest.raises(UsageError, match="no_such_scene"):
            group.check()


def test_nodes_do_not_outlive_a_killed_parent(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib\n"
        "from humanpred_ros.evaluation.processes import NodeGroup, free_domain_id\n"
        "group = NodeGroup(pathlib.Path(sys.argv[1]), free_domain_id())\n"
        "group.start('simulated_arm', {'scene': 'face_to_face'})\n"
        "print('started', flush=True)\n"
        "sys.stdin.read()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert parent.stdin is not None
    assert parent.stdout is not None
    try:
        assert parent.stdout.readline() == b"started\n"
        marker = f"ROS_LOG_DIR={tmp_path}"
        wait_until(lambda: bool(processes_with_environment(marker)), "the node's process")
        os.kill(parent.pid, signal.SIGKILL)
        wait_until(lambda: not processes_with_environment(marker), "the orphaned node to end", 20.0)
    finally:
        parent.kill()
        parent.wait()
        parent.stdin.close()
        parent.stdout.close()
