"""A goal is a set of configurations, and one that makes no sense is refused by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from humanpred_ros.errors import SceneError
from humanpred_ros.robot.goal import Goal


def test_one_configuration_is_a_set_of_one() -> None:
    goal = Goal("here", np.arange(7.0))
    assert goal.configurations.shape == (1, 7)
    np.testing.assert_array_equal(goal.configuration, np.arange(7.0))
    assert goal.task_cost == 0.0


def test_the_first_configuration_is_the_preferred_one() -> None:
    q = np.arange(6.0).reshape(2, 3)
    goal = Goal("either", q, task_cost=2)
    np.testing.assert_array_equal(goal.configuration, q[0])
    assert goal.task_cost == 2.0


def test_a_goal_cannot_be_changed_by_accident() -> None:
    q = np.zeros((2, 3))
    goal = Goal("fixed", q)
    q[0] = 1.0
    assert (goal.configurations == 0.0).all()
    with pytest.raises(ValueError, match="read-only"):
        goal.configurations[0, 0] = 1.0


@pytest.mark.parametrize(
    ("configurations", "cost", "words"),
    [
        ([], 0.0, "at least one configuration"),
        (np.empty((0, 7)), 0.0, "at least one configuration"),
        ([[1.0, 2.0], [3.0]], 0.0, "wanted numbers"),
        ([0.0, np.nan], 0.0, "finite"),
        ("home", 0.0, "wanted numbers"),
        (np.zeros((1, 2, 3)), 0.0, "wanted shape"),
        ([0.0], -0.1, "task_cost of at least 0, got -0.1"),
        ([0.0], np.inf, "task_cost: wanted finite"),
        ([0.0], [1.0, 2.0], "task_cost: wanted shape"),
    ],
)
def test_goals_that_make_no_sense_are_refused_by_name(configurations: Any, cost: Any, words: str) -> None:
    with pytest.raises(SceneError, match=f"goal 'odd'.*{words}"):
        Goal("odd", configurations, cost)
