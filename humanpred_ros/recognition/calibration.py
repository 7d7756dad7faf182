"""Turns votes into probabilities: of the times a class gets 80 %, it shall be right in 80 %.

Trees that vote on motions they have not seen are too sure before the hand has moved, when the differences they see
are chance, and too cautious once it has gone half way, when many weak votes agree. So the votes are raised to a
power that depends on how far the palm has been from its start; and a constant share is kept for what no vote
foresees, a mistracked motion above all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.compiled import exact

#: Added to every vote: none is so surely wrong that a logarithm should make it impossible.
_LEAST_VOTE = 1e-3
#: Pulls the parameters towards no change at all, for libraries that hardly say anything.
_RIDGE = 1e-3
N_PARAMETERS = 5


@dataclass(frozen=True, eq=False)
class Calibration:
    """How votes become probabilities.

    Attributes:
        parameters: (5,) four of the logarithm of the power: a constant, half a metre's share of the reach, its
            square, and whether it has hardly begun; the last of the constant share (logit).
    """

    parameters: FloatArray

    def __post_init__(self) -> None:
        parameters = checked("calibration", self.parameters, (N_PARAMETERS,))
        object.__setattr__(self, "parameters", frozen(parameters))

    def __call__(self, votes: FloatArray, reached_m: FloatArray) -> FloatArray:
        """Return probabilities (M, C) for votes (M, C) and how far the palm has been from its start (M,)."""
        return _calibrated(self.parameters, votes, reached_m)

    @classmethod
    def fit(cls, votes: FloatArray, reached_m: FloatArray, label: NDArray[np.intp]) -> Calibration:
        """Return the calibration under which the true classes (M,) are most probable.

        Args:
            votes: (M, C) of trees that had not seen these motions.
            reached_m: (M,) how far the palm had been from its start.
            label: (M,) numbers of the true classes.
        """
        from scipy.optimize import minimize  # only training needs it

        rows = np.arange(len(votes))

        def loss(parameters: FloatArray) -> float:
            true = _calibrated(parameters, votes, reached_m)[rows, label]
            return float(-np.log(true).mean() + _RIDGE * (parameters[:-1] ** 2).sum())

        start = np.array([0.0, 0.0, 0.0, 0.0, -3.0])
        return cls(minimize(loss, start, method="BFGS", options={"maxiter": 40}).x)


@exact
def _calibrated(parameters: FloatArray, votes: FloatArray, reached_m: FloatArray) -> FloatArray:
    n, n_classes = votes.shape
    p = np.empty((n, n_classes))
    constant = 1.0 / (1.0 + np.exp(-min(max(parameters[4], -20.0), 20.0)))
    for m in range(n):
        u = min(reached_m[m] / 0.5, 1.5)
        log_power = parameters[0] + parameters[1] * u + parameters[2] * u * u + parameters[3] * np.exp(-u / 0.1)
        power = np.exp(min(max(log_power, -4.0), 3.0))
        most = 0.0
        for c in range(n_classes):
            p[m, c] = np.log(votes[m, c] + _LEAST_VOTE)
            most = p[m, c] if c == 0 else max(most, p[m, c])
        total = 0.0
        for c in range(n_classes):
            p[m, c] = np.exp(power * (p[m, c] - most))
            total += p[m, c]
        for c in range(n_classes):
            p[m, c] = (1.0 - constant) * p[m, c] / total + constant / n_classes
    return p
