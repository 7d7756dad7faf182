"""The files for RViz and Foxglove name topics that are published, and show all markers."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
import yaml
from paths import REPOSITORY

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from rclpy.qos import ReliabilityPolicy

from humanpred_ros import topics
from humanpred_ros.nodes import qos

MARKERS = {
    topics.human_markers("body_0"),
    topics.OCCUPANCY_MARKERS,
    topics.CANDIDATES,
    topics.FUTURES,
    topics.ROLLOUTS,
    topics.GUARD_MARKERS,
}
OTHERS = {
    topics.DECISION,
    topics.DIAGNOSTICS.lstrip("/"),
    topics.SPEED_FACTOR,
    topics.COSTS,
    topics.POSTERIOR,
    "robot_description",
}


def texts(content: Any) -> list[str]:
    if isinstance(content, dict):
        return [text for key, value in content.items() for text in (*texts(key), *texts(value))]
    if isinstance(content, list):
        return [text for value in content for text in texts(value)]
    return [content] if isinstance(content, str) else []


@pytest.mark.parametrize("name", ["rviz/humanpred.rviz", "foxglove/humanpred.json"])
def test_every_topic_is_one_of_ours_and_all_markers_are_shown(name: str) -> None:
    text = (REPOSITORY / name).read_text(encoding="utf-8")
    content = json.loads(text) if name.endswith("json") else yaml.safe_load(text)
    named = {re.split(r"[.\[]", word)[0].lstrip("/") for word in texts(content) if word.startswith("/")}
    assert named <= MARKERS | OTHERS
    assert named >= MARKERS


def test_rviz_subscribes_so_that_it_is_matched() -> None:
    content = yaml.safe_load((REPOSITORY / "rviz" / "humanpred.rviz").read_text(encoding="utf-8"))
    shown = [d for d in content["Visualization Manager"]["Displays"] if d["Class"].endswith("/MarkerArray")]
    policies = {d["Topic"]["Reliability Policy"] for d in shown}
    reliable = qos.MARKERS.reliability == ReliabilityPolicy.RELIABLE
    assert policies == {"Best Effort"} or (policies == {"Reliable"} and reliable)


def test_a_foxglove_layout_places_every_panel_once() -> None:
    content = json.loads((REPOSITORY / "foxglove" / "humanpred.json").read_text(encoding="utf-8"))
    placed: list[str] = []

    def walk(node: Any) -> None:
        if isinstance(node, str):
            placed.append(node)
        else:
            walk(node["first"])
            walk(node["second"])

    walk(content["layout"])
    assert sorted(placed) == sorted(content["configById"])
