"""A recorded run, and the running graph, in a browser: what is shown is what there was, and a page is served."""

from __future__ import annotations

import io
import socket
import threading
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from waiting import wait_until

from humanpred_ros.errors import UsageError
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.viewing.playback import Player, Recording
from humanpred_ros.viewing.recorded import GoalPlan, RecordedDecision
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.space import (
    CANDIDATES,
    ROLLOUTS,
    ServerSettings,
    SpaceMoment,
    SpaceView,
    as_text,
    served,
    set_value,
)
from humanpred_ros.viewing.workcell import Workcell, load_workcell

pytest.importorskip("viser", reason="needs viser: install the `view` extra")


@pytest.fixture
def recording(full: Run) -> Recording:
    return Recording(full, load_workcell(full))


@pytest.fixture
def page(recording: Recording) -> Iterator[tuple[SpaceView, str]]:
    told: list[str] = []
    with served(ServerSettings(port=18080), told.append) as server:
        yield SpaceView(server, recording.scene, recording.human), told[-1].split()[1]


def test_a_moment_is_what_was_recorded(recording: Recording) -> None:
    run = recording.run
    decision = next(decision for decision in run.decisions if decision.goals)
    moment = recording.at(decision.t_s)
    assert moment.decision is decision
    np.testing.assert_allclose(moment.q_arm, run.robot.at(np.array([decision.t_s]))[0])
    np.testing.assert_allclose(moment.bodies[""], run.postures.at(np.array([decision.t_s]))[0])
    assert sum(moment.posterior.values()) == pytest.approx(1.0)
    assert len(moment.centres_m) == len(moment.probability) > 0
    # Nothing of the future is shown, and at the end what was last.
    assert recording.at(-1.0).decision is None
    assert recording.at(-1.0).posterior == {}
    assert recording.at(run.duration_s + 1.0).decision is run.decisions[-1]


def test_where_the_arm_goes_is_shown_until_it_is_there(recording: Recording) -> None:
    track = recording.run.trajectories[0]
    during = recording.at(0.5 * float(track.t_s[0] + track.t_s[-1]))
    assert during.q_goal is not None
    assert during.tool_path_m is not None
    begun = [one for one in recording.run.trajectories if one.t_s[0] <= during.t_s]
    np.testing.assert_array_equal(during.q_goal, begun[-1].q[-1])
    last = recording.run.trajectories[-1]
    assert recording.at(float(last.t_s[-1]) + 0.01).q_goal is None


def test_turns_are_switches_and_the_beginnings_of_holds(recording: Recording) -> None:
    run = recording.run
    steps = list(run.decisions)
    for k in (1, 2, 4):
        steps[k] = replace(steps[k], action="hold", reason="stale human data", switched=False)
    steps[3] = replace(steps[3], action="replan", switched=True, chosen="blue")
    turned = Recording(replace(run, decisions=tuple(steps[:5])), recording.workcell)
    assert [text for _, text in turned.turns][-3:] == [
        "holds: stale human data", "turns to blue", "holds: stale human data",
    ]  # fmt: skip


def test_runs_that_nobody_can_draw_are_refused(full: Run) -> None:
    with pytest.raises(UsageError, match="wanted a run whose scene is known; no such scene"):
        Recording(full, Workcell(None, None, ("no such scene",)))
    with pytest.raises(UsageError, match="wanted a run with people"):
        Recording(replace(full, duration_s=0.0), load_workcell(full))


def test_a_page_is_served_and_plays(page: tuple[SpaceView, str], recording: Recording) -> None:
    view, address = page
    assert address.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(address, timeout=30) as answer:
        assert b"<html" in answer.read(10_000)
    player, ended = Player(view, recording), threading.Event()
    thread = threading.Thread(target=player.run, args=(ended,))
    thread.start()
    try:
        wait_until(lambda: player.slider.value > 0.2, "the run to play")
        player._jump("next")
        assert not player.playing.value
        first = recording.turns[0] if recording.turns else None
        assert player.happened.content == (as_text(first[1]) if first else "nothing more happens there")
    finally:
        ended.set()
        thread.join()


def test_strange_moments_are_drawn_too(page: tuple[SpaceView, str]) -> None:
    view, _ = page
    view.show(SpaceMoment())
    view.show(SpaceMoment(q_arm=np.full(7, np.nan), state="waiting", posterior={"<b>screws</b>": 0.4}))
    assert "<b>" not in view._bars[0][0].content.replace("\\<", "").replace("\\>", "")


def test_layers_and_people_are_shown_as_chosen(page: tuple[SpaceView, str], recording: Recording) -> None:
    view, _ = page
    q, line = recording.run.postures.q[0], (np.zeros((1, 2, 3)), np.ones((1, 3)))
    moment = SpaceMoment(t_s=0.0, bodies={"anna": q, "ben": q}, lines={CANDIDATES: line, ROLLOUTS: line})
    view.show(moment)
    assert set(view._body.options) >= {"anna", "ben"}
    assert view._moving["/people/1/0"].visible
    assert view._moving[f"/lines/{CANDIDATES.replace(' ', '_')}"].visible
    assert f"/lines/{ROLLOUTS.replace(' ', '_')}" not in view._moving  # off at first
    set_value(view._body, "ben")
    set_value(view._shown[CANDIDATES], False)
    view.show(moment)
    assert not view._moving["/people/1/0"].visible
    assert view._moving["/people/0/0"].visible
    assert not view._moving[f"/lines/{CANDIDATES.replace(' ', '_')}"].visible


def test_the_last_half_minute_is_kept_and_another_beginning_begins_anew(page: tuple[SpaceView, str]) -> None:
    view, _ = page
    hold = RecordedDecision(t_s=0.0, action="hold", goals=(GoalPlan(name="red", selection_cost=0.5),))
    for t_s in (0.0, 10.0, 10.05, 35.0):
        view.show(SpaceMoment(t_s=t_s, posterior={"1": 0.4}, decision=hold))
    samples = view._strip._samples
    assert [sample.t_s for sample in samples] == [10.0, 35.0]
    assert samples[-1].held
    assert samples[-1].costs == {"red": 0.5}
    view.show(SpaceMoment(t_s=1.0))
    assert [sample.t_s for sample in samples] == [1.0]


def test_a_port_in_use_is_passed_over_and_told() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        told: list[str] = []
        with served(ServerSettings(port=port), told.append):
            pass
    assert told[0].startswith(f"port {port} is in use")
    assert f":{port} " not in told[1]


def test_a_namespace_that_is_none_is_refused_in_one_line() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    from humanpred_ros.nodes.live_view import LiveViewSettings, run

    with pytest.raises(UsageError, match="namespace: wanted /NAME"):
        run(LiveViewSettings(namespace="a b"), Console(file=io.StringIO()))


def test_text_of_strangers_is_shown_as_text() -> None:
    assert as_text("a*b* [x](http://y) <script>") == r"a\*b\* \[x\]\(http://y\) \<script\>"


def test_the_running_graph_is_listened_to_while_somebody_looks(make_node: Callable[[str], Any]) -> None:
    from sensor_msgs.msg import CompressedImage, JointState

    from humanpred_ros import topics
    from humanpred_ros.human.model import HumanModel
    from humanpred_ros.nodes import qos
    from humanpred_ros.nodes.base import new_executor
    from humanpred_ros.nodes.live_view import Graph

    scene, human = load_scene("face_to_face"), HumanModel.kinect12()
    node, other = make_node("view"), make_node("robot")
    arm = other.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
    body = other.create_publisher(JointState, topics.human_joint_states("anna"), qos.SENSOR_PUBLISHER)
    space = other.create_publisher(CompressedImage, topics.COMPACT_OCCUPANCY, qos.SENSOR_PUBLISHER)
    graph = Graph(node, scene, human)
    executor = new_executor(node.context)
    for one in (node, other):
        executor.add_node(one)
    names = scene.arm.chain.joint_names

    def shown() -> SpaceMoment:
        graph.look(True)
        arm.publish(JointState(name=list(names), position=[float(v) for v in scene.start]))
        body.publish(JointState(name=list(human.dof_names), position=[float(v) for v in human.lower]))
        space.publish(CompressedImage(format="nonsense"))
        for _ in range(20):
            executor.spin_once(timeout_sec=0.01)
        return graph.moment()

    graph.look(False)
    assert arm.get_subscription_count() == 0
    wait_until(lambda: shown().q_arm is not None and len(graph.moment().bodies) == 1 and graph.troubles, "the graph")
    moment = graph.moment()
    np.testing.assert_allclose(moment.q_arm, scene.start)
    assert topics.COMPACT_OCCUPANCY in graph.troubles
    assert "waiting for /stomp_planner/decision" in moment.state
    graph.look(False)
    wait_until(lambda: executor.spin_once(timeout_sec=0.01) or arm.get_subscription_count() == 0, "no listener")


def test_lines_of_markers_are_read_as_they_are_sent() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    from builtin_interfaces.msg import Time

    from humanpred_ros.nodes.markers import candidate_markers, rollout_markers
    from humanpred_ros.viewing.recorded import lines_of

    way = np.arange(12.0).reshape(4, 3)
    for array in (candidate_markers([("red", way, True)], Time()), rollout_markers([("red", [way])], Time())):
        ends, colours = lines_of(array)
        np.testing.assert_array_equal(ends, np.stack([way[:-1], way[1:]], axis=1))
        assert colours.shape == (3, 3)
        assert (colours >= 0.0).all()
        assert (colours <= 1.0).all()


def test_the_planner_is_asked_for_what_was_clicked(
    page: tuple[SpaceView, str], make_node: Callable[[str], Any]
) -> None:
    from std_srvs.srv import SetBool

    from humanpred_ros import topics
    from humanpred_ros.nodes.base import new_executor
    from humanpred_ros.nodes.live_view import Operator

    view, node, planner, asked = page[0], make_node("view"), make_node("planner"), []

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append(request.data)
        response.message = "red is *disabled*"
        return response

    scene = load_scene("face_to_face")
    planner.create_service(SetBool, f"{topics.PLANNER}/tasks/{scene.goals[0].name}/enable", answer)
    operator, executor = Operator(node, view, scene), new_executor(node.context)
    for one in (node, planner):
        executor.add_node(one)
    operator._ask(f"tasks/{scene.goals[0].name}/enable", SimpleNamespace(target=SimpleNamespace(value="disable")))

    def told() -> str:
        operator.work()
        executor.spin_once(timeout_sec=0.05)
        return str(operator._answer.content)

    wait_until(lambda: r"red is \*disabled\*" in told(), "the planner's answer")
    assert asked == [False]
    operator._ask("pause", SimpleNamespace(target=SimpleNamespace()))
    wait_until(lambda: "nobody offers /stomp\\_planner/pause" in told(), "a word that nobody answers")
