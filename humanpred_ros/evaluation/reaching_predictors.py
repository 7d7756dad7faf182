"""The predictors of reaches that `humanpred evaluate reaching` compares: trivial ones, P2's, and improved ones.

Each can be made without the recording it is tested on; a further predictor is a further entry of `REACHING_PREDICTORS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType

import numpy as np

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.evaluation.reaching_weights import ALL, ALONE, IMPROVED, PUBLISHED
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.between_ends import PostureBounds, minimum_jerk, straight_line
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.planner import (
    STEP_S,
    PlannedPrediction,
    PredictsReaches,
    ReachPlanner,
    ReachTask,
    improved_planner,
)
from humanpred_ros.reaching.surroundings import Surroundings

WRIST = "right_wrist"
#: Kinds of predictors, in the order of tables.
TRIVIAL = "nothing learned"
SIMPLE = "learned, not planned"
REPRODUCED = "P2 reproduced"
BETTER = "better"
REFERENCE = "reference"
GROUPS = (TRIVIAL, SIMPLE, REPRODUCED, BETTER, REFERENCE)
#: Phases at which time profiles are averaged.
_N_PHASES = 100
#: A motion that ends nearer to its start than this share of its farthest distance is no reach, but there and back.
_LEAST_WAY_SHARE = 0.25


@dataclass(frozen=True)
class ReachingMaterial:
    """What predictors may be made of."""

    recordings: Sequence[ReachRecording]  #: to learn from
    model: HumanModel  #: the human
    #: learned from them, by the names of `reaching_weights.LEARNING` and by recording
    weights: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    surroundings: Surroundings = field(default_factory=Surroundings.of_p2)  #: what stands where they were recorded

    def without(self, name: str) -> list[ReachRecording]:
        """Return all recordings except one; all of them if none has that name."""
        return [recording for recording in self.recordings if recording.name != name]


@dataclass(frozen=True)
class ReachingEntry:
    """One predictor."""

    description: str  #: for people
    #: returns the predictor for a recording, by name; it knows all recordings except that one
    make: Callable[[ReachingMaterial, str], PredictsReaches]
    group: str = TRIVIAL  #: one of `GROUPS`
    learns: str | None = None  #: which of `reaching_weights.LEARNING` it needs, None if none
    step_s: float | None = None  #: time between plans; None where it plans once, or not at all

    @property
    def by_chance(self) -> bool:
        """Whether runs with other seeds differ: only planning is random."""
        return self.group in (REPRODUCED, BETTER)

    @property
    def of_tested(self) -> bool:
        """Whether it learns from the very recording it is tested on, so that it can be tested on no other."""
        return self.learns == ALONE


@dataclass(frozen=True, eq=False)
class Line:
    """Moves on the straight line in posture space."""

    profile: Callable[[FloatArray], FloatArray]  #: returns the share of the way (n,) at phases (n,) from 0 to 1

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J), ends exact; nothing is random."""
        return straight_line(task.start, task.goal, self.profile(task.phase))


def mean_profile(recordings: Sequence[ReachRecording]) -> Line:
    """Return the straight line with the mean time profile of recorded reaches.

    A profile is the projection onto the line from the first to the last posture. Motions of people who came back to
    where they began have none; without any other the profile is minimum jerk.

    Raises:
        MotionError: no recordings.
    """
    if not recordings:
        raise MotionError("time profile: wanted at least one recording to learn from, got none")
    phases = np.linspace(0.0, 1.0, _N_PHASES)
    profiles = []
    for motion in (recording.active for recording in recordings):
        away = np.linalg.norm(motion.q - motion.q[0], axis=1)
        if away[-1] > _LEAST_WAY_SHARE * away.max():
            way = motion.q[-1] - motion.q[0]
            done = (motion.q - motion.q[0]) @ way / float(way @ way)
            phase = (motion.t_s - motion.t_s[0]) / motion.duration_s
            profiles.append(np.interp(phases, phase, done))
    if not profiles:
        return Line(minimum_jerk)
    mean = np.mean(profiles, axis=0)
    return Line(lambda phase: np.asarray(np.interp(phase, phases, mean)))


#: Predictors that plan: description, the weights they learn (None: those of `NAMED_WEIGHTS`), and kind.
_PLANNED: dict[str, tuple[str, str | None, str]] = {
    "own": ("cost learned from the tested reach itself (P2 Table I): no prediction, a fit", ALONE, REPRODUCED),
    "learned": ("P2: learned cost, straight line as first guess", PUBLISHED, REPRODUCED),
    "learned_near": (
        "as learned, but bounded by how far a reach moves people, not by where they stood", PUBLISHED, BETTER
    ),
    "improved": ("learned cost of smoothness, better first guess, noise and bounds", IMPROVED, BETTER),
    "baseline_0": ("smooth only, ignores the partner (P2's aggressive baseline)", None, REPRODUCED),
    "baseline_1": ("smooth, equally far from all links of the partner (P2's conservative baseline)", None, REPRODUCED),
}  # fmt: skip


def _plan(name: str, step_s: float | None, material: ReachingMaterial, tested: str) -> PlannedPrediction:
    """Return the predictor `name` for a recording: planned once, or again every `step_s`."""
    model, surroundings, learns = material.model, material.surroundings, _PLANNED[name][1]
    known = material.recordings if name == "own" else material.without(tested)
    if learns is None:
        weights = NAMED_WEIGHTS[name]
    else:
        learned = material.weights[learns]
        weights = learned.get(tested, learned[ALL])
    if name == "improved":
        return PlannedPrediction(improved_planner(known, model, weights, surroundings), step_s)
    bounds = PostureBounds.from_recordings(known, model, relative=name == "learned_near")
    return PlannedPrediction(ReachPlanner(model, weights, bounds, surroundings), step_s)


def _planned_entries() -> Iterator[tuple[str, ReachingEntry]]:
    for step_s, tail, how in ((None, "", ""), (STEP_S, "_replanned", ", re-planned every 0.1 s")):
        for name, (text, learns, group) in _PLANNED.items():
            if name != "own" or step_s is None:
                default = "; the default" if name + tail == "improved" else ""
                make = partial(_plan, name, step_s)
                yield name + tail, ReachingEntry(text + default + how, make, group, learns, step_s)


def _line(profile: Callable[[FloatArray], FloatArray]) -> Callable[[ReachingMaterial, str], Line]:
    return lambda material, tested: Line(profile)


REACHING_PREDICTORS: Mapping[str, ReachingEntry] = MappingProxyType(
    {
        "hold": ReachingEntry("stays in the first posture", _line(np.zeros_like)),
        "line": ReachingEntry("straight line in posture space, constant speed", _line(lambda phase: phase)),
        "minimum_jerk": ReachingEntry("straight line, minimum-jerk timing", _line(minimum_jerk)),
        "time_profile": ReachingEntry(
            "straight line, mean timing of the other recordings",
            lambda material, tested: mean_profile(material.without(tested)), SIMPLE,
        ),
        **dict(_planned_entries()),
    }
)  # fmt: skip


def reaching_entry(name: str) -> ReachingEntry:
    """Return the entry of that name (UsageError if there is none)."""
    if name not in REACHING_PREDICTORS:
        raise UsageError(f"predictors: wanted some of {', '.join(REACHING_PREDICTORS)}, got {name or 'none'}")
    return REACHING_PREDICTORS[name]
