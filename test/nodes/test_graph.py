"""The whole graph as separate processes over DDS on a shipped bag, with numeric verdicts."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray
from paths import REPOSITORY
from rich.console import Console
from rosbags.rosbag2 import Reader
from sent_trajectories import trajectory_from_message
from waiting import processes_with_environment, wait_until

from humanpred_ros.bags.messages import point_cloud2_fields
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.evaluation.demo import DemoSettings, period_of, run_demo
from humanpred_ros.evaluation.reproduce import compare_bags, replay_run
from humanpred_ros.evaluation.simulation import drive, predicted
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.recognition.training import load_model
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros import topics
from humanpred_ros.nodes import conversions, occupancy_topics
from humanpred_ros.nodes.planner_settings import StompPlannerSettings

LABEL, INDEX = 3, 2
OPTIONS = DemoSettings(trajectory=f"{LABEL}/{INDEX}", seed=3, markers=True)
POSTURES = topics.human_joint_states("body_0")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one stepped run on the shipped library."""
    folder = tmp_path_factory.mktemp("graph") / "run"
    options = OPTIONS.replaced(out=str(folder))
    summary = run_demo(options, Console(file=io.StringIO()))
    assert summary.missed == 0
    return folder


@pytest.fixture(scope="module")
def bag(run: Path) -> BagReader:
    return BagReader(run / "bag")


@pytest.fixture(scope="module")
def motion() -> Motion:
    return load_library(REPOSITORY / "bags" / "synthetic_reaches").find(OPTIONS.trajectory)


def by_stamp(bag: BagReader, topic: str) -> dict[int, Any]:
    return {conversions.stamp_ns(message.header.stamp): message for _, message in bag.decoded(topic)}


@pytest.mark.core
def test_every_posture_arrives_and_is_answered_once(bag: BagReader, motion: Motion) -> None:
    stamps = list(by_stamp(bag, POSTURES))
    assert len(stamps) == bag.require_topic(POSTURES).count >= len(motion)
    assert list(by_stamp(bag, topics.COMPACT_OCCUPANCY)) == stamps
    # Clouds are listened to until the publisher of the compact form is found.
    assert bag.require_topic(topics.OCCUPANCY).count < 0.2 * len(stamps)
    assert list(by_stamp(bag, topics.HUMAN_GOALS)) == stamps
    assert list(by_stamp(bag, topics.POSTERIOR)) == stamps
    decisions = by_stamp(bag, topics.DECISION)
    assert list(decisions) == stamps
    for stamp, costs in by_stamp(bag, topics.COSTS).items():  # as the decision's texts, but numbers
        told = {s.name: {v.key: v.value for v in s.values}["selection_cost"] for s in decisions[stamp].status[1:]}
        assert dict(zip(costs.name, map(repr, map(float, costs.position)), strict=True)) == told
    assert bag.require_topic(topics.COSTS).count == sum(len(d.status) > 1 for d in decisions.values()) > 0
    assert len(stamps) == bag.require_topic(topics.DECISION).count
    recorded = np.array([message.position for message in by_stamp(bag, POSTURES).values()])
    assert np.array_equal(recorded[: len(motion)], motion.q)


def test_the_true_class_is_recognised(bag: BagReader, motion: Motion) -> None:
    posteriors = [point_cloud2_fields(message) for message in by_stamp(bag, topics.HUMAN_GOALS).values()]
    for fields in posteriors:
        assert 0.0 < fields["probability"].sum() <= 1.0 + 1e-5  # the rest is the probability of no class
    at_the_end_of_the_reach = posteriors[int(0.7 * len(motion))]
    truth = fields_of(at_the_end_of_the_reach, str(LABEL).encode())
    assert truth > 0.5


def fields_of(fields: dict[str, NDArray[Any]], label: bytes) -> float:
    return float(fields["probability"][fields["label"] == label][0])


@pytest.mark.core
def test_occupancy_and_posterior_are_those_of_the_library_called_directly(run: Path, bag: BagReader) -> None:
    scene, human = load_scene(OPTIONS.scene), HumanModel.kinect12()
    model = load_model(run / "model.npz", human)
    predictor = make_predictor(
        OPTIONS.predictor, PredictorRequest(human, scene.grid, scene.T_world_human, model, onsets=True)
    )
    clouds, goals = by_stamp(bag, topics.COMPACT_OCCUPANCY), by_stamp(bag, topics.HUMAN_GOALS)
    origin_ns = next(iter(clouds))
    for stamp, message in by_stamp(bag, POSTURES).items():
        prediction = predictor.update(np.array(message.position), (stamp - origin_ns) * 1e-9)
        expected = prediction.occupancy.sparse(OPTIONS.threshold).probability
        came = occupancy_topics.occupancy_of(clouds[stamp], scene.grid, 0.0).probability
        np.testing.assert_array_equal(came, expected)
        assert expected.max() == 1.0  # the body is where it is
        assert prediction.posterior is not None
        probability = point_cloud2_fields(goals[stamp])["probability"]
        np.testing.assert_array_equal(probability, prediction.posterior.probability.astype(np.float32))


def test_trajectories_keep_limits_times_and_continuity(bag: BagReader) -> None:
    scene = load_scene(OPTIONS.scene)
    chain = scene.arm.chain
    messages = list(by_stamp(bag, topics.TRAJECTORY).values())
    assert messages
    origin_ns = next(iter(by_stamp(bag, POSTURES)))
    executing = None
    for message in messages:
        trajectory = trajectory_from_message(message, chain.joint_names, origin_ns)
        t = np.linspace(trajectory.start_s, trajectory.end_s, 500)
        q, v, _ = trajectory.sample(t)
        assert (np.abs(v) <= chain.velocity_limit * 1.001).all()
        assert ((q >= chain.lower - 0.01) & (q <= chain.upper + 0.01)).all()
        before = (scene.start, 0.0, 0.0) if executing is None else executing.sample(trajectory.start_s)
        # Times travel in whole nanoseconds, which accelerations between knots 20 ms apart feel most.
        state = (trajectory.q[0], trajectory.v[0], trajectory.a[0])
        for was, becomes, tolerance in zip(before, state, (1e-6, 1e-6, 1e-3), strict=True):
            np.testing.assert_allclose(becomes, was, atol=tolerance)
        executing = trajectory
    goals = np.array([goal.configuration for goal in scene.goals])
    assert np.abs(goals - executing.q[-1]).max(axis=1).min() < 1e-6  # type: ignore[union-attr]
    # The simulated arm was where it was told to be, at every posture from the start on.
    states = by_stamp(bag, topics.JOINT_STATES)
    assert set(by_stamp(bag, POSTURES)) <= states.keys()
    for stamp, state in list(states.items())[-5:]:
        told = executing.sample((stamp - origin_ns) * 1e-9)[0]  # type: ignore[union-attr]
        np.testing.assert_allclose(state.position, told, atol=1e-6)
    # "arrived" was said only once it had.
    assert np.abs(goals - np.asarray(list(states.values())[-1].position)).max(axis=1).min() < 1e-6


def test_the_bag_is_complete_for_other_readers(run: Path, bag: BagReader) -> None:
    (file,) = (run / "bag").glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        by_mcap = sum(1 for _ in reader.iter_messages())
        facts = {record.name: record.metadata for record in reader.iter_metadata()}
    with Reader(run / "bag") as other:
        assert sum(1 for _ in other.messages()) == by_mcap == other.message_count
        names = {connection.topic for connection in other.connections}
    assert facts["run"]["trajectory"] == OPTIONS.trajectory
    expected = (POSTURES, topics.human_urdf("body_0"), topics.VOXEL_GRID, topics.CLOCK)
    assert names.issuperset(bag.find(name) for name in (*expected, topics.CANDIDATES, topics.ROLLOUTS))
    assert "<svg" in (run / "report.html").read_text(encoding="utf-8")


class Sender(Replanner):
    """Remembers what the node sends: what is left of the motion under way, and the new one after it."""

    def respond(self, *arguments: Any) -> Decision:
        if not hasattr(self, "sent"):
            self.sent: list[TimedTrajectory] = []
        decision = super().respond(*arguments)
        if decision.trajectory is not None:
            motion = self.motion_from(min(decision.stamp_s, decision.t_switch_s))
            self.sent.append(motion.lasting_until(decision.stamp_s + 0.1))
        return decision


@pytest.mark.core
def test_a_stepped_run_decides_as_the_library_called_directly(run: Path, bag: BagReader, motion: Motion) -> None:
    scene, human = load_scene(OPTIONS.scene), HumanModel.kinect12()
    model = load_model(run / "model.npz", human)
    predictor = make_predictor(
        OPTIONS.predictor, PredictorRequest(human, scene.grid, scene.T_world_human, model, onsets=True)
    )
    settings = StompPlannerSettings(period_s=period_of(motion, OPTIONS.steps), seed=OPTIONS.seed, threads=1)
    replanner = Sender.for_scene(scene, settings.replanner_config())
    n_held = int(OPTIONS.hold_last_s / motion.period_s)
    direct = drive(replanner, scene.start, predicted(predictor, motion, OPTIONS.threshold, n_held), len(motion))
    over_dds = by_stamp(bag, topics.DECISION)
    assert len(direct) == len(over_dds)
    origin_ns = next(iter(over_dds))
    for decision, (stamp, message) in zip(direct, over_dds.items(), strict=True):
        assert facts_of(message) == facts_of(conversions.decision_message(decision, stamp, 0.0))
    sent = by_stamp(bag, topics.TRAJECTORY)
    assert len(sent) == len(replanner.sent) >= 1
    for trajectory, message in zip(replanner.sent, sent.values(), strict=True):
        expected = conversions.trajectory_message(replanner.joint_names, trajectory, origin_ns)
        assert conversions.stamp_ns(expected.header.stamp) == conversions.stamp_ns(message.header.stamp)
        for ours, theirs in zip(expected.points, message.points, strict=True):
            assert conversions.stamp_ns(ours.time_from_start) == conversions.stamp_ns(theirs.time_from_start)
            assert ours.positions.tolist() == theirs.positions.tolist()
            assert ours.velocities.tolist() == theirs.velocities.tolist()
            assert ours.accelerations.tolist() == theirs.accelerations.tolist()
    assert any(decision.action == "arrived" for decision in direct)
    # The person takes the place the arm was going to; it goes to another one.
    assert any(decision.switched for decision in direct)


def facts_of(message: Any) -> list[tuple[str, str, dict[str, str]]]:
    return [
        (status.name, status.message, {v.key: v.value for v in status.values if v.key != "compute_ms"})
        for status in message.status
    ]


def test_a_fresh_planner_fed_the_recorded_occupancy_decides_the_same(run: Path, tmp_path: Path) -> None:
    comparison = replay_run(run, tmp_path / "replayed")
    assert comparison.n_decisions > 20
    assert comparison.n_trajectories >= 1
    assert comparison.differing == ()


@pytest.mark.core
def test_predictor_and_planner_in_one_process_decide_the_same(run: Path, bag: BagReader, tmp_path: Path) -> None:
    folder = tmp_path / "one"
    run_demo(
        OPTIONS.replaced(out=str(folder), model=str(run / "model.npz"), one_process=True), Console(file=io.StringIO())
    )
    one = BagReader(folder / "bag")
    assert compare_bags(bag, one).differing == ()
    # Everybody else gets the same as from two processes.
    for topic in (topics.COMPACT_OCCUPANCY, topics.HUMAN_GOALS):
        ours, theirs = ([bytes(m.data) for m in by_stamp(b, topic).values()] for b in (bag, one))
        assert ours == theirs


def test_a_comparison_finds_what_differs(run: Path, bag: BagReader, tmp_path: Path) -> None:
    other = DemoSettings(
        **{**OPTIONS.__dict__, "out": str(tmp_path / "other"), "seed": 4, "model": str(run / "model.npz")}
    )
    run_demo(other, Console(file=io.StringIO()))
    comparison = compare_bags(bag, BagReader(tmp_path / "other" / "bag"))
    assert comparison.differing


@pytest.mark.parametrize("when", ["training", "starting", "moving"])
def test_ctrl_c_leaves_no_process_and_a_readable_bag(run: Path, tmp_path: Path, when: str) -> None:
    folder = tmp_path / "run"
    command = [
        sys.executable,
        "-m",
        "humanpred_ros.cli",
        "demo",
        "--trajectory",
        OPTIONS.trajectory,
        "--out",
        str(folder),
    ]
    # Where a run with this seed was once interrupted too late, its model is kept and nothing is trained again:
    # a new seed each time.
    command += ["--seed", str(time.time_ns() % 2**31)] if when == "training" else ["--model", str(run / "model.npz")]
    demo = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    assert demo.stdout is not None
    try:
        if when == "training":
            wait_until(lambda: "sklearn" in mapped(demo.pid), "the demo to load what only training needs")
        elif when == "starting":
            wait_until(lambda: len(list((folder / "logs").glob("*.log"))) >= 4, "the nodes to be started")
        else:
            log = folder / "logs" / "stomp_planner.log"
            wait_until(lambda: log.exists() and " s to place" in log.read_text(encoding="utf-8"), "a decision")
        os.killpg(demo.pid, signal.SIGINT)
        output, _ = demo.communicate(timeout=30.0)
    finally:
        demo.kill()
        demo.stdout.close()
    assert demo.returncode == 130, output
    assert "interrupted" in output
    assert processes_with_environment(f"ROS_LOG_DIR={folder}") == []
    if when == "moving":
        assert BagReader(folder / "bag").require_topic(POSTURES).count > 0
    elif (folder / "bag").exists():
        assert BagReader(folder / "bag").message_count >= 0


def mapped(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
    except OSError:
        return ""


def test_markers_are_recorded_where_they_are_asked_for(bag: BagReader) -> None:
    planned = {stamp for stamp, message in by_stamp(bag, topics.DECISION).items() if len(message.status) > 1}
    for topic, prefix in ((topics.CANDIDATES, "candidate/"), (topics.ROLLOUTS, "rollouts/")):
        arrays = [message.markers for _, message in bag.decoded(topic)]
        assert arrays
        for first, *others in arrays:
            assert first.action == 3  # DELETEALL: what an earlier step had drawn
            assert all(marker.ns.startswith(prefix) and len(marker.points) for marker in others)
            assert {conversions.stamp_ns(marker.header.stamp) for marker in others} <= planned


def test_decisions_keep_their_numbers_over_the_wire(bag: BagReader) -> None:
    planned = [message for message in by_stamp(bag, topics.DECISION).values() if len(message.status) > 1]
    assert planned
    for message in planned:
        for goal in message.status[1:]:
            values = {item.key: item.value for item in goal.values}
            assert float(values["selection_cost"]) >= 0.0
            assert {"cost/human", "cost/obstacle", "cost/smoothness"} <= values.keys()
