"""One task of the robot as a set of configurations, because most tasks can be finished in more than one way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen


@dataclass(frozen=True, eq=False)
class Goal:
    """A task of the robot: bring the arm to any one of `configurations`.

    Attributes:
        name: how scenes, messages and reports call it.
        configurations: (K, J) rad, K >= 1, the preferred one first; one configuration (J,) becomes (1, J).
        task_cost: what choosing this task costs beside disturbing the human, at least 0, in the unit of a
            goal's selection cost (human cost integrated over configuration distance).

    Raises:
        SceneError: for no configurations, values that are not finite, or a cost that is negative.
    """

    name: str
    configurations: FloatArray
    task_cost: float = 0.0

    def __post_init__(self) -> None:
        what = f"goal {self.name!r}"
        given = np.asarray(self.configurations, dtype=object)  # lists of different lengths are for `checked` to refuse
        if given.ndim < 2:
            given = given[None]
        configurations = checked(f"{what}: configurations", given, ("K", "J"), error=SceneError)
        if configurations.size == 0:
            raise SceneError(f"{what}: wanted at least one configuration, got shape {configurations.shape}")
        object.__setattr__(self, "configurations", frozen(configurations))
        cost = float(checked(f"{what}: task_cost", self.task_cost, (), error=SceneError))
        if cost < 0.0:
            raise SceneError(f"{what}: wanted a task_cost of at least 0, got {cost}; raise the others' instead")
        object.__setattr__(self, "task_cost", cost)

    @property
    def configuration(self) -> FloatArray:
        """The preferred configuration (J,) rad."""
        first: FloatArray = self.configurations[0]
        return first
