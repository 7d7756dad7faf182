"""Over DDS, the planner reacts between two steps, takes another noise while it runs, and draws rollouts on request."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from planner_client import NS, Answer, PlannerClient, least_gap_m, nobody, somebody, voxels_near
from std_srvs.srv import SetBool, Trigger

from humanpred_ros.nodes import conversions
from humanpred_ros.nodes.operator_services import PAUSED
from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.planning.replanner_config import ReplannerConfig

SCENE = load_scene("face_to_face")
PERIOD_S, SEPARATION_M = 0.2, 0.05
#: Half the diagonal of a voxel: distances are kept from voxels, these tests measure to their centres.
HALF_M = 0.5 * np.sqrt(3.0) * SCENE.grid.resolution_m
PARAMETERS = {
    "scene": "face_to_face", "iterations": 20, "waypoints": 50, "rollouts": 6, "period_s": PERIOD_S,
    "min_separation_m": SEPARATION_M, "lossless": True, "max_human_age_s": 60.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerClient]:
    """A planner that answers when asked, whatever the clock does; asking about an earlier time starts it anew."""
    with PlannerClient(tmp_path_factory.mktemp("planner"), SCENE, PARAMETERS) as client:
        client.settle_arm()
        client.arm_runs = False  # it stays at the scene's start, where each session begins
        yield client


class Session:
    """One start of the planner, with times counted from its first occupancy; each lies before the last one."""

    begins_ns = 0

    def __init__(self, client: PlannerClient) -> None:
        Session.begins_ns = (Session.begins_ns or client.now_ns()) - NS
        self.client, self.origin_ns = client, Session.begins_ns
        client.trajectories.clear()
        client.decisions.clear()
        self.ask(0.0)

    def ask(self, t_s: float, person: Sequence[int] | np.ndarray = ()) -> Answer:
        flat = np.asarray(person, dtype=np.int64)
        occupancy = somebody(SCENE, flat) if len(flat) else nobody(SCENE)
        return self.client.ask(occupancy, self.origin_ns + round(t_s * NS))

    def set_out(self, until_s: float) -> None:
        """Answer occupancies without a person until the arm is on its way to a goal."""
        for t_s in np.arange(PERIOD_S, until_s + 1e-9, PERIOD_S):
            answer = self.ask(float(t_s))
            assert answer.action in ("replan", "keep"), answer
        assert self.client.trajectories


@pytest.mark.parametrize("where", ["along the whole arm", "at the hand"])
def test_a_person_who_will_stand_where_the_arm_ends_is_answered_at_once(client: PlannerClient, where: str) -> None:
    session = Session(client)
    session.set_out(0.6)
    executing = client.executing(session.origin_ns)
    idle = session.ask(0.63)
    assert (idle.action, idle.reason, idle.values["step"]) == ("keep", "no replanning step is due", "-1")
    person = voxels_near(SCENE, executing.q[-1], 0.0)
    if where == "at the hand":
        hand = SCENE.arm.chain.tool_pose(executing.q[-1:])[0, :3, 3]
        person = person[np.linalg.norm(SCENE.grid.centres_m(person) - hand, axis=1) < 0.15]
    moved_s = 0.66 + PERIOD_S
    assert least_gap_m(SCENE, executing, person, moved_s) < 0.0  # it would have run into them
    person = np.setdiff1d(person, voxels_near(SCENE, executing.sample(moved_s)[0], 0.12))  # but is not there yet
    n_before = len(client.trajectories)
    answer = session.ask(0.66, person)
    assert answer.action in ("replan", "evade", "hold"), answer
    assert set(answer.goals) == {"red", "blue"}  # a step of its own, between two that are due
    assert any(goal["set_aside"] for goal in answer.goals.values()) or answer.action == "replan"
    client.wait(lambda: len(client.trajectories) > n_before, "what the arm does instead")
    instead = client.executing(session.origin_ns)
    assert instead.start_s == pytest.approx(0.66, abs=1e-6)  # it begins with what is left of the old one
    # An arm at speed cannot always keep the separation from somebody who appears; touching them it can avoid.
    assert least_gap_m(SCENE, instead, person, moved_s) >= (0.0 if answer.action == "hold" else SEPARATION_M - 0.01)
    for t_s in np.linspace(0.66, 0.66 if answer.action == "hold" else moved_s, 9):
        np.testing.assert_allclose(instead.sample(t_s)[0], executing.sample(t_s)[0], atol=1e-6)
        np.testing.assert_allclose(instead.sample(t_s)[1], executing.sample(t_s)[1], atol=1e-5)


def test_a_person_right_in_front_of_the_arm_stops_it_at_once(client: PlannerClient) -> None:
    session = Session(client)
    session.set_out(1.0)
    executing = client.executing(session.origin_ns)
    now_s = 1.05
    here, soon = (executing.sample(t_s)[0] for t_s in (now_s, now_s + PERIOD_S))
    person = np.setdiff1d(voxels_near(SCENE, soon, 0.03), voxels_near(SCENE, here, SEPARATION_M + HALF_M))
    assert len(person)
    n_before = len(client.trajectories)
    answer = session.ask(now_s, person)
    assert answer.action == "hold", answer
    assert answer.reason.startswith("too close: ")
    client.wait(lambda: len(client.trajectories) > n_before, "the stop")
    stop = client.executing(session.origin_ns)
    assert stop.start_s == pytest.approx(now_s, abs=1e-6)
    assert stop.end_s < executing.end_s
    assert least_gap_m(SCENE, stop, person, now_s) > least_gap_m(SCENE, executing, person, now_s)
    # When they have gone, the arm is sent on with the next occupancy, due or not.
    assert session.ask(now_s + 0.03).action == "replan"


def costs_of(answer: Answer) -> dict[str, str]:
    return {name: goal["selection_cost"] for name, goal in answer.goals.items()}


def test_noise_changes_while_the_node_runs(client: PlannerClient) -> None:
    def costs() -> dict[str, str]:
        return costs_of(Session(client).ask(PERIOD_S))

    default = StompPlannerSettings().noise_std
    first = costs()
    assert costs() == first  # the same seed, so the same plan
    assert client.set_parameter("noise_std", 10.0 * default) == (True, "")
    assert costs() != first
    assert client.set_parameter("noise_std", default) == (True, "")
    assert costs() == first


@pytest.mark.parametrize(
    ("name", "value"), [("noise_std", -1.0), ("noise_std", 2.0), ("noise_std", "much"), ("seed", 3), ("period_s", 0.3)]
)
def test_other_changes_are_refused_with_a_reason(client: PlannerClient, name: str, value: float | str) -> None:
    before = costs_of(Session(client).ask(PERIOD_S))
    done, reason = client.set_parameter(name, value)
    assert not done
    assert reason
    assert costs_of(Session(client).ask(PERIOD_S)) == before


def test_people_may_pause_the_arm_and_leave_tasks_alone(client: PlannerClient) -> None:
    def call(name: str, data: bool | None = None) -> tuple[bool, str]:
        kind, request = (Trigger, Trigger.Request()) if data is None else (SetBool, SetBool.Request(data=data))
        response = client.call(kind, f"stomp_planner/{name}", request)
        return response.success, response.message

    session = Session(client)
    session.set_out(0.6)
    n_before = len(client.trajectories)
    assert call("pause")[0]
    client.wait(lambda: len(client.trajectories) > n_before, "the stop")
    stop = client.executing(session.origin_ns)
    assert not stop.sample(stop.end_s)[1].any()
    assert call("plan_now") == (False, f"nothing is planned: {PAUSED}")
    for t_s in (0.63, 1.2):
        assert (session.ask(t_s).action, session.ask(t_s + 0.01).reason) == ("hold", PAUSED)
    assert call("resume") == (True, "planning goes on")
    assert call("resume") == (False, "it was not paused")
    first = session.ask(1.4)
    assert first.action == "replan"
    chosen, other = first.values["chosen"], {"red": "blue", "blue": "red"}[first.values["chosen"]]
    assert call(f"tasks/{chosen}/enable", False)[0]
    assert not session.ask(1.43).goals  # at the next step
    second = session.ask(1.6)
    assert (second.values["chosen"], second.goals[chosen]["set_aside"]) == (other, "disabled")
    assert "no task is enabled" in call(f"tasks/{other}/enable", False)[1]
    assert session.ask(1.8).reason.startswith("no task is enabled")
    for task in ("red", "blue"):
        assert call(f"tasks/{task}/enable", True) == (True, f"{task} is enabled")
    assert session.ask(1.83).action == "replan"
    assert not session.ask(1.86).goals
    assert call("plan_now")[0]
    assert session.ask(1.89).goals


@pytest.mark.parametrize(
    ("name", "value"), [("task_costs.red", 5.0), ("min_separation_m", 0.2), ("velocity_scale", 0.1)]
)
def test_settings_change_between_two_steps(client: PlannerClient, name: str, value: float) -> None:
    session = Session(client)
    session.set_out(0.4)
    before = StompPlannerSettings().part(ReplannerConfig).model_dump().get(name, 0.0)
    assert client.set_parameter(name, value) == (True, "")
    answer = session.ask(0.6)
    if name == "task_costs.red":
        assert (answer.values["chosen"], answer.goals["red"]["task_cost"]) == ("blue", "5.0")
    if name == "velocity_scale":
        assert answer.action == "replan"
    assert client.set_parameter(name, PARAMETERS.get(name, before)) == (True, "")
    for wrong, reason in ((-1.0, name), (float("nan"), name), ("much", "expected 'Type.DOUBLE'")):
        done, said = client.set_parameter(name, wrong)
        assert not done
        assert reason in said


def test_rollouts_are_drawn_for_who_asks(client: PlannerClient) -> None:
    client.watch_rollouts()
    session = Session(client)
    t_s = 0.0
    while not client.rollouts and t_s < 2.0:  # the planner may notice its listener only after a step or two
        t_s += PERIOD_S
        assert session.ask(t_s).action in ("replan", "keep")
    client.wait(lambda: bool(client.rollouts), "rollouts")
    markers = {marker.ns: marker for marker in client.rollouts[0].markers if marker.ns}
    (stamp_ns,) = {conversions.stamp_ns(marker.header.stamp) for marker in markers.values()}
    (answer,) = (answer for answer in client.decisions if answer.stamp_ns == stamp_ns)
    assert set(markers) == {f"rollouts/{name}" for name, goal in answer.goals.items() if int(goal["iterations"])}
    for marker in markers.values():
        assert marker.header.frame_id == "world"
        assert len(marker.points) == 2 * (PARAMETERS["waypoints"] - 1) * PARAMETERS["rollouts"]
        assert np.isfinite([[point.x, point.y, point.z] for point in marker.points]).all()
