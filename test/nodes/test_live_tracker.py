"""Live trackers of every kind over DDS become the postures a replay would publish, or a named reason why not."""

from __future__ import annotations

import array
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.skeletons import POINTS, load_skeleton, person_points
from humanpred_ros.human.tracker_messages import _decoded_markers, _raw_markers, bodies_in_markers, seen_bodies
from humanpred_ros.motion.library_io import load_library

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from geometry_msgs.msg import Point, Pose, PoseArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, PointCloud2, PointField
from std_msgs.msg import Bool, ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.frames import TrackerFrames
from humanpred_ros.nodes.lifecycle import started
from humanpred_ros.nodes.skeleton_tracker import SkeletonTrackerNode

HUMAN = HumanModel.kinect12()
Q = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0].q
PERSON = person_points(HUMAN, Q)
HAND = POINTS.index("right_hand")


def markers(points: np.ndarray, stamp_ns: int, frame_id: str, body: int = 0, ids: int = 100) -> MarkerArray:
    said = MarkerArray()
    for k, (x, y, z) in enumerate(points):
        marker = Marker(type=Marker.SPHERE, action=Marker.ADD, id=body * ids + k)
        marker.header.frame_id, marker.header.stamp = frame_id, conversions.time_message(stamp_ns)
        marker.pose.position = Point(x=float(x), y=float(y), z=float(z))
        said.markers.append(marker)
    return said


def poses(points: np.ndarray, stamp_ns: int, frame_id: str) -> PoseArray:
    said = PoseArray(poses=[Pose(position=Point(x=float(x), y=float(y), z=float(z))) for x, y, z in points])
    said.header.frame_id, said.header.stamp = frame_id, conversions.time_message(stamp_ns)
    return said


def cloud(points: np.ndarray, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud that names points, in another order, padded."""
    order = np.random.default_rng(0).permutation(len(points))
    table = np.zeros(len(points), dtype={"names": ["x", "y", "z", "joint"], "formats": ["<f4"] * 3 + ["<u2"],
                                         "offsets": [0, 4, 8, 16], "itemsize": 24})  # fmt: skip
    table["x"], table["y"], table["z"] = points[order].T
    table["joint"] = order
    said = PointCloud2(height=1, width=len(points), point_step=24, row_step=24 * len(points))
    said.fields = [PointField(name=n, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, n in enumerate("xyz")]
    said.fields.append(PointField(name="joint", offset=16, datatype=PointField.UINT16, count=1))
    said.data = array.array("B", table.tobytes())
    said.header.frame_id, said.header.stamp = frame_id, conversions.time_message(stamp_ns)
    return said


class Rig:
    """A tracker node, and a client that plays the camera and listens, on a domain of their own."""

    def __init__(self, **parameters: str) -> None:
        arguments = ["--ros-args", *(part for name, value in parameters.items() for part in ("-p", f"{name}:={value}"))]
        rclpy.init(args=arguments, domain_id=free_domain_id())
        self.tracker = started(SkeletonTrackerNode)
        self.client = rclpy.create_node("camera")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.tracker)
        self.executor.add_node(self.client)
        self.postures: dict[str, list[JointState]] = {}
        self.nobody: list[Header] = []
        self.client.create_subscription(Header, topics.NOBODY, self.nobody.append, qos.SENSOR_SUBSCRIBER)

    def hear(self, body: str) -> None:
        heard = self.postures.setdefault(body, [])
        self.client.create_subscription(
            JointState, topics.human_joint_states(body), heard.append, qos.SENSOR_SUBSCRIBER
        )

    def wait(self, condition: Callable[[], object], what: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        until_s = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < until_s, f"waited 60 s for {what}; {self.tracker.facts()}, {self.refused()}"
            meanwhile()
            self.executor.spin_once(timeout_sec=0.02)

    def refused(self) -> dict[str, int]:
        return dict(self.tracker.refused)

    def now_ns(self) -> int:
        return int(self.client.get_clock().now().nanoseconds)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Rig]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made: list[Rig] = []

    def make(**parameters: str) -> Rig:
        made.append(Rig(**parameters))
        return made[-1]

    yield make
    for one in made:
        one.executor.shutdown()
        one.client.destroy_node()
        one.tracker.destroy_node()
    rclpy.try_shutdown()


def palm(message: JointState) -> np.ndarray:
    return np.asarray(HUMAN.forward(conversions.ordered_positions(message, HUMAN.dof_names))["right_palm"])


@pytest.mark.parametrize(
    ("skeleton", "kind", "say"),
    [
        ("azure_kinect", MarkerArray, markers),
        ("coco17", PoseArray, poses),
        ("zed_body38", PoseArray, poses),
        ("openni15", PointCloud2, cloud),
    ],
)
def test_points_of_a_live_tracker_become_postures(
    skeleton: str, kind: Any, say: Callable[..., Any], rig: Callable[..., Rig]
) -> None:
    points = load_skeleton(skeleton).shown(PERSON)
    run = rig(skeleton=skeleton, topic="points", tracker_frame="camera")
    run.hear("body_0")
    urdf: list[String] = []
    held: list[Bool] = []
    run.client.create_subscription(String, topics.human_urdf("body_0"), urdf.append, qos.LATCHED)
    run.client.create_subscription(Bool, topics.human_held("body_0"), held.append, qos.LATCHED)
    camera = run.client.create_publisher(kind, "points", 10)
    sent: dict[int, int] = {}

    def send() -> None:
        stamp_ns = run.now_ns()
        sent[stamp_ns] = len(sent) % 60
        camera.publish(say(points[sent[stamp_ns]], stamp_ns, "camera"))

    heard = run.postures["body_0"]
    run.wait(lambda: len(heard) >= 10 and urdf and held, "ten postures", send)
    assert HumanModel(urdf[0].data).dof_names == HUMAN.dof_names
    assert not held[0].data
    for message in heard[:10]:
        assert message.header.frame_id == "kinect"
        frame = sent[conversions.stamp_ns(message.header.stamp)]
        assert np.linalg.norm(palm(message) - PERSON[frame, HAND]) < 0.05
    assert (run.tracker.working(), run.refused()) == ("tracking", {})
    if kind is MarkerArray:  # what it publishes when it sees nobody
        run.wait(lambda: run.nobody, "the word that nobody is there", lambda: camera.publish(MarkerArray()))


def test_bodies_of_ros4hri_with_their_urdf(rig: Callable[..., Rig]) -> None:
    u = 1.72 / 7.5
    urdf = ros4hri_urdf("rxkdf", u)
    run = rig(skeleton="ros4hri", topic="humans/bodies", tracker_frame="body_rxkdf", tracker_pose="'1 2 0.9 0 0 0'")
    run.hear("body_0")
    latched = run.client.create_publisher(String, "humans/bodies/rxkdf/urdf", qos.LATCHED)
    states = run.client.create_publisher(JointState, "humans/bodies/rxkdf/joint_states", 10)
    latched.publish(String(data=urdf))
    names = [f"{side}_{joint}_rxkdf" for side in "lr" for joint in ("y_shoulder", "elbow")]
    bend = {"r_y_shoulder": 0.0, "r_elbow": 1.2}

    def send() -> None:
        q = [
            bend.get(name.removesuffix("_rxkdf"), 0.0) + 1e-3 * np.random.default_rng().standard_normal()
            for name in names
        ]
        states.publish(conversions.joint_state(names, np.array(q), run.now_ns()))

    run.wait(lambda: len(run.postures["body_0"]) >= 5, "postures of a ROS4HRI body", send)
    q = conversions.ordered_positions(run.postures["body_0"][-1], HUMAN.dof_names)
    places = HUMAN.forward(q)
    # The upper arm hangs from the shoulder at (0, -0.8 u), the forearm is bent forwards by 1.2 rad.
    elbow = np.array([1.0, 2.0 - 0.8 * u, 0.9 + (2.6 - 1.6) * u])
    np.testing.assert_allclose(places["right_elbow"], elbow, atol=0.03)
    towards = places["right_palm"] - places["right_elbow"]
    np.testing.assert_allclose(towards / np.linalg.norm(towards), [np.sin(1.2), 0.0, -np.cos(1.2)], atol=0.1)
    assert run.tracker.facts()["body_0/id"] == "rxkdf"


def ros4hri_urdf(body: str, u: float) -> str:
    """Return the arms of a REP-155 body: origin mid-hips, x forward; shoulders at 2.6 u, upper arm 1.6 u."""
    links = [f'<link name="body_{body}"/>']
    for side, sign in (("l", 1), ("r", -1)):
        for part in ("shoulder", "forearm", "wrist", "hip"):
            links.append(f'<link name="{side}_{part}_{body}"/>')
        limit = '<limit lower="-3" upper="3" effort="0" velocity="1"/>'
        links.append(
            f'<joint name="{side}_y_shoulder_{body}" type="revolute"><parent link="body_{body}"/>'
            f'<child link="{side}_shoulder_{body}"/><origin xyz="0 {0.8 * sign * u} {2.6 * u}"/>'
            f'<axis xyz="0 0 {-sign}"/>{limit}</joint>'
            f'<joint name="{side}_elbow_{body}" type="revolute"><parent link="{side}_shoulder_{body}"/>'
            f'<child link="{side}_forearm_{body}"/><origin xyz="0 0 {-1.6 * u}"/><axis xyz="0 -1 0"/>{limit}</joint>'
            f'<joint name="{side}_wrist_{body}" type="fixed"><parent link="{side}_forearm_{body}"/>'
            f'<child link="{side}_wrist_{body}"/><origin xyz="0 0 {-u}"/></joint>'
            f'<joint name="{side}_y_hip_{body}" type="fixed"><parent link="body_{body}"/>'
            f'<child link="{side}_hip_{body}"/><origin xyz="0 {0.5 * sign * u} 0"/></joint>'
        )
    return f'<robot name="human">{"".join(links)}</robot>'


def test_two_people_are_two_bodies_and_their_ids_may_change(rig: Callable[..., Rig]) -> None:
    points = load_skeleton("azure_kinect").shown(PERSON)
    run = rig(topic="points")
    run.hear("body_0")
    run.hear("body_1")
    camera = run.client.create_publisher(MarkerArray, "points", 10)
    ids = [3, 8]
    count = 0

    def send() -> None:
        nonlocal count
        count += 1
        both = MarkerArray()
        for k, body in enumerate(ids):
            other = points[count % 60] + (2.0 * k, 0.0, 0.0)
            both.markers += markers(other, run.now_ns(), "depth_camera_link", body).markers
        camera.publish(both)

    run.wait(lambda: min(map(len, run.postures.values())) >= 3, "postures of both", send)
    apart = palm(run.postures["body_1"][-1]) - palm(run.postures["body_0"][-1])
    assert apart[1] == pytest.approx(-2.0, abs=0.3)  # the camera's x is to the right
    ids[0] = 5
    run.wait(lambda: run.tracker.facts().get("body_0/id") == "5", "the first person under another id", send)


def test_what_cannot_be_used_is_named_and_counted(rig: Callable[..., Rig]) -> None:
    points = load_skeleton("azure_kinect").shown(PERSON)
    run = rig(topic="points")
    run.hear("body_0")
    other = run.client.create_publisher(PoseArray, "elsewhere", 10)
    run.wait(lambda: "/elsewhere (geometry_msgs/msg/PoseArray)" in run.tracker.waiting_for(), "what is published")
    assert run.tracker.waiting_for().startswith("/points: nobody publishes it")
    run.client.destroy_publisher(other)
    camera = run.client.create_publisher(MarkerArray, "points", 10)
    count = 0

    def send(
        change: Callable[[np.ndarray], np.ndarray] = lambda p: p, frame_id: str = "depth_camera_link", ns: int = -1
    ) -> None:
        nonlocal count
        count += 1
        stamp_ns = run.now_ns() if ns < 0 else ns
        camera.publish(markers(change(points[count % 60]), stamp_ns, frame_id))

    for kind, fault in {
        "units": lambda: send(lambda p: 1000.0 * p),
        "not upright": lambda: send(lambda p: p * (1, -1, 1)),
        "wrong frame": lambda: send(frame_id="elsewhere"),
        "stamp ahead": lambda: send(ns=run.now_ns() + 10**10),
        "lost hand": lambda: send(lambda p: np.where(np.isin(np.arange(32), [14, 15])[:, None], np.nan, p)),
    }.items():
        run.wait(lambda kind=kind: run.refused().get(kind), kind, fault)
        before = len(run.postures["body_0"])
        run.wait(lambda before=before: len(run.postures["body_0"]) > before + 3, f"postures after {kind}", send)
    run.wait(lambda: "time of arrival" in run.tracker.warnings.get("stamps", ""), "stamps", lambda: send(ns=0))
    before = len(run.postures["body_0"])
    run.wait(lambda: len(run.postures["body_0"]) > before + 3, "postures without stamps", lambda: send(ns=0))


def test_a_type_whose_package_is_not_installed_is_named_with_what_to_install(rig: Callable[..., Rig]) -> None:
    run = rig(topic="points")
    run.tracker.get_publishers_info_by_topic = lambda topic: [SimpleNamespace(topic_type="zed_msgs/msg/ObjectsStamped")]
    run.tracker.look()
    assert "ros-jazzy-zed-msgs" in str(run.tracker.failure)
    run.tracker.get_publishers_info_by_topic = lambda topic: [SimpleNamespace(topic_type="std_msgs/msg/Bool")]
    run.tracker.look()
    assert run.tracker.fault().startswith("/points: wanted one of visualization_msgs/msg/MarkerArray")


def test_messages_of_other_packages_are_read_by_their_fields() -> None:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=5), frame_id="map")
    skeleton = load_skeleton("zed_body38")
    points = skeleton.shown(PERSON[0])
    keypoints = [SimpleNamespace(kp=point) for point in (*points, *np.zeros((32, 3)))]
    body = SimpleNamespace(label_id=7, confidence=80.0, tracking_state=1, body_format=2,
                           skeleton_3d=SimpleNamespace(keypoints=keypoints))  # fmt: skip
    searched = SimpleNamespace(**{**vars(body), "label_id": 8, "tracking_state": 2})
    zed = seen_bodies(SimpleNamespace(header=header, objects=[body, searched]), "zed_msgs/msg/ObjectsStamped", skeleton)
    assert (zed.stamp_ns, zed.frame_id, list(zed.bodies)) == (3_000_000_005, "map", ["7"])
    np.testing.assert_array_equal(zed.bodies["7"][0], points)
    with pytest.raises(ArrayError, match="its skeleton is zed_body38"):
        seen_bodies(
            SimpleNamespace(header=header, objects=[body]), "zed_msgs/msg/ObjectsStamped", load_skeleton("zed_body18")
        )

    yolo = load_skeleton("yolo")
    points = yolo.shown(PERSON[0])
    data = [SimpleNamespace(id=k + 1, point=SimpleNamespace(x=x, y=y, z=z), score=0.9)
            for k, (x, y, z) in enumerate(points) if k != 9]  # fmt: skip
    found = SimpleNamespace(id="4", keypoints3d=SimpleNamespace(data=data, frame_id="base_link"))
    seen = seen_bodies(SimpleNamespace(header=header, detections=[found]), "yolo_msgs/msg/DetectionArray", yolo)
    assert seen.frame_id == "base_link"
    assert np.isnan(seen.bodies["4"][0][9]).all()
    np.testing.assert_array_equal(seen.bodies["4"][0][10], points[10])
    data[-1].id = 17
    message = SimpleNamespace(header=header, detections=[found])
    with pytest.raises(ArrayError, match="ids from 0 to 16"):
        seen_bodies(message, "yolo_msgs/msg/DetectionArray", load_skeleton("coco17"))


def test_a_tilted_frame_that_tf_places_is_right_for_points(rig: Callable[..., Rig]) -> None:
    run = rig(topic="points")
    run.hear("body_0")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.3, 0.1, 1.0)  # optical, in the scene's tracker frame
    run.tracker.frames = TrackerFrames("x", np.eye(4), lambda frame: T)
    optical = load_skeleton("azure_kinect").shown(PERSON)
    camera = run.client.create_publisher(MarkerArray, "points", 10)
    run.wait(lambda: run.postures["body_0"], "a posture",
             lambda: camera.publish(markers(optical[0], run.now_ns(), "optical")))  # fmt: skip
    np.testing.assert_allclose(palm(run.postures["body_0"][0]), PERSON[0, HAND] + T[:3, 3], atol=0.03)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"skeleton": "nobody"}, ["nobody", "azure_kinect", "coco17"]),
        ({"skeleton": "mediapipe33"}, ["tracker_pose", "where the person stands"]),
        ({"tracker_pose": "'1 2 3'"}, ["tracker_pose", "six numbers"]),
        ({"axes": "right right up"}, ["axes"]),
    ],
)
def test_parameters_that_cannot_be_used(parameters: dict[str, str], words: list[str], rig: Callable[..., Rig]) -> None:
    with pytest.raises(UsageError) as caught:
        rig(**parameters)
    for word in words:
        assert word in str(caught.value)


def test_serialized_markers_are_read_as_rclpy_reads_them() -> None:
    rng = np.random.default_rng(0)

    def word() -> str:
        return "".join(rng.choice(list("abcé/_x"), size=rng.integers(0, 9)))

    for _ in range(200):
        array = MarkerArray()
        for _ in range(rng.integers(0, 5)):
            n = [int(k) for k in rng.integers(0, 3, 5)]
            marker = Marker(ns=word(), id=int(rng.integers(-5, 300)), action=n[0], text=word(), mesh_resource=word())
            marker.header.frame_id, marker.texture_resource, marker.texture.format = word(), word(), word()
            marker.header.stamp.sec, marker.header.stamp.nanosec = (int(k) for k in rng.integers(0, 10**9, 2))
            marker.pose.position = Point(x=rng.normal(), y=rng.normal(), z=rng.normal())
            marker.points, marker.colors = [Point(x=1.0)] * n[1], [ColorRGBA()] * n[2]
            marker.uv_coordinates, marker.texture.data = [UVCoordinate(u=0.1)] * n[3], bytes(3 * n[4])
            marker.mesh_file.filename, marker.mesh_file.data = word(), bytes(n[4])
            array.markers.append(marker)
        data = bytes(serialize_message(array))
        assert list(_raw_markers(data)) == _decoded_markers(deserialize_message(data, MarkerArray))
        cut = data[: int(rng.integers(0, max(len(data) - 8, 1)))]  # what is not whole is for rclpy to refuse
        assert bodies_in_markers(cut, load_skeleton("azure_kinect")) is None or not array.markers
