"""A run read back says what was recorded, whatever is missing from it."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_messages import diagnostic_array
from paths import REPOSITORY

from humanpred_ros import topics
from humanpred_ros.bags import messages
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.robot.scene import Scene
from humanpred_ros.viewing.run import POSTURE_TO_OCCUPANCY, POSTURE_TO_TRAJECTORY, Run, read_run

REACH_S, POSTURE_S, PERIOD_S = 1.65, 1.65 / 99, 0.0825
RECORDED = (
    "/humans/bodies/body_0/joint_states",
    "/humans/bodies/body_0/urdf",
    "/human_occupancy",
    "/human_occupancy/voxel_grid",
    "/human_goals",
    "/stomp_planner/decision",
    "/r_arm_controller/joint_trajectory",
    "/joint_states",
)


def test_series_have_what_was_recorded(full: Run) -> None:
    assert len(full.postures) == len(full.posterior) == len(full.occupancy) == len(full.decisions) == 160
    assert full.postures.frame_id == "kinect"
    np.testing.assert_allclose(full.postures.t_s, POSTURE_S * np.arange(160), atol=1e-9)
    np.testing.assert_array_equal(full.postures.q[0][:4], [-0.169, -1.821, 0.763, 1.33])
    assert len(full.trajectories) == sum(decision.action == "replan" for decision in full.decisions) == 27
    assert full.posterior.labels == tuple("01234567")
    np.testing.assert_allclose(full.posterior.probability.sum(axis=1), 1.0, atol=1e-6)
    assert full.facts["trajectory"] == "3/2"
    assert full.motion_duration_s == REACH_S
    assert full.duration_s == pytest.approx(159 * POSTURE_S, abs=0.02)
    assert {topic.name for topic in full.topics} == set(RECORDED)
    assert full.notes == ()


def test_robot_states_before_the_first_posture_have_negative_times(full: Run, scene: Scene) -> None:
    assert full.robot.t_s[0] == pytest.approx(-0.2)
    np.testing.assert_array_equal(full.robot.q[0], scene.start)
    assert np.isnan(full.robot.at(np.array([-1.0, 99.0]))).all()
    np.testing.assert_allclose(full.robot.at(full.robot.t_s), full.robot.q, atol=1e-12)


def test_velocities_that_were_not_sent_are_differences(full: Run) -> None:
    v, dt = full.robot.v, np.diff(full.robot.t_s)
    moved = ((v[1:] + v[:-1]) / 2.0 * dt[:, None]).sum(axis=0)
    np.testing.assert_allclose(moved, full.robot.q[-1] - full.robot.q[0], atol=1e-3)


def test_occupancy_sums_up_and_is_kept_where_it_was_planned_on(full: Run, scene: Scene) -> None:
    track = full.occupancy
    assert track.grid == scene.grid
    assert [snapshot.t_s for snapshot in track.snapshots] == [step.t_s for step in full.steps]
    for snapshot in track.snapshots:
        k = int(np.searchsorted(track.t_s, snapshot.t_s))
        assert len(snapshot.probability) == track.n_voxels[k]
        assert snapshot.probability.sum() == pytest.approx(track.expected_voxels[k])
        assert (scene.grid.flat_index(snapshot.centres_m) >= 0).all()


def test_decisions_keep_costs_to_the_last_bit(full: Run) -> None:
    step = full.steps[3]
    assert (step.action, step.step, step.chosen, step.previous, step.switched) == ("replan", 4, "blue", "red", True)
    assert step.t_switch_s == pytest.approx(step.t_s + PERIOD_S, abs=1e-9)
    assert step.compute_s == pytest.approx(0.0275)
    blue = step.plan_of_chosen
    assert blue is not None
    assert blue.selection_cost == 0.0025 + 1.6 * float(np.exp(-12.0 * (4 / 20.0)))
    assert blue.terms["human_occupancy"] == blue.selection_cost
    assert not full.steps[1].goals[1].valid
    assert "table" in full.steps[1].goals[1].message
    assert full.steps[8].action == "missed"
    assert full.goal_names == ("red", "blue")


def test_steps_are_what_was_planned_and_compared(full: Run) -> None:
    kept = dataclasses.replace(full.steps[5], action="keep")
    arrived = dataclasses.replace(full.steps[-1], action="arrived")
    run = dataclasses.replace(full, decisions=(*full.steps[:5], kept, *full.steps[6:-1], arrived))
    assert [step.action for step in run.steps[5:7]] == ["keep", "replan"]
    assert len(run.steps) == len(full.steps) - 1


def test_steps_of_a_restarted_planner_are_counted_anew_and_told(tmp_path: Path) -> None:
    goal = (0, "red", "chosen", {"selection_cost": "1.0"})
    with BagWriter(tmp_path / "bag") as writer:
        for k, step in enumerate((1, 2, 1, 2, 3)):
            array = diagnostic_array(10 * k, [(0, "decision", "replan", {"step": str(step)}), goal])
            writer.write_message(topics.DECISION, 10 * k, array)
    run = read_run(tmp_path)
    assert [step.step for step in run.steps] == [1, 2, 3, 4, 5]
    assert any("counted anew" in text for text in run.notes)


def test_goals_that_come_and_go_lose_nothing_of_the_posterior(tmp_path: Path) -> None:
    told = [((4, 7), (0.25, 0.75)), ((4, 7, 2), (0.125, 0.375, 0.5)), ((2,), (1.0,))]
    with BagWriter(tmp_path / "bag") as writer:
        for k, (labels, probability) in enumerate(told):
            numbers = np.array(labels, dtype=np.float32)
            fields = {"x": numbers, "y": numbers + k, "z": numbers, "class_id": numbers}
            fields["probability"] = np.array(probability, dtype=np.float32)
            cloud = messages.point_cloud2(10_000_000 * k, "world", fields)
            writer.write_message(topics.HUMAN_GOALS, 10_000_000 * k, cloud)
    posterior = read_run(tmp_path).posterior
    assert posterior.labels == ("2", "4", "7")
    np.testing.assert_array_equal(posterior.probability, [[0, 0.25, 0.75], [0.5, 0.125, 0.375], [1, 0, 0]])
    np.testing.assert_array_equal(posterior.goals_m[:, 1], [2 + 2, 4 + 1, 7 + 1])


def test_latencies_are_differences_of_the_times_of_sending(full: Run) -> None:
    by_name = {latency.name: latency for latency in full.latencies}
    jitter_s = 1e-9 * np.round(1e6 * (0.4 * np.sin(12.9898 * np.arange(160)) + 0.5))
    np.testing.assert_allclose(by_name[POSTURE_TO_OCCUPANCY].delay_s, 0.004 + jitter_s, atol=1e-12)
    answered = by_name[POSTURE_TO_TRAJECTORY]
    assert len(answered) == 27  # the missed step sent none
    k = np.rint(answered.t_s / POSTURE_S).astype(int)
    np.testing.assert_allclose(answered.delay_s, 0.031 - 50e-6 + jitter_s[k], atol=1e-12)


def test_percent_of_the_motion_ends_at_a_hundred(full: Run) -> None:
    assert full.percent(0.0) == 0.0
    assert full.percent(REACH_S / 2) == pytest.approx(50.0)
    assert full.percent(REACH_S + 1.0) == 100.0


def test_length_of_the_motion_is_found_where_it_was_not_told(make_run: Callable[..., Path]) -> None:
    run = read_run(make_run(facts={"duration_s": ""}, held=20))
    assert run.motion_duration_s == pytest.approx(REACH_S, abs=2 * POSTURE_S)


@pytest.mark.parametrize("missing", RECORDED)
def test_any_topic_may_be_missing(make_run: Callable[..., Path], missing: str) -> None:
    run = read_run(make_run(without=(missing,), n_postures=12, held=0))
    assert missing not in {topic.name for topic in run.topics}
    assert len(run.postures) == (0 if missing.startswith("/humans/bodies/body_0/joint") else 12)
    assert len(run.decisions) == (0 if missing.endswith("decision") else 12)
    assert (run.occupancy.grid is None) == missing.endswith("voxel_grid")


def test_a_run_interrupted_before_anything_came_is_empty(make_run: Callable[..., Path], tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_metadata("run", {"scene": "face_to_face"})
    for folder in (tmp_path, make_run(n_postures=0)):
        run = read_run(folder)
        assert len(run.postures) == len(run.posterior) == len(run.occupancy) == len(run.decisions) == 0
        assert run.steps == () == run.trajectories
        assert all(len(latency) == 0 for latency in run.latencies)
        assert run.percent(0.0) in (None, 0.0)


def test_unusable_postures_are_left_out_and_told(make_run: Callable[..., Path]) -> None:
    run = read_run(make_run(nan_posture=5, n_postures=12, held=0))
    assert len(run.postures) == 11
    assert np.isfinite(run.postures.q).all()
    assert any("non-finite" in text for text in run.notes)


def test_stamps_that_jump_back_are_left_out_and_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for k, stamp in enumerate((10, 20, 20, 15, 30)):
            message = messages.joint_state(stamp, ["a"], [float(k)])
            writer.write_message("/humans/bodies/x/joint_states", 1_000 + k, message)
    run = read_run(tmp_path)
    np.testing.assert_array_equal(run.postures.q[:, 0], [0.0, 1.0, 4.0])
    assert len(run.notes) == 1
    assert "1 messages" in run.notes[0]


def test_full_turns_of_endless_joints_are_no_motion(make_run: Callable[..., Path]) -> None:
    plain, turned = (read_run(make_run(full_turns=turns, n_postures=70, held=0)) for turns in (0, 3))
    np.testing.assert_allclose(plain.robot.q, turned.robot.q, atol=1e-9)


def test_what_is_no_run_is_refused_with_a_way_out(make_run: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"humanpred demo"):
        read_run(tmp_path / "nothing")
    broken = shutil.copytree(make_run(n_postures=12, held=0), tmp_path / "broken")
    file = next((broken / "bag").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(BagError, match=r"salvage"):
        read_run(broken)


def test_topics_of_another_kind_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_message("/human_occupancy", 1, messages.string("hello"))
    with pytest.raises(BagError, match=r"PointCloud2"):
        read_run(tmp_path)


@pytest.mark.parametrize("values", [{"step": "first"}, {"t_switch_s": "np.float64(1.0)"}])
def test_decisions_that_are_not_ours_are_refused(tmp_path: Path, values: dict[str, str]) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        array = diagnostic_array(5, [(0, "decision", "keep", values)])
        writer.write_message(topics.DECISION, 5, array)
    with pytest.raises(BagError, match="wanted numbers"):
        read_run(tmp_path)


def test_the_example_reads_a_run(full: Run) -> None:
    program = REPOSITORY / "examples" / "read_run.py"
    done = subprocess.run([sys.executable, str(program), str(full.folder)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{len(full.postures)} postures")
    assert done.stdout.count("step ") == len(full.steps)
