"""What goal inference has learned, as one small immutable object, and what it concludes from a reach so far.

P(goal | reach so far) is the prior times exp(-weighted excess cost), normalised: people are taken to make a detour the
more rarely the longer it is, which is the maximum-entropy distribution of P2's learning (P2 eq. 3, there over whole
trajectories). That none of the places is the goal shows in others, nobody told of (`untold`), being better goals: the
odds of that are the prior ones times the ratio of the mean likelihoods, and nothing about it needs learning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.excess_cost import N_PARTS, excess_costs
from humanpred_ros.reaching.unlisted_places import UntoldPlaces

#: Of the weights before anything is learned, in the order of `PARTS`: a decimetre makes a goal e times less probable,
#: and so does pointing 60 degrees elsewhere.
PRIOR_WEIGHTS = np.array([10.0, 10.0, 10.0, 2.0, 2.0, 10.0, 10.0])
#: Never quite sure that it is none of the places, nor that it is one of them, so that all shares stay defined.
_MOST_LOG_ODDS = 20.0


@dataclass(frozen=True)
class GoalConfig:
    """How goals are learned and inferred.

    Attributes:
        unknown_prior: how often a reach goes to none of the places, before anything is seen. A judgement, not learned,
            and the same as the reach forest's.
        n_postures: postures of each motion that are learned from, evenly spaced.
        apart_m: places nearer to each other than this are not told apart: people are no more exact. Neither in
            learning nor as one that was told and one that was not.
    """

    unknown_prior: float = 0.2
    n_postures: int = 20
    apart_m: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.unknown_prior < 1:
            raise UsageError(f"goals: wanted unknown_prior between 0 and 1, got {self.unknown_prior}")
        if self.n_postures < 2:
            raise UsageError(f"goals: wanted n_postures of at least 2, got {self.n_postures}")
        if not 0 <= self.apart_m < np.inf:
            raise UsageError(f"goals: wanted apart_m finite and not negative, got {self.apart_m}")


@dataclass(frozen=True, eq=False)
class GoalModel:
    """How much the parts of the excess cost count.

    Attributes:
        weights: (N_PARTS,) not negative, of `PARTS`: 1/m, but the headings', which have no unit.
        n_motions: how many motions were learned from; 0 if the weights are the prior ones.
        ends: in which posture reaches end, which makes best reaches of the whole body known; None if unknown.

    Raises:
        ArrayError: wrong shape, not finite, or of the wrong sign.
    """

    weights: FloatArray
    n_motions: int = 0
    ends: EndPostures | None = None

    def __post_init__(self) -> None:
        weights = checked("goal weights", self.weights, (N_PARTS,))
        if (weights < 0).any():
            raise ArrayError(f"goal weights: wanted none negative, got {weights}; excess costs cannot be gains")
        object.__setattr__(self, "weights", frozen(weights))

    @classmethod
    def prior(cls) -> GoalModel:
        """Return the model before anything is learned; usable, and not far from what libraries teach."""
        return cls(PRIOR_WEIGHTS)

    def log_likelihood(
        self, rows: FloatArray, places_m: FloatArray, best: Sequence[FloatArray] | None = None
    ) -> FloatArray:
        """Return (N, G) ln P(reach so far | place), up to a constant; arguments as those of `excess_costs`."""
        log_likelihood: FloatArray = -(excess_costs(rows, places_m, best) @ self.weights)
        return log_likelihood

    @cached_property
    def untold(self) -> UntoldPlaces | None:
        """Where hands go that nobody told of; None if it is not known where they go at all."""
        return None if self.ends is None else UntoldPlaces.around_ends(self.ends)


def unknown_probability(told: FloatArray, untold: FloatArray, prior: float) -> float:
    """Return P(none of the told places | reach so far).

    Args:
        told: (G,) ln of P(place) P(reach so far | place) of the places told, given that it is one of them.
        untold: (M,) the same of places that stand for all others, given that it is one of those; may be none.
        prior: probability that it is none of the told ones, before anything was seen.
    """
    log_odds = -_MOST_LOG_ODDS
    if len(untold):
        log_odds = float(np.log(prior / (1.0 - prior)) + np.logaddexp.reduce(untold) - np.logaddexp.reduce(told))
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS))))
