"""A recorded run, and the running graph, in a browser: what is shown is what there was, and a page is served."""

from __future__ import annotations

import io
import socket
import threading
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from waiting import wait_until

from humanpred_ros.errors import UsageError
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.viewing.playback import Player, Recording, replay_page
from humanpred_ros.viewing.run import Run
from humanpred_ros.viewing.space import ServerSettings, SpaceMoment, SpaceView, as_text, served
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
    np.testing.assert_allclose(moment.bodies[0], run.postures.at(np.array([decision.t_s]))[0])
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


def test_a_page_plays_by_itself(recording: Recording) -> None:
    page = replay_page(recording)
    assert "__VISER_EMBED_DATA__" in page
    assert len(page) < 6_000_000


def test_strange_moments_are_drawn_too(page: tuple[SpaceView, str]) -> None:
    view, _ = page
    view.show(SpaceMoment())
    view.show(SpaceMoment(q_arm=np.full(7, np.nan), state="waiting", posterior={"<b>screws</b>": 0.4}))
    assert "<b>" not in view._bars[0][0].content.replace("\\<", "").replace("\\>", "")


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
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import CompressedImage, JointState

    from humanpred_ros import topics
    from humanpred_ros.human.model import HumanModel
    from humanpred_ros.nodes import qos
    from humanpred_ros.nodes.live_view import Graph

    scene, human = load_scene("face_to_face"), HumanModel.kinect12()
    node, other = make_node("view"), make_node("robot")
    arm = other.create_publisher(JointState, topics.JOINT_STATES, qos.SENSOR_PUBLISHER)
    body = other.create_publisher(JointState, topics.human_joint_states("anna"), qos.SENSOR_PUBLISHER)
    space = other.create_publisher(CompressedImage, topics.COMPACT_OCCUPANCY, qos.SENSOR_PUBLISHER)
    graph = Graph(node, scene, human)
    executor = SingleThreadedExecutor(context=node.context)
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
