"""What an evaluation knows of a predictor of reaches: how to make it without the recording it is tested on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.reaching.learned import WeightTable
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.reach_task import ReachPredictor
from humanpred_ros.reaching.surroundings import Surroundings

#: Gives the predictor for a recording, by name; it knows all recordings to learn from but that one.
Without = Callable[[str], ReachPredictor]
#: Kinds of predictors, in the order of tables.
TRIVIAL = "nothing learned"
SIMPLE = "learned, not planned"
REPRODUCED = "P2 reproduced"
BETTER = "better"
REFERENCE = "reference"
GROUPS = (TRIVIAL, SIMPLE, REPRODUCED, BETTER, REFERENCE)


@dataclass(frozen=True)
class ReachingMaterial:
    """What predictors may be made of.

    Attributes:
        recordings: to learn from.
        model: the human.
        weights: learned from them, by the names of `LEARNING`.
        scene: what stands where they were recorded.
    """

    recordings: Sequence[ReachRecording]
    model: HumanModel
    weights: Mapping[str, WeightTable] = field(default_factory=dict)
    scene: Surroundings = field(default_factory=Surroundings.of_p2)

    def without(self, name: str) -> list[ReachRecording]:
        """Return all recordings but one; all of them if none has that name."""
        return [recording for recording in self.recordings if recording.name != name]

    def learned(self, how: str) -> WeightTable:
        """Return the weights learned in one way.

        Raises:
            UsageError: weights that were not learned.
        """
        if how not in self.weights:
            raise UsageError(
                f"reaching weights: wanted those learned as {how}, got {', '.join(self.weights) or 'none'}"
            )
        return self.weights[how]


@dataclass(frozen=True)
class ReachingEntry:
    """One predictor.

    Attributes:
        description: for people.
        prepare: does once what all recordings share, and returns a predictor for each.
        group: one of `GROUPS`.
        by_chance: whether runs with other seeds differ.
        replanned: whether it plans again on the way.
        learns: which of `LEARNING` it needs, None if none.
        of_tested: it learns from the very recording it is tested on, so it can be tested on no other.
    """

    description: str
    prepare: Callable[[ReachingMaterial], Without]
    group: str = TRIVIAL
    by_chance: bool = False
    replanned: bool = False
    learns: str | None = None
    of_tested: bool = False
