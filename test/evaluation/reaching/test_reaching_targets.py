"""A target is met or missed by what was measured, and left out if something it needs was not run."""

from __future__ import annotations

import numpy as np

from humanpred_ros.evaluation.reaching.entry import BETTER, REPRODUCED
from humanpred_ros.evaluation.reaching.reference import (
    DEMONSTRATIONS,
    INTERFERENCE_CASE,
    PUBLISHED,
    PUBLISHED_INTERFERENCE,
)
from humanpred_ros.evaluation.reaching.result import (
    DistanceFigures,
    PredictorFigures,
    ReachingSet,
    RecordingFigures,
    Statistic,
)
from humanpred_ros.evaluation.reaching.targets import targets_of
from humanpred_ros.evaluation.reaching.timing import PredictionTime
from humanpred_ros.evaluation.target import Target

Means = tuple[float, float, float]


def distances(means: Means) -> DistanceFigures:
    return DistanceFigures(*(Statistic(value, 0.0, value, value) for value in means))


def predictor(name: str, means: Means, names: tuple[str, ...], worse_on: tuple[str, ...] = ()) -> PredictorFigures:
    found = tuple(
        RecordingFigures(entry, distances((99.0, 99.0, 99.0) if entry in worse_on else means), np.zeros((1, 3)))
        for entry in names
    )
    group = BETTER if name.startswith("improved") else REPRODUCED
    return PredictorFigures(name, "", group, 1, found, distances(means), None, 1.0)


def seven(*predictors: tuple[str, Means] | tuple[str, Means, tuple[str, ...]]) -> ReachingSet:
    facts = tuple({"name": name} for name in DEMONSTRATIONS)
    figures = tuple(predictor(name, means, DEMONSTRATIONS, *more) for name, means, *more in predictors)
    return ReachingSet("", facts, (), figures, PUBLISHED, True)


def case(*predictors: tuple[str, Means]) -> ReachingSet:
    figures = tuple(predictor(name, means, (INTERFERENCE_CASE,)) for name, means in predictors)
    return ReachingSet("", ({"name": INTERFERENCE_CASE},), (), figures, PUBLISHED_INTERFERENCE, False)


def found(targets: tuple[Target, ...], part: str) -> list[Target]:
    return [target for target in targets if part in target.what]


GOOD = (
    ("learned", (30.0, 43.0, 20.0)),
    ("baseline_0", (29.0, 45.0, 22.0)),
    ("baseline_1", (65.0, 58.0, 36.0)),
    ("improved", (18.0, 38.0, 14.0)),
    ("minimum_jerk", (23.12, 43.63, 18.93)),
)


def test_everything_measured_is_judged() -> None:
    times = [PredictionTime(name, "r", 1.31, ms, ms, ms) for name, ms in (("learned", 40.0), ("improved", 51.0))]
    targets = targets_of(seven(*GOOD), None, times=times, elapsed_s=300.0)
    for part in ("order", "learned, planned once", "mean of the seven", "improved < minimum_jerk"):
        judged = [target for target in found(targets, part) if "each of" not in target.what]
        assert judged
        assert all(target.met for target in judged)
    assert [target.met for target in found(targets, "one prediction")] == [True, False]
    (whole,) = found(targets, "this evaluation")
    assert whole.reached == "5.0 min"
    (joint, _) = found(targets, "learned, planned once")
    assert "-3.2 %" in joint.reached
    assert joint.published == "30.98"


def test_what_falls_short_is_missed() -> None:
    swapped = dict(GOOD) | {"baseline_0": (29.0, 42.0, 22.0), "learned": (40.0, 43.0, 20.0), "improved": (21, 38, 17)}
    targets = targets_of(seven(*swapped.items()), None, elapsed_s=601.0)
    order = found(targets, "order")
    assert [target.met for target in order] == [False, True]
    assert order[0].reached == "43.00 / 42.00 / 58.00"
    assert [target.met for target in found(targets, "learned, planned once")] == [False, True]
    assert not any(target.met for target in found(targets, "improved, mean of the seven"))
    assert not found(targets, "this evaluation")[0].met


def test_one_reach_may_be_worse_than_minimum_jerk_but_not_two() -> None:
    for worse, met in ((DEMONSTRATIONS[:1], True), (DEMONSTRATIONS[:2], False)):
        predictors = (("improved", (18.0, 38.0, 14.0), worse), GOOD[-1])
        judged = found(targets_of(seven(*predictors), None), "improved < minimum_jerk")
        assert [target.met for target in judged] == [met, met]
        assert judged[0].reached == f"on {7 - len(worse)} of 7"


def test_planning_again_has_to_help_in_every_distance() -> None:
    better = case(("learned", (60.0, 50.0, 40.0)), ("learned_replanned", (50.0, 40.0, 39.0)))
    worse = case(("learned", (60.0, 50.0, 40.0)), ("learned_replanned", (50.0, 40.0, 41.0)))
    (good,) = found(targets_of(seven(), better), "lower") or found(targets_of(seven(), better), INTERFERENCE_CASE)
    assert good.met
    assert good.published == "52.89 → 44.91, 49.22 → 36.20"
    (bad,) = found(targets_of(seven(), worse), INTERFERENCE_CASE)
    assert not bad.met


def test_what_was_not_run_is_left_out() -> None:
    assert not targets_of(seven(), None)
    only = targets_of(seven(("improved", (18.0, 38.0, 14.0))), case(("learned", (60.0, 50.0, 40.0))))
    assert [target.met for target in only] == [True, True]
    assert all("mean of the seven" in target.what for target in only)
