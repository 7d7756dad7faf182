"""Over DDS, an arm that is not where the planner thinks it is leads to a hold with that reason, every time anew."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from humanpred_ros.robot.scene import load_scene

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from planner_client import NS, PlannerClient, nobody
from std_msgs.msg import Int16, String
from waiting import wait_until

from humanpred_ros import topics
from humanpred_ros.nodes import conversions, qos

SCENE = load_scene("face_to_face")
PARAMETERS = {"scene": "face_to_face", "iterations": 5, "waypoints": 40, "period_s": 0.2, "velocity_scale": 0.05}
TOLERANCE_RAD = 0.05


class Session:
    """A planner that has an arm on its way, with nobody near."""

    def __init__(self, client: PlannerClient) -> None:
        self.client = client

    def go_on(self, condition: Callable[[], bool], what: str) -> None:
        """Send occupancies until a condition holds."""
        client = self.client

        def send() -> None:
            client.send_cloud(conversions.occupancy_cloud(nobody(SCENE), 0.0, client.now_ns()))

        client.send_until(send, condition, what, timeout_s=120.0)

    def until_moving(self) -> None:
        n_before = len(self.client.decisions)
        self.go_on(
            lambda: (
                np.abs(self.client.controller.v).max() > 0.05
                and any(d.action in ("keep", "replan") for d in self.client.decisions[n_before:])
            ),
            "the arm to be on its way",
        )

    def until_hold(self, reason: str) -> None:
        n_before = len(self.client.decisions)
        self.go_on(self._held(reason, n_before), f"a hold: {reason}")

    def wait_for_hold(self, reason: str) -> None:
        self.client.wait(self._held(reason, len(self.client.decisions)), f"a hold: {reason}")

    def _held(self, reason: str, since: int) -> Callable[[], bool]:
        decisions = self.client.decisions
        return lambda: any(d.action == "hold" and d.reason.startswith(reason) for d in decisions[since:])


@pytest.fixture
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with PlannerClient(tmp_path_factory.mktemp("planner"), SCENE, PARAMETERS) as client:
        client.settle_arm()
        yield Session(client)


def farthest(client: PlannerClient) -> float:
    """Return how far the newest trajectory begins or ends from where the arm is, rad."""
    points = client.trajectories[-1].points
    return max(
        float(np.abs(np.array(point.positions) - client.controller.q).max()) for point in (points[0], points[-1])
    )


def test_an_arm_that_does_not_follow_is_stopped_and_goes_on_from_where_it_is(session: Session) -> None:
    client = session.client
    for _ in range(2):
        session.until_moving()
        client.controller.stuck = True
        session.until_hold("the arm does not follow")
        client.wait(lambda: farthest(client) < TOLERANCE_RAD, "a stop that begins and ends where the arm is")
        client.controller.stuck = False
    session.until_moving()
    # Moved by hand, 0.2 rad, and held there: the next motion begins there.
    client.controller.stuck = True
    client.controller.q = client.controller.q + 0.2
    session.until_hold("the arm does not follow")
    client.controller.stuck = False
    n_sent = len(client.trajectories)
    session.until_moving()
    first = client.trajectories[n_sent].points[0]
    assert np.abs(np.array(first.positions) - client.controller.q).max() < 0.2


def test_an_arm_that_falls_silent_is_stopped_every_time(session: Session) -> None:
    client = session.client
    for _ in range(2):
        session.until_moving()
        client.arm_runs = False
        session.until_hold("silent arm")
        # Nobody knows where it is: people who are seen go on being answered with a hold, and nothing is sent.
        n_before = len(client.decisions)
        session.go_on(lambda n=n_before: len(client.decisions) > n + 5, "the stop")
        n_before, n_sent = len(client.decisions), len(client.trajectories)
        session.go_on(lambda n=n_before: len(client.decisions) > n + 20, "further answers")
        assert {d.action for d in client.decisions[n_before:]} == {"hold"}
        assert len(client.trajectories) == n_sent
        client.arm_runs = True


class Guard:
    """Says a factor 30 times a second, which the arm obeys, as long as it runs."""

    def __init__(self, session: Session) -> None:
        node, self.controller = session.client.node, session.client.controller
        self.percent, self.reason, self.runs = 100, "", True
        self.factors = node.create_publisher(Int16, topics.SPEED_FACTOR, qos.SENSOR_PUBLISHER)
        self.reasons = node.create_publisher(String, topics.GUARD_STOP, qos.COMMAND)
        node.create_timer(1.0 / 30.0, self.say)

    def say(self) -> None:
        self.controller.speed_factor = self.percent / 100.0 if self.runs else 0.0
        if self.runs:
            self.reasons.publish(String(data=self.reason))
            self.factors.publish(Int16(data=self.percent))


def test_the_planner_obeys_the_guard_and_notices_its_end(session: Session) -> None:
    guard = Guard(session)
    client = session.client
    for percent in (100, 70):
        guard.percent, guard.reason = percent, ""
        session.until_moving()
    guard.percent, guard.reason = 0, "the person is 0.20 m away"
    session.until_hold("separation guard: the person is 0.20 m away")
    q, n_before = client.controller.q.copy(), len(client.decisions)
    session.go_on(lambda: len(client.decisions) > n_before + 20, "answers while the arm stands")
    assert {d.action for d in client.decisions[n_before:]} == {"hold"}
    guard.percent, guard.reason = 70, ""
    assert farthest(client) < TOLERANCE_RAD  # nothing that the arm would go on with by itself
    assert np.abs(client.controller.q - q).max() < TOLERANCE_RAD
    session.until_moving()
    guard.runs = False
    session.until_hold("guard silent")
    guard.runs = True
    session.until_moving()
    guard.percent = 300
    session.until_hold("invalid speed factor")
    guard.percent = 100
    session.until_moving()
    other = client.node.create_publisher(Int16, topics.SPEED_FACTOR, qos.SENSOR_PUBLISHER)
    session.until_hold("two guards")
    client.node.destroy_publisher(other)
    session.until_moving()


def test_a_planner_that_stood_still_commands_nothing_before_it_knows_where_the_arm_is(session: Session) -> None:
    client, process = session.client, session.client.process.process
    guard = Guard(session)
    for stops in (True, False):  # the guard stops the arm meanwhile, as it hears no planner; or the arm moves on
        session.until_moving()
        process.send_signal(signal.SIGSTOP)
        n_sent, since_s = len(client.trajectories), client.now_ns() * 1e-9
        guard.percent, guard.reason = (0, "silent planner") if stops else (100, "")

        def stood(since_s: float = since_s) -> bool:
            client.spin()
            return client.now_ns() * 1e-9 - since_s > 1.0

        wait_until(stood, "a planner that stands", 30.0)
        process.send_signal(signal.SIGCONT)
        session.until_hold("the planner stood still")
        session.go_on(lambda n=n_sent: len(client.trajectories) > n, "the stop from where the arm is")
        guard.percent, guard.reason = 100, ""
        session.until_moving()
        assert max(client.gaps_rad[n_sent:]) < TOLERANCE_RAD


def test_a_stamp_ahead_holds_and_spoils_nothing(session: Session) -> None:
    for _ in range(2):
        session.until_moving()
        n_before = len(session.client.decisions)
        cloud = conversions.occupancy_cloud(nobody(SCENE), 0.0, session.client.now_ns() + 60 * NS)
        session.client.send_until(
            lambda cloud=cloud: session.client.send_cloud(cloud),
            lambda n=n_before: any(d.reason.startswith("stamp ahead") for d in session.client.decisions[n:]),
            "a hold",
        )
        session.until_moving()  # ordinary stamps count at once
        session.wait_for_hold("stale human data")  # and so does their silence


def test_a_second_planner_does_not_command(session: Session) -> None:
    session.until_moving()
    session.client.group.start("stomp_planner", PARAMETERS)
    session.until_hold("two planners: /stomp_planner commands this arm already")
    # The first one works on; by now its arm may have arrived.
    decisions, since = session.client.decisions, len(session.client.decisions)
    session.go_on(lambda: any(d.action in ("keep", "replan", "arrived") for d in decisions[since:]), "an answer")


def test_a_planner_that_is_ended_stops_the_arm(session: Session) -> None:
    session.until_moving()
    client = session.client
    client.process.process.send_signal(signal.SIGINT)

    def rests() -> bool:
        client.spin()
        return client.decisions[-1].reason == "the planner is ended" and not client.controller.v.any()

    wait_until(rests, "the last stop", 30.0)
