"""Says when a reach resembles none that was learned: where the hand has been, no motion of the library has been.

The measure is a distance in space: from the palm now and its farthest point so far to those of the nearest postures of
the library, in the second nearest motion, because the nearest could be a mistracked one. What a distance means is
learned by pretending: each motion is compared with the library without itself, which makes it a known one, and
without its whole class, which makes it an unknown one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.geometry.compiled import exact, fast
from humanpred_ros.recognition.reach_features import FAR, REACHED, Float32Array

#: Palm now, and when it was farthest from its start.
COLUMNS = (0, 1, 2, FAR, FAR + 1, FAR + 2)
#: Below this, distances are the tracker's noise.
_NOISE_M = 0.005


@dataclass(frozen=True, eq=False)
class Novelty:
    """What was learned of distances to the library.

    Attributes:
        points: (M, 6) `COLUMNS` of the library's postures, motion by motion, metres.
        first: (K + 1,) where each motion's postures begin.
        weights: (4,) of the logarithm of how much more probable a distance is if the reach is of no class.
    """

    points: Float32Array
    first: NDArray[np.int64]
    weights: FloatArray
    _columns: Float32Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
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
    def fit(
        cls,
        features: Float32Array,
        first: NDArray[np.int64],
        label: NDArray[np.intp],
        distances: Float32Array | None = None,
    ) -> Novelty:
        """Learn from features (M, F) of K motions that begin at `first` (K + 1,), of the classes `label` (K,).

        `distances` are `motion_distances` of these, if they are known already.
        """
        points = np.ascontiguousarray(features[:, COLUMNS])
        nearest = motion_distances(features, first) if distances is None else distances
        asked = _asked(first)
        motion = np.repeat(np.arange(len(label)), np.diff(first))[asked]
        own = motion[:, None] == np.arange(len(label))
        own_class = label[motion][:, None] == label
        reached = features[asked, REACHED]
        known = _inputs(_second_smallest(nearest, own), reached)
        unknown = _inputs(_second_smallest(nearest, own_class), reached)
        return cls(points, first, _logistic_weights(known, unknown))


def motion_distances(features: Float32Array, first: NDArray[np.int64]) -> Float32Array:
    """Return (N, K) the distances of every other posture of each motion from each motion: what `Novelty.fit` needs.

    They take most of its time, and leaving a motion out only takes away its rows and its column.
    """
    points = np.ascontiguousarray(features[:, COLUMNS])
    return _nearest(points[_asked(first)], np.ascontiguousarray(points.T), first)


def distances_without(distances: Float32Array, first: NDArray[np.int64], k: int) -> Float32Array:
    """Return `motion_distances` without motion `k`, from those with it."""
    motion = np.repeat(np.arange(len(first) - 1), np.diff(first))[_asked(first)]
    kept: Float32Array = np.delete(distances[motion != k], k, axis=1)
    return kept


def _asked(first: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (M,) every other posture of each motion: four weights need no more."""
    number = np.arange(first[-1]) - np.repeat(first[:-1], np.diff(first))
    every_other: NDArray[np.bool_] = number % 2 == 0
    return every_other


def _logistic_weights(known: FloatArray, unknown: FloatArray) -> FloatArray:
    from sklearn.linear_model import LogisticRegression  # only training needs it

    x = np.vstack([known, unknown])
    y = np.repeat([0, 1], [len(known), len(unknown)])
    # As many of one kind as of the other, so the odds are the ratio of the densities.
    weights: FloatArray = LogisticRegression(C=1.0, fit_intercept=False).fit(x, y).coef_[0]
    return weights


@exact
def _inputs(distance_m: FloatArray, reached_m: Float32Array) -> FloatArray:
    """Return (N, 4) what the ratio is linear in: a distance means nothing before the reach has begun."""
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
