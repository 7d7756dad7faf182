"""Decisions: equal if every bit is, whatever they took to make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from humanpred_ros.planning.decision import Decision, GoalReport
from humanpred_ros.planning.trajectory import at_rest


def report(name: str = "red", cost: float = 1.0, valid: bool = True) -> GoalReport:
    return GoalReport(
        name=name,
        cost={"human": cost},
        total=cost,
        human=cost,
        length=0.5,
        selection_cost=cost,
        path=np.linspace([0.0, 0.0], [1.0, cost], 5),
        valid=valid,
        reason="" if valid else "in the way",
        iterations=50,
        warm_start="straight",
    )


def decision(**change: object) -> Decision:
    parts = {
        "stamp_s": 1.0,
        "step": 3,
        "action": "replan",
        "reason": "red is the cheapest goal",
        "chosen": "red",
        "previous": "blue",
        "goals": (report("red"), report("blue", 2.0, valid=False)),
        "t_switch_s": 1.1,
        "trajectory": at_rest([0.0, 1.0], 1.1),
    }
    return Decision(**(parts | change))


def test_equal_decisions_are_equal_however_long_they_took() -> None:
    assert decision() == decision(compute_s=9.9)
    assert report() == report()


@pytest.mark.parametrize(
    "change",
    [
        {"step": 4},
        {"chosen": "blue"},
        {"action": "keep"},
        {"t_switch_s": np.nextafter(1.1, 2.0)},
        {"trajectory": at_rest([0.0, np.nextafter(1.0, 2.0)], 1.1)},
        {"trajectory": None},
        {"goals": ()},
        {"goals": (report("red"), report("blue", np.nextafter(2.0, 3.0), valid=False))},
    ],
)
def test_any_difference_counts(change: dict[str, object]) -> None:
    assert decision() != decision(**change)
    assert decision(**change) == decision(**change)


def test_no_switch_time_equals_no_switch_time() -> None:
    none = decision(t_switch_s=float("nan"), trajectory=None)
    assert none == decision(t_switch_s=float("nan"), trajectory=None)
    assert none != decision()


def test_it_says_whether_the_goal_was_switched() -> None:
    assert decision().switched
    assert not decision(previous="red").switched
    assert not decision(previous=None).switched


def test_the_margin_is_to_the_next_goal_that_could_have_been_chosen() -> None:
    goals = (report("red"), report("blue", 2.0, valid=False), report("green", 4.0))
    assert decision(goals=goals).margin == 3.0
    assert decision(goals=goals, chosen="green").margin == -3.0  # habit decided
    assert np.isnan(decision().margin)
    assert np.isnan(decision(goals=(replace(report("red"), set_aside="far too expensive"), report("green"))).margin)


def test_it_explains_itself_in_one_line() -> None:
    text = decision().summary()
    assert "\n" not in text
    assert text == "to red, not blue: red is the cheapest goal"


def test_reports_are_found_by_name_and_cannot_be_changed() -> None:
    assert decision().report("blue").total == 2.0
    with pytest.raises(KeyError):
        decision().report("green")
    with pytest.raises(ValueError, match="read-only"):
        decision().report("red").path[0] = 1.0
    with pytest.raises(TypeError):
        decision().report("red").cost["human"] = 0.0  # type: ignore[index]
    assert replace(report(), total=3.0) != report()
