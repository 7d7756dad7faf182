"""Where the points of a resting body are and how they scatter there, learned frame by frame while the body rests.

What a depth camera gets wrong has directions: the twist of a nearly straight arm, say, is hardly known, so that the
palm wanders across the forearm and not along it. Distances from rest are therefore measured in standard deviations of
what this person showed at rest before this sensor (Mahalanobis), with a floor for each coordinate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact

#: Frames closer than this say much the same: a camera's errors last for two or three of its frames.
CORRELATED_S = 0.1
#: Deviations beyond so many times the median one count as that, where all frames are looked at together.
_BAD = 6.0


@dataclass(frozen=True)
class RestConfig:
    """How rest is learned; chosen with `OnsetConfig`.

    Attributes:
        floor_m: standard deviation of each coordinate that comes on top of what is learned.
        turn_rad: a body at rest sways, and turns as a whole about the vertical, by this standard deviation.
        noise_s: time constant of learning the scatter.
        settled_s: where a body settles, what was learned elsewhere counts as so many seconds of the new rest.
        drift_s: time constant with which the place follows; at first it is the mean of all frames.
        trusted: a frame farther away than this counts less, by the square of how much farther it is.
    """

    floor_m: float = 0.0035
    turn_rad: float = 0.01
    noise_s: float = 30.0
    settled_s: float = 1.0
    drift_s: float = 0.5
    trusted: float = 2.0

    def __post_init__(self) -> None:
        check_positive("rest", self)


class RestModel:
    """Running mean and covariance of the coordinates of points, both robust: what lies far off counts little.

    One update takes a few microseconds.

    Attributes:
        config: the settings.
        place: (K,) where the coordinates (x y z of each point, metres) rest.
        covariance: (K, K) of their scatter, as learned.
        rested_s: how much of the present rest the place is known from.
    """

    def __init__(self, scatter_m: FloatArray, config: RestConfig | None = None) -> None:
        """Make a model that knows nothing but the usual standard deviations (K,), K a multiple of 3."""
        self.config = RestConfig() if config is None else config
        self.covariance = np.diag(np.asarray(scatter_m, dtype=np.float64) ** 2)
        self.place = np.zeros(len(self.covariance))
        self.rested_s = 0.0

    def settle(self, x: FloatArray, rested_s: float) -> None:
        """Say that the body has come to rest, and was at (n, K) for the last `rested_s` seconds."""
        self.place = np.median(x, axis=0)
        self.rested_s = rested_s
        deviation = x - self.place
        # A frame that the tracker got wrong counts no more than a bad one.
        usual = np.maximum(np.median(np.abs(deviation), axis=0), self.config.floor_m)
        deviation = np.clip(deviation, -_BAD * usual, _BAD * usual)
        new = rested_s / (rested_s + self.config.settled_s)
        self.covariance += new * (deviation.T @ deviation / len(x) - self.covariance)

    def distance(self, x: FloatArray) -> float:
        """Return how far coordinates (K,) are from rest, in standard deviations (root mean square over K).

        A place known from a short rest only is itself uncertain, which makes all distances less.
        """
        config = self.config
        known = self.rested_s / (self.rested_s + CORRELATED_S)
        return math.sqrt(known * _squared(x, self.place, self.covariance, config.floor_m, config.turn_rad))

    def learn(self, x: FloatArray, distance: float, step_s: float) -> None:
        """Take coordinates (K,), at their `distance`, as those of a resting body for `step_s` seconds."""
        if step_s <= 0 or not math.isfinite(distance):
            return
        config = self.config
        weight = 1.0 if distance <= config.trusted else (config.trusted / distance) ** 2
        # The place of settling counts as one frame.
        follow = weight * min(1.0, step_s / (min(config.drift_s, self.rested_s + step_s) + step_s))
        self.rested_s += step_s
        _learn(x, self.place, self.covariance, follow, weight, min(1.0, step_s / config.noise_s))


def check_positive(what: str, config: Any, skip: Sequence[str] = ()) -> None:
    """Check that all numbers of a dataclass are finite and above 0; raises UsageError."""
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name not in skip and not (np.isfinite(value).all() and np.min(value) > 0):
            raise UsageError(f"{what}: wanted {field.name} finite and above 0, got {value}")


@exact
def _squared(x: FloatArray, place: FloatArray, covariance: FloatArray, floor: float, turn: float) -> float:
    """Return the mean squared distance over the coordinates, by a Cholesky factor L of the covariance.

    To what was learned come the floor and a turn of all points, x y z after each other, about the vertical axis.
    """
    n = len(x)
    moved = np.zeros(n)
    for i in range(0, n, 3):
        moved[i], moved[i + 1] = -turn * place[i + 1], turn * place[i]
    L = np.zeros((n, n))
    total = 0.0
    y = np.zeros(n)
    for i in range(n):
        for j in range(i + 1):
            s = covariance[i, j] + moved[i] * moved[j]
            if i == j:
                s += floor * floor
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
        s = x[i] - place[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s / L[i, i]
        total += y[i] * y[i]
    return total / n


@exact
def _learn(
    x: FloatArray, place: FloatArray, covariance: FloatArray, follow: float, weight: float, learn: float
) -> None:
    n = len(x)
    for i in range(n):
        for j in range(n):
            square = weight * (x[i] - place[i]) * (x[j] - place[j])
            covariance[i, j] += learn * (square - covariance[i, j])
    for i in range(n):
        place[i] += follow * (x[i] - place[i])
