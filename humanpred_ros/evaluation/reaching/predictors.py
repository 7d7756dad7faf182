"""The predictors of reaches that can be evaluated, by name; a further one is a further entry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.reaching.entry import SIMPLE, ReachingEntry, ReachingMaterial, Without
from humanpred_ros.evaluation.reaching.planned import planned_entries
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.bow import learn_bow
from humanpred_ros.reaching.trivial import TimedLine, constant_speed, cubic, hold, mean_profile, minimum_jerk


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
        "time_profile": ReachingEntry("straight line, mean timing of the other recordings", _time_profile, SIMPLE),
        "bow": ReachingEntry("minimum jerk, bowed as the other recordings", _bow, SIMPLE),
        **dict(planned_entries()),
    }
)


def reaching_entry(name: str) -> ReachingEntry:
    """Return the entry of that name.

    Raises:
        UsageError: an unknown name.
    """
    if name not in REACHING_PREDICTORS:
        raise UsageError(f"predictors: wanted some of {', '.join(REACHING_PREDICTORS)}, got {name or 'none'}")
    return REACHING_PREDICTORS[name]
