"""What an evaluation knows of a predictor of reaches: how to make it without the recording it is tested on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.task import ReachPredictor

#: Gives the predictor for a recording, by name; it knows all recordings to learn from but that one.
Without = Callable[[str], ReachPredictor]


@dataclass(frozen=True)
class ReachingMaterial:
    """What predictors may be made of.

    Attributes:
        recordings: to learn from.
        model: the human.
        seed: of learning.
    """

    recordings: Sequence[ReachRecording]
    model: HumanModel
    seed: int = 0

    def without(self, name: str) -> list[ReachRecording]:
        """Return all recordings but one; all of them if none has that name."""
        return [recording for recording in self.recordings if recording.name != name]


@dataclass(frozen=True)
class ReachingEntry:
    """One predictor.

    Attributes:
        description: for people.
        prepare: does once what all recordings share, and returns a predictor for each.
        by_chance: whether runs with other seeds differ.
    """

    description: str
    prepare: Callable[[ReachingMaterial], Without]
    by_chance: bool = False
