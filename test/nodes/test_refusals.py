"""Data that cannot be used lead to a counted refusal or a hold with a named reason, never to a crash."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import ArrayError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import placed_postures, turn_and_shift
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_client import NodeClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.time import Time
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, occupancy_topics, qos
from humanpred_ros.nodes.frames import pose_matrix, tf_lookup
from humanpred_ros.nodes.lifecycle import started
from humanpred_ros.nodes.occupancy_predictor import OccupancyPredictorNode
from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.nodes.run_recorder import RunRecorder
from humanpred_ros.nodes.seen_people import SeenPeople
from humanpred_ros.nodes.skeleton_tracker_replay import SkeletonTrackerReplay
from humanpred_ros.nodes.stomp_planner import StompPlannerNode

SCENE = load_scene("face_to_face")
HUMAN = HumanModel.kinect12()
POSTURE = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q[0]
NS = conversions.NS_PER_S


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[type[Any], dict[str, str]], Any]]:
    """Return a maker of nodes on a domain of their own."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    nodes: list[Any] = []

    def make(kind: type[Any], parameters: dict[str, str]) -> Any:
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        rclpy.init(args=arguments, domain_id=free_domain_id())
        nodes.append(started(kind))
        return nodes[-1]

    try:
        yield make
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def posture(t_ns: int, q: np.ndarray = POSTURE, names: tuple[str, ...] = HUMAN.dof_names) -> Any:
    return conversions.joint_state(names, q, t_ns, "kinect")


class PredictorWithClock:
    """An occupancy_predictor whose clock the test sets, and what it publishes.

    Attributes:
        said: of each cloud, the reason why nobody knows where people are, or "" for an ordinary one.
    """

    def __init__(self, make: Callable[..., Any], **parameters: str) -> None:
        self.node = make(OccupancyPredictorNode, {"predictor": "current", "use_sim_time": "true", **parameters})
        self.node.occupancies.compact.publish = self._take
        self.node.people.steady_s = lambda: self.now_s
        self.now_s, self.rng = 0.0, np.random.default_rng(0)
        self.said: list[str] = []

    def _take(self, message: Any) -> None:
        try:
            occupancy_topics.occupancy_of(message, SCENE.grid, 0.0)
        except ArrayError as error:
            self.said.append(str(error).removeprefix("where people are is not known: "))
        else:
            assert message.data, "an empty occupancy"
            self.said.append("")

    def see(
        self, now_s: float, stamp_s: float | None = None, q: np.ndarray | None = None, **changes: Any
    ) -> str | None:
        """Show a posture at a time, of a person at rest if not told; return what is said of it, None for nothing."""
        q = POSTURE + 1e-4 * self.rng.standard_normal(len(POSTURE)) if q is None else q
        self.now_s = now_s
        self.node.get_clock().set_ros_time_override(Time(nanoseconds=round((1000.0 + now_s) * NS)))
        message = posture(round((1000.0 + (now_s if stamp_s is None else stamp_s)) * NS), q)
        for name, value in changes.items():
            setattr(message.header if name == "frame_id" else message, name, value)
        before = len(self.said)
        self.node.people.take(self.node.people.bodies["body_0"], message)
        return self.said[-1] if len(self.said) > before else None

    def stream(self, begin_s: float, end_s: float, ahead_s: float = 0.0, **changes: Any) -> list[str | None]:
        """Show a person at rest 30 times a second; return what is said of each posture."""
        return [self.see(t, t + ahead_s, **changes) for t in np.arange(begin_s, end_s, 1 / 30).tolist()]


def kind(said: str | None) -> str | None:
    return None if said is None else said.split(":")[0]


def test_the_predictor_refuses_postures_by_name_and_goes_on(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    millimetres, spoiled = POSTURE.copy(), POSTURE.copy()
    millimetres[:3] *= 1000.0
    spoiled[3] = np.nan
    faults: dict[str, dict[str, Any]] = {
        "not finite": {"position": spoiled.tolist()},
        "missing joints": {"name": list(HUMAN.dof_names[:-1])},
        "joint twice": {"name": [*HUMAN.dof_names[:-1], HUMAN.dof_names[0]]},
        "units": {"position": millimetres.tolist()},
        "wrong frame": {"frame_id": "camera"},
        "stamp zero": {},
    }
    t = 0.0
    for again in range(2):  # each is found again after it has gone
        for fault, changes in faults.items():
            assert set(predictor.stream(t, t + 0.8)[-10:]) == {""}
            stamp_s = -1000.0 if fault == "stamp zero" else None
            assert kind(predictor.see(t + 0.81, stamp_s, **changes)) == fault
            t += 0.85
        assert {name: predictor.node.refused[name] > again for name in faults} == dict.fromkeys(faults, True)
    assert set(predictor.stream(t, t + 1.0)[-10:]) == {""}


def test_a_bad_posture_in_two_is_never_believed(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    spoiled = POSTURE.copy()
    spoiled[3] = np.nan
    said = [predictor.see(k / 30, None, spoiled if k % 2 else POSTURE + 1e-3 * k) for k in range(60)]
    assert said[0] == ""
    assert {kind(one) for one in said[1:]} == {"not finite"}


def test_a_frame_must_be_the_expected_one_and_be_named(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros, human_frame="camera_link")
    assert set(predictor.stream(0.0, 0.5, frame_id="/camera_link")) == {""}
    said = predictor.see(0.6, frame_id="kinect")
    assert said is not None
    assert "wanted 'camera_link', got 'kinect'" in said
    assert kind(predictor.see(0.7, frame_id="")) == "wrong frame"
    assert predictor.node.holding_because().startswith("wrong frame")
    assert set(predictor.stream(0.8, 1.5, frame_id="camera_link")[-5:]) == {""}
    assert predictor.node.holding_because() == ""


def test_where_tf_is_postures_of_other_frames_are_where_it_says(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    clouds: list[Any] = []
    take = predictor._take
    predictor.node.occupancies.compact.publish = lambda message: (clouds.append(message), take(message))
    assert predictor.see(0.0) == ""
    # The same person, seen by a camera that stands elsewhere.
    T_world_camera = SCENE.T_world_human @ turn_and_shift(0.7, (0.5, -0.3, 0.2))
    poses = {"camera": T_world_camera, "tilted": T_world_camera @ pose_matrix((0, 0, 0), (1.0, 0, 0, 0))}

    def lookup(frame: str) -> Any:
        if frame not in poses:
            raise LookupError("no such frame")
        return poses[frame]

    predictor.node.people.frames.lookup = lookup
    seen = placed_postures(POSTURE, HUMAN.dof_names, np.linalg.inv(turn_and_shift(0.7, (0.5, -0.3, 0.2))))
    assert predictor.see(0.1, q=seen, frame_id="camera") == ""
    first, second = (occupancy_topics.occupancy_of(cloud, SCENE.grid, 0.0).probability for cloud in clouds)
    assert (first != second).sum() < 0.01 * first.sum()  # rounding puts a few points into the next voxel
    said = [predictor.see(0.2 + k / 10, frame_id=frame) for k, frame in enumerate(("tilted", "map", ""))]
    assert [kind(one) for one in said] == ["wrong frame"] * 3
    assert ("z up" in str(said[0]), "no such frame" in str(said[1])) == (True, True)
    poses["kinect"] = T_world_camera  # somebody moved it: TF knows, the scene does not
    assert set(predictor.stream(1.0, 2.0)[-5:]) == {""}
    assert "0.6" in predictor.node.warnings["tracker frame"]


def test_tf_is_asked_for_the_newest_pose_in_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoWayError(Exception):
        pass

    def lookup_transform(target: str, source: str, time: Any) -> Any:
        if source != "camera":
            raise NoWayError(f"{source} does not exist")
        assert (target, time.nanoseconds) == ("world", 0)
        half = np.sqrt(0.5)
        pose = SimpleNamespace(
            translation=SimpleNamespace(x=1.0, y=2.0, z=3.0), rotation=SimpleNamespace(x=0.0, y=0.0, z=half, w=half)
        )
        return SimpleNamespace(transform=pose)

    tf2 = SimpleNamespace(
        Buffer=lambda: SimpleNamespace(lookup_transform=lookup_transform),
        TransformListener=lambda buffer, node: None,
        TransformException=NoWayError,
    )
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2)
    lookup = tf_lookup(None)  # type: ignore[arg-type]
    assert lookup is not None
    np.testing.assert_allclose(lookup("camera"), turn_and_shift(np.pi / 2, (1.0, 2.0, 3.0)), atol=1e-12)
    with pytest.raises(LookupError, match="map does not exist"):
        lookup("map")
    with pytest.raises(LookupError, match="a pose that is none"):
        pose_matrix((0.0, np.nan, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_a_posture_that_was_overtaken_is_no_hold_and_a_clock_that_goes_back_is(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    assert set(predictor.stream(0.0, 0.5)) == {""}
    assert predictor.see(0.51, 0.3) is None
    assert predictor.see(0.52, 0.51) == ""
    said = predictor.stream(0.6, 1.5, ahead_s=-0.9)  # a tracker whose clock was set back
    assert said[0] is None
    assert {kind(one) for one in said[6:20]} == {"stamp back"}
    said = predictor.stream(1.5, 2.5, ahead_s=-0.9)
    assert said[-1] == "", "taken up again; whoever plans says that it is old"
    assert "0.9 s behind" in predictor.node.warnings["clock of body_0"]
    assert set(predictor.stream(4.0, 4.6)[-5:]) == {""}
    assert [kind(predictor.see(4.7 + k / 30, 4.6)) for k in range(12)][-3:] == ["stamp equal"] * 3


def test_a_clock_ahead_is_named_with_its_size_and_moves_nothing(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    for begin in (0.0, 2.0):
        assert set(predictor.stream(begin, begin + 0.5)) == {""}
        assert str(predictor.see(begin + 0.51, 3600.0)).startswith("stamp ahead: a posture's stamp is 3.6e+03 s")
        assert predictor.see(begin + 0.52) == ""
        said = predictor.stream(begin + 0.6, begin + 1.0, ahead_s=3.0)
        assert set(said[3:]) == {"stamp ahead: the tracker's clock is 3 s ahead of this host's clock"}
        assert predictor.see(begin + 1.01) == ""


def test_ages_that_change_while_a_planner_runs_count_for_what_it_hears(ros: Callable[..., Any]) -> None:
    planner = ros(StompPlannerNode, {"scene": "face_to_face", "iterations": "2", "waypoints": "20"})
    assert planner.on_parameters(
        [Parameter("max_arm_age_s", value=0.7), Parameter("max_human_age_s", value=0.9)]
    ).successful
    ages_s = {topic: heard.max_age_s for topic, heard in planner.inputs.items()}
    assert ages_s["/joint_states"] == 0.7
    assert {age_s for topic, age_s in ages_s.items() if topic.startswith("/human_occupancy")} == {0.9}


def test_a_planner_names_the_other_hosts_clock_and_a_transport_that_gives_nothing() -> None:
    people = SeenPeople(StompPlannerSettings())
    assert people.ahead(-0.8).endswith("at most 0.05 s are allowed")
    people.clock = lambda: "the clock of the host that publishes /people is 0.80 s ahead of this host's"
    people.silence = lambda: "/people: its publisher is there, but nothing has arrived for longer than 0.5 s"
    assert people.ahead(-0.8) == (
        "stamp ahead: the human data's stamps are 0.8 s ahead of this host's clock, at most 0.05 s are allowed; "
        "the clock of the host that publishes /people is 0.80 s ahead of this host's"
    )
    assert people.stale(0.9).endswith("; the clock of the host that publishes /people is 0.80 s ahead of this host's")
    assert people.overdue(people.true_s + 0.6).endswith("0.60 s old; " + people.silence())


def test_a_clock_that_is_set_back_is_a_hold_and_then_a_new_beginning(ros: Callable[..., Any]) -> None:
    predictor = PredictorWithClock(ros)
    for _ in range(2):
        assert set(predictor.stream(5.0, 5.5)[1:]) == {""}
        said = predictor.stream(2.0, 2.5)
        assert kind(said[0]) == "clock set back"
        assert set(said[1:]) == {""}
        predictor.now_s = 2.6


def test_a_replay_stamps_with_the_time_there_is_after_the_clock_was_set(ros: Callable[..., Any]) -> None:
    node = ros(SkeletonTrackerReplay, {})
    stamps: list[int] = []
    node.bodies["body_0"][0].publish = lambda message: stamps.append(conversions.stamp_ns(message.header.stamp))
    node.begun, node.begun_s = True, time.monotonic()
    node.begin()
    node.publish_due()
    for set_by_s in (36, -72):
        node.origin_ns -= set_by_s * NS
        n_before = len(stamps)
        while len(stamps) == n_before:
            node.publish_due()
        assert abs(node.get_clock().now().nanoseconds - stamps[-1]) < NS


def cloud(t_ns: int, grid: VoxelGrid = SCENE.grid) -> Any:
    probability = np.zeros(grid.shape, dtype=np.float32)
    probability[5, 5, 5] = 0.5
    return conversions.occupancy_cloud(Occupancy(grid, probability), 0.0, t_ns)


def test_the_planner_holds_on_occupancy_it_cannot_use(ros: Callable[..., Any]) -> None:
    node = ros(StompPlannerNode, {"scene": "face_to_face", "lossless": "true", "iterations": "5"})
    decisions: list[Any] = []
    trajectories: list[Any] = []
    node.decision_publisher.publish = decisions.append
    node.commander.send = trajectories.append
    node.on_occupancy(cloud(1 * NS))
    # Without the arm's joints there is nothing to plan from.
    assert [decision.status[0].message for decision in decisions] == ["hold"]
    decisions.clear()
    assert node.refused["no arm"] == 1
    arm = conversions.joint_state(node.replanner.joint_names, SCENE.start, 1)
    arm.position[2] = np.nan
    node.on_joint_state(arm)
    assert node.arm.q is None
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names[:-1], SCENE.start[:-1], 1))
    assert node.arm.q is None
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names, SCENE.start, 1))

    node.on_occupancy(cloud(1 * NS))
    node.on_occupancy(cloud(1 * NS + NS // 5))
    assert [decision.status[0].message for decision in decisions] == ["keep", "replan"]
    spoiled = cloud(1 * NS + NS // 4)
    points = np.frombuffer(bytes(spoiled.data), dtype="<f4").copy()
    points[3] = np.nan
    spoiled.data = points.tobytes()
    node.on_occupancy(spoiled)
    assert decisions[-1].status[0].message == "hold"
    reason = {item.key: item.value for item in decisions[-1].status[0].values}["reason"]
    assert "invalid human data: not finite" in reason
    other = VoxelGrid((-2.01, -3.0, -0.4), 0.05, SCENE.grid.shape)
    node.on_occupancy(cloud(1 * NS + NS // 3, other))
    assert decisions[-1].status[0].message == "hold"
    assert node.refused["other lattice"] == 1
    node.on_occupancy(cloud(2 * NS))
    assert decisions[-1].status[0].message in ("replan", "keep")


def test_a_planner_that_finds_another_just_after_it_began_leaves_the_arm_alone(ros: Callable[..., Any]) -> None:
    node = ros(StompPlannerNode, {"scene": "face_to_face", "iterations": "5"})
    decisions: list[Any] = []
    node.decision_publisher.publish = decisions.append
    looking, late, names = True, "", ""
    node.others = SimpleNamespace(looking=lambda: looking, late=lambda: late, names=lambda: names, begin=lambda: None)
    nothing = Occupancy(SCENE.grid, np.zeros(SCENE.grid.shape, dtype=np.float32))

    def answer() -> str:
        """Return the answer to an occupancy, with the arm at rest; a busy machine lets the process stand still."""
        while (said := told()).startswith("hold stood still"):
            pass
        return said

    def told() -> str:
        n_before = len(decisions)
        until_s = time.monotonic() + 30.0
        while len(decisions) == n_before and time.monotonic() < until_s:
            now_ns = node.get_clock().now().nanoseconds
            node.on_joint_state(conversions.joint_state(node.replanner.joint_names, SCENE.start, now_ns))
            node.on_occupancy(conversions.occupancy_cloud(nothing, 0.0, now_ns))
            time.sleep(0.01)
        (status,) = decisions[-1].status
        return f"{status.message} " + next(item.value for item in status.values if item.key == "reason")

    assert answer().startswith("hold looking around: whether two planners command this arm")
    node.commander.waiting_for = str
    assert node.waiting_for() == "other planners to be heard of, if there are any"
    looking = False
    while answer().startswith("hold arm not known"):
        pass
    assert node.begun
    late = names = "/the_first"
    answer()
    assert not node.begun
    late = ""
    assert answer() == "hold two planners: /the_first commands this arm already; end one of them"
    names = ""
    answer()
    assert node.begun
    node.close()


def test_rollouts_are_kept_only_for_someone_who_looks(ros: Callable[..., Any]) -> None:
    node = ros(StompPlannerNode, {"scene": "face_to_face", "lossless": "true", "iterations": "5", "rollouts": "6"})
    node.on_joint_state(conversions.joint_state(node.replanner.joint_names, SCENE.start, 1))
    drawn: list[Any] = []
    node.pictures.rollouts.publish = drawn.append
    for t_ns in (1 * NS, 1 * NS + NS // 5):
        node.on_occupancy(cloud(t_ns))
    assert node.replanner.rollouts == {}
    assert drawn == []
    node.pictures.rollouts.get_subscription_count = lambda: 1
    node.on_occupancy(cloud(1 * NS + 2 * NS // 5))
    assert {paths.shape[0] for paths in node.replanner.rollouts.values()} == {6}
    assert {marker.ns for marker in drawn[0].markers[1:]} == {f"rollouts/{name}" for name in node.replanner.rollouts}
    node.pictures.rollouts.get_subscription_count = lambda: 0
    node.on_occupancy(cloud(1 * NS + 3 * NS // 5))
    assert len(drawn) == 1


@pytest.mark.parametrize("markers", [False, True])
def test_the_recorder_asks_for_markers_only_when_told_to(
    ros: Callable[..., Any], tmp_path: Path, markers: bool
) -> None:
    recorder = ros(RunRecorder, {"output": f"'{tmp_path / 'bag'}'", "markers": str(markers).lower()})
    recorder.close()
    pictures = {topics.CANDIDATES, topics.ROLLOUTS, topics.OCCUPANCY_MARKERS}
    assert pictures & {name.lstrip("/") for name in recorder.inputs} == (pictures if markers else set())
    assert pictures & BagReader(tmp_path / "bag").names.keys() == (pictures if markers else set())


class RunListener(NodeClient):
    """Starts the planner and listens to what it decides and to where the arm goes.

    Attributes:
        actions: of the decisions, in order.
        rested_s: for how long the arm has been at rest, by its own stamps.
        rest_q: where the arm was last heard of, (D,).
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.actions: list[str] = []
        self.rested_s = np.inf
        self._moved_ns = 0
        node.create_subscription(
            DiagnosticArray, topics.DECISION, lambda m: self.actions.append(m.status[0].message), qos.LOSSLESS
        )
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_state, qos.SENSOR_SUBSCRIBER)
        return ()

    def _on_state(self, message: JointState) -> None:
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        if np.abs(message.velocity).max(initial=0.0) > 1e-6:
            self._moved_ns = stamp_ns
        self.rested_s = (stamp_ns - self._moved_ns) / NS
        self.rest_q = np.asarray(message.position)


def test_a_tracker_that_dies_stops_the_arm(tmp_path: Path) -> None:
    planner = {"scene": "face_to_face", "controller": "simulated_arm"}
    with RunListener(tmp_path, "stomp_planner", planner) as run:
        run.group.start("run_recorder", {"output": str(tmp_path / "bag")})
        run.group.start("simulated_arm", {"scene": "face_to_face"})
        run.group.start("occupancy_predictor", {"predictor": "current", "listener": "stomp_planner"})
        tracker = run.group.start(
            "skeleton_tracker_replay",
            {
                "trajectory": "3/2",
                "wait_for": "occupancy_predictor,stomp_planner,simulated_arm,run_recorder",
                "listener": "occupancy_predictor",
            },
        )
        run.wait(lambda: "replan" in run.actions and run.rested_s == 0.0, "the arm to move", timeout_s=60.0)
        tracker.process.kill()
        run.group.nodes.remove(tracker)
        run.wait(lambda: run.actions[-1] == "hold" and run.rested_s > 0.5, "the arm to come to rest")
        run.group.check()
    bag = BagReader(tmp_path / "bag")
    actions = [message.status[0].message for _, message in bag.decoded(topics.DECISION)]
    assert actions[-1] == "hold"
    states = [message for _, message in bag.decoded(topics.JOINT_STATES)]
    np.testing.assert_array_equal(states[-1].position, run.rest_q)
    for goal in SCENE.goals:
        assert np.abs(run.rest_q - goal.configuration).max() > 0.05
