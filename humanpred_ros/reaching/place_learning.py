"""How much do people care about the parts of a reach's excess cost? Learned from reaches whose goals are known.

The weights are those under which the true goals are most probable among the others (a conditional logit, which is the
maximum-entropy model of choice), none negative, and pulled towards fixed prior weights, so that a handful of motions
is enough: the pull is a Gaussian prior as wide as the prior weights are large, and a motion counts once, however many
of its postures are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, unwrap_angles
from humanpred_ros.reaching.best_reaches import best_reach
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.excess_cost import N_PARTS, chosen_postures, excess_costs, reach_so_far
from humanpred_ros.reaching.place_model import PRIOR_WEIGHTS, GoalConfig, GoalModel
from humanpred_ros.reaching.places import GoalPlaces, ReachEnd, reach_ends, reaching_for, typical_end
from humanpred_ros.recognition.reach_features import N_START


@dataclass(frozen=True, eq=False)
class ReachLesson:
    """What there is to learn from one motion.

    Attributes:
        end: where it went.
        rows: (n, N_COLUMNS) of `features`, at evenly spaced postures.
        q: (T, D) all its postures, angles continuous.
    """

    end: ReachEnd
    rows: FloatArray
    q: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", frozen(self.rows))


def reach_lessons(library: MotionLibrary, human: HumanModel, config: GoalConfig) -> tuple[ReachLesson, ...]:
    """Return a lesson for each motion of a library, in its order.

    Raises:
        HumanModelError: a library of another human.
    """
    return tuple(
        ReachLesson(
            end,
            reach_so_far(motion, human)[chosen_postures(len(motion), config.n_postures)],
            unwrap_angles(motion).q,
        )
        for motion, end in zip(library, reach_ends(library, human), strict=True)
    )


def learn_goal_model(
    motions: Iterable[Motion],
    human: HumanModel,
    places: GoalPlaces | None = None,
    config: GoalConfig | None = None,
    ends: EndPostures | None = None,
) -> GoalModel:
    """Return the model that motions with known goals teach.

    Args:
        motions: reaches, with or without the way back; those without a label, or with one that has no place, are
            left out. Mistracked ones count: a tracker will go on losing arms.
        human: whose motions they are.
        places: of the labels; if None, where each class's motions go, the learned one not counted.
        config: settings.
        ends: in which posture reaches end; if None, learned from the same motions.

    Raises:
        HumanModelError: motions of another human.
        LibraryFormatError: two motions of the same name, or mixed DoFs.
    """
    config = config or GoalConfig()
    labelled = tuple(motion for motion in motions if motion.label is not None)
    if not labelled:
        return GoalModel.prior()
    lessons = reach_lessons(MotionLibrary("reaches", labelled), human, config)
    return fit_goal_model(lessons, human, config, places, ends)


def fit_goal_model(
    lessons: Sequence[ReachLesson],
    human: HumanModel,
    config: GoalConfig,
    places: GoalPlaces | None = None,
    ends: EndPostures | None = None,
    *,
    without: Collection[int] = (),
) -> GoalModel:
    """Return the model that lessons teach, the prior one where there is nothing to tell apart.

    Nothing is learned of the labels in `without`, nor from motions mislabelled that end there, nor are they
    alternatives; the rest as `learn_goal_model`.
    """
    strayed = reaching_for([lesson.end for lesson in lessons], without)
    taught = [lesson for lesson in lessons if lesson.end.label is not None and lesson.end.name not in strayed]
    known = _known_places([lesson.end for lesson in taught], places, without)
    if known is None:
        return GoalModel.prior()
    if ends is None:
        tracked = [lesson.q for lesson in taught if lesson.end.tracked] or [lesson.q for lesson in taught]
        ends = EndPostures.learn(tracked, human)
    choices = []
    for lesson in taught:
        label = lesson.end.label
        if label is None or label not in known.labels:
            continue
        seen = (
            known.with_goal(label, _true_place(lesson.end, [each.end for each in taught])) if places is None else known
        )
        choice = _choice(lesson, seen, human, ends, config)
        if choice is not None:
            choices.append(choice)
    if not choices:
        return GoalModel.prior()
    return GoalModel(_fit_weights(choices), len(choices), ends)


def _known_places(ends: Sequence[ReachEnd], places: GoalPlaces | None, without: Collection[int]) -> GoalPlaces | None:
    if places is None:
        return GoalPlaces.of_ends(ends) if ends else None
    left = [label for label in places.labels if label not in without]
    return GoalPlaces(tuple(left), np.array([places.place(label) for label in left])) if left else None


def _choice(
    lesson: ReachLesson, places: GoalPlaces, human: HumanModel, ends: EndPostures, config: GoalConfig
) -> FloatArray | None:
    """Return a motion's excess costs (n, G, N_PARTS) of places, the true one first; None if there is no other."""
    true = np.array(places.labels) == lesson.end.label
    apart = np.linalg.norm(places.places_m - places.places_m[true], axis=1) >= config.apart_m
    if not apart.any():
        return None
    alternatives = np.vstack([places.places_m[true], places.places_m[apart]])
    start_q = np.median(lesson.q[:N_START], axis=0)
    best = [best_reach(human, ends, start_q, place) for place in alternatives]
    return excess_costs(lesson.rows, alternatives, best)


def _true_place(end: ReachEnd, ends: Sequence[ReachEnd]) -> FloatArray:
    """Return a motion's goal (3,) as the others of its class show it; its own end would make it too easy."""
    others = [other for other in ends if other.label == end.label and other.name != end.name]
    return typical_end(others or [end])


def _fit_weights(choices: Sequence[FloatArray]) -> FloatArray:
    """Return the most probable weights (N_PARTS,) of choices (n, G, N_PARTS) of excess costs, the chosen place first.

    By number of places, so that each number is one array product.
    """
    by_size: dict[int, list[FloatArray]] = {}
    for costs in choices:
        # Only what the others cost more than the true one counts.
        more = costs[:, 1:] - costs[:, :1]
        by_size.setdefault(more.shape[1], []).append(more)
    groups = [
        (np.concatenate(group), np.concatenate([np.full(len(more), 1.0 / len(more)) for more in group]))
        for group in by_size.values()
    ]

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        pull = (weights - PRIOR_WEIGHTS) / PRIOR_WEIGHTS
        total, gradient = 0.5 * float(pull @ pull), pull / PRIOR_WEIGHTS
        for more, share in groups:
            # -ln P(true) = ln(1 + sum exp(-more)); costs are bounded, so nothing overflows.
            others = np.exp(-(more @ weights))
            whole = 1.0 + others.sum(axis=1)
            total += float(share @ np.log(whole))
            gradient = gradient - np.einsum("n,ng,ngk->k", share / whole, others, more)
        return total, gradient

    return _minimised(loss, PRIOR_WEIGHTS, [(0.0, None)] * N_PARTS)


def _minimised(
    loss: Callable[[FloatArray], tuple[float, FloatArray]],
    start: FloatArray,
    bounds: list[tuple[float | None, float | None]],
) -> FloatArray:
    from scipy.optimize import minimize  # only learning needs it

    found: NDArray[np.float64] = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x
    return found
