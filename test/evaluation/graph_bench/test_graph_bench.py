"""The graph's bench reads its figures off what was recorded, and runs the real nodes."""

from __future__ import annotations

import argparse
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
from humanpred_ros.errors import BagError, GoalUnreachableError, UsageError
from humanpred_ros.evaluation.graph_bench import command as graph_bench_command
from humanpred_ros.evaluation.graph_bench import input as graph_bench_input
from humanpred_ros.evaluation.graph_bench.bench import GraphCase, summarised
from humanpred_ros.evaluation.graph_bench.input import back_and_forth, write_scene, write_scene_for
from humanpred_ros.evaluation.graph_bench.latency import (
    Answers,
    Delays,
    answers_of,
    posture_answers,
    skipped_steps,
)
from humanpred_ros.evaluation.graph_bench.run import GraphRun
from humanpred_ros.evaluation.graph_bench.usage import NodeUsage, UsageMeter, usage_of, wait_until_resting
from humanpred_ros.evaluation.processes import NodeProcess
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.placement import placed, turn_and_shift
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import Scene, load_scene

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
MS = 1_000_000
POSTURE_MS, PERIOD_MS = 33, 99
STARTED_NS = 1_700_000_000 * 1000 * MS
FIRST_NS = STARTED_NS + 2500 * MS


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    graph_bench_command.add_arguments(parser)
    return parser.parse_args(words)


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
    assert answers.occupancy_s == pytest.approx([0.006] * 11)
    assert answers.step_s == pytest.approx([0.031] * 4)
    assert answers.trajectory_s == pytest.approx([0.029] * 2)
    assert answers.compute_s == pytest.approx([0.0125] * 4)
    assert answers.iterations == (20,) * 4  # goals that were set aside do not count
    assert (answers.late, answers.skipped, answers.unanswered) == (0, 0, 1)
    assert answers.ready_s == pytest.approx(2.0)


def test_every_posture_has_its_occupancy_or_none(tmp_path: Path) -> None:
    *answered, last = posture_answers(BagReader(write_run(tmp_path)))
    assert [answer.delay_s for answer in answered] == pytest.approx([0.006] * 11)
    assert np.diff([answer.sent_ns for answer in answered]).tolist() == [POSTURE_MS * MS] * 10
    assert last.heard_ns is None
    assert np.isnan(last.delay_s)


def test_plans_that_came_too_late_are_counted(tmp_path: Path) -> None:
    assert answers_of(write_run(tmp_path, missed_at=6), PERIOD_MS * 1e-3, STARTED_NS).late == 1


def test_due_times_without_a_step_are_counted() -> None:
    assert skipped_steps([0.0, 0.1, 0.2, 0.3], 0.1) == 0
    assert skipped_steps([0.0, 0.1, 0.2333, 0.3333], 0.1) == 0  # a third late is late, not missed
    assert skipped_steps([0.0, 0.1, 0.3, 0.6], 0.1) == 3
    assert skipped_steps([0.0], 0.1) == 0


def test_a_run_without_postures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="did the tracker start"):
        answers_of(write_run(tmp_path, postures=0), 0.1, STARTED_NS)


def test_figures_of_no_answers_are_not_numbers() -> None:
    delays = Delays.of([])
    assert delays.n == 0
    assert np.isnan(delays.median_ms)
    assert Delays.of([0.1, 0.2, 0.3]).median_ms == pytest.approx(200.0)


def test_runs_are_put_together() -> None:
    def answers(seconds: tuple[float, ...], late: int) -> Answers:
        return Answers(seconds, seconds, seconds[:1], seconds, (50,) * len(seconds), late, 1, 0, 1.5)

    runs = [
        GraphRun(Path("a"), 0, 1.2, (NodeUsage("stomp_planner", 40.0, 200.0),)),
        GraphRun(Path("b"), 0, None, (NodeUsage("stomp_planner", 60.0, 220.0),)),
    ]
    result = summarised(2, runs, [answers((0.01, 0.02), 1), answers((0.03,), 0)])
    assert (result.step.n, result.step.median_ms) == (3, pytest.approx(20.0))
    assert (result.trajectory.n, result.steps, result.late, result.skipped, result.missed) == (2, 3, 1, 2, 3)
    assert result.usage == (NodeUsage("stomp_planner", 50.0, 220.0),)
    assert (result.ready_s, result.ready_cpu_s) == (1.5, 1.2)


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

    monkeypatch.setattr(graph_bench_input, "share_file", lambda *parts: Shared())
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
def test_a_node_that_works_is_waited_for_and_its_work_is_measured(busy_node: NodeProcess) -> None:
    meter = UsageMeter([busy_node])
    meter.note()
    wait_until_resting([busy_node], lambda: None, 30.0)
    meter.note()
    used = usage_of(busy_node.process.pid)
    assert used is not None
    assert used.cpu_s > 0.0
    assert used.memory_mb > 3.0
    (found,) = meter.result()
    assert found.node == "busy"
    assert 0.0 < found.cpu_percent <= 110.0


@LINUX
def test_a_failed_node_ends_the_wait(busy_node: NodeProcess) -> None:
    def check() -> None:
        raise UsageError("it failed")

    with pytest.raises(UsageError, match="it failed"):
        wait_until_resting([busy_node], check, 30.0)


def test_a_process_that_has_ended_uses_nothing() -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    assert usage_of(process.pid) is None


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
    with pytest.raises(UsageError, match=message):
        graph_bench_command.run(parsed(*words), Console(file=io.StringIO()))


@LINUX
def test_the_real_nodes_are_measured_and_ended(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    out, kept = tmp_path / "bench.json", tmp_path / "kept"
    words = ["--goals", "2", "--runs", "1", "--seconds", "2", "--waypoints", "30", "--iterations", "5"]
    options = parsed(*words, "--predictor", "current", "--json", str(out), "--keep", str(kept))
    printed = io.StringIO()
    assert graph_bench_command.run(options, Console(file=printed, width=120)) == 0
    bench = json.loads(out.read_text())
    assert bench["case"]["waypoints"] == 30
    (result,) = bench["results"]
    assert result["goals"] == 2
    assert result["occupancy"]["n"] + result["unanswered"] == 61
    assert result["steps"] == result["step"]["n"] >= 1
    assert result["trajectory"]["n"] <= result["steps"]
    assert result["occupancy"]["median_ms"] > 0.0
    assert result["step"]["median_ms"] > 0.0
    assert {node["node"] for node in result["usage"]} == {
        "run_recorder", "simulated_arm", "occupancy_predictor", "stomp_planner", "skeleton_tracker_replay",
    }  # fmt: skip
    assert all(node["memory_mb"] > 10.0 for node in result["usage"])
    assert result["ready_s"] > 0.0
    assert result["ready_cpu_s"] > 0.0
    assert "posture to trajectory" in printed.getvalue()
    wait_until(lambda: not processes_with_environment(f"ROS_LOG_DIR={kept}"), "the nodes to end", 10.0)


def test_the_issues_case() -> None:
    case = GraphCase()
    assert (case.goals, case.waypoints, case.rate_hz, case.iterations) == ((2, 4, 8), 100, 30.0, 50)
