"""All weights that an evaluation needs, learned once: from all recordings, leaving each out, and from each alone."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.features import DISTANCE_NAMES
from humanpred_ros.reaching.learner import LearningSettings, ReachLearner
from humanpred_ros.reaching.piirl import PiirlSettings
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import ReachWeights

_log = logging.getLogger(__name__)

PUBLISHED, ALONE, IMPROVED = "published", "alone", "improved"
_AS_PUBLISHED = LearningSettings(keep_unfit=True)
#: Ways to learn: P2's (all recordings, split, the paper's loss); P2's from one whole recording (facts section 5); and
#: with features in units of their spread, an optimum inside the bounds, and no recording with a jump. What it costs to
#: come near the partner is not learned there: of a few reaches it cannot be told from nothing (the bootstrap says so),
#: and what comes out makes other reaches worse. The partner remains an obstacle.
LEARNING: Mapping[str, LearningSettings] = MappingProxyType(
    {
        PUBLISHED: _AS_PUBLISHED,
        ALONE: _AS_PUBLISHED.replaced(splitting=None),
        IMPROVED: LearningSettings(
            piirl=PiirlSettings(normalised=True, with_demonstration=True, l2=0.1, without=DISTANCE_NAMES),
            splitting=None,
        ),
    }
)  # fmt: skip


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
        """Return the weights that know nothing of the recording `name`."""
        return self.left_out.get(name, self.everything)


@dataclass(frozen=True, eq=False)
class LearnedWeights:
    """What was learned in one way, and how sure it is.

    Attributes:
        table: the weights.
        everything: those from all recordings, with bootstrap and provenance.
        notes: what learning had to say about the recordings.
        learn_s: time that `everything` took: samples, their features, weights and bootstrap.
        processor_s: the same as processor time, which other work on the machine matters less to.
    """

    table: WeightTable
    everything: ReachWeights
    notes: tuple[str, ...]
    learn_s: float
    processor_s: float


def learn_all(
    recordings: Sequence[ReachRecording], model: HumanModel, how: str, seed: int, scene: Surroundings | None = None
) -> LearnedWeights:
    """Learn from all, from all but each and, for `ALONE`, from each.

    Recordings with jumps are learned from after all where there are no others, with a warning.

    Args:
        recordings: at least two.
        model: the human.
        how: one of `LEARNING`.
        seed: of samples and bootstrap.
        scene: what stands there; P2's table if None.

    Raises:
        MotionError: too little to learn from.
    """
    begin, processor_begin = time.perf_counter(), time.process_time()
    config = LEARNING[how].replaced(seed=seed)
    learner = ReachLearner(recordings, model, config, scene)
    if not learner.names:
        learner = ReachLearner(recordings, model, config.replaced(keep_unfit=True), scene)
    everything = learner.learn()
    learn_s, processor_s = time.perf_counter() - begin, time.process_time() - processor_begin
    names = [recording.name for recording in recordings]

    @lru_cache(maxsize=1)
    def less_strict() -> ReachLearner:
        return ReachLearner(recordings, model, config.replaced(keep_unfit=True), scene)

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
