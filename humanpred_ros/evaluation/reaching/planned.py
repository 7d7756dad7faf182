"""Predictors of reaches that plan, for `humanpred evaluate reaching`: P2's, its baselines and a better one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from humanpred_ros.evaluation.reaching.entry import BETTER, REPRODUCED, ReachingEntry, ReachingMaterial, Without
from humanpred_ros.evaluation.reaching.learned import ALONE, IMPROVED, PUBLISHED
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.planned_predictors import improved_predictor, planned_predictor
from humanpred_ros.reaching.posture_bounds import BoundsConfig
from humanpred_ros.reaching.reach_task import ReachPredictor

#: The predictor that is used where nobody asks for another.
DEFAULT_PREDICTOR = "improved"
_NAMED = {
    "baseline_0": "smooth only, blind to the partner (P2's aggressive baseline)",
    "baseline_1": "smooth, equally afraid of all distances (P2's conservative baseline)",
    "authors_static": "mean of the weights that P2's authors learned, the tested reach among them",
}
#: What each is, how it is built, the way its weights are learned, and its group.
_LEARNED: dict[str, tuple[str, Callable[..., ReachPredictor], str, str]] = {
    "learned": ("P2: learned cost, straight line as first guess", planned_predictor, PUBLISHED, REPRODUCED),
    "learned_near": (
        "as learned, but bounded by how far a reach moves people, not by where they stood",
        partial(planned_predictor, bounds=BoundsConfig(relative=True)), PUBLISHED, BETTER,
    ),
    DEFAULT_PREDICTOR: (
        "learned cost of smoothness, better first guess, noise and bounds", improved_predictor, IMPROVED, BETTER
    ),
}  # fmt: skip


def planned_entries() -> Iterator[tuple[str, ReachingEntry]]:
    """Yield name and entry of each: planned once, then re-planned every 0.1 s."""
    yield (
        "own",
        ReachingEntry(
            "cost learned from the tested reach itself (P2 Table I): no prediction, a fit", _own, REPRODUCED,
            by_chance=True, learns=ALONE, of_tested=True,
        ),
    )  # fmt: skip
    for replanned in (False, True):
        for name, (description, build, way, group) in _LEARNED.items():
            default = "; the default" if name == DEFAULT_PREDICTOR and not replanned else ""
            yield _entry(name, description + default, _learned(build, way, replanned), group, replanned, way)
        for name, description in _NAMED.items():
            yield _entry(name, description, _named(name, replanned), REPRODUCED, replanned)


def _entry(
    name: str,
    description: str,
    prepare: Callable[[ReachingMaterial], Without],
    group: str,
    replanned: bool,
    learns: str | None = None,
) -> tuple[str, ReachingEntry]:
    tail, how = ("_replanned", ", re-planned every 0.1 s") if replanned else ("", "")
    entry = ReachingEntry(description + how, prepare, group, by_chance=True, replanned=replanned, learns=learns)
    return name + tail, entry


def _own(material: ReachingMaterial) -> Without:
    weights = material.learned(ALONE).alone
    return lambda tested: planned_predictor(material.recordings, material.model, weights[tested], scene=material.scene)


def _named(name: str, replanned: bool) -> Callable[[ReachingMaterial], Without]:
    def prepare(material: ReachingMaterial) -> Without:
        weights = NAMED_WEIGHTS[name]
        return lambda left_out: planned_predictor(
            material.without(left_out), material.model, weights, replanned=replanned, scene=material.scene
        )

    return prepare


def _learned(build: Callable[..., ReachPredictor], how: str, replanned: bool) -> Callable[[ReachingMaterial], Without]:
    def prepare(material: ReachingMaterial) -> Without:
        learned = material.learned(how)
        return lambda left_out: build(
            material.without(left_out), material.model, learned.without(left_out), replanned=replanned,
            scene=material.scene,
        )  # fmt: skip

    return prepare
