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
from humanpred_ros.evaluation.reaching_weights import ALONE, IMPROVED, PUBLISHED, WeightTable
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.first_guess import minimum_jerk, straight_line
from humanpred_ros.reaching.posture_bounds import BoundsSettings
from humanpred_ros.reaching.prediction import (
    STEP_S,
    PlannedPrediction,
    PredictsReaches,
    ReachTask,
    improved_planner,
    planned_prediction,
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
#: Returns the predictor for a recording, by name; it knows all recordings except that one.
Without = Callable[[str], PredictsReaches]


@dataclass(frozen=True)
class ReachingMaterial:
    """What predictors may be made of.

    Attributes:
        recordings: to learn from.
        model: the human.
        weights: learned from them, by the names of `reaching_weights.LEARNING`.
        surroundings: what stands where they were recorded.
    """

    recordings: Sequence[ReachRecording]
    model: HumanModel
    weights: Mapping[str, WeightTable] = field(default_factory=dict)
    surroundings: Surroundings = field(default_factory=Surroundings.of_p2)

    def without(self, name: str) -> list[ReachRecording]:
        """Return all recordings except one; all of them if none has that name."""
        return [recording for recording in self.recordings if recording.name != name]


@dataclass(frozen=True)
class ReachingEntry:
    """One predictor.

    Attributes:
        description: for people.
        prepare: does once what all recordings share, and returns a predictor for each.
        group: one of `GROUPS`.
        by_chance: whether runs with other seeds differ.
        replanned: whether it plans again on the way.
        learns: which of `reaching_weights.LEARNING` it needs, None if none.
        of_tested: it learns from the very recording it is tested on, so it can be tested on no other.
    """

    description: str
    prepare: Callable[[ReachingMaterial], Without]
    group: str = TRIVIAL
    by_chance: bool = False
    replanned: bool = False
    learns: str | None = None
    of_tested: bool = False


@dataclass(frozen=True)
class TimedLine:
    """Moves on the straight line in posture space, `profile` (n,) of the way at phases (n,) from 0 to 1."""

    profile: Callable[[FloatArray], FloatArray]

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J); nothing is random."""
        return straight_line(task.start, task.goal, self.profile(task.phase))


#: Phases at which time profiles are averaged, and the bow is kept.
_N_PHASES, _N_BOW_PHASES = 100, 101
#: A motion that ends nearer to its start than this share of its farthest distance is no reach, but there and back.
_LEAST_WAY_SHARE = 0.25


def mean_profile(recordings: Sequence[ReachRecording]) -> TimedLine:
    """Return the predictor with the mean time profile of recorded reaches.

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
            profiles.append(np.interp(phases, _phase(motion), done))
    if not profiles:
        return TimedLine(minimum_jerk)
    mean = np.mean(profiles, axis=0)
    return TimedLine(lambda phase: np.asarray(np.interp(phase, phases, mean)))


@dataclass(frozen=True, eq=False)
class BowedLine:
    """Predicts the minimum-jerk line plus a learned deviation, the bow: simple, and hard to beat (not in P2).

    People bend the elbow and lift the hand first, and turn the shoulder late. The bow is what recorded reaches have
    beyond the minimum-jerk line between their ends. Like the height of an arc over its chord, it is taken to grow with
    the square of the distance the wrist goes.

    Attributes:
        shape: (P, J) bow at even phases of a reach whose wrist goes one metre.
        model: the human.
    """

    shape: FloatArray
    model: HumanModel

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J), ends exact; nothing is random."""
        phases = np.linspace(0.0, 1.0, len(self.shape))
        bow = np.stack([np.interp(task.phase, phases, column) for column in self.shape.T], axis=1)
        size = _wrist_way_m(self.model, task.start, task.goal) ** 2.0
        postures: FloatArray = straight_line(task.start, task.goal, minimum_jerk(task.phase)) + size * bow
        return postures


def learn_bow(recordings: Sequence[ReachRecording], model: HumanModel) -> BowedLine:
    """Return the predictor with the bow of recorded reaches; those unfit for learning are left out.

    The shape is fitted by least squares, with one more observation of no bow, of the mean weight of the others.

    Raises:
        MotionError: nothing to learn from, or wrists that go nowhere.
    """
    usable = [recording.active for recording in recordings if recording.usable_for_learning]
    if not usable:
        raise MotionError("bow: wanted at least one recording fit for learning, got none")
    sizes = np.array([_wrist_way_m(model, motion.q[0], motion.q[-1]) ** 2.0 for motion in usable])
    if not sizes.any():
        raise MotionError("bow: wanted reaches, the wrist ends where it began in all recordings")
    phases = np.linspace(0.0, 1.0, _N_BOW_PHASES)
    bows = []
    for motion in usable:
        phase = _phase(motion)
        beyond = motion.q - straight_line(motion.q[0], motion.q[-1], minimum_jerk(phase))
        bows.append(np.stack([np.interp(phases, phase, column) for column in beyond.T], axis=1))
    squares = sizes**2
    shape = np.tensordot(sizes, np.array(bows), axes=1) / (squares.sum() + squares.mean())
    return BowedLine(frozen(shape), model)  # type: ignore[arg-type]


def _phase(motion: Motion) -> FloatArray:
    phase: FloatArray = (motion.t_s - motion.t_s[0]) / motion.duration_s
    return phase


def _wrist_way_m(model: HumanModel, start: FloatArray, goal: FloatArray) -> float:
    places = model.forward(np.stack([start, goal]))[WRIST]
    return float(np.linalg.norm(places[1] - places[0]))


#: The predictor that is used where no other is asked for.
DEFAULT_PREDICTOR = "improved"


def _planned(
    make: Callable[..., PredictsReaches], weights: Callable[[ReachingMaterial, str], FloatArray]
) -> Callable[[ReachingMaterial], Without]:
    """Return what prepares a planned predictor with the weights for each recording left out."""
    return lambda material: (
        lambda name: make(
            material.without(name), material.model, weights(material, name), surroundings=material.surroundings
        )
    )


def _improved(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    weights: FloatArray,
    surroundings: Surroundings,
    step_s: float | None = None,
) -> PlannedPrediction:
    return PlannedPrediction(improved_planner(recordings, model, weights, surroundings), step_s)


def _own(material: ReachingMaterial) -> Without:
    return lambda tested: planned_prediction(
        material.recordings, material.model, material.weights[ALONE].alone[tested], surroundings=material.surroundings
    )


def _planned_entries() -> Iterator[tuple[str, ReachingEntry]]:
    """Yield name and entry of each predictor that plans: planned once, then re-planned every 0.1 s."""
    own = "cost learned from the tested reach itself (P2 Table I): no prediction, a fit"
    yield "own", ReachingEntry(own, _own, REPRODUCED, by_chance=True, learns=ALONE, of_tested=True)
    near = partial(planned_prediction, bounds=BoundsSettings(relative=True))
    learned: dict[str, tuple[str, Callable[..., PredictsReaches], str, str]] = {
        "learned": ("P2: learned cost, straight line as first guess", planned_prediction, PUBLISHED, REPRODUCED),
        "learned_near": (
            "as learned, but bounded by how far a reach moves people, not by where they stood", near, PUBLISHED, BETTER
        ),
        DEFAULT_PREDICTOR: (
            "learned cost of smoothness, better first guess, noise and bounds", _improved, IMPROVED, BETTER
        ),
    }  # fmt: skip
    named = {
        "baseline_0": "smooth only, ignores the partner (P2's aggressive baseline)",
        "baseline_1": "smooth, equally far from all links of the partner (P2's conservative baseline)",
        "authors_static": "mean of the weights that P2's authors learned, the tested reach among them",
    }
    for step_s, tail, how in ((None, "", ""), (STEP_S, "_replanned", ", re-planned every 0.1 s")):
        for name, (text, make, way, group) in learned.items():
            weights = partial(_left_out_weights, way)
            default = "; the default" if name == DEFAULT_PREDICTOR and step_s is None else ""
            yield name + tail, ReachingEntry(
                text + default + how, _planned(partial(make, step_s=step_s), weights), group, by_chance=True,
                replanned=step_s is not None, learns=way,
            )  # fmt: skip
        for name, text in named.items():
            yield name + tail, ReachingEntry(
                text + how, _planned(partial(planned_prediction, step_s=step_s), partial(_named_weights, name)),
                REPRODUCED, by_chance=True, replanned=step_s is not None,
            )  # fmt: skip


def _left_out_weights(way: str, material: ReachingMaterial, name: str) -> FloatArray:
    return material.weights[way].without(name)


def _named_weights(which: str, material: ReachingMaterial, name: str) -> FloatArray:
    return NAMED_WEIGHTS[which]


def _profile(profile: Callable[[FloatArray], FloatArray]) -> Callable[[ReachingMaterial], Without]:
    return lambda material: lambda name: TimedLine(profile)


REACHING_PREDICTORS: Mapping[str, ReachingEntry] = MappingProxyType(
    {
        "hold": ReachingEntry("stays in the first posture", _profile(np.zeros_like)),
        "line": ReachingEntry("straight line in posture space, constant speed", _profile(lambda phase: phase)),
        "cubic": ReachingEntry(
            "straight line, cubic timing", _profile(lambda phase: phase**2 * (3.0 - 2.0 * phase))
        ),
        "minimum_jerk": ReachingEntry("straight line, minimum-jerk timing", _profile(minimum_jerk)),
        "time_profile": ReachingEntry(
            "straight line, mean timing of the other recordings",
            lambda material: lambda name: mean_profile(material.without(name)), SIMPLE,
        ),
        "bow": ReachingEntry(
            "minimum jerk, bowed as the other recordings",
            lambda material: lambda name: learn_bow(material.without(name), material.model), SIMPLE,
        ),
        **dict(_planned_entries()),
    }
)  # fmt: skip


def reaching_entry(name: str) -> ReachingEntry:
    """Return the entry of that name (UsageError if there is none)."""
    if name not in REACHING_PREDICTORS:
        raise UsageError(f"predictors: wanted some of {', '.join(REACHING_PREDICTORS)}, got {name or 'none'}")
    return REACHING_PREDICTORS[name]
