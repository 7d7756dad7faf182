"""Learns the weights under which demonstrations cost less than what the person did not do (P2 III-C).

Path-integral inverse reinforcement learning. With features phi of demonstration d and of its samples k, and weights w,

    L(w) = sum over d of log sum over k of exp(-w . (phi_dk - phi_d))

It is convex in w. The demonstration itself is not in the sum, so on data that weights can separate it falls without
end: w is bounded, 0 <= w <= `upper`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from humanpred_ros.errors import MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.collisions import ReachCollisions, Touch
from humanpred_ros.reaching.demonstrations import Demonstration, SamplingSettings, sample_around
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, ReachFeatures
from humanpred_ros.settings import Settings, setting

#: A weight this close to its bound (relative to `upper`) is reported to be there.
_AT_BOUND = 1e-6
#: Demonstrations whose samples are drawn at the same time, with some 100 MB each.
_THREADS = 4


class PiirlSettings(Settings):
    """How weights are learned."""

    with_demonstration: bool = setting(
        False, "Count the demonstration among what could have been done, as a likelihood would (docs/papers.md (2.3))"
    )
    normalised: bool = setting(
        False,
        "Divide each feature by its standard deviation over the samples before learning, so that bound and penalties "
        "mean the same for all; the weights returned are for the features as they are",
    )
    # Without a finite bound the loss falls without end where weights separate the data.
    upper: float = setting(300.0, "Upper bound of the weights, of normalised features if so", low=1e-12)
    l2: float = setting(0.0, "Penalty l2 sum(w^2) / 2 for each demonstration", low=0.0)
    without: tuple[str, ...] = setting((), "Names of features whose weights are kept at 0")

    def check(self) -> None:
        if unknown := sorted(set(self.without) - set(FEATURE_NAMES)):
            raise SettingsError(f"learning: wanted names of features in `without`, got {', '.join(unknown)}")


@dataclass(frozen=True, eq=False)
class Contrast:
    """A demonstration and what it is distinguished from."""

    demonstration: str  #: its name
    recording: str  #: the recording it is from
    differences: FloatArray  #: (K, 24) features of its samples minus its own
    discarded: int = 0  #: how many more samples were drawn that collided
    touches: tuple[Touch, ...] = ()  #: where the demonstration itself is inside something, the deepest first


@dataclass(frozen=True, eq=False)
class PiirlSolution:
    """Learned weights."""

    weights: FloatArray  #: (24,) for the features of `ReachFeatures`
    loss: float  #: at the weights
    at_upper: np.ndarray[tuple[int], np.dtype[np.bool_]]  #: (24,) true where a weight was stopped by its upper bound


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
        samples, collided = sample_around(demo, sampling, source, beside)
        differences = features.values(samples, demo.situation) - features.values(demo.q, demo.situation)
        touches = () if beside is None else beside.touches
        return Contrast(demo.name, demo.recording, differences, collided, touches)

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
    """The loss of demonstrations, with its gradient.

    Args:
        blocks: (K, 24) features of samples minus those of their demonstration, one block for each.
        settings: loss and penalties.
    """

    def __init__(self, blocks: Sequence[FloatArray], settings: PiirlSettings) -> None:
        self._settings = settings
        self._counts = np.array([len(block) for block in blocks])
        self._starts = np.cumsum(self._counts) - self._counts
        self._differences = np.concatenate(blocks)

    def at(self, w: FloatArray) -> tuple[float, FloatArray]:
        """Return the loss and its gradient (24,) at weights (24,)."""
        n, l2, own = len(self._counts), self._settings.l2, self._settings.with_demonstration
        # Without BLAS, whose threads cost more than they gain in such thin products.
        exponents = -np.einsum("mf,f->m", self._differences, w)
        # The largest is subtracted first, so that nothing overflows; the demonstration itself has the exponent 0.
        top = np.maximum.reduceat(exponents, self._starts)
        top = np.maximum(top, 0.0) if own else top
        shares = np.exp(exponents - np.repeat(top, self._counts))
        totals = np.add.reduceat(shares, self._starts) + (np.exp(-top) if own else 0.0)
        gradient = -np.einsum("m,mf->f", shares / np.repeat(totals, self._counts), self._differences)
        loss = float((top + np.log(totals)).sum())
        return loss + n * (0.5 * l2 * float(w @ w)), gradient + n * (l2 * w)
