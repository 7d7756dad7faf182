"""What goal inference has learned, as one small immutable object, and what it concludes from a reach so far.

P(goal | reach so far) is the prior times exp(-weighted excess cost), normalised: people are taken to make a detour the
more rarely the longer it is, which is the maximum-entropy distribution of P2's learning (P2 eq. 3, there over whole
trajectories). That none of the places is the goal shows in all of them costing more than people ever waste.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.checks import FloatArray, checked, frozen
from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.reaching.futures.end_postures import EndPostures
from humanpred_ros.reaching.goals.features import N_PARTS, REACHED_M, excess_costs

#: Of the weights before anything is learned, in the order of `PARTS`: a decimetre makes a goal e times less probable,
#: and so does pointing 60 degrees elsewhere.
PRIOR_WEIGHTS = np.array([10.0, 10.0, 10.0, 2.0, 2.0, 10.0, 10.0])
#: And of ln(odds of no goal) once the hand has gone half a metre: a constant, and per root of the excess of all goals.
PRIOR_UNKNOWN = np.array([-7.0, 3.0])
#: At this distance from its start a hand has shown all it can of whether it goes to no place.
_SHOWN_M = 0.5


@dataclass(frozen=True)
class GoalConfig:
    """How goals are learned and inferred.

    Attributes:
        unknown_prior: how often a reach goes to none of the places, before anything is seen. A judgement, not learned,
            and the same as the reach forest's.
        n_postures: postures of each motion that are learned from, evenly spaced.
        apart_m: places nearer to each other than this are not told apart when learning: people are no more exact.
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
        unknown: (2,) of ln(odds of no goal), see `PRIOR_UNKNOWN`; the first not positive, the second not negative.
        n_motions: how many motions were learned from; 0 if the weights are the prior ones.
        ends: in which posture reaches end, which makes best reaches of the whole body known; None if unknown.

    Raises:
        ArrayError: wrong shape, not finite, or of the wrong sign.
    """

    weights: FloatArray
    unknown: FloatArray
    n_motions: int = 0
    ends: EndPostures | None = None

    def __post_init__(self) -> None:
        weights = checked("goal weights", self.weights, (N_PARTS,))
        unknown = checked("weights of no goal", self.unknown, (2,))
        if (weights < 0).any():
            raise ArrayError(f"goal weights: wanted none negative, got {weights}; excess costs cannot be gains")
        if unknown[0] > 0 or unknown[1] < 0:
            raise ArrayError(f"weights of no goal: wanted one not positive and one not negative, got {unknown}")
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "unknown", frozen(unknown))

    @classmethod
    def prior(cls) -> GoalModel:
        """Return the model before anything is learned; usable, and not far from what libraries teach."""
        return cls(PRIOR_WEIGHTS, PRIOR_UNKNOWN)

    def log_likelihood(
        self, rows: FloatArray, places_m: FloatArray, best: Sequence[FloatArray] | None = None
    ) -> FloatArray:
        """Return (N, G) ln P(reach so far | place), up to a constant; arguments as those of `excess_costs`."""
        log_likelihood: FloatArray = -(excess_costs(rows, places_m, best) @ self.weights)
        return log_likelihood

    def unknown_log_odds(self, log_likelihood: FloatArray, reached_m: FloatArray) -> FloatArray:
        """Return (N,) by how much the reaches speak for no goal: ln P(reach | none) / P(reach | one of the places).

        Args:
            log_likelihood: (N, G) of the places, equally probable beforehand.
            reached_m: (N,) how far the hand has been from its start.
        """
        odds: FloatArray = unknown_inputs(log_likelihood, reached_m) @ self.unknown
        return odds

    def posterior(
        self, row: FloatArray, places_m: FloatArray, unknown_prior: float, best: Sequence[FloatArray] | None = None
    ) -> tuple[FloatArray, float]:
        """Return ln P(reach so far | place) (G,) and P(none of the places | reach so far) for one row (N_COLUMNS,)."""
        log_likelihood = self.log_likelihood(row[None], places_m, best)
        log_odds = float(self.unknown_log_odds(log_likelihood, row[None, REACHED_M])[0])
        log_odds += float(np.log(unknown_prior / (1.0 - unknown_prior)))
        # Never quite sure of it, so that the goals' shares stay defined.
        return log_likelihood[0], float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -20.0, 20.0))))


def unknown_inputs(log_likelihood: FloatArray, reached_m: FloatArray) -> FloatArray:
    """Return (N, 2) what the odds of no goal are linear in: both 0 until the hand moves, when nothing can be said."""
    best = log_likelihood.max(axis=1)
    mean = best + np.log(np.exp(log_likelihood - best[:, None]).mean(axis=1))
    shown = np.minimum(reached_m / _SHOWN_M, 1.0)
    inputs: FloatArray = np.column_stack([shown, shown * np.sqrt(np.maximum(-mean, 0.0))])
    return inputs
