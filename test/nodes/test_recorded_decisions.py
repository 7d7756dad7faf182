"""What the planner says of its decisions is what reports read from a bag: to the last bit, and with every reason."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from humanpred_ros.planning.decision import EVADE, HOLD, REPLAN, Decision, GoalReport
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.viewing.recorded import decision_of

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.nodes import conversions

PATH = np.zeros((2, 7))
RED = GoalReport(
    name="red", cost={"human": 0.1, "obstacle": 1.0 / 3.0}, total=0.1 + 1.0 / 3.0, human=0.07, length=1.25,
    selection_cost=0.1 / 3.0, path=PATH, valid=True, reason="", iterations=50, warm_start="executing", rest=0.2 / 3.0,
    task_cost=0.01, alternative=3, revived=True,
)  # fmt: skip
BLUE = dataclasses.replace(RED, name="blue", selection_cost=0.4, revived=False)
STILL = TimedTrajectory(np.array([0.0, 1.0]), PATH, PATH, PATH)


def recorded(decision: Decision):  # type: ignore[no-untyped-def]
    return decision_of(conversions.decision_message(decision, 5, 12.5), decision.stamp_s, 0.0)


@pytest.mark.parametrize("action", [REPLAN, EVADE])
def test_numbers_and_reasons_come_through(action: str) -> None:
    decision = Decision(0.7, 4, action, "red costs 1, blue 2", "red", "blue", (RED, BLUE), 0.8, STILL)
    read = recorded(decision)
    assert (read.action, read.step, read.chosen, read.previous, read.switched) == (action, 4, "red", "blue", True)
    assert (read.reason, read.margin, read.t_switch_s) == (decision.reason, decision.margin, 0.8)
    assert read.is_step
    for said, goal in zip(decision.goals, read.goals, strict=True):
        for name in ("name", "selection_cost", "human", "length", "rest", "task_cost", "alternative", "revived"):
            assert getattr(goal, name) == getattr(said, name)
        assert goal.terms == said.cost
        assert (goal.valid, goal.set_aside, goal.eligible) == (True, "", True)
    assert [goal.message for goal in read.goals] == ["chosen", "candidate"]


def test_a_goal_out_of_the_question_says_why() -> None:
    aside = dataclasses.replace(BLUE, set_aside="far too expensive: costs 9", valid=False, reason="in collision")
    invalid = dataclasses.replace(BLUE, name="green", valid=False, reason="in collision")
    read = recorded(
        Decision(0.7, 4, REPLAN, "red is the cheapest goal", "red", None, (RED, aside, invalid), 0.8, STILL)
    )
    assert [goal.eligible for goal in read.goals] == [True, False, False]
    assert [goal.message for goal in read.goals] == ["chosen", "far too expensive: costs 9", "in collision"]
    assert read.goals[1].set_aside == "far too expensive: costs 9"
    assert math.isnan(read.margin)  # nothing else could have been chosen


def test_a_hold_between_steps_is_no_step() -> None:
    read = recorded(Decision(0.7, 4, HOLD, "too close: 0.03 m", "red", "red"))
    assert (read.step, read.is_step, read.reason) == (-1, False, "too close: 0.03 m")
