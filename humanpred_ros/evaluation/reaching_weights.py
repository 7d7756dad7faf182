"""Weights for `humanpred evaluate reaching`: learned once, compared with the published ones, and recovered (P2 Fig. 7).

All weights belong to the same features with the same scales, and the published ones to the same bounds, so they can be
compared as they stand. What a weight means for a reach depends on how much its feature varies, though, and costs have
no unit; so every set of weights is also given as influence: weight times the standard deviation of its feature over
samples around the demonstrations, as a share of the sum over all features.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.demonstrations import Demonstration, demonstration, demonstrations
from humanpred_ros.reaching.features import DISTANCE_NAMES, N_SMOOTHNESS, NAMED_WEIGHTS, ReachFeatures
from humanpred_ros.reaching.first_guess import straight_line
from humanpred_ros.reaching.learner import LearningSettings, ReachLearner
from humanpred_ros.reaching.piirl import Contrast, PiirlSettings, contrasts, learn_weights
from humanpred_ros.reaching.planner import ReachPlanner, ReachPlannerSettings
from humanpred_ros.reaching.posture_bounds import PostureBounds
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import ReachWeights

_log = logging.getLogger(__name__)

PUBLISHED, ALONE, IMPROVED = "published", "alone", "improved"
_AS_PUBLISHED = LearningSettings(keep_unfit=True)
#: Ways to learn: P2's (all recordings, cut, the paper's loss); P2's from one whole recording; and with features in
#: units of their spread, an optimum inside the bounds, and no recording with a jump. The improved way learns no cost of
#: coming near the partner: a few reaches cannot tell it from nothing (the bootstrap says so), and what comes out makes
#: other reaches worse. The partner remains an obstacle.
LEARNING: Mapping[str, LearningSettings] = MappingProxyType(
    {
        PUBLISHED: _AS_PUBLISHED,
        ALONE: _AS_PUBLISHED.replaced(splitting=None),
        IMPROVED: LearningSettings(
            piirl=PiirlSettings(normalised=True, with_demonstration=True, l2=0.1, without=DISTANCE_NAMES),
            splitting=None,
        ),
    }
)
#: Samples of each demonstration that say how much a feature varies.
_N_SAMPLES = 200


@dataclass(frozen=True, eq=False)
class WeightTable:
    """Weights (24,) learned in one way, as plain arrays: what predictors need.

    Attributes:
        everything: from all recordings.
        left_out: from all but one, by its name.
        alone: from one, by its name; empty where that is not wanted.
    """

    everything: FloatArray
    left_out: Mapping[str, FloatArray]
    alone: Mapping[str, FloatArray]

    def without(self, name: str) -> FloatArray:
        """Return the weights that have not seen the recording `name`."""
        return self.left_out.get(name, self.everything)


@dataclass(frozen=True, eq=False)
class LearnedWeights:
    """What was learned in one way, and how certain it is.

    Attributes:
        table: the weights.
        everything: those from all recordings, with bootstrap and provenance.
        notes: what learning reported about the recordings.
        learn_s: time that `everything` took: samples, their features, weights and bootstrap.
        processor_s: the same as processor time, which other work on the machine changes less.
    """

    table: WeightTable
    everything: ReachWeights
    notes: tuple[str, ...]
    learn_s: float
    processor_s: float


def learn_all(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    how: str,
    seed: int,
    surroundings: Surroundings | None = None,
) -> LearnedWeights:
    """Learn from all recordings (at least two), from all but each and, for `ALONE`, from each.

    Recordings with jumps are learned from after all where there are no others, with a warning.

    Args:
        recordings: at least two.
        model: the human.
        how: one of `LEARNING`.
        seed: of samples and bootstrap.
        surroundings: what stands there; P2's table if None.

    Raises:
        MotionError: too little to learn from.
    """
    begin, processor_begin = time.perf_counter(), time.process_time()
    settings = LEARNING[how].replaced(seed=seed)

    @lru_cache(maxsize=1)
    def less_strict() -> ReachLearner:
        return ReachLearner(recordings, model, settings.replaced(keep_unfit=True), surroundings)

    learner = ReachLearner(recordings, model, settings, surroundings)
    if not learner.names:
        learner = less_strict()
    everything = learner.learn()
    learn_s, processor_s = time.perf_counter() - begin, time.process_time() - processor_begin
    names = [recording.name for recording in recordings]

    def learned(some: Sequence[str]) -> FloatArray:
        if set(some) & set(learner.names):
            return learner.learn(some, bootstrap=False).weights
        _log.warning("%s: nothing else to learn from; learned from all the same", ", ".join(some))
        return less_strict().learn(some, bootstrap=False).weights

    table = WeightTable(
        everything.weights,
        {name: learned([other for other in names if other != name]) for name in names},
        {name: learned([name]) for name in names} if how == ALONE else {},
    )
    return LearnedWeights(table, everything, learner.notes, learn_s, processor_s)


@dataclass(frozen=True, eq=False)
class WeightColumn:
    """One set of weights.

    Attributes:
        name, description: which.
        weights: (24,) of `FEATURE_NAMES`.
        spread: (24,) standard deviation of what `description` says; None where it is not known.
        at_upper: names of the weights that their bound stopped.
        influence: (24,) shares that sum to 1.
    """

    name: str
    description: str
    weights: FloatArray
    spread: FloatArray | None
    at_upper: tuple[str, ...]
    influence: FloatArray


def weight_columns(learned: Mapping[str, LearnedWeights], deviation: FloatArray) -> tuple[WeightColumn, ...]:
    """Return the weights that were learned, by the names of `LEARNING`, and the published ones; see `influence`."""
    found: list[tuple[str, str, FloatArray, FloatArray | None, tuple[str, ...]]] = []
    for how, text in (
        (PUBLISHED, "P2's way, all recordings"),
        (IMPROVED, "smoothness only, features normalised, no jumps"),
    ):
        if how in learned:
            all_ = learned[how].everything
            text += f", ± over {len(all_.bootstrap)} bootstrap draws of them"
            found.append((how, text, all_.weights, all_.spread, all_.at_upper))
    if ALONE in learned:
        each = np.array(list(learned[ALONE].table.alone.values()))
        text = f"P2's way, from one whole recording each; mean ± over {len(each)} recordings"
        found.append((ALONE, text, each.mean(axis=0), each.std(axis=0), ()))
    for name, cuts in (("authors_static", "without cuts"), ("authors_dynamic", "with cuts")):
        text = f"learned by P2's authors from one of the seven each, {cuts}; mean"
        found.append((name, text, NAMED_WEIGHTS[name], None, ()))
    return tuple(WeightColumn(*row, influence(row[2], deviation)) for row in found)


def influence(weights: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return how much of a cost's variation is due to each feature: shares (..., 24); zeros for weights of zero."""
    moved = weights * deviation
    total = moved.sum(axis=-1, keepdims=True)
    shares: FloatArray = np.divide(moved, total, out=np.zeros_like(moved), where=total > 0.0)
    return shares


def feature_deviation(recordings: Sequence[ReachRecording], model: HumanModel, seed: int) -> FloatArray:
    """Return the standard deviation (24,) of each feature over samples around whole recordings."""
    features = ReachFeatures(model)
    sampling = LEARNING[PUBLISHED].sampling.replaced(n_samples=_N_SAMPLES)
    demos = demonstrations(recordings, features, keep_unfit=True)
    found = contrasts(demos, features, sampling, np.random.default_rng([seed, 2]))
    squares = np.mean([contrast.differences.var(axis=0) for contrast in found], axis=0)
    deviation: FloatArray = np.sqrt(squares)
    return deviation


#: P2's hand-tuned weights of the 16 distances; its smoothness weights for Fig. 7 are not known.
_KNOWN_DISTANCES = (
    0.1, 8.0, 5.0, 8.0, 5.0, 1.0, 2.0, 5.0,
    5.0, 2.0, 5.0, 5.0, 5.0, 5.0, 5.0, 2.0,
)  # fmt: skip
#: Ways to learn that are compared. Whoever is known to mind the partner's nearness can only be learned from with it.
METHODS: Mapping[str, PiirlSettings] = MappingProxyType(
    {
        PUBLISHED: LEARNING[PUBLISHED].piirl,
        f"{IMPROVED}, distances too": LEARNING[IMPROVED].piirl.replaced(without=()),
    }
)


def known_weights() -> FloatArray:
    """Return the weights (24,) that the made-up demonstrations minimise."""
    weights = NAMED_WEIGHTS["baseline_0"].copy()
    weights[N_SMOOTHNESS:] = _KNOWN_DISTANCES
    return frozen(weights)  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class RecoveryRun:
    """One repetition: by how much reaches cost more than the demonstrations, by the known weights, as shares.

    Attributes:
        learned: (K, D) of reaches planned with learned weights, by method.
        best_sample: (K, D) of the best sample.
        line: (D,) of the straight line that planning begins with, which is also what baseline 0 plans.
    """

    learned: Mapping[str, FloatArray]
    best_sample: FloatArray
    line: FloatArray


class Recovery:
    """Learns known weights again from more and more samples (P2 Fig. 7); a worker process keeps it.

    The recorded people's weights are unknown, so demonstrations are made: reaches planned with known weights between
    the recorded ends, beside the recorded partners. From these weights are learned; reaches planned with the learned
    weights should then cost no more than the demonstrations, by the known weights. Demonstration and reach are planned
    with the same noise, so that they differ by the weights alone, and without obstacles, whose weight is not learned.

    Args:
        recordings: ends, durations and partners of the demonstrations to make.
        model: the human.
        samples: numbers of samples around each demonstration, ascending.
        seed: repetition r draws from (seed, r, ..).
    """

    def __init__(
        self, recordings: Sequence[ReachRecording], model: HumanModel, samples: Sequence[int], seed: int
    ) -> None:
        self._recordings, self._model, self._samples, self._seed = tuple(recordings), model, tuple(samples), seed
        self._bounds = PostureBounds.from_recordings(recordings, model)

    def __call__(self, repetition: int) -> RecoveryRun:
        """Make demonstrations, learn from more and more samples, plan again and compare."""
        features, known = ReachFeatures(self._model), known_weights()
        demos = []
        for number, recording in enumerate(self._recordings):
            situation = demonstration(recording, features).situation
            demos.append(Demonstration(recording.name, 0, self._planned(known, number, repetition), situation))
        costs = np.array([features.values(demo.q, demo.situation) @ known for demo in demos])

        def more(reaches: Sequence[FloatArray]) -> FloatArray:
            found = [features.values(q, demo.situation) @ known for q, demo in zip(reaches, demos, strict=True)]
            shares: FloatArray = np.array(found) / costs - 1.0
            return shares

        sampling = LEARNING[PUBLISHED].sampling.replaced(n_samples=max(self._samples))
        drawn = contrasts(demos, features, sampling, np.random.default_rng([self._seed, repetition]))
        learned: dict[str, list[FloatArray]] = {how: [] for how in METHODS}
        best = []
        for count in self._samples:
            some = [Contrast(c.demonstration, c.recording, c.differences[:count]) for c in drawn]
            best.append(np.array([(c.differences @ known).min() for c in some]) / costs)
            for how, piirl in METHODS.items():
                weights = learn_weights(some, piirl).weights
                learned[how].append(more([self._planned(weights, d, repetition) for d in range(len(demos))]))
        phase = np.linspace(0.0, 1.0, features.settings.n_waypoints)
        return RecoveryRun(
            learned={how: np.array(shares) for how, shares in learned.items()},
            best_sample=np.array(best),
            line=more([straight_line(demo.q[0], demo.q[-1], phase) for demo in demos]),
        )

    def _planned(self, weights: FloatArray, number: int, repetition: int) -> FloatArray:
        recording = self._recordings[number]
        planner = ReachPlanner(self._model, weights, self._bounds, settings=ReachPlannerSettings(obstacle_weight=0.0))
        rng = np.random.default_rng([self._seed, repetition, number])
        ends, partner = recording.active.q[[0, -1]], planner.partner(recording.passive.q[0])
        return planner.plan(ends[0], ends[1], recording.active.duration_s, partner, rng).q


def recovery_figures(runs: Sequence[RecoveryRun], samples: Sequence[int]) -> dict[str, Any]:
    """Return P2's Fig. 7: cost differences, in percent of the demonstrations' cost.

    Statistics (mean, sd, low, high) are over repetitions, of the mean over demonstrations: "learned" by method, and
    "best_sample", one for each number of samples; "line" one.
    """

    def over(shares: Sequence[FloatArray]) -> dict[str, float]:
        return statistic(np.array([100.0 * float(share.mean()) for share in shares]))

    count = range(len(samples))
    return {
        "samples": list(samples),
        "demonstrations": len(runs[0].line),
        "learned": {how: [over([run.learned[how][k] for run in runs]) for k in count] for how in runs[0].learned},
        "best_sample": [over([run.best_sample[k] for run in runs]) for k in count],
        "line": over([run.line for run in runs]),
    }


def statistic(values: FloatArray) -> dict[str, float]:
    """Return what P2 prints of runs: mean, population standard deviation, least, largest."""
    return dict(zip(STATISTICS, (float(f) for f in spread(values)), strict=True))


#: Names of what `spread` returns.
STATISTICS = ("mean", "sd", "low", "high")


def spread(values: FloatArray) -> FloatArray:
    """Return mean, population standard deviation, least and largest (4, ...) of values (..., K)."""
    return np.stack([values.mean(axis=-1), values.std(axis=-1), values.min(axis=-1), values.max(axis=-1)])
