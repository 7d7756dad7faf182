"""A robot's file may name the topic on which a running robot says what it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from small_robot import URDF, write_robot

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from rclpy.context import Context
from std_msgs.msg import String

from humanpred_ros.errors import RobotError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.nodes import latched_text, qos
from humanpred_ros.robot.robot import load_robot

SRDF = '<robot name="small"><group_state name="up" group="a">{}</group_state></robot>'.format(
    "".join(f'<joint name="{joint}" value="0.5"/>' for joint in ("turn", "lift", "bend", "roll"))
)


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    domain_id = free_domain_id()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    node = rclpy.create_node("driver", context=context)
    for topic, text in (("/robot_description", URDF), ("/robot_description_semantic", SRDF)):
        node.create_publisher(String, topic, qos.LATCHED).publish(String(data=text))
    yield
    node.destroy_node()
    context.try_shutdown()


def test_a_running_robot_says_what_it_is(published: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    live = {"description": "topic:/robot_description", "semantic": "topic:/robot_description_semantic"}
    robot = load_robot(write_robot(tmp_path, **live))
    assert robot.description.name == "small"
    assert robot.state("up").tolist() == [0.5] * 4
    assert not robot.urdf.is_relative_to(tmp_path)
    monkeypatch.setenv(latched_text.PATIENCE, "5")
    words = r"wanted a text on /other \(std_msgs/msg/String, latched\), got none in 5 s; .*: /robot_description, "
    with pytest.raises(RobotError, match=words):
        load_robot(write_robot(tmp_path, description="topic:/other"))
