"""Two robots on one ROS domain, each in a namespace, with trackers of their own or with one for both."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.processes import NodeGroup, chosen_domain_id, free_domain_id
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.nodes import conversions
from humanpred_ros.nodes.lifecycle import started
from humanpred_ros.nodes.simulated_arm import SimulatedArm
from humanpred_ros.viewing.run import read_run

POSTURES = topics.human_joint_states("body_0")
MOTIONS = {"/robot1": "3/2", "/robot2": "5/1"}


def stamps(bag: BagReader, topic: str) -> list[int]:
    return [conversions.stamp_ns(message.header.stamp) for _, message in bag.decoded(topic)]


@pytest.mark.core
def test_two_robots_do_not_hear_each_other(tmp_path: Path) -> None:
    with NodeGroup(tmp_path / "logs", free_domain_id()) as group:
        trackers = []
        for namespace, motion in MOTIONS.items():
            # Each has a simulated time of its own.
            here = {"__ns": namespace, "/clock": "clock"}
            stepped: dict[str, Any] = {"use_sim_time": True, "lossless": True}
            group.start("simulated_arm", {"use_sim_time": True}, here)
            group.start("occupancy_predictor", {**stepped, "predictor": "current", "listener": "stomp_planner"}, here)
            planner = {"period_s": 0.5, "iterations": 5, "threads": 1, "controller": "simulated_arm"}
            group.start("stomp_planner", {**stepped, **planner, "listener": "skeleton_tracker_replay"}, here)
            group.start("run_recorder", {"output": str(tmp_path / namespace[1:] / "bag"), "stay": False}, here)
            replayed = {"trajectory": motion, "mode": "stepped", "hold_last_s": 0.0, "listener": "occupancy_predictor"}
            peers = "simulated_arm,occupancy_predictor,stomp_planner,run_recorder"
            trackers.append(group.start("skeleton_tracker_replay", {**replayed, "wait_for": peers}, here))
        for tracker in trackers:
            group.wait_for(tracker)
    library = load_library(REPOSITORY / "bags" / "synthetic_reaches")
    for namespace, motion in MOTIONS.items():
        bag = BagReader(tmp_path / namespace[1:] / "bag")
        assert bag.find(topics.DECISION) == f"{namespace}/stomp_planner/decision"
        seen = np.array([message.position for _, message in bag.decoded(POSTURES)])
        np.testing.assert_array_equal(seen, library.find(motion).q)
        assert stamps(bag, topics.COMPACT_OCCUPANCY) == stamps(bag, topics.DECISION) == stamps(bag, POSTURES)
        run = read_run(tmp_path / namespace[1:])
        assert len(run.steps) >= 3
        assert not any("two planners" in decision.reason for decision in run.decisions)


def test_two_robots_share_a_tracker_by_remapping(tmp_path: Path) -> None:
    with NodeGroup(tmp_path / "logs", free_domain_id()) as group:
        robots = list(MOTIONS)
        for namespace in robots:
            here = {"__ns": namespace, POSTURES: f"/people/{POSTURES}"}
            predictor = {"predictor": "current", "lossless": True, "listener": "run_recorder"}
            group.start("occupancy_predictor", predictor, here)
            recorder = {"output": str(tmp_path / namespace[1:] / "bag"), "stay": False}
            group.start("run_recorder", {**recorder, "wait_for": f"{topics.COMPACT_OCCUPANCY},{POSTURES}"}, here)
        tracker = group.start(
            "skeleton_tracker_replay",
            {
                "trajectory": MOTIONS["/robot1"],
                "hold_last_s": 0.0,
                "listener": ",".join(f"{namespace}/occupancy_predictor" for namespace in robots),
                "wait_for": ",".join(f"{namespace}/{node}" for namespace in robots for node in ("run_recorder",)),
            },
            {"__ns": "/people"},
        )
        group.wait_for(tracker)
    bags = [BagReader(tmp_path / namespace[1:] / "bag") for namespace in robots]
    sent = stamps(bags[0], POSTURES)
    assert len(sent) > 100
    for namespace, bag in zip(robots, bags, strict=True):
        assert bag.find(POSTURES) == f"/people/{POSTURES}"
        assert bag.find(topics.COMPACT_OCCUPANCY) == f"{namespace}/human_occupancy/compact"
        assert stamps(bag, topics.COMPACT_OCCUPANCY) == stamps(bag, POSTURES) == sent
        assert len(read_run(bag.path.parent).postures) == len(sent)


@pytest.fixture
def arguments(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return what starts ROS with these arguments, as a node's process does."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def start(*words: str) -> None:
        monkeypatch.setattr(sys, "argv", ["simulated_arm", "--ros-args", *words])
        rclpy.init(args=sys.argv, domain_id=free_domain_id())

    try:
        yield start
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize("section", ["simulated_arm", "/simulated_arm", "/**", "/*"])
@pytest.mark.parametrize(("name", "value"), [("period_s", 0.2), ("gmm.evidence", "mean"), ("speed_factro", 1.0)])
def test_parameters_of_other_nodes_pass_only_where_all_get_them(
    arguments: Any, tmp_path: Path, section: str, name: str, value: Any
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(f"{section}:\n  ros__parameters:\n    {name}: {value}\n    use_sim_time: true\n", encoding="utf-8")
    arguments("--params-file", str(file))
    if "*" in section and name != "speed_factro":
        started(SimulatedArm).destroy_node()
        return
    with pytest.raises(UsageError, match=f"parameter {name}: simulated_arm has none of that name"):
        started(SimulatedArm)


def test_a_parameter_of_another_node_is_refused_with_its_owner(arguments: Any) -> None:
    arguments("-p", "period_s:=0.2")
    with pytest.raises(UsageError, match=r"stomp_planner has: -p stomp_planner:period_s:=VALUE"):
        started(SimulatedArm)


def test_a_domain_is_that_of_the_environment_unless_nodes_run_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id = free_domain_id()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    assert chosen_domain_id() == domain_id
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = rclpy.create_node("stomp_planner", namespace="robot1", context=context)
    try:
        with pytest.raises(UsageError, match=rf"ROS_DOMAIN_ID {domain_id}: .* robot1/stomp_planner"):
            chosen_domain_id()
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@pytest.mark.parametrize("text", ["233", "x", "-1", "1.0", "९", "9999999"])
def test_an_environment_without_a_domain_id_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(UsageError, match="ROS_DOMAIN_ID: wanted a whole number from 0 to 232"):
        chosen_domain_id()
