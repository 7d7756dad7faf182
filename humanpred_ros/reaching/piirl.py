"""Learns the weights under which demonstrations cost less than what the person did not do (P2 III-C).

Path-integral inverse reinforcement learning. With features phi of demonstration d and of its samples k, and weights w,

    paper:  L(w) = sum over d of log sum over k of exp(-w . (phi_dk - phi_d))
    coded:  L(w) = sum over d and k of exp(-w . (phi_dk - phi_d))        (the authors' code; docs/papers.md (2.5))

Both are convex in w. Neither has the demonstration itself in the sum, so on data that weights can separate both fall
without end: w is bounded, 0 <= w <= `upper`. For the second the logarithm is minimised, which has the same minimiser
and does not overflow.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from humanpred_ros.errors import MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.collisions import ReachCollisions, Touch
from humanpred_ros.reaching.demonstrations import Demonstration, SamplingSettings, sample_around
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, ReachFeatures
from humanpred_ros.reaching.learning_kernels import log_sums
from humanpred_ros.settings import Settings, setting

#: A weight this close to its bound (relative to `upper`) is reported to be there.
_AT_BOUND = 1e-6
#: Demonstrations whose samples are drawn at the same time, with some 100 MB each.
_THREADS = 4


class PiirlSettings(Settings):
    """How weights are learned."""

    loss: Literal["paper", "coded"] = setting("paper", "The paper's loss, or that of the authors' code")
    with_demonstration: bool = setting(
        False, "Count the demonstration among what could have been done, as a likelihood would (docs/papers.md (2.3))"
    )
    normalised: bool = setting(
        False,
        "Divide each feature by its standard deviation over the samples before learning, so that bound and penalties "
        "mean the same for all; the weights returned are for the features as they are",
    )
    # Without a finite bound the losses fall without end where weights separate the data.
    upper: float = setting(300.0, "Upper bound of the weights, of normalised features if so", low=1e-12)
    l1: float = setting(0.0, "Penalty l1 sum(w) for each demonstration", low=0.0)
    l2: float = setting(0.0, "Penalty l2 sum(w^2) / 2 for each demonstration", low=0.0)
    without: tuple[str, ...] = setting((), "Names of features whose weights are kept at 0")

    def check(self) -> None:
        if unknown := sorted(set(self.without) - set(FEATURE_NAMES)):
            raise SettingsError(f"learning: wanted names of features in `without`, got {', '.join(unknown)}")


@dataclass(frozen=True, eq=False)
class Contrast:
    """A demonstration and what it is distinguished from.

    Attributes:
        demonstration: its name.
        recording: the recording it is from.
        differences: (K, 24) features of its samples minus its own.
        discarded: how many more samples were drawn that collided.
        touches: where the demonstration itself is inside something, the deepest first.
    """

    demonstration: str
    recording: str
    differences: FloatArray
    discarded: int = 0
    touches: tuple[Touch, ...] = ()


@dataclass(frozen=True, eq=False)
class PiirlSolution:
    """Learned weights.

    Attributes:
        weights: (24,) for the features of `ReachFeatures`.
        loss: at the weights.
        at_upper: (24,) true where a weight was stopped by its upper bound.
    """

    weights: FloatArray
    loss: float
    at_upper: np.ndarray[tuple[int], np.dtype[np.bool_]]


def contrasts(
    demos: Sequence[Demonstration],
    features: ReachFeatures,
    sampling: SamplingSettings,
    rng: np.random.Generator,
    collisions: ReachCollisions | None = None,
) -> tuple[Contrast, ...]:
    """Return the features of samples around every demonstration; nothing learned changes them, so draw them once.

    Each demonstration draws from a generator of its own, so that neither threads nor other demonstrations change it.

    Args:
        demos: what was done.
        features: of the human.
        sampling: how demonstrations are varied.
        rng: source of all randomness.
        collisions: finds samples that collide; None to keep all.

    Raises:
        MotionError: all samples around a demonstration collide.
    """

    def contrast(demo: Demonstration, source: np.random.Generator) -> Contrast:
        beside = None if collisions is None else collisions.beside(demo.q, demo.partner)
        samples = sample_around(demo, sampling, source, beside)
        differences = features.values(samples.q, demo.situation) - features.values(demo.q, demo.situation)
        touches = () if beside is None else beside.touches
        return Contrast(demo.name, demo.recording, differences, samples.collided, touches)

    # Nearly all of the work is in compiled loops, which let other threads run.
    with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(contrast, demos, rng.spawn(len(demos))))


def learn_weights(
    found: Sequence[Contrast], settings: PiirlSettings | None = None, start: FloatArray | None = None
) -> PiirlSolution:
    """Return the weights that minimise the loss, by L-BFGS-B.

    Args:
        found: contrasts of the demonstrations.
        settings: loss, bounds, penalties.
        start: (24,) weights to begin with, to save time; the minimum of a convex loss does not depend on them.

    Raises:
        MotionError: no demonstrations, or the solver failed.
    """
    settings = settings or PiirlSettings()
    if not found:
        raise MotionError("learning: wanted at least one demonstration, got none; look at what was left out and why")
    deviation = np.concatenate([contrast.differences for contrast in found]).std(axis=0)
    deviation = np.where(deviation > 0.0, deviation, 1.0)
    unit = deviation if settings.normalised else np.ones(N_FEATURES)
    loss = PiirlLoss([contrast.differences / unit for contrast in found], settings)
    # The solver sees weights times the deviation of their feature: one step then means the same for all of them.
    scale = deviation / unit
    upper = np.where(np.isin(FEATURE_NAMES, settings.without), 0.0, settings.upper)
    # Beyond some 1e3 deviations a feature decides alone; a start there would leave the solver on a flat stretch.
    at = 1.0 / scale if start is None else start * unit

    def scaled(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = loss.at(x / scale)
        return value, gradient / scale

    solved = minimize(
        scaled,
        np.clip(at * scale, 0.0, upper * scale),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, most) for most in upper * scale],
        options={"maxiter": 3000, "maxfun": 6000, "ftol": 1e-12, "gtol": 1e-8, "maxcor": 30},
    )
    if not np.isfinite(solved.fun):
        raise MotionError(f"learning: wanted a finite loss, the solver ended with {solved.fun} ({solved.message})")
    w = np.clip(solved.x / scale, 0.0, upper)
    return PiirlSolution(w / unit, float(solved.fun), w >= settings.upper * (1.0 - _AT_BOUND))


class PiirlLoss:
    """The loss of demonstrations; for "coded", its logarithm times the number of demonstrations.

    Args:
        blocks: (K, 24) features of samples minus those of their demonstration, one block for each.
        settings: loss and penalties.
    """

    def __init__(self, blocks: Sequence[FloatArray], settings: PiirlSettings) -> None:
        self._settings = settings
        self._n = len(blocks)
        together = settings.loss == "coded"
        ends = [0, *np.cumsum([len(block) for block in blocks])]
        self._starts = np.array([0, ends[-1]] if together else ends, dtype=np.int64)
        self._times = float(self._n if together else 1)
        self._differences = np.ascontiguousarray(np.concatenate(blocks))

    def at(self, w: FloatArray) -> tuple[float, FloatArray]:
        """Return the loss and its gradient (24,) at weights (24,)."""
        s, n = self._settings, self._n
        gradient = np.zeros(len(w))
        loss = self._times * log_sums(self._differences, self._starts, w, s.with_demonstration, gradient)
        loss += n * (s.l1 * float(w.sum()) + 0.5 * s.l2 * float(w @ w))
        return loss, self._times * gradient + n * (s.l1 + s.l2 * w)
