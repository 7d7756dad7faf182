"""Weights for `humanpred evaluate reaching`: learned once, compared with the published ones, and recovered (P2 Fig. 7).

All weights but those of the improved way belong to the same features with the same scales and bounds, so they can be
compared as they stand.
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
from humanpred_ros.reaching.between_ends import PostureBounds, straight_line
from humanpred_ros.reaching.demonstrations import Demonstration, demonstration
from humanpred_ros.reaching.features import DISTANCE_NAMES, FEATURE_NAMES, N_SMOOTHNESS, NAMED_WEIGHTS, ReachFeatures
from humanpred_ros.reaching.learner import LearningSettings, ReachLearner
from humanpred_ros.reaching.piirl import Contrast, PiirlSettings, contrasts, learn_weights
from humanpred_ros.reaching.planner import ReachPlanner, ReachPlannerSettings
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
        ALONE: _AS_PUBLISHED.replaced(cut=False),
        IMPROVED: LearningSettings(
            piirl=PiirlSettings(normalised=True, with_demonstration=True, l2=0.1, without=DISTANCE_NAMES),
            cut=False,
        ),
    }
)
#: The key of the weights from all recordings among those by recording.
ALL = ""
#: Names of what `spread` returns.
STATISTICS = ("mean", "sd", "low", "high")


def spread(values: FloatArray) -> FloatArray:
    """Return what P2 prints of runs (..., K): mean, population standard deviation, least and largest (4, ...)."""
    return np.stack([values.mean(axis=-1), values.std(axis=-1), values.min(axis=-1), values.max(axis=-1)])


@dataclass(frozen=True, eq=False)
class LearnedWeights:
    """What was learned in one way, and how certain it is."""

    everything: ReachWeights  #: the weights from all recordings, with bootstrap and provenance
    each: Mapping[str, FloatArray]  #: (24,) by recording: learned from all others; with `ALONE` from that one
    notes: tuple[str, ...]  #: what learning reported about the recordings
    learn_s: float  #: time that `everything` took: samples, their features, weights and bootstrap


def learn_all(
    recordings: Sequence[ReachRecording],
    model: HumanModel,
    how: str,
    seed: int,
    surroundings: Surroundings | None = None,
) -> LearnedWeights:
    """Learn from all recordings (at least two), and from all but each or, for `ALONE`, from each.

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
    begin = time.perf_counter()
    settings = LEARNING[how].replaced(seed=seed)

    @lru_cache(maxsize=1)
    def less_strict() -> ReachLearner:
        return ReachLearner(recordings, model, settings.replaced(keep_unfit=True), surroundings)

    learner = ReachLearner(recordings, model, settings, surroundings)
    if not learner.names:
        learner = less_strict()
    everything = learner.learn()
    learn_s = time.perf_counter() - begin
    each = {}
    for name in (recording.name for recording in recordings):
        some = [other.name for other in recordings if (other.name == name) == (how == ALONE)]
        able = learner
        if not set(some) & set(learner.names):
            _log.warning("%s: nothing else to learn from; learned from all the same", ", ".join(some))
            able = less_strict()
        each[name] = able.learn(some, bootstrap=False).weights
    return LearnedWeights(everything, each, learner.notes, learn_s)


def weight_columns(learned: Mapping[str, LearnedWeights]) -> list[dict[str, Any]]:
    """Return the weights that were learned, by the names of `LEARNING`, and the published ones, side by side.

    Each has name, description, weights (24,), spread (24,) as standard deviation of what the description says (None
    where it is not known), and at_upper with the features whose bound stopped them.
    """
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
        each = np.array(list(learned[ALONE].each.values()))
        text = f"P2's way, from one whole recording each; mean ± over {len(each)} recordings"
        found.append((ALONE, text, each.mean(axis=0), each.std(axis=0), ()))
    for name, cuts in (("authors_static", "without cuts"), ("authors_dynamic", "with cuts")):
        text = f"learned by P2's authors from one of the seven each, {cuts}; mean"
        found.append((name, text, NAMED_WEIGHTS[name], None, ()))
    keys = ("name", "description", "weights", "spread", "at_upper")
    return [dict(zip(keys, row, strict=True)) for row in found]


def weight_figures(learned: Mapping[str, LearnedWeights]) -> dict[str, Any]:
    """Return what was learned; `left_out` has P2's Fig. 10: weights (R, 24) without each of R recordings."""
    return {
        "features": FEATURE_NAMES,
        "upper": LEARNING[PUBLISHED].piirl.upper,
        "columns": weight_columns(learned),
        "left_out": [
            {"how": how, "recordings": list(found.each), "weights": np.array(list(found.each.values()))}
            for how, found in learned.items()
            if how != ALONE
        ],
        "provenance": {how: each.everything.provenance for how, each in learned.items()},
        "notes": {how: each.notes for how, each in learned.items()},
        "learn_s": {how: each.learn_s for how, each in learned.items()},
    }


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


def recover(
    recordings: Sequence[ReachRecording], model: HumanModel, samples: Sequence[int], seed: int, repetition: int
) -> dict[str, Any]:
    """Learn known weights again from more and more samples, once (P2 Fig. 7).

    The recorded people's weights are unknown, so demonstrations are made: reaches planned with known weights between
    the recorded ends, beside the recorded partners. From these weights are learned; reaches planned with the learned
    weights should then cost no more than the demonstrations, by the known weights. Demonstration and reach are planned
    with the same noise, so that they differ by the weights alone, and without obstacles, whose weight is not learned.

    Args:
        recordings: ends, durations and partners of the demonstrations to make.
        model: the human.
        samples: numbers of samples around each demonstration, ascending.
        seed: of all repetitions.
        repetition: its number; it draws from (seed, repetition, ..).

    Returns:
        By how much reaches cost more than the demonstrations, by the known weights, as shares: "learned" (K, D) of
        reaches planned with learned weights, by method; "best_sample" (K, D); and "line" (D,) of the straight line
        that planning begins with, which is also what baseline 0 plans.
    """
    bounds = PostureBounds.from_recordings(recordings, model)
    features, known = ReachFeatures(model), known_weights()

    def planned(weights: FloatArray, number: int) -> FloatArray:
        recording = recordings[number]
        planner = ReachPlanner(model, weights, bounds, settings=ReachPlannerSettings(obstacle_weight=0.0))
        rng = np.random.default_rng([seed, repetition, number])
        ends, partner = recording.active.q[[0, -1]], planner.partner(recording.passive.q[0])
        return planner.plan(ends[0], ends[1], recording.active.duration_s, partner, rng).q

    demos = [
        Demonstration(each.name, 0, planned(known, number), demonstration(each, features).situation)
        for number, each in enumerate(recordings)
    ]
    costs = np.array([features.values(demo.q, demo.situation) @ known for demo in demos])

    def more(reaches: Sequence[FloatArray]) -> FloatArray:
        found = [features.values(q, demo.situation) @ known for q, demo in zip(reaches, demos, strict=True)]
        shares: FloatArray = np.array(found) / costs - 1.0
        return shares

    sampling = LEARNING[PUBLISHED].sampling.replaced(n_samples=max(samples))
    drawn = contrasts(demos, features, sampling, np.random.default_rng([seed, repetition]))
    learned: dict[str, list[FloatArray]] = {how: [] for how in METHODS}
    best = []
    for count in samples:
        some = [Contrast(c.demonstration, c.recording, c.differences[:count]) for c in drawn]
        best.append(np.array([(c.differences @ known).min() for c in some]) / costs)
        for how, piirl in METHODS.items():
            weights = learn_weights(some, piirl).weights
            learned[how].append(more([planned(weights, number) for number in range(len(demos))]))
    phase = np.linspace(0.0, 1.0, features.n_waypoints)
    return {
        "learned": {how: np.array(shares) for how, shares in learned.items()},
        "best_sample": np.array(best),
        "line": more([straight_line(demo.q[0], demo.q[-1], phase) for demo in demos]),
    }


def recovery_figures(runs: Sequence[Mapping[str, Any]], samples: Sequence[int]) -> dict[str, Any]:
    """Return P2's Fig. 7 of runs of `recover`: cost differences, in percent of the demonstrations' cost.

    Statistics (mean, sd, low, high) are over repetitions, of the mean over demonstrations: "learned" by method, and
    "best_sample", one for each number of samples; "line" one.
    """

    def over(shares: Sequence[FloatArray]) -> dict[str, float]:
        return dict(zip(STATISTICS, spread(100.0 * np.array([each.mean() for each in shares])).tolist(), strict=True))

    count = range(len(samples))
    return {
        "samples": list(samples),
        "demonstrations": len(runs[0]["line"]),
        "learned": {how: [over([run["learned"][how][k] for run in runs]) for k in count] for how in runs[0]["learned"]},
        "best_sample": [over([run["best_sample"][k] for run in runs]) for k in count],
        "line": over([run["line"] for run in runs]),
    }
