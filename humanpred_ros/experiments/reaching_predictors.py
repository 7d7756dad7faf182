"""The predictors of reaches that can be evaluated, by name; a further one is a further entry."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from humanpred_ros.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.bow import learn_bow
from humanpred_ros.reaching.task import ReachPredictor
from humanpred_ros.reaching.trivial import TimedLine, constant_speed, cubic, hold, mean_profile, minimum_jerk

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


def _profile(profile: Callable[[FloatArray], FloatArray]) -> Callable[[ReachingMaterial], Without]:
    return lambda material: lambda name: TimedLine(profile)


def _time_profile(material: ReachingMaterial) -> Without:
    return lambda name: mean_profile(material.without(name))


def _bow(material: ReachingMaterial) -> Without:
    return lambda name: learn_bow(material.without(name), material.model)


REACHING_PREDICTORS: Mapping[str, ReachingEntry] = MappingProxyType(
    {
        "hold": ReachingEntry("stays in the first posture", _profile(hold)),
        "line": ReachingEntry("straight line in posture space, constant speed", _profile(constant_speed)),
        "cubic": ReachingEntry("straight line, cubic timing", _profile(cubic)),
        "minimum_jerk": ReachingEntry("straight line, minimum-jerk timing", _profile(minimum_jerk)),
        "time_profile": ReachingEntry("straight line, mean timing of the other recordings", _time_profile),
        "bow": ReachingEntry("minimum jerk, bowed as the other recordings", _bow),
    }
)
