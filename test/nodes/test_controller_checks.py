"""What a joint trajectory controller refuses, one rule after the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")

from humanpred_ros.nodes.conversions import REST_VELOCITY, controller_refusal
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise

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
