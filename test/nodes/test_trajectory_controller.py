"""The documented behaviour of a joint trajectory controller, one rule after the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.nodes.conversions import REST_VELOCITY, controller_refusal
from humanpred_ros.nodes.trajectory_controller import ControllerSettings, TrajectoryController

NAMES = ("shoulder", "elbow")


def time(ns: int) -> SimpleNamespace:
    return SimpleNamespace(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def point(at_ns: int, **parts: Any) -> SimpleNamespace:
    given = {"positions": [0.0, 1.0], "velocities": [0.0, 0.0], "accelerations": [0.0, 0.0], "effort": []} | parts
    return SimpleNamespace(time_from_start=time(at_ns), **given)


def message(*points: SimpleNamespace, names: tuple[str, ...] = NAMES, stamp_ns: int = 10) -> SimpleNamespace:
    return SimpleNamespace(joint_names=list(names), points=list(points), header=SimpleNamespace(stamp=time(stamp_ns)))


def test_what_the_package_makes_is_taken() -> None:
    trajectory = time_parameterise(straight([0.0, 0.0], [1.0, -0.5], 20), 1.0, 4.0, [0.2, 0.1])
    points = [
        point(round((t - trajectory.start_s) * 1e9), positions=list(q), velocities=list(v), accelerations=list(a))
        for t, q, v, a in zip(trajectory.t_s, trajectory.q, trajectory.v, trajectory.a, strict=True)
    ]
    assert controller_refusal(message(*points), NAMES) == ""


@pytest.mark.parametrize(
    "taken",
    [
        message(point(0)),
        message(point(0), point(1)),
        message(point(5), names=("elbow", "shoulder")),
        message(point(0, velocities=[1.0, 1.0]), point(9)),
        message(point(0), point(9, velocities=[], accelerations=[])),
        message(point(9, velocities=[REST_VELOCITY, 0.0])),
        message(point(0, positions=np.zeros(2), velocities=np.zeros(2), effort=np.zeros(0))),
    ],
)
def test_what_a_controller_takes_is_taken(taken: SimpleNamespace) -> None:
    assert controller_refusal(taken, NAMES) == ""


@pytest.mark.parametrize(
    ("refused", "reason"),
    [
        (message(point(0), names=("shoulder",)), "joints"),
        (message(point(0), names=("shoulder", "wrist")), "joints"),
        (message(point(0), names=("shoulder", "shoulder")), "joints"),
        (message(point(0), names=()), "joints"),
        (message(), "at least one point"),
        (message(point(5), point(5)), "increasing"),
        (message(point(5), point(3)), "increasing"),
        (message(point(-1)), "increasing"),
        (message(point(0, positions=[0.0])), "2 positions, got 1"),
        (message(point(0, positions=[])), "2 positions, got 0"),
        (message(point(0, velocities=[0.0])), "velocities"),
        (message(point(0, accelerations=[0.0] * 3)), "accelerations"),
        (message(point(0, effort=[0.0, 0.0])), "efforts"),
        (message(point(0), point(9, velocities=[0.0, -1e-6])), "rest"),
        (message(point(0), point(1, positions=[0.0, np.nan])), "finite"),
        (message(point(0, velocities=[np.inf, 0.0]), point(1)), "finite"),
    ],
)
def test_what_a_controller_refuses_is_refused(refused: SimpleNamespace, reason: str) -> None:
    assert reason in controller_refusal(refused, NAMES)


def test_a_trajectory_that_is_over_is_refused() -> None:
    assert controller_refusal(message(point(0), point(90), stamp_ns=10), NAMES, now_ns=100) == ""
    assert "over" in controller_refusal(message(point(0), point(90), stamp_ns=10), NAMES, now_ns=101)
    # Without a stamp it begins when it comes.
    assert controller_refusal(message(point(0), point(90), stamp_ns=0), NAMES, now_ns=10**18) == ""


def moving(q: tuple[float, float], at_s: float, **parts: Any) -> SimpleNamespace:
    return point(round(at_s * 1e9), positions=list(q), **parts)


def run(controller: TrajectoryController, until_s: float, step_s: float = 0.01) -> None:
    """Let time go on to `until_s`."""
    begin_ns = controller._now_ns or 0
    for k in range(1, round((until_s - begin_ns * 1e-9) / step_s) + 1):
        controller.update(begin_ns + round(k * step_s * 1e9))


def made(**settings: float) -> TrajectoryController:
    controller = TrajectoryController(NAMES, [0.0, 1.0], 2.0, ControllerSettings(**settings))
    controller.update(0)
    run(controller, 1.0)
    return controller


def test_a_stamp_of_zero_means_begin_when_it_arrives() -> None:
    controller = made()
    assert controller.command(message(moving((1.0, 1.0), 2.0), stamp_ns=0), 1_000_000_000) == ""
    run(controller, 2.0)
    np.testing.assert_allclose(controller.q, [0.5, 1.0], atol=1e-9)  # half way at half time, and not there at once
    run(controller, 3.0)
    np.testing.assert_array_equal(controller.q, [1.0, 1.0])
    np.testing.assert_array_equal(controller.v, [0.0, 0.0])


def test_a_new_trajectory_makes_it_forget_the_old_one_at_once() -> None:
    controller = made()
    controller.command(message(moving((1.0, 1.0), 2.0), stamp_ns=0), 1_000_000_000)
    run(controller, 2.0)
    q, v = controller.q.copy(), controller.v.copy()
    # It begins in 2 s, but from now on the arm goes to where it begins.
    controller.command(message(moving((0.5, 2.0), 0.0), moving((0.5, 2.5), 1.0), stamp_ns=4_000_000_000), 2_000_000_000)
    run(controller, 2.01)
    np.testing.assert_allclose(controller.q, q + 0.01 * v, atol=2e-4)  # no step in position or velocity
    run(controller, 3.0)
    assert 1.2 < controller.q[1] < 1.8
    run(controller, 4.0)
    np.testing.assert_allclose(controller.q, [0.5, 2.0], atol=1e-9)


def test_what_is_refused_leaves_the_old_one_under_way() -> None:
    controller = made()
    controller.command(message(moving((1.0, 1.0), 2.0), stamp_ns=0), 1_000_000_000)
    assert "over" in controller.command(message(moving((5.0, 5.0), 0.5), stamp_ns=1), 2_000_000_000)
    run(controller, 3.0)
    np.testing.assert_array_equal(controller.q, [1.0, 1.0])


def test_the_arm_moves_no_faster_than_its_joints_can() -> None:
    controller = made()
    # Its first point was due half a second ago: the controller jumps to it, and the arm follows as it can.
    late = message(moving((1.0, 1.0), 0.0), moving((2.0, 1.0), 1.0), stamp_ns=500_000_000)
    assert controller.command(late, 1_000_000_000) == ""
    run(controller, 1.1)
    np.testing.assert_allclose(controller.q, [0.2, 1.0], atol=1e-6)  # 2 rad/s for 0.1 s
    np.testing.assert_allclose(controller.v, [2.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ({"velocities": [], "accelerations": []}, 0.25),
        ({"accelerations": []}, 0.25**2 * (3 - 2 * 0.25)),
        ({}, 0.25**3 * (10 - 15 * 0.25 + 6 * 0.25**2)),
    ],
    ids=["line", "cubic", "quintic"],
)
def test_between_points_it_follows_what_both_points_have(parts: dict[str, Any], expected: float) -> None:
    controller = made()
    points = moving((0.0, 1.0), 0.0, **parts), moving((1.0, 1.0), 2.0, **parts)
    controller.command(message(*points, stamp_ns=10**9), 10**9)
    run(controller, 1.5)
    np.testing.assert_allclose(controller.q[0], expected, atol=1e-9)


def test_a_speed_factor_makes_time_run_slower_and_zero_is_a_pause() -> None:
    controller = made()
    controller.command(message(moving((1.0, 1.0), 2.0, velocities=[], accelerations=[]), stamp_ns=0), 1_000_000_000)
    controller.speed_factor = 0.5
    run(controller, 2.0)
    np.testing.assert_allclose(controller.q[0], 0.25, atol=1e-6)
    controller.speed_factor = 0.0
    run(controller, 3.0)
    np.testing.assert_allclose(controller.q[0], 0.25, atol=1e-6)
    np.testing.assert_array_equal(controller.v, 0.0)
    controller.speed_factor = 1.0
    run(controller, 4.5)
    np.testing.assert_allclose(controller.q[0], 1.0, atol=1e-6)


def test_an_arm_that_does_not_follow_ends_the_trajectory() -> None:
    controller = made(path_tolerance_rad=0.1)
    controller.command(message(moving((1.0, 1.0), 2.0), stamp_ns=0), 1_000_000_000)
    run(controller, 1.5)
    at = controller.q.copy()
    controller.stuck = True
    run(controller, 2.5)
    assert "path tolerance: shoulder" in controller.ended
    controller.stuck = False
    run(controller, 4.0)
    np.testing.assert_array_equal(controller.q, at)  # held where it was: it does not go on when it is free again


def test_an_arm_that_does_not_arrive_in_time_has_failed() -> None:
    controller = made(goal_tolerance_rad=0.05, goal_time_s=0.5)
    controller.command(message(moving((1.0, 1.0), 1.0), stamp_ns=0), 1_000_000_000)
    controller.stuck = True
    run(controller, 2.4)
    assert controller.ended == ""
    run(controller, 2.6)
    assert "goal tolerance: shoulder" in controller.ended
