"""The graph's bench reads its figures off what was recorded, and runs the real nodes."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_messages import diagnostic_array, joint_trajectory
from rich.console import Console
from waiting import processes_with_environment, wait_until

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.cli import parse
from humanpred_ros.errors import BagError, GoalUnreachableError, HumanPredError, UsageError
from humanpred_ros.evaluation import bench_nodes
from humanpred_ros.evaluation.bench_nodes import (
    Answers,
    NodeUsage,
    answers_of,
    back_and_forth,
    posture_answers,
    skipped_steps,
    wait_until_resting,
    write_scene,
    write_scene_for,
)
from humanpred_ros.evaluation.graph_bench import GraphBenchSettings, together
from humanpred_ros.evaluation.processes import NodeGroup, NodeProcess
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, placed, turn_and_shift
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import Scene, load_scene

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
MS = 1_000_000
POSTURE_MS, PERIOD_MS = 33, 99
STARTED_NS = 1_700_000_000 * 1000 * MS
FIRST_NS = STARTED_NS + 2500 * MS


def run(*words: str) -> str:
    printed = io.StringIO()
    command, settings = parse(["bench", "graph", *words])
    assert command(settings, Console(file=printed, width=120)) == 0
    return printed.getvalue()


@pytest.fixture(scope="module")
def motion() -> Motion:
    return load_library(locate("synthetic_reaches", "bags")).find("3/2")


def decision(stamp_ns: int, action: str, iterations: tuple[int, ...]) -> Any:
    values = {"compute_ms": "12.5", "step": "1" if iterations else "-1"}
    goals = [(0, f"goal {k}", "", {"iterations": str(n)}) for k, n in enumerate(iterations)]
    return diagnostic_array(stamp_ns, [(0, "decision", action, values), *goals])


def write_run(folder: Path, *, postures: int = 12, missed_at: int = -1, busy_from: int = 99) -> Path:
    """Write a run with a step at every third posture: occupancy after 5 ms, decision after 30, heard 1 ms later.

    Steps at even numbers send a trajectory 2 ms before their decision. From posture `busy_from` on no step is taken.
    """
    sent: list[tuple[int, str, Any]] = []
    for k in range(postures):
        stamp = FIRST_NS + k * POSTURE_MS * MS
        sent.append((stamp, "/humans/bodies/body_0/joint_states", ros.joint_state(stamp, ["a"], [0.0])))
        if k == postures - 1:
            continue  # the last posture is not answered
        cloud = ros.point_cloud2(stamp, "world", {"x": np.zeros(1, dtype=np.float32)})
        sent.append((stamp + 5 * MS, "/human_occupancy", cloud))
        step = k % 3 == 0 and k < busy_from
        action = "missed" if k == missed_at else "replan" if step else "keep"
        sent.append((stamp + 30 * MS, "/stomp_planner/decision", decision(stamp, action, (50, 0, 20) if step else ())))
        if step and k % 2 == 0:
            trajectory = joint_trajectory(stamp + PERIOD_MS * MS, ["a"], [0.0, 1.0], [[0.0], [1.0]])
            sent.append((stamp + 28 * MS, "/r_arm_controller/joint_trajectory", trajectory))
    for after_ms, text in ((1000, "waiting for the arm"), (2000, "ready"), (2200, "ready")):
        stamp = STARTED_NS + after_ms * MS
        sent.append((stamp, "/diagnostics", diagnostic_array(stamp, [(0, "stomp_planner", text, {})])))
    with BagWriter(folder / "bag") as bag:
        for topic, kind in (
            ("/humans/bodies/body_0/joint_states", ros.JOINT_STATE),
            ("/human_occupancy", ros.POINT_CLOUD2),
            ("/stomp_planner/decision", ros.DIAGNOSTIC_ARRAY),
            ("/r_arm_controller/joint_trajectory", ros.JOINT_TRAJECTORY),
            ("/diagnostics", ros.DIAGNOSTIC_ARRAY),
        ):
            bag.add_topic(topic, kind)
        for sent_ns, topic, message in sorted(sent, key=lambda entry: entry[0]):
            bag.write_message(topic, sent_ns + MS, message, sent_ns)
    return folder / "bag"


def test_delays_are_read_from_publication_to_receipt(tmp_path: Path) -> None:
    answers = answers_of(write_run(tmp_path), PERIOD_MS * 1e-3, STARTED_NS)
    assert answers.delays_ms["occupancy_ms"] == pytest.approx([6.0] * 11)
    assert answers.delays_ms["step_ms"] == pytest.approx([31.0] * 4)
    assert answers.delays_ms["trajectory_ms"] == pytest.approx([29.0] * 2)
    assert answers.delays_ms["compute_ms"] == pytest.approx([12.5] * 4)
    assert answers.iterations == [20] * 4  # goals that were set aside do not count
    assert answers.counts == {"steps": 4, "late": 0, "skipped": 0, "unanswered": 1}
    assert answers.ready_s == pytest.approx(2.0)


def test_every_posture_has_its_occupancy_or_none(tmp_path: Path) -> None:
    *answered, last = posture_answers(BagReader(write_run(tmp_path)))
    assert [answer.delay_ms for answer in answered] == pytest.approx([6.0] * 11)
    assert np.diff([answer.sent_ns for answer in answered]).tolist() == [POSTURE_MS * MS] * 10
    assert last.heard_ns is None
    assert np.isnan(last.delay_ms)


def test_plans_that_came_too_late_are_counted(tmp_path: Path) -> None:
    assert answers_of(write_run(tmp_path, missed_at=6), PERIOD_MS * 1e-3, STARTED_NS).counts["late"] == 1


def test_due_times_without_a_step_are_counted() -> None:
    assert skipped_steps([0.0, 0.1, 0.2, 0.3], 0.1) == 0
    assert skipped_steps([0.0, 0.1, 0.2333, 0.3333], 0.1) == 0  # a third late is late, not missed
    assert skipped_steps([0.0, 0.1, 0.3, 0.6], 0.1) == 3
    assert skipped_steps([0.0], 0.1) == 0


def test_a_run_without_postures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="did the tracker start"):
        answers_of(write_run(tmp_path, postures=0), 0.1, STARTED_NS)


def test_runs_are_put_together() -> None:
    def answers(*ms: float, late: int) -> Answers:
        delays = {"occupancy_ms": ms, "step_ms": ms, "trajectory_ms": ms[:1], "compute_ms": ()}
        counts = {"steps": len(ms), "late": late, "skipped": 1, "unanswered": 0}
        return Answers(delays, (50,) * len(ms), counts, 1.5)

    result = together(
        2,
        [
            (answers(10.0, 20.0, late=1), 1.2, (NodeUsage("stomp_planner", 40.0, 200.0),)),
            (answers(30.0, late=0), float("nan"), (NodeUsage("stomp_planner", 60.0, 220.0),)),
        ],
    )
    assert (result["step_ms"].n, result["step_ms"].median) == (3, pytest.approx(20.0))
    assert (result["trajectory_ms"].n, result["steps"], result["late"], result["skipped"]) == (2, 3, 1, 2)
    assert (result["unanswered"], result["compute_ms"].n) == (0, 0)
    assert np.isnan(result["compute_ms"].median)
    assert result["usage"] == [{"node": "stomp_planner", "cpu_percent": 50.0, "memory_mb": 220.0}]
    assert (result["ready_s"], result["ready_cpu_s"]) == (1.5, 1.2)


@pytest.mark.parametrize("n_goals", [1, 2, 8])
def test_a_scene_gets_as_many_reachable_goals_as_asked(tmp_path: Path, n_goals: int) -> None:
    scene: Scene = load_scene(write_scene(tmp_path / "scene.yaml", n_goals))
    configurations = [goal.configuration for goal in scene.goals]
    assert len(configurations) == n_goals
    distance = [np.abs(a - b).max() for k, a in enumerate(configurations) for b in configurations[:k]]
    assert min(distance, default=1.0) > 0.05
    scene.check_free()


def test_people_of_any_library_stand_where_the_scenes_person_does(tmp_path: Path) -> None:
    shipped = load_library(locate("synthetic_reaches", "bags"))
    original = load_scene("four_places")
    scene = load_scene(write_scene_for(tmp_path / "scene.yaml", shipped))
    np.testing.assert_allclose(scene.T_world_human, original.T_world_human, atol=0.01)
    assert scene.grid == original.grid
    aside = turn_and_shift(0.0, (3.0, -2.0, 0.5))
    moved = replace(shipped, motions=tuple(placed(motion, aside) for motion in shipped.motions[:50]))
    there = load_scene(write_scene_for(tmp_path / "there.yaml", moved)).T_world_human @ aside
    np.testing.assert_allclose(there, original.T_world_human, atol=0.05)


def test_a_goal_in_collision_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Shared:
        def read_text(self, encoding: str) -> str:
            text = (locate("four_places", "config", "scenes", suffix=".yaml")).read_text(encoding=encoding)
            return text.replace("-0.720, 0.72]", "-0.720, 0.90]")  # the table raised into the goals

    monkeypatch.setattr(bench_nodes, "share_file", lambda *parts: Shared())
    with pytest.raises(GoalUnreachableError, match="goal"):
        write_scene(tmp_path / "scene.yaml", 2)


def test_the_person_reaches_and_draws_back_without_a_jump(motion: Motion) -> None:
    played = back_and_forth(motion, 10.0)
    assert len(played) == 301
    np.testing.assert_allclose(np.diff(played.t_s), 1.0 / 30.0, atol=2e-9)
    np.testing.assert_array_equal(played.q[0], motion.q[0])
    turn = round(motion.duration_s * 30.0)
    assert np.abs(played.q[turn] - motion.q[-1]).max() < 0.1
    assert np.abs(played.q[2 * turn] - motion.q[0]).max() < 0.1
    fastest = np.abs(np.diff(motion.q, axis=0) / np.diff(motion.t_s)[:, None]).max()
    assert np.abs(np.diff(played.q, axis=0)).max() <= 1.05 * fastest / 30.0


BUSY = "import time; end = time.monotonic() + 1.0\nwhile time.monotonic() < end: pass\ntime.sleep(60)"


@pytest.fixture
def busy_node(tmp_path: Path) -> Iterator[NodeProcess]:
    process = subprocess.Popen([sys.executable, "-c", BUSY])
    yield NodeProcess("busy", process, tmp_path / "log")
    process.kill()
    process.wait()


@LINUX
def test_a_node_that_works_is_waited_for_and_its_work_is_measured(busy_node: NodeProcess, tmp_path: Path) -> None:
    before = busy_node.usage()
    wait_until_resting(NodeGroup(tmp_path, 1, [busy_node]))
    after = busy_node.usage()
    assert before is not None
    assert after is not None
    assert after.cpu_s > before.cpu_s
    assert after.memory_mb > 3.0
    busy_node.process.kill()
    busy_node.process.wait()
    assert busy_node.usage() is None


@LINUX
def test_a_failed_node_ends_the_wait(tmp_path: Path) -> None:
    failed = subprocess.Popen([sys.executable, "-c", "raise SystemExit(2)"])
    failed.wait()
    (tmp_path / "log").write_text("it failed", encoding="utf-8")
    with pytest.raises(UsageError, match="it failed"):
        wait_until_resting(NodeGroup(tmp_path, 1, [NodeProcess("bad", failed, tmp_path / "log")]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--goals", "0"], "--goals"),
        (["--runs", "0"], "--runs"),
        (["--seconds", "0.1"], "--seconds"),
        (["--json", "no/such/folder.json"], "folder that exists"),
        (["--keep", "."], "--keep"),
    ],
)
def test_impossible_options_are_refused_before_anything_starts(words: list[str], message: str) -> None:
    with pytest.raises(HumanPredError, match=message):
        run(*words)


@LINUX
def test_the_real_nodes_are_measured_and_ended(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    out, kept = tmp_path / "bench.json", tmp_path / "kept"
    words = ["--goals", "2", "--runs", "1", "--seconds", "2", "--waypoints", "30", "--iterations", "5"]
    plot = tmp_path / "bench.png"
    printed = run(*words, "--predictor", "current", "--json", str(out), "--plot", str(plot), "--keep", str(kept))
    bench = json.loads(out.read_text())
    assert bench["settings"]["waypoints"] == 30
    assert plot.read_bytes()[:4] == b"\x89PNG"
    (result,) = bench["results"]
    assert result["goals"] == 2
    assert result["occupancy_ms"]["n"] + result["unanswered"] == 61
    assert result["steps"] == result["step_ms"]["n"] >= 1
    assert result["trajectory_ms"]["n"] <= result["steps"]
    assert result["occupancy_ms"]["median"] > 0.0
    assert result["step_ms"]["median"] > 0.0
    assert {node["node"] for node in result["usage"]} == {
        "run_recorder", "simulated_arm", "occupancy_predictor", "stomp_planner", "skeleton_tracker_replay",
        "separation_guard",
    }  # fmt: skip
    assert all(node["memory_mb"] > 10.0 for node in result["usage"])
    assert result["ready_s"] > 0.0
    assert result["ready_cpu_s"] > 0.0
    assert "posture to trajectory" in printed
    wait_until(lambda: not processes_with_environment(f"ROS_LOG_DIR={kept}"), "the nodes to end", 10.0)


def test_the_issues_case() -> None:
    settings = GraphBenchSettings()
    assert (settings.goals, settings.waypoints, settings.iterations) == ((2, 4, 8), 100, 50)
    assert bench_nodes.RATE_HZ == 30.0
