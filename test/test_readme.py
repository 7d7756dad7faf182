"""The README's commands exist, its tables name what is there."""

from __future__ import annotations

import re
import shlex

import pytest
from paths import REPOSITORY

from humanpred_ros.cli import parse

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
COMMANDS = sorted(set(re.findall(r"(?:^|`)humanpred ([a-z][^`#\n]*)", README, flags=re.MULTILINE)))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_readme_is_understood(command: str) -> None:
    run, _ = parse(shlex.split(command))
    assert callable(run)


def test_the_commands_were_found() -> None:
    assert len(COMMANDS) >= 8


def test_every_node_and_topic_is_named() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    from humanpred_ros import topics

    for source in (REPOSITORY / "humanpred_ros" / "nodes").glob("*.py"):
        if "main = entry_point(" in source.read_text(encoding="utf-8"):
            assert f"`{source.stem}`" in README
    published = ("OCCUPANCY", "VOXEL_GRID", "HUMAN_GOALS", "JOINT_STATES", "TRAJECTORY", "DECISION")
    for name in (*published, "CANDIDATES", "ROLLOUTS"):
        assert f"`{getattr(topics, name)}`" in README
    for topic in (topics.human_joint_states("<id>"), topics.human_urdf("<id>"), topics.human_markers("<id>")):
        assert f"`{topic}`" in README


def test_the_two_commands_come_first() -> None:
    first, second = re.findall(r"^```bash (\w+)\n(.+?)\n```", README, flags=re.MULTILINE | re.DOTALL)[:2]
    assert first[0] == "demo"
    assert first[1].endswith("humanpred demo")
    assert second[0] == "test"
    assert second[1].endswith("pytest")
