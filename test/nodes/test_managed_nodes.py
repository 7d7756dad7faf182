"""A lifecycle manager brings the graph up, down and up again, and is told why where that cannot be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import PlanningError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from node_client import NodeClient
from planner_client import PlannerClient, nobody
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode

SCENE = load_scene("face_to_face")
CONFIGURE, CLEAN_UP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
SHUT_DOWN = Transition.TRANSITION_INACTIVE_SHUTDOWN
#: In the order in which a manager brings them up.
GRAPH: dict[str, dict[str, Any]] = {
    "simulated_arm": {"scene": "nowhere"},
    "stomp_planner": {"scene": "face_to_face", "iterations": 5, "waypoints": 40, "velocity_scale": 0.03},
    "occupancy_predictor": {"predictor": "current"},
    "run_recorder": {},
    "skeleton_tracker_replay": {"trajectory": "3/2", "hold_last_s": 600.0, "wait_for": "occupancy_predictor"},
}


def change_state(client: NodeClient, name: str, transition: int) -> bool:
    """Ask for a transition as nav2's manager does, by its number; return whether it was made."""
    service = client.node.create_client(ChangeState, f"{name}/change_state")
    client.wait(service.service_is_ready, f"{name} to be managed", timeout_s=120.0)
    future = service.call_async(ChangeState.Request(transition=Transition(id=transition)))
    client.wait(future.done, f"{name} to make transition {transition}", timeout_s=300.0)
    client.node.destroy_client(service)
    return bool(future.result().success)


class Manager(NodeClient):
    """Stands in for nav2's lifecycle manager with bond_timeout 0: speaks its two services, and watches the arm.

    Attributes:
        told: level, message and values of each node's last status.
        speed: of the arm's fastest joint, rad/s.
    """

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        self.told: dict[str, tuple[bytes, str, dict[str, str]]] = {}
        self.speed = 0.0
        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_status, qos.COMMAND)
        node.create_subscription(JointState, topics.JOINT_STATES, self._on_arm, qos.COMMAND)
        return ()

    def _on_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.told[status.name] = status.level, status.message, {item.key: item.value for item in status.values}

    def _on_arm(self, message: JointState) -> None:
        self.speed = max(map(abs, message.velocity), default=0.0)

    def state(self, name: str) -> str:
        service = self.node.create_client(GetState, f"{name}/get_state")
        self.wait(service.service_is_ready, f"the state of {name}")
        future = service.call_async(GetState.Request())
        self.wait(future.done, f"the state of {name}")
        self.node.destroy_client(service)
        return str(future.result().current_state.label)

    def all(self, transition: int, state: str) -> None:
        """Take all nodes through a transition, down in the reverse order, and see that they say so."""
        down = transition in (DEACTIVATE, CLEAN_UP)
        for name in reversed(GRAPH) if down else GRAPH:
            assert change_state(self, name, transition), (name, state, self.told.get(name))
            assert self.state(name) == state
        if state != "active":
            self.wait(lambda: all(self.told[name][:2] == (DiagnosticStatus.WARN, state) for name in GRAPH), state)
            assert {self.told[name][2]["ready"] for name in GRAPH} == {"false"}

    def wait_for_motion(self) -> None:
        self.wait(lambda: self.speed > 0.02 and self.told["stomp_planner"][1] == "planning", "motion", timeout_s=120.0)


def test_a_manager_brings_the_graph_up_down_and_up(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    GRAPH["run_recorder"]["output"] = str(bag)
    with Manager(tmp_path, "simulated_arm", {"managed": True, **GRAPH["simulated_arm"]}) as manager:
        for name in (*list(GRAPH)[1:], "separation_guard"):
            manager.group.start(name, {"managed": True, **GRAPH.get(name, {})})
        manager.wait(lambda: manager.told.keys() >= GRAPH.keys(), "all nodes", timeout_s=120.0)
        assert {manager.told[name][1] for name in GRAPH} == {"unconfigured"}

        # What cannot be configured stays unconfigured and says why, until somebody puts it right.
        assert not change_state(manager, "simulated_arm", CONFIGURE)
        assert manager.state("simulated_arm") == "unconfigured"
        manager.wait(lambda: "nowhere" in manager.told["simulated_arm"][1], "the reason")
        assert manager.told["simulated_arm"][0] == DiagnosticStatus.ERROR
        assert manager.set_parameter("scene", "face_to_face") == (True, "")

        manager.all(CONFIGURE, "inactive")
        manager.all(ACTIVATE, "active")
        manager.wait_for_motion()
        for name in GRAPH:  # calls in the wrong state change nothing
            assert not change_state(manager, name, CONFIGURE)
            assert manager.state(name) == "active"
        refused = "refused/transition in the wrong state"
        manager.wait(lambda: all(manager.told[name][2].get(refused) == "1" for name in GRAPH), "refusals")
        done, why = manager.set_parameter("waypoints", 60, "stomp_planner")
        assert not done
        assert why.startswith("waypoints: cannot change at run time: start the node anew with it, or clean")
        assert why.endswith("the noise is computed for paths of this length")

        # Without the planner the arm rests, although people are seen and its driver runs.
        assert change_state(manager, "stomp_planner", DEACTIVATE)
        manager.wait(lambda: manager.speed < 1e-6, "the arm to rest")
        assert change_state(manager, "stomp_planner", ACTIVATE)
        manager.wait_for_motion()
        manager.all(DEACTIVATE, "inactive")

        manager.all(ACTIVATE, "active")
        manager.wait_for_motion()
        # A guard that was heard is missed: the arm rests, and its driver says for want of what.
        for transition in (CONFIGURE, ACTIVATE, DEACTIVATE):
            assert change_state(manager, "separation_guard", transition)
            if transition == ACTIVATE:
                manager.wait(
                    lambda: manager.told["simulated_arm"][2].get("input/speed_ovr/age_s") != "none came",
                    "the guard's word",
                )
        manager.wait(lambda: "guard" in manager.told["simulated_arm"][1], "the guard to be missed")
        manager.wait(lambda: manager.speed < 1e-6, "the arm to rest")
        manager.all(DEACTIVATE, "inactive")
        manager.all(CLEAN_UP, "unconfigured")
        manager.all(CONFIGURE, "inactive")
        for name in GRAPH:
            assert change_state(manager, name, SHUT_DOWN)
            assert manager.state(name) == "finalized"
    for folder in (bag, bag.with_name("bag_2")):
        assert next(iter(BagReader(folder).messages([topics.DECISION]))), "a whole bag of each time"


class Fragile(GraphNode):
    """Fails where it is told to."""

    fails = ""

    def __init__(self) -> None:
        super().__init__("fragile")

    def configure(self) -> None:
        self.loaded = "much"
        self._fail("configure")

    def activate(self) -> None:
        self.spoken = self.create_publisher(JointState, "spoken", 1)
        self._fail("activate")

    def deactivate(self) -> None:
        self._fail("deactivate")

    def _fail(self, where: str) -> None:
        if self.fails == where:
            raise PlanningError(f"cannot {where}")
        if self.fails == f"bug in {where}":
            raise ZeroDivisionError(self.fails)


@pytest.fixture
def fragile(monkeypatch: pytest.MonkeyPatch) -> Iterator[Fragile]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(args=["--ros-args", "-p", "managed:=true"], domain_id=free_domain_id())
    node = Fragile()
    statuses: list[Any] = []
    node._diagnostics.publish = statuses.append
    node.said = lambda: (node.publish_status(), statuses[-1].status[0].message)[1]  # type: ignore[attr-defined]
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("fails", "state", "says"),
    [
        ("configure", "unconfigured", "unconfigured: cannot configure"),
        ("bug in configure", "unconfigured", "unconfigured: bug in configure"),
        ("activate", "inactive", "inactive: cannot activate"),
        ("bug in activate", "unconfigured", "unconfigured: bug in activate"),
        ("bug in deactivate", "unconfigured", "unconfigured: bug in deactivate"),
        ("a callback", "inactive", "inactive: division by zero"),
        ("the work", "inactive", "inactive: the disk is full"),
    ],
)
def test_an_error_leads_to_a_state_and_nothing_is_left_behind(fails: str, state: str, says: str, fragile: Any) -> None:
    n_publishers = len(list(fragile.publishers))
    for _ in range(2):
        fragile.fails = fails
        fragile.trigger_configure()
        if fragile.state == "inactive":
            fragile.trigger_activate()
        if fails == "a callback":
            fragile.survive(ZeroDivisionError("division by zero"))
        elif fails == "the work":
            fragile.stop_with(PlanningError("the disk is full"))
            fragile.publish_status()
        elif fragile.state == "active":
            fragile.trigger_deactivate()
        assert (fragile.state, fragile.said()) == (state, says)
        assert len(list(fragile.publishers)) == n_publishers
        assert hasattr(fragile, "loaded") == (state == "inactive")
        fragile.fails = ""
        if state == "unconfigured":
            fragile.trigger_configure()
        fragile.trigger_activate()
        assert (fragile.state, fragile.said()) == ("active", "ready")
        fragile.trigger_deactivate()
        fragile.trigger_cleanup()
        assert fragile.said() == "unconfigured"
        assert not hasattr(fragile, "loaded")


@pytest.fixture
def planner(tmp_path: Path) -> Iterator[PlannerClient]:
    parameters = {"scene": "face_to_face", "iterations": 5, "waypoints": 40, "period_s": 0.2, "velocity_scale": 0.05}
    with PlannerClient(tmp_path, SCENE, parameters) as client:
        client.settle_arm()
        yield client


def test_a_planner_that_is_activated_again_goes_on_from_where_the_arm_is(planner: PlannerClient) -> None:
    def see_nobody() -> None:
        planner.send_cloud(conversions.occupancy_cloud(nobody(SCENE), 0.0, planner.now_ns()))

    def moves() -> bool:
        return bool(np.abs(planner.controller.v).max() > 0.02)

    planner.send_until(see_nobody, moves, "the arm to be on its way", timeout_s=120.0)
    assert change_state(planner, "stomp_planner", DEACTIVATE)
    planner.wait(lambda: planner.decisions[-1].reason.startswith("the planner is ended"), "the last hold")
    planner.wait(lambda: not moves(), "the arm to rest")
    n_sent = len(planner.trajectories)
    # Somebody moves it while nobody looks.
    planner.controller.q = planner.controller.q + 0.1
    planner.controller.hold()
    assert change_state(planner, "stomp_planner", ACTIVATE)
    planner.wait(lambda: planner.diagnostics[0] == "ready", "the planner to be as before its first occupancy")
    planner.send_until(see_nobody, moves, "the arm to be on its way again", timeout_s=120.0)
    start = np.array(planner.trajectories[n_sent].points[0].positions)
    assert np.abs(start - planner.controller.q).max() < 0.05
