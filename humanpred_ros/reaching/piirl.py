"""Learns what a person minimises: weights under which the demonstrations cost less than what was not done (P2 III-C).

Path-integral inverse reinforcement learning. With features phi of demonstration d and of its samples k, and weights w,

    paper:  L(w) = sum over d of log sum over k of exp(-w . (phi_dk - phi_d))
    coded:  L(w) = sum over d and k of exp(-w . (phi_dk - phi_d))        (what the authors ran; facts section 5)

both convex in w. Neither has the demonstration itself in the sum, so on data that weights can separate both fall
without end: w is bounded, 0 <= w <= `upper`. Of the second, the logarithm is minimised, which has the same minimiser
and does not overflow.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching import loss_kernels
from humanpred_ros.reaching.collisions import ReachCollisions, Touch
from humanpred_ros.reaching.demonstrations import Demonstration
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, ReachFeatures
from humanpred_ros.reaching.sampling import SamplingConfig, sample_around

LOSSES = ("paper", "coded")
#: A weight this close to a bound (relative to `upper`) is reported to be there.
_AT_BOUND = 1e-6
#: Demonstrations whose samples are drawn at a time, each with some 100 MB.
_THREADS = 4


@dataclass(frozen=True)
class PiirlConfig:
    """How weights are learned.

    Attributes:
        loss: "paper" or "coded".
        with_demonstration: also count the demonstration among what could have been done, as a likelihood would.
        normalised: divide every feature by its standard deviation over the samples before learning, so that bound and
            penalties mean the same for all; the weights returned are for the features as they are.
        upper: bound of the weights, of normalised features if so (P2's code: 300).
        l1, l2: penalties l1 sum(w) and l2 sum(w^2) / 2 for each demonstration (P2's code: none).
        without: names of features that play no part: their weights are 0.

    Raises:
        UsageError: an unknown loss or feature, or numbers that cannot be.
    """

    loss: str = "paper"
    with_demonstration: bool = False
    normalised: bool = False
    upper: float = 300.0
    l1: float = 0.0
    l2: float = 0.0
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise UsageError(f"learning: wanted a loss of {', '.join(LOSSES)}, got {self.loss!r}")
        # Without a finite bound the losses fall without end where weights separate the data.
        if not (0.0 < self.upper < np.inf and 0.0 <= self.l1 < np.inf and 0.0 <= self.l2 < np.inf):
            raise UsageError(
                f"learning: wanted a finite upper > 0 and penalties >= 0, got {self.upper}, {self.l1}, {self.l2}"
            )
        if unknown := sorted(set(self.without) - set(FEATURE_NAMES)):
            raise UsageError(f"learning: wanted names of features to leave out, got {', '.join(unknown)}")


@dataclass(frozen=True, eq=False)
class Contrast:
    """What a demonstration is told apart from.

    Attributes:
        demonstration: its name.
        recording: the recording it is from.
        differences: (K, 24) features of its samples less its own.
        discarded: how many samples more were drawn, which collided.
        touches: where the demonstration itself is in something, the deepest first.
    """

    demonstration: str
    recording: str
    differences: FloatArray
    discarded: int = 0
    touches: tuple[Touch, ...] = ()


@dataclass(frozen=True, eq=False)
class PiirlSolution:
    """Weights and how they came out.

    Attributes:
        weights: (24,) for the features of `ReachFeatures`.
        loss: at the weights.
        at_upper: (24,) true where a weight was stopped by its upper bound.
        iterations: of the solver.
    """

    weights: FloatArray
    loss: float
    at_upper: np.ndarray[tuple[int], np.dtype[np.bool_]]
    iterations: int


def contrasts(
    demos: Sequence[Demonstration],
    features: ReachFeatures,
    sampling: SamplingConfig,
    rng: np.random.Generator,
    collisions: ReachCollisions | None = None,
) -> tuple[Contrast, ...]:
    """Return samples' features for every demonstration; they depend on nothing that is learned, so draw them once.

    Each demonstration draws from a generator of its own, so that neither threads nor others' collisions change it.

    Args:
        demos: what was done.
        features: of whom and how.
        sampling: what it is told apart from.
        rng: source of all chance.
        collisions: what no sample may run into; None if all are possible.

    Raises:
        MotionError: all samples around a demonstration collide.
    """

    def contrast(demo: Demonstration, source: np.random.Generator) -> Contrast:
        collides = None if collisions is None else collisions.beside(demo)
        samples = sample_around(demo, sampling, source, collides)
        differences = features.values(samples.q, demo.situation) - features.values(demo.q, demo.situation)
        touches = () if collides is None else collides.touches
        return Contrast(demo.name, demo.recording, differences, samples.collided, touches)

    # Nearly all of the work is in compiled loops, which let other threads run.
    with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(contrast, demos, rng.spawn(len(demos))))


def learn_weights(
    found: Sequence[Contrast], config: PiirlConfig | None = None, start: FloatArray | None = None
) -> PiirlSolution:
    """Return the weights that minimise the loss, by L-BFGS-B.

    Args:
        found: contrasts of the demonstrations.
        config: loss, bounds, penalties.
        start: (24,) weights to begin with, to save time; convex losses forget it.

    Raises:
        MotionError: no demonstrations, or the solver failed.
    """
    config = config or PiirlConfig()
    if not found:
        raise MotionError("learning: wanted at least one demonstration, got none; look at what was left out and why")
    deviation = np.concatenate([contrast.differences for contrast in found]).std(axis=0)
    deviation = np.where(deviation > 0.0, deviation, 1.0)
    unit = deviation if config.normalised else np.ones(N_FEATURES)
    loss = _Loss([contrast.differences / unit for contrast in found], config)
    # The solver sees weights times the spread of their feature: one step then means the same for all of them.
    scale = deviation / unit
    upper = np.where(np.isin(FEATURE_NAMES, config.without), 0.0, config.upper)
    # Beyond some 1e3 spreads a feature decides alone; a start there would leave the solver on a flat stretch.
    at = 1.0 / scale if start is None else start * unit
    solved = minimize(
        lambda x: loss.scaled(x, scale),
        np.clip(at * scale, 0.0, upper * scale),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, most) for most in upper * scale],
        options={"maxiter": 3000, "maxfun": 6000, "ftol": 1e-12, "gtol": 1e-8, "maxcor": 30},
    )
    if not np.isfinite(solved.fun):
        raise MotionError(f"learning: wanted a finite loss, the solver ended with {solved.fun} ({solved.message})")
    w = np.clip(solved.x / scale, 0.0, upper)
    return PiirlSolution(w / unit, float(solved.fun), w >= config.upper * (1.0 - _AT_BOUND), int(solved.nit))


def loss_gradient(w: FloatArray, blocks: Sequence[FloatArray], config: PiirlConfig) -> tuple[float, FloatArray]:
    """Return the loss ("coded": its logarithm, times the number of demonstrations) and its gradient (24,) at w (24,).

    Args:
        w: weights.
        blocks: (K, 24) features of samples less those of their demonstration, one block for each.
        config: loss and penalties.
    """
    return _Loss(blocks, config).at(w)


class _Loss:
    """The loss over all samples in one array."""

    def __init__(self, blocks: Sequence[FloatArray], config: PiirlConfig) -> None:
        self._config = config
        self._n = len(blocks)
        together = config.loss == "coded"
        ends = [0, *np.cumsum([len(block) for block in blocks])]
        self._starts = np.array([0, ends[-1]] if together else ends, dtype=np.int64)
        self._times = float(self._n if together else 1)
        self._differences = np.ascontiguousarray(np.concatenate(blocks))

    def at(self, w: FloatArray) -> tuple[float, FloatArray]:
        """Return loss and gradient at weights (24,)."""
        c, n = self._config, self._n
        gradient = np.zeros(len(w))
        loss = self._times * loss_kernels.log_sums(self._differences, self._starts, w, c.with_demonstration, gradient)
        loss += n * (c.l1 * float(w.sum()) + 0.5 * c.l2 * float(w @ w))
        return loss, self._times * gradient + n * (c.l1 + c.l2 * w)

    def scaled(self, x: FloatArray, scale: FloatArray) -> tuple[float, FloatArray]:
        """Return loss and gradient by x, where the weights are x / scale."""
        loss, gradient = self.at(x / scale)
        return loss, gradient / scale
