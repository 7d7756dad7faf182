"""Over DDS, nothing a planner may be sent makes it crash, or plan a motion on nothing: it says what was wrong."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from paths import REPOSITORY
from sent_trajectories import trajectory_from_message
from waiting import wait_until

from humanpred_ros.evaluation.processes import NodeGroup, free_domain_id
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from planner_client import NS, PlannerClient, nobody, somebody, voxels_near

from humanpred_ros.nodes import conversions

SCENE = load_scene("face_to_face")
QUICK = {"scene": "face_to_face", "iterations": 5, "waypoints": 40, "period_s": 0.2}
MS = NS // 1000


def spoiled_cloud(t_ns: int) -> Any:
    cloud = conversions.occupancy_cloud(nobody(SCENE), 0.0, t_ns)
    points = np.frombuffer(bytes(cloud.data), dtype="<f4").copy()
    points[3] = np.nan
    cloud.data = points.tobytes()
    return cloud


def shifted_cloud(t_ns: int) -> Any:
    grid = VoxelGrid((-2.01, -3.0, -0.4), 0.05, SCENE.grid.shape)
    return conversions.occupancy_cloud(Occupancy(grid, nobody(SCENE).probability), 0.0, t_ns)


def good_cloud(t_ns: int) -> Any:
    return conversions.occupancy_cloud(nobody(SCENE), 0.0, t_ns)


def assert_no_motion(client: PlannerClient) -> None:
    """A hold may be sent to an arm at rest, which stays where it is."""
    for message in client.trajectories:
        for point in message.points:
            assert list(point.positions) == SCENE.start.tolist()
            assert not np.any(point.velocities)


def test_bad_input_is_named_and_moves_nothing(tmp_path: Path) -> None:
    with PlannerClient(tmp_path, SCENE, QUICK) as client:

        def refusal_of(send: Callable[[], None], kind: str) -> None:
            client.send_until(send, lambda: client.refused(kind) > 0, f"a refusal: {kind}")

        refusal_of(lambda: client.send_arm(n_joints=6), "missing joints")
        refusal_of(lambda: client.send_arm([*SCENE.start[:-1], np.nan]), "not finite")
        refusal_of(lambda: client.send_cloud(good_cloud(client.now_ns())), "no arm")
        assert client.diagnostics[0].startswith("waiting for the arm's joints")

        outside = SCENE.start.copy()
        outside[3] = 1.0  # an elbow bent backwards

        def start_outside() -> None:
            client.send_arm(outside)
            client.send_cloud(good_cloud(client.now_ns()))

        refusal_of(start_outside, "start configuration")
        assert {decision.action for decision in client.decisions} == {"hold"}
        assert any("r_elbow_flex_joint within" in decision.reason for decision in client.decisions)
        client.arm_runs = True

        def hold_on(make: Callable[[int], Any], age_ns: int, reason: str) -> None:
            n_before = len(client.decisions)

            def send() -> None:
                client.send_cloud(make(client.now_ns() - age_ns))

            client.send_until(
                send,
                lambda: any(decision.reason.startswith(reason) for decision in client.decisions[n_before:]),
                f"a hold: {reason}",
            )
            assert {decision.action for decision in client.decisions[n_before:]} <= {"hold", "keep"}

        hold_on(spoiled_cloud, 0, "invalid human data: not finite")
        hold_on(shifted_cloud, 0, "invalid human data: other lattice")
        hold_on(good_cloud, 3 * NS, "stale human data")
        assert_no_motion(client)
        # All that is forgotten as soon as the human data can be used.
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns())),
            lambda: client.decisions[-1].action == "replan",
            "a plan on good data",
        )


def test_data_that_come_late_neither_restart_nor_jerk_a_moving_arm(tmp_path: Path) -> None:
    with PlannerClient(tmp_path, SCENE, {**QUICK, "velocity_scale": 0.05}) as client:
        client.settle_arm()
        first_ns = client.now_ns()
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns())),
            lambda: bool(client.trajectories) and client.now_ns() - stamp(client.trajectories[0]) > NS // 4,
            "the arm to be on its way",
        )
        refused = client.refused("stamp not increasing")
        ages = itertools.cycle((0, 150 * MS))
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns() - next(ages))),
            lambda: client.refused("stamp not increasing") > refused,
            "the refusal of data that were overtaken",
        )
        n_before = len(client.decisions)
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns() - 2 * NS)),
            lambda: any(d.reason.startswith("stale human data") for d in client.decisions[n_before:]),
            "a hold",
        )
        client.wait(lambda: len(client.trajectories) >= 2, "the stop")
        stop = client.trajectories[-1]
        before = [trajectory_from_message(m, client.joint_names, first_ns) for m in client.trajectories[:-1]]
        begins_s = (stamp(stop) - first_ns) * 1e-9
        executing = next(t for t in reversed(before) if t.start_s <= begins_s)
        q, v, _ = executing.sample(begins_s)
        assert np.abs(v).max() > 0.01  # it was moving
        np.testing.assert_allclose(stop.points[0].positions, q, atol=1e-6)
        np.testing.assert_allclose(stop.points[0].velocities, v, atol=1e-5)
        assert not np.any(stop.points[-1].velocities)
        # Every silence leads to a hold, not only the first one.
        for _ in range(2):
            n_before = len(client.decisions)
            client.send_until(
                lambda: client.send_cloud(good_cloud(client.now_ns())),
                lambda n=n_before: any(d.action == "replan" for d in client.decisions[n:]),
                "a plan on good data",
            )
            n_before = len(client.decisions)
            client.wait(
                lambda n=n_before: any(d.reason.startswith("stale human data") for d in client.decisions[n:]),
                "a hold in the silence",
            )


def stamp(message: Any) -> int:
    return conversions.stamp_ns(message.header.stamp)


def test_a_deadline_too_short_for_one_update_holds_with_that_reason(tmp_path: Path) -> None:
    parameters = {**QUICK, "iterations": 10000, "period_s": 0.02, "max_human_age_s": 2.0}
    with PlannerClient(tmp_path, SCENE, parameters) as client:
        client.settle_arm()
        # Older than a whole step when they come: there is no time left at all.
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns() - 100 * MS)),
            lambda: len(client.decisions) >= 10,
            "ten decisions",
        )
        late = [decision for decision in client.decisions if decision.goals]
        assert late
        assert {decision.action for decision in late} == {"hold"}
        assert {decision.reason for decision in late} == {"the deadline left no time for a single update"}
        assert all(goal["iterations"] == "0" for decision in late for goal in decision.goals.values())
        assert client.trajectories == []
        # In time, there is some; too little of it may come out as a missed step.
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns())),
            lambda: len(client.decisions) >= 20,
            "ten more decisions",
        )
        assert {decision.action for decision in client.decisions} <= {"keep", "hold", "replan", "missed"}


def empty_cloud(t_ns: int) -> Any:
    return conversions.occupancy_cloud(Occupancy(SCENE.grid, np.zeros(SCENE.grid.shape, np.float32)), 0.0, t_ns)


def test_that_people_have_left_must_be_said(tmp_path: Path) -> None:
    with PlannerClient(tmp_path, SCENE, QUICK) as client:
        client.settle_arm()
        for cloud, answers, reason in (
            (good_cloud, {"keep", "replan", "arrived"}, ""),
            (empty_cloud, {"hold"}, "empty occupancy"),
            (conversions.nobody_cloud, {"keep", "replan", "arrived"}, ""),
            (empty_cloud, {"keep", "replan", "arrived"}, ""),  # they have left: there still is nobody
            (good_cloud, {"keep", "replan", "arrived"}, ""),
            (empty_cloud, {"hold"}, "empty occupancy"),
        ):
            n_before = len(client.decisions)
            sent_ns = client.now_ns()
            client.send_until(
                lambda cloud=cloud: client.send_cloud(cloud(client.now_ns())),
                lambda n=n_before, since=sent_ns, wanted=answers, why=reason: any(
                    d.stamp_ns >= since and d.action in wanted and d.reason.startswith(why)
                    for d in client.decisions[n:]
                ),
                f"one of {answers} to {cloud.__name__}",
            )


def test_bad_data_hold_while_a_step_is_planned(tmp_path: Path) -> None:
    slow = {**QUICK, "iterations": 10_000, "waypoints": 100, "period_s": 10.0, "max_human_age_s": 20.0}
    with PlannerClient(tmp_path, SCENE, slow) as client:
        client.settle_arm()
        long_ago_ns = client.now_ns() - 11 * NS
        client.send_until(
            lambda: client.send_cloud(good_cloud(long_ago_ns)),
            lambda: any(d.action == "keep" for d in client.decisions),
            "the first decision",
        )
        n_before = len(client.decisions)
        due_ns = client.now_ns()  # more than a period later
        client.send_until(
            lambda: client.send_cloud(good_cloud(due_ns)), lambda: client.now_ns() - due_ns > NS // 2, "a step"
        )
        client.send_until(
            lambda: client.send_cloud(spoiled_cloud(client.now_ns())),
            lambda: any(d.reason.startswith("invalid human data") for d in client.decisions[n_before:]),
            "a hold",
        )
        # The step is still being planned; when it is, its plan is not executed.
        assert not any(d.stamp_ns == due_ns for d in client.decisions)
        client.wait(lambda: any(d.stamp_ns == due_ns for d in client.decisions), "the end of the step", timeout_s=60.0)
        planned = next(d for d in client.decisions if d.stamp_ns == due_ns)
        assert (planned.action, planned.reason[:18]) == ("hold", "invalid human data")
        assert_no_motion(client)


def test_a_stop_does_not_wait_for_a_step_that_is_being_planned(tmp_path: Path) -> None:
    slow = {**QUICK, "iterations": 10_000, "period_s": 4.0, "max_human_age_s": 20.0, "max_arm_age_s": 20.0}
    slow["velocity_scale"] = 0.03  # under way for long
    with PlannerClient(tmp_path, SCENE, slow) as client:
        client.settle_arm()
        first_ns = client.now_ns()
        client.send_until(
            lambda: client.send_cloud(good_cloud(client.now_ns())), lambda: bool(client.trajectories), "a plan"
        )
        client.wait(lambda: client.now_ns() - stamp(client.trajectories[-1]) > 5 * NS, "the arm to be on its way")
        executing, now_s = client.executing(first_ns), (client.now_ns() - first_ns) * 1e-9
        here, soon = (executing.sample(now_s + wait_s)[0] for wait_s in (1.0, 5.0))
        person = somebody(SCENE, np.setdiff1d(voxels_near(SCENE, soon, 0.03), voxels_near(SCENE, here, 0.1)))
        n_before = len(client.decisions)
        due_ns = client.now_ns()
        client.send_cloud(good_cloud(due_ns))
        client.wait(lambda: client.now_ns() - due_ns > NS // 4, "the step to begin")

        def step_in_front() -> None:
            client.send_cloud(conversions.occupancy_cloud(person, 0.0, client.now_ns()))

        client.send_until(
            step_in_front,
            lambda: any(d.reason.startswith("too close") for d in client.decisions[n_before:]),
            "a stop",
        )
        assert not any(d.stamp_ns == due_ns for d in client.decisions)  # the step is still being planned


def test_a_machine_too_busy_to_finish_a_step_holds(tmp_path: Path) -> None:
    with PlannerClient(tmp_path, SCENE, {**QUICK, "velocity_scale": 0.05}) as client:
        client.settle_arm()
        for _ in range(2):
            n_before = len(client.decisions)
            client.send_until(
                lambda: client.send_cloud(good_cloud(client.now_ns())),
                lambda n=n_before: any(d.action == "replan" for d in client.decisions[n:]),
                "the arm to be on its way",
            )
            # Older than a whole step when they come, not too old: no step has time for a single update.
            client.send_until(
                lambda: client.send_cloud(good_cloud(client.now_ns() - 300 * MS)),
                lambda n=n_before: any(d.reason.startswith("overload") for d in client.decisions[n:]),
                "a hold",
            )


def scene_with_goals(path: Path, change: Callable[[list[Any]], list[Any]]) -> Path:
    content = yaml.safe_load((REPOSITORY / "config" / "scenes" / "face_to_face.yaml").read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({**content, "goals": change(content["goals"])}), encoding="utf-8")
    return path


def test_scenes_without_proper_goals_end_the_node_with_a_named_error(tmp_path: Path) -> None:
    def unreachable(goals: list[Any]) -> list[Any]:
        return [goals[0], {"name": "far", "configuration_deg": [300.0, *goals[0]["configuration_deg"][1:]]}]

    scenes = {
        "none": (lambda goals: [], "goals"),
        "twice": (lambda goals: [goals[0], dict(goals[1], name="red")], "red"),
        "far": (unreachable, "far"),
    }
    groups = [NodeGroup(tmp_path / name, free_domain_id()) for name in scenes]
    try:
        nodes = {
            name: group.start("stomp_planner", {"scene": str(scene_with_goals(tmp_path / f"{name}.yaml", change))})
            for group, (name, (change, _)) in zip(groups, scenes.items(), strict=True)
        }
        wait_until(lambda: not any(node.running for node in nodes.values()), "the nodes to end")
    finally:
        for group in groups:
            group.stop()
    for name, node in nodes.items():
        lines = node.log.read_text(encoding="utf-8").splitlines()
        assert node.process.returncode == 2, lines
        assert not any("Traceback" in line for line in lines)
        assert "wanted" in lines[-1], name
        assert scenes[name][1] in lines[-1]
