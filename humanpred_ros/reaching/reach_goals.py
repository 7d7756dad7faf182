"""Where the hand may go is said in a parameter, in a scene, or by a library; here all three become the same thing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.places import GoalPlaces


def goals_from_text(entries: Sequence[str], T_world_human: FloatArray) -> GoalPlaces | None:
    """Return the places of entries `label x y z` (a whole number, metres in the world frame); None of no entries.

    Empty entries count as none: ROS knows no empty list of texts.

    Args:
        entries: any number.
        T_world_human: (4, 4) from the tracker's frame to the world; the result is in the tracker's.

    Raises:
        UsageError: an entry that is something else, or a label used twice.
    """
    told = [_read(entry) for entry in entries if entry.strip()]
    return _places([label for label, _ in told], [place for _, place in told], T_world_human) if told else None


def goals_of_scene(goals: Mapping[int, FloatArray], T_world_human: FloatArray) -> GoalPlaces | None:
    """Return the places (3,) by label that a scene gives, world frame, in the tracker's frame; None of none."""
    return _places(list(goals), list(goals.values()), T_world_human) if goals else None


def _places(labels: Sequence[int], places_m: Sequence[FloatArray], T_world_human: FloatArray) -> GoalPlaces:
    try:
        return GoalPlaces(tuple(labels), np.array(places_m)).moved(np.linalg.inv(T_world_human))
    except HumanPredError as trouble:
        raise UsageError(str(trouble)) from trouble


def _read(entry: str) -> tuple[int, FloatArray]:
    try:
        label, *place = entry.split()
        x, y, z = (float(number) for number in place)
        # Python reads 1_0 as 10; who writes that has made a slip.
        if "_" in entry or not all(map(math.isfinite, (x, y, z))):
            raise ValueError
        return int(label), np.array([x, y, z])
    except ValueError:
        raise UsageError(
            f"reach goal: wanted 'label x y z', a whole number and the palm's place in metres in the world frame, as "
            f"in '3 -0.22 -0.67 0.80', got {entry!r:.80}"
        ) from None
