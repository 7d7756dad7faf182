"""The order of the goals: the cheapest first, but for the one being worked on."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from humanpred_ros.planning.decision import GoalReport
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.step import Candidate, Step

PATH = np.zeros((5, 3))


def candidate(name: str, cost: float, **report: object) -> Candidate:
    made = Candidate(name, 0, PATH, "straight")
    made.report = GoalReport(
        name, {"human": cost}, cost, cost, 1.0, cost, PATH, valid=True, reason="", iterations=1, warm_start="straight"
    )
    for key, value in report.items():
        object.__setattr__(made.report, key, value)
    return made


def order(*candidates: Candidate, chosen: str | None, left: dict[str, int] | None = None, **config: float) -> list[str]:
    """Names of the candidates, best first, for a robot that works on `chosen` and has left goals before."""
    settings = ReplannerConfig(**{"switch_cost": 0.1, "switch_improvement": 0.0, **config})
    state = SimpleNamespace(chosen=chosen, left=left or {})
    step = SimpleNamespace(config=settings, state=state, candidates=list(candidates))
    return [found.name for found in Step.ranked(step)]


A, B, C = candidate("a", 1.0), candidate("b", 0.85), candidate("c", 0.95)


def test_without_a_goal_the_cheapest_comes_first() -> None:
    assert order(A, B, C, chosen=None) == ["b", "c", "a"]


def test_the_present_goal_yields_only_to_a_clearly_cheaper_one() -> None:
    assert order(A, B, C, chosen="a") == ["b", "a", "c"]
    assert order(A, B, C, chosen="a", switch_improvement=0.1) == ["a", "b", "c"]
    assert order(A, B, C, chosen="c") == ["c", "b", "a"]
    assert order(A, B, C, chosen="b") == ["b", "c", "a"]


@pytest.mark.parametrize(("times", "first"), [(0, "b"), (1, "a"), (2, "a")])
def test_a_goal_that_was_left_before_must_be_cheaper_by_more(times: int, first: str) -> None:
    # 0.15 cheaper: enough for a switch cost of 0.1, not for twice or three times that.
    assert order(A, B, C, chosen="a", left={"b": times})[0] == first
    # What counts is how often that goal was left, not the others.
    assert order(A, B, C, chosen="a", left={"a": times, "c": times})[0] == "b"


def test_three_times_the_cost_is_asked_for_a_goal_left_twice() -> None:
    much = candidate("b", 0.71)
    assert order(A, much, chosen="a", left={"b": 1})[0] == "b"
    assert order(A, much, chosen="a", left={"b": 2})[0] == "a"


def test_what_may_not_be_executed_is_not_in_the_order() -> None:
    refused = candidate("b", 0.1, set_aside="the person is there")
    forbidden = candidate("c", 0.1, valid=False, reason="obstacle")
    assert order(A, refused, forbidden, chosen="b") == ["a"]
