"""Predictors of reaches that plan, for `humanpred evaluate reaching`: P2's, its baselines and a better one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from humanpred_ros.experiments.reaching_entry import ReachingEntry, ReachingMaterial, Without
from humanpred_ros.reaching.learning import LearningConfig, ReachLearner
from humanpred_ros.reaching.named_weights import named_weights
from humanpred_ros.reaching.piirl import PiirlConfig
from humanpred_ros.reaching.planned_predictors import improved_predictor, planned_predictor
from humanpred_ros.reaching.task import ReachPredictor

#: P2's: all demonstrations, split; the paper's loss.
_AS_PUBLISHED = LearningConfig(keep_unfit=True)
#: Features in units of their spread, an optimum inside the bounds, and no recording with a jump.
_IMPROVED = LearningConfig(piirl=PiirlConfig(normalised=True, with_demonstration=True, l2=0.1), splitting=None)
_NAMED = {
    "baseline_0": "smooth only, blind to the partner (P2's aggressive baseline)",
    "baseline_1": "smooth, equally afraid of all distances (P2's conservative baseline)",
    "authors_static": "the authors' weights, learned with the tested recording",
}


def planned_entries() -> Iterator[tuple[str, ReachingEntry]]:
    """Yield name and entry of each, planned once, then re-planned every 0.1 s."""
    for replanned in (False, True):
        tail, how = ("_replanned", ", re-planned") if replanned else ("", "")
        for name, description in _NAMED.items():
            yield name + tail, ReachingEntry(description + how, _named(name, replanned), True)
        yield (
            "learned" + tail,
            ReachingEntry("P2: learned cost" + how, _learned(_planned, _AS_PUBLISHED, replanned), True),
        )
        yield (
            "improved" + tail,
            ReachingEntry(
                "learned cost, better first guess and noise" + how, _learned(_improved, _IMPROVED, replanned), True
            ),
        )


_Build = Callable[..., ReachPredictor]
_planned: _Build = planned_predictor
_improved: _Build = improved_predictor


def _named(name: str, replanned: bool) -> Callable[[ReachingMaterial], Without]:
    def prepare(material: ReachingMaterial) -> Without:
        weights = named_weights(name)
        return lambda left_out: planned_predictor(
            material.without(left_out), material.model, weights, replanned=replanned
        )

    return prepare


def _learned(build: _Build, config: LearningConfig, replanned: bool) -> Callable[[ReachingMaterial], Without]:
    def prepare(material: ReachingMaterial) -> Without:
        learner = ReachLearner(material.recordings, material.model, config)

        def without(left_out: str) -> ReachPredictor:
            others = material.without(left_out)
            weights = learner.learn([recording.name for recording in others], bootstrap=False).weights
            return build(others, material.model, weights, replanned=replanned)

        return without

    return prepare
