"""Over DDS, obstacles come and go while the planner runs; what cannot be believed is a hold with its reason."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from planner_client import NS, Answer, PlannerClient, nobody
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from visualization_msgs.msg import Marker, MarkerArray

from humanpred_ros import topics
from humanpred_ros.nodes import qos

SCENE = load_scene("face_to_face")
RED = SCENE.arm.chain.tool_pose(SCENE.goal("red").configuration)[:3, 3]
PARAMETERS = {"scene": "face_to_face", "iterations": 10, "waypoints": 40, "rollouts": 6, "lossless": True}


def marker(**changes: object) -> Marker:
    """Return a box where the task `red` wants the tool."""
    box = Marker(ns="things", id=7, type=Marker.CUBE)
    box.header.frame_id = "world"
    box.scale.x = box.scale.y = box.scale.z = 0.1
    box.pose.orientation.w = 1.0
    box.pose.position.x, box.pose.position.y, box.pose.position.z = map(float, RED)
    for path, value in changes.items():
        *parents, name = path.split("__")
        target = box
        for parent in parents:
            target = getattr(target, parent)
        setattr(target, name, value)
    return box


def cloud(points: np.ndarray, **changes: object) -> PointCloud2:
    data = np.asarray(points, dtype=np.float32)
    fields = [PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, name in enumerate("xyz")]
    message = PointCloud2(header=Header(frame_id="world"), height=1, width=len(data), fields=fields, point_step=12)
    message.row_step, message.data, message.is_dense = 12 * len(data), data.tobytes(), True
    for name, value in changes.items():
        setattr(message, name, value)
    return message


class Client(PlannerClient):
    """A planner, and somebody who tells it of obstacles."""

    begins_ns = 0

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.solids = node.create_publisher(MarkerArray, topics.OBSTACLES, qos.COMMAND)
        self.latched = node.create_publisher(MarkerArray, topics.OBSTACLES, qos.LATCHED)
        self.points = node.create_publisher(PointCloud2, topics.OBSTACLE_CLOUD, qos.SENSOR_PUBLISHER)
        return (*super().connect(node), self.solids, self.points)

    def send(self, *markers: Marker) -> None:
        self.solids.publish(MarkerArray(markers=list(markers)))

    def until(self, wanted: Callable[[Answer], bool]) -> Answer:
        """Start the planner anew, by going back in time, and ask until an answer is as wanted."""
        answers: list[Answer] = []
        self.begins_ns = (self.begins_ns or self.now_ns()) - 1000 * NS

        def asked() -> bool:
            answers.append(self.ask(nobody(SCENE), self.begins_ns + len(answers) * NS // 4))
            return wanted(answers[-1])

        self.wait(asked, "an answer that knows of the obstacles")
        return answers[-1]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with Client(tmp_path_factory.mktemp("planner"), SCENE, PARAMETERS) as client:
        client.settle_arm()
        client.arm_runs = False
        yield client


def red_is_blocked(answer: Answer) -> bool:
    return "m from obstacle" in answer.goals.get("red", {}).get("set_aside", "")


def red_is_free(answer: Answer) -> bool:
    return answer.action != "hold" and not red_is_blocked(answer)


#: Each as `send` and `remove`.
SOLIDS: dict[str, tuple[list[Marker], list[Marker]]] = {
    "a box, deleted": ([marker()], [marker(action=Marker.DELETE)]),
    "a can, all deleted": (
        [marker(type=Marker.CYLINDER), marker(id=8, type=Marker.TEXT_VIEW_FACING, text="can")],
        [marker(ns="", id=0, action=Marker.DELETEALL)],
    ),
    "a ball, moved away": ([marker(type=Marker.SPHERE)], [marker(type=Marker.SPHERE, pose__position__z=3.0)]),
    "a box that does not last": ([marker(lifetime__sec=1)], []),
    "a box in the frame of the base": (
        [
            marker(
                header__frame_id="/base_footprint",
                **{
                    f"pose__position__{axis}": float(value)
                    for axis, value in zip("xyz", (np.linalg.inv(SCENE.T_world_base) @ [*RED, 1.0])[:3], strict=True)
                },
            )
        ],
        [marker(action=Marker.DELETE)],
    ),
}


@pytest.mark.parametrize("solid", SOLIDS)
def test_solids_block_a_task_while_they_are_there(client: Client, solid: str) -> None:
    there, gone = SOLIDS[solid]
    client.send(*there)
    client.until(red_is_blocked)
    client.send(*gone)
    client.until(red_is_free)


def test_what_was_latched_or_is_a_cloud_counts_too(client: Client) -> None:
    client.latched.publish(MarkerArray(markers=[marker()]))
    client.until(red_is_blocked)
    client.latched.publish(MarkerArray(markers=[marker(action=Marker.DELETE)]))
    client.until(red_is_free)
    client.points.publish(cloud(RED + np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))))
    client.until(red_is_blocked)
    client.points.publish(cloud(np.zeros((0, 3))))
    client.until(red_is_free)


NOWHERE = np.array([[0.0, 5.0, 0.0]])
WRONG: dict[str, tuple[Marker | PointCloud2, str]] = {
    "a length that is none": (marker(scale__y=float("nan")), "obstacle things/7: wanted a finite place and lengths"),
    "a length of 0": (marker(scale__y=0.0), "lengths above 0"),
    "millimetres": (marker(scale__x=86.0, scale__y=86.0, scale__z=108.0), "wanted metres"),
    "a place in millimetres": (marker(pose__position__y=-700.0), "wanted metres"),
    "no orientation": (marker(pose__orientation__w=0.0), "wanted a quaternion"),
    "an unknown frame": (marker(header__frame_id="camera"), "wrong frame: wanted one of world, base_footprint"),
    "no frame": (marker(header__frame_id=""), "wrong frame"),
    "an ellipsoid": (marker(type=Marker.SPHERE, scale__x=0.2), "round SPHERE, got type 2"),
    "another kind": (marker(type=Marker.MESH_RESOURCE), "got type 10"),
    "an unknown action": (marker(action=9), "wanted action 0, 2 or 3, got 9"),
    "a torn cloud": (cloud(NOWHERE, width=7), "layout does not fit its data"),
    "a cloud without z": (cloud(NOWHERE, fields=cloud(NOWHERE).fields[:2]), "wanted field 'z'"),
    "a dense cloud with gaps": (cloud(NOWHERE * np.nan), "1 of 1 that are not"),
    "a cloud that sees nothing": (cloud(NOWHERE * np.nan, is_dense=False), "1 of 1 that are not"),
    "a cloud in millimetres": (cloud(NOWHERE * 1000.0), "wanted metres"),
    "a cloud of an unknown frame": (cloud(NOWHERE, header=Header(frame_id="camera")), "wrong frame"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_cannot_be_believed_holds_the_arm_until_it_can(client: Client, wrong: str) -> None:
    message, words = WRONG[wrong]
    if isinstance(message, Marker):
        client.send(marker(id=8, pose__position__z=5.0), message)  # what is right beside it is taken
    else:
        client.points.publish(message)
    held = client.until(lambda answer: answer.action == "hold")
    assert held.reason.startswith("invalid obstacles: ")
    assert words in held.reason
    client.send(marker(id=8, action=Marker.DELETE))  # says nothing of the other
    if isinstance(message, Marker):
        client.send(marker(action=Marker.DELETE))
    else:
        client.points.publish(cloud(NOWHERE))
    client.until(red_is_free)


TASKS: dict[str, tuple[str, str]] = {
    "unreachable": (
        "{name: far, tool_pose: {position_m: [0, -4, 1], orientation_deg: [0, 0, 0], %s}}",
        "goal 'far'.*no",
    ),
    "in the table": (
        "{name: low, configuration_rad: [-0.226, 0.5, -1.521, -0.4, -0.280, -0.486, 0.0]}",
        "goal low: .* m from",
    ),
    "outside limits": ("{name: odd, configuration_deg: [90, 0, 0, -10, 0, 0, 0]}", "goal 'odd'.*r_shoulder_pan_joint"),
    "of another robot": ("{name: odd, configuration_deg: [90, 0, 0]}", "goal 'odd'"),
    "no task": ("{name: odd}", r"tasks: goals\[1\]: wanted either configuration_rad"),
    "one of a name twice": ("{name: red, configuration_rad: [-0.7, 0.33, -1.6, -1.0, -0.35, -0.75, 0.0]}", "red twice"),
    "no YAML": ("{", "tasks: wanted YAML"),
}
BLUE, RED_TASK = (
    f"{{name: {goal.name}, configuration_rad: {goal.configuration.tolist()}}}"
    for goal in (SCENE.goal("blue"), SCENE.goal("red"))
)


@pytest.mark.parametrize("wrong", TASKS)
def test_tasks_that_cannot_be_done_are_refused_with_the_reason(client: Client, wrong: str) -> None:
    text, words = TASKS[wrong]
    tolerance = "position_tolerance_m: 0.01, orientation_tolerance_deg: 5"
    done, reason = client.set_parameter("tasks", f"[{RED_TASK}, {text % tolerance if '%' in text else text}]")
    assert not done
    assert re.search(words, reason), reason
    assert "\n" not in reason


def test_tasks_are_added_changed_and_removed(client: Client) -> None:
    q = 0.3 * SCENE.start + 0.7 * SCENE.goal("blue").configuration
    place = f"{{name: place 3, task_cost: 0.001, configuration_rad: {q.tolist()}}}"
    assert client.set_parameter("tasks", f"[{place}, {BLUE}]") == (True, "")
    answer = client.until(lambda answer: "place 3" in answer.goals)
    assert set(answer.goals) == {"place 3", "blue"}
    done = client.call(SetBool, "stomp_planner/tasks/place_3/enable", SetBool.Request(data=False))
    assert done.success
    answer = client.until(lambda answer: "place 3" in answer.goals)
    assert answer.goals["place 3"]["set_aside"] == "disabled"
    assert client.set_parameter("tasks", "") == (True, "")
    assert set(client.until(lambda answer: len(answer.goals) == 2).goals) == {"red", "blue"}
