"""Which columns the report's tables of goals have: what no goal of a run has or tells is left out."""

from __future__ import annotations

import math
from dataclasses import dataclass

from humanpred_ros.viewing.run import Run


@dataclass(frozen=True)
class GoalColumns:
    """What is told of the goals of a run's steps.

    Attributes:
        terms: names of STOMP's cost terms.
        rest: whether costs of resting at the goals are known.
        task_cost: whether any goal has a cost of its own.
        alternative: whether any plan leads to another than its goal's preferred configuration.
        margin: whether the margin of any choice is known.
    """

    terms: tuple[str, ...]
    rest: bool
    task_cost: bool
    alternative: bool
    margin: bool


def told_of_goals(run: Run) -> GoalColumns:
    """Return what the steps of a run tell of their goals; bags of earlier versions tell less."""
    goals = [goal for step in run.steps for goal in step.goals]
    return GoalColumns(
        terms=tuple(dict.fromkeys(name for goal in goals for name in goal.terms)),
        rest=any(math.isfinite(goal.rest) for goal in goals),
        task_cost=any(math.isfinite(goal.task_cost) and goal.task_cost != 0.0 for goal in goals),
        alternative=any(goal.alternative for goal in goals),
        margin=any(math.isfinite(step.margin) for step in run.steps),
    )
