"""Where the person's hand may go: places that a scene knows of, whether or not anybody was ever seen to go there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.robot.scene_file import Section

REACH_GOAL_KEYS = ("label", "place_m")


@dataclass(frozen=True, eq=False)
class ReachGoal:
    """A place the person may reach for.

    Attributes:
        label: number by which messages call it; where a library has a class of reaches to it, that class's.
        place_m: (3,) where the palm ends, world frame.

    Raises:
        SceneError: a label that is no whole number, or a place that is not three finite numbers.
    """

    label: int
    place_m: FloatArray

    def __post_init__(self) -> None:
        if isinstance(self.label, bool) or not isinstance(self.label, int):
            raise SceneError(f"reach goal: wanted a whole number as label, got {self.label!r:.60}")
        place = checked(f"reach goal {self.label}: place_m", self.place_m, (3,), error=SceneError)
        object.__setattr__(self, "place_m", frozen(place))


def parse_reach_goals(entries: Sequence[Section]) -> tuple[ReachGoal, ...]:
    """Return the reach goals of a scene file's sections, with `REACH_GOAL_KEYS`.

    Raises:
        SceneError: missing or unknown keys, impossible values.
    """
    return tuple(ReachGoal(entry.value("label"), entry.numbers("place_m", 3)) for entry in entries)
