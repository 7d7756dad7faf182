"""How to tell for which place a person reaches: weights of the parts of the excess cost, and how they are learned.

P(place | reach so far) is the prior times exp(-weighted excess cost), normalised: people make a detour the more rarely
the longer it is, which is the maximum-entropy distribution of P2's learning (P2 eq. 3, there over whole trajectories).
A reach to none of the places shows in unlisted places (`unlisted_places`) being better ones: the odds are the prior
odds times the ratio of the mean likelihoods, and need no learning.

The weights are learned from reaches whose places are known, as those under which the true places are most probable
among the others (a conditional logit, the maximum-entropy model of choice). None is negative, and all are pulled
towards fixed prior weights, so that a handful of motions is enough: the pull is a Gaussian prior as wide as the prior
weights are large, and a motion counts once, however many of its postures are looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, unwrap_angles
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.excess_cost import N_PARTS, best_reach, chosen_postures, excess_costs, reach_so_far
from humanpred_ros.reaching.places import Places, ReachEnd, UnlistedPlaces, reach_ends, reaching_for, typical_end
from humanpred_ros.recognition.reach_features import N_START
from humanpred_ros.settings import Settings, setting

#: Weights before anything is learned, in the order of `PARTS`: a decimetre makes a place e times less probable, and so
#: does pointing 60 degrees elsewhere.
PRIOR_WEIGHTS = np.array([10.0, 10.0, 10.0, 2.0, 2.0, 10.0, 10.0])
#: The log odds of "none of the places" are limited, so that all shares stay positive.
_MOST_LOG_ODDS = 20.0


class PlaceSettings(Settings):
    """How places are learned and inferred."""

    unknown_prior: float = setting(
        0.2,
        "Probability, before anything is seen, that a reach goes to none of the places; a judgement, not learned",
        low=1e-6,
        high=1.0 - 1e-6,
    )
    n_postures: int = setting(20, "Postures of each motion that are learned from, evenly spaced", low=2)
    apart_m: float = setting(
        0.1, "Places nearer to each other than this are not told apart: people are no more exact", unit="m", low=0.0
    )


@dataclass(frozen=True, eq=False)
class PlaceModel:
    """How much the parts of the excess cost count.

    Raises:
        ArrayError: wrong shape, not finite, or of the wrong sign.
    """

    weights: FloatArray  #: (N_PARTS,) not negative, of `PARTS`: 1/m, but no unit for the headings
    n_motions: int = 0  #: how many motions were learned from; 0 if the weights are the prior ones
    #: in which posture reaches end, from which best reaches of the whole body follow; None if unknown
    ends: EndPostures | None = None

    def __post_init__(self) -> None:
        weights = checked("place weights", self.weights, (N_PARTS,))
        if (weights < 0).any():
            raise ArrayError(f"place weights: wanted none negative, got {weights}; excess costs cannot be gains")
        object.__setattr__(self, "weights", frozen(weights))

    @classmethod
    def prior(cls) -> PlaceModel:
        """Return the model before anything is learned; usable, and not far from what libraries teach."""
        return cls(PRIOR_WEIGHTS)

    def log_likelihood(
        self, rows: FloatArray, places_m: FloatArray, best: Sequence[FloatArray] | None = None
    ) -> FloatArray:
        """Return (N, G) ln P(reach so far | place), up to a constant; arguments as those of `excess_costs`."""
        log_likelihood: FloatArray = -(excess_costs(rows, places_m, best) @ self.weights)
        return log_likelihood

    @cached_property
    def unlisted(self) -> UnlistedPlaces | None:
        """Where hands go besides the listed places; None if it is not known where they go at all."""
        return None if self.ends is None else UnlistedPlaces.around_ends(self.ends)


def unknown_probability(listed: FloatArray, unlisted: FloatArray, prior: float) -> float:
    """Return P(none of the listed places | reach so far).

    Args:
        listed: (G,) ln of P(place) P(reach so far | place) of the listed places, given that it is one of them.
        unlisted: (M,) the same of the unlisted places, given that it is one of those; may be none.
        prior: probability that it is none of the listed ones, before anything was seen.
    """
    log_odds = -_MOST_LOG_ODDS
    if len(unlisted):
        log_odds = float(np.log(prior / (1.0 - prior)) + np.logaddexp.reduce(unlisted) - np.logaddexp.reduce(listed))
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS))))


@dataclass(frozen=True, eq=False)
class ReachLesson:
    """What there is to learn from one motion."""

    end: ReachEnd  #: where it went
    rows: FloatArray  #: (n, N_COLUMNS) of `excess_cost`, at evenly spaced postures
    q: FloatArray  #: (T, D) all its postures, angles continuous


def reach_lessons(library: MotionLibrary, human: HumanModel, settings: PlaceSettings) -> tuple[ReachLesson, ...]:
    """Return a lesson for each motion of a library, in its order.

    Raises:
        HumanModelError: a library of another human.
    """
    return tuple(
        ReachLesson(
            end,
            reach_so_far(motion, human)[chosen_postures(len(motion), settings.n_postures)],
            unwrap_angles(motion).q,
        )
        for motion, end in zip(library, reach_ends(library, human), strict=True)
    )


def fit_place_model(
    lessons: Sequence[ReachLesson], human: HumanModel, settings: PlaceSettings, without: Collection[str] = ()
) -> PlaceModel:
    """Return the model that follows from lessons; the prior one where there is nothing to tell apart.

    Nothing is learned of the labels in `without`, nor from motions mislabelled that end there, nor are they
    alternatives. Motions without a label are left out. Mistracked ones count: the tracker will lose arms in use, too.
    """
    strayed = reaching_for([lesson.end for lesson in lessons], without)
    used = [lesson for lesson in lessons if lesson.end.label is not None and lesson.end.name not in strayed]
    if not used:
        return PlaceModel.prior()
    own_ends = [lesson.end for lesson in used]
    known = Places.of_ends(own_ends).by_label
    tracked = [lesson.q for lesson in used if lesson.end.tracked] or [lesson.q for lesson in used]
    ends = EndPostures.learn(tracked, human)
    choices = []
    for lesson in used:
        # A motion's own end would make its place too easy to find.
        others = [o for o in own_ends if o.label == lesson.end.label and o.name != lesson.end.name]
        true_m = typical_end(others or [lesson.end])
        alternatives = np.array([place for label, place in known.items() if label != lesson.end.label]).reshape(-1, 3)
        apart = np.linalg.norm(alternatives - true_m, axis=1) >= settings.apart_m
        if apart.any():
            offered = np.vstack([true_m, alternatives[apart]])
            start_q = np.median(lesson.q[:N_START], axis=0)
            best = [best_reach(human, ends, start_q, place) for place in offered]
            choices.append(excess_costs(lesson.rows, offered, best))
    if not choices:
        return PlaceModel.prior()
    return PlaceModel(_fit_weights(choices), len(choices), ends)


def _fit_weights(choices: Sequence[FloatArray]) -> FloatArray:
    """Return the most probable weights (N_PARTS,) of choices (n, G, N_PARTS) of excess costs, the chosen place first.

    Choices among equally many places are put into one array, so that each number is one product.
    """
    from scipy.optimize import minimize  # only learning needs it

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

    bounds = [(0.0, None)] * N_PARTS
    found: NDArray[np.float64] = minimize(loss, PRIOR_WEIGHTS, jac=True, method="L-BFGS-B", bounds=bounds).x
    return found
