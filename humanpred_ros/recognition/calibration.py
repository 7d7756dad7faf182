"""Turns a forest's votes, and distances from the library, into the probabilities of the classes and of no class.

**Calibration.** A probability of 80 % is calibrated if it is right in 80 % of the cases. Trees that vote on motions
they have not seen are too sure before the hand has moved, because the differences they see then are chance. They are
too cautious once the hand has gone half way, where many weak votes agree. So the votes are raised to a power that
depends on how far the palm has been from its start. A constant share is kept for what no vote foresees, mostly
mistracked motions.

**Novelty.** A reach is of no class if the hand has been where no motion of the library has been. The measure is a
distance in space: from the palm now, and from its farthest point so far, to those of the nearest postures of the
library. The second nearest motion counts, because the nearest one may be mistracked. What a distance means is learned
from the library: each motion is compared with the library without itself, as an example of a known class, and without
its whole class, as an example of no class.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.compiled import exact, fast
from humanpred_ros.recognition.reach_features import FAR, REACHED, Float32Array

#: Added to every vote before its logarithm is taken: no class is ruled out for certain.
_LEAST_VOTE = 1e-3
#: Pulls the parameters towards no change at all, for libraries that hardly say anything.
_RIDGE = 1e-3
N_PARAMETERS = 5
#: Palm now, and when it was farthest from its start.
COLUMNS = (0, 1, 2, FAR, FAR + 1, FAR + 2)
#: Below this, distances are the tracker's noise.
_NOISE_M = 0.005


@dataclass(frozen=True, eq=False)
class Calibration:
    """Turns votes into probabilities."""

    #: (5,) The first four give the logarithm of the power: weights of a constant, of the reach so far in half metres,
    #: of its square, and of a term that is 1 at the start and soon fades. The last is the logit of the constant share.
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


@dataclass(frozen=True, eq=False)
class Novelty:
    """Turns distances from the library into odds of no class."""

    points: Float32Array  #: (M, 6) `COLUMNS` of the library's postures, motion by motion, metres
    first: NDArray[np.int64]  #: (K + 1,) where each motion's postures begin
    weights: FloatArray  #: (4,) give ln p(distance | of no class) / p(distance | of some class) from `_inputs`
    _columns: Float32Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", checked("novelty weights", self.weights, (4,)))
        for name in ("points", "first", "weights"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "_columns", np.ascontiguousarray(self.points.T))

    def distance_m(self, features: Float32Array) -> FloatArray:
        """Return (N,) the distance of features (N, F) from the second nearest motion."""
        nearest = _nearest(np.ascontiguousarray(features[:, COLUMNS]), self._columns, self.first)
        return _second_smallest(nearest, np.zeros(nearest.shape, dtype=np.bool_))

    def log_ratio(self, features: Float32Array) -> FloatArray:
        """Return (N,) ln p(distance | of no class) / p(distance | of some class) for features (N, F)."""
        ratio: FloatArray = _inputs(self.distance_m(features), features[:, REACHED]) @ self.weights
        return ratio

    @classmethod
    def fit(cls, features: Float32Array, first: NDArray[np.int64], label: NDArray[np.intp]) -> Novelty:
        """Learn from features (M, F) of K motions that begin at `first` (K + 1,), of the classes `label` (K,)."""
        points = np.ascontiguousarray(features[:, COLUMNS])
        # Every other posture of each motion: four weights need no more.
        number = np.arange(first[-1]) - np.repeat(first[:-1], np.diff(first))
        asked = number % 2 == 0
        nearest = _nearest(points[asked], np.ascontiguousarray(points.T), first)
        motion = np.repeat(np.arange(len(label)), np.diff(first))[asked]
        own = motion[:, None] == np.arange(len(label))
        own_class = label[motion][:, None] == label
        reached = features[asked, REACHED]
        known = _inputs(_second_smallest(nearest, own), reached)
        unknown = _inputs(_second_smallest(nearest, own_class), reached)
        return cls(points, first, _logistic_weights(known, unknown))


def _logistic_weights(known: FloatArray, unknown: FloatArray) -> FloatArray:
    from sklearn.linear_model import LogisticRegression  # only training needs it

    x = np.vstack([known, unknown])
    y = np.repeat([0, 1], [len(known), len(unknown)])
    # As many of one kind as of the other, so the odds are the ratio of the densities.
    weights: FloatArray = LogisticRegression(C=1.0, fit_intercept=False).fit(x, y).coef_[0]
    return weights


@exact
def _inputs(distance_m: FloatArray, reached_m: Float32Array) -> FloatArray:
    """Return (N, 4) the inputs that the log ratio is linear in; the reach so far is among them."""
    inputs = np.empty((len(distance_m), 4))
    for n in range(len(distance_m)):
        log_distance = np.log((distance_m[n] + _NOISE_M) / 0.05)
        u = min(reached_m[n] / 0.5, 1.0)
        inputs[n, 0], inputs[n, 1], inputs[n, 2], inputs[n, 3] = 1.0, u, log_distance, u * log_distance
    return inputs


@exact
def _second_smallest(nearest: Float32Array, left_out: NDArray[np.bool_]) -> FloatArray:
    """Return the second smallest distance per row among motions not left out; the smallest if there is but one."""
    out = np.empty(len(nearest))
    for n in range(len(nearest)):
        least = second = np.inf
        for k in range(nearest.shape[1]):
            if left_out[n, k]:
                continue
            if nearest[n, k] < least:
                least, second = nearest[n, k], least
            elif nearest[n, k] < second:
                second = nearest[n, k]
        out[n] = second if second < np.inf else least
    return out


@fast
def _nearest(x: Float32Array, columns: Float32Array, first: NDArray[np.int64]) -> Float32Array:
    """Return (N, K) the distance of each x (N, 6) from the nearest of each motion's postures (6, M), per point."""
    out = np.empty((len(x), len(first) - 1), dtype=np.float32)
    for n in range(len(x)):
        for k in range(len(first) - 1):
            least = np.float32(1e30)
            for m in range(first[k], first[k + 1]):
                a, b, c = x[n, 0] - columns[0, m], x[n, 1] - columns[1, m], x[n, 2] - columns[2, m]
                d, e, f = x[n, 3] - columns[3, m], x[n, 4] - columns[4, m], x[n, 5] - columns[5, m]
                least = min(least, a * a + b * b + c * c + d * d + e * e + f * f)
            out[n, k] = np.sqrt(least * np.float32(0.5))
    return out
