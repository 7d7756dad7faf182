"""The evaluation of reaches judged: reference values that must come out, and what the project wants of itself.

A target is judged only if everything it needs was run; those about P2's recordings, only on these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from humanpred_ros.evaluation.reaching.entry import BETTER
from humanpred_ros.evaluation.reaching.learned import PUBLISHED as LEARNED_AS_PUBLISHED
from humanpred_ros.evaluation.reaching.planned import DEFAULT_PREDICTOR
from humanpred_ros.evaluation.reaching.reference import (
    DEMONSTRATIONS,
    INTERFERENCE_CASE,
    TOLERANCE_M,
    TRIVIAL,
    TRIVIAL_INTERFERENCE,
    TRIVIAL_MEANS,
)
from humanpred_ros.evaluation.reaching.result import PredictorFigures, ReachingSet
from humanpred_ros.evaluation.reaching.timing import PredictionTime
from humanpred_ros.evaluation.reaching.weights import WeightFigures
from humanpred_ros.evaluation.target import Target

_LABEL = "joint / task as coded / task"
#: Reproduced distances may be off the published ones by this share.
_REPRODUCTION = 0.15
#: What the default predictor must not exceed on P2's seven: joint, task (m).
_BETTER_M = (20.0, 16.5)
#: It may be worse than minimum jerk on so many.
_EXCEPTIONS = 1
_LEARNING_S, _PREDICTION_MS, _EVALUATION_S = 20.0, 50.0, 600.0


def targets_of(
    demos: ReachingSet,
    interference: ReachingSet | None,
    weights: WeightFigures | None = None,
    times: Sequence[PredictionTime] = (),
    elapsed_s: float | None = None,
) -> tuple[Target, ...]:
    """Return the targets that can be judged.

    Args:
        demos: predicted leaving one out.
        interference: predicted from all of them.
        weights: learned ones, with the time that took.
        times: of single predictions.
        elapsed_s: of a complete evaluation, None for another.
    """
    seven = set(demos.names) == set(DEMONSTRATIONS)
    case = interference if interference is not None and interference.names == (INTERFERENCE_CASE,) else None
    targets = list(reference_targets(demos, interference))
    if seven:
        targets += _order(demos)
        targets += _as_published(demos)
    if case is not None:
        targets += _replanning(case)
    if seven:
        targets += _better(demos)
    targets += _wins(demos)
    targets += _times(weights, times, elapsed_s)
    return tuple(targets)


def reference_targets(demos: ReachingSet, interference: ReachingSet | None) -> tuple[Target, ...]:
    """Return the reference values that these recordings allow to be checked; none for other recordings than P2's."""
    targets = []
    if set(demos.names) == set(DEMONSTRATIONS):
        for figures in demos.predictors:
            if figures.name in TRIVIAL:
                targets.append(_one_by_one(figures))
            if figures.name in TRIVIAL_MEANS:
                targets.append(_means(figures, "mean of the seven", TRIVIAL_MEANS[figures.name]))
    if interference is not None and interference.names == (INTERFERENCE_CASE,):
        targets += [
            _means(figures, f"on {INTERFERENCE_CASE}", TRIVIAL_INTERFERENCE[figures.name])
            for figures in interference.predictors
            if figures.name in TRIVIAL_INTERFERENCE
        ]
    return tuple(targets)


def _order(demos: ReachingSet) -> Iterator[Target]:
    names = ("learned", "baseline_0", "baseline_1")
    figures = [found for name in names if (found := demos.predictor(name)) is not None]
    if len(figures) < len(names):
        return
    for which, distance in ((1, "task as coded"), (2, "task")):
        reached = [found.average.means[which] for found in figures]
        rows = [row for name in names if (row := demos.published_of(name)) is not None] if which == 1 else []
        yield Target(
            f"reproduction, {distance}: order",
            " < ".join(names),
            _ascending(reached),
            _ascending([row.task_as_coded_m for row in rows]),
            reached == sorted(set(reached)),
        )


def _as_published(demos: ReachingSet) -> Iterator[Target]:
    figures, published = demos.predictor("learned"), demos.published_of("learned")
    if figures is None or published is None:
        return
    pairs = (("joint", published.joint_m), ("task as coded", published.task_as_coded_m))
    for (distance, wanted), reached in zip(pairs, figures.average.means, strict=False):
        off = reached / wanted - 1.0
        yield Target(
            f"reproduction, {distance}: learned, planned once",
            f"published ± {100.0 * _REPRODUCTION:.0f} %",
            f"{reached:.2f}, {100.0 * off:+.1f} %",
            f"{wanted:.2f}",
            abs(off) <= _REPRODUCTION,
        )


def _replanning(case: ReachingSet) -> Iterator[Target]:
    for name in ("learned", "improved"):
        again, once = case.predictor(f"{name}_replanned"), case.predictor(name)
        if again is None or once is None:
            continue
        rows = case.published_of(f"{name}_replanned"), case.published_of(name)
        published = ""
        if rows[0] is not None and rows[1] is not None:
            published = _changes((rows[1].joint_m, rows[1].task_as_coded_m), (rows[0].joint_m, rows[0].task_as_coded_m))
        yield Target(
            f"{'reproduction, ' if once.group != BETTER else ''}{INTERFERENCE_CASE}: {name}, {_LABEL}",
            "lower when re-planned",
            _changes(once.average.means, again.average.means),
            published,
            all(a < b for a, b in zip(again.average.means, once.average.means, strict=True)),
        )


def _better(demos: ReachingSet) -> Iterator[Target]:
    figures, published = demos.predictor(DEFAULT_PREDICTOR), demos.published_of("learned")
    if figures is None:
        return
    texts = (f"{published.joint_m:.2f}" if published is not None else "", "")
    for distance, reached, wanted, text in zip(
        ("joint", "task"), (figures.average.joint_m.mean, figures.average.task_m.mean), _BETTER_M, texts, strict=True
    ):
        yield Target(
            f"better, {distance}: {DEFAULT_PREDICTOR}, mean of the seven",
            f"<= {wanted:.1f}",
            f"{reached:.2f}",
            text,
            reached <= wanted,
        )


def _wins(demos: ReachingSet) -> Iterator[Target]:
    count = len(demos.names)
    for distance, field in (("joint", "joint_m"), ("task", "task_m")):
        wins = demos.better_than(DEFAULT_PREDICTOR, "minimum_jerk", field)
        if wins is not None:
            yield Target(
                f"better, {distance}: {DEFAULT_PREDICTOR} < minimum_jerk",
                f"on >= {count - _EXCEPTIONS} of {count}",
                f"on {wins} of {count}",
                "",
                wins >= count - _EXCEPTIONS,
            )


def _times(weights: WeightFigures | None, times: Sequence[PredictionTime], elapsed_s: float | None) -> Iterator[Target]:
    if weights is not None and LEARNED_AS_PUBLISHED in weights.learn_s:
        learn_s, processor_s = weights.learn_s[LEARNED_AS_PUBLISHED], weights.processor_s[LEARNED_AS_PUBLISHED]
        yield Target(
            "learning as P2 did, bootstrap included",
            f"<= {_LEARNING_S:.0f} s", f"{learn_s:.1f} s (processor: {processor_s:.1f} s)", "", learn_s <= _LEARNING_S,
        )  # fmt: skip
    for entry in times:
        if entry.predictor in ("learned", DEFAULT_PREDICTOR):
            yield Target(
                f"one prediction by {entry.predictor}, reach of {entry.duration_s:.2f} s, median",
                f"<= {_PREDICTION_MS:.0f} ms",
                f"{entry.median_ms:.1f} ms (processor: {entry.processor_ms:.1f} ms)",
                "",
                entry.median_ms <= _PREDICTION_MS,
            )
    if elapsed_s is not None:
        yield Target(
            "this evaluation",
            f"<= {_EVALUATION_S / 60.0:.0f} min", f"{elapsed_s / 60.0:.1f} min", "", elapsed_s <= _EVALUATION_S,
        )  # fmt: skip


def _means(figures: PredictorFigures, where: str, wanted: tuple[float, float, float]) -> Target:
    off = max(abs(got - want) for got, want in zip(figures.average.means, wanted, strict=True))
    return Target(
        f"{figures.name}, {where}: {_LABEL}",
        _row(wanted),
        _row(figures.average.means),
        "",
        off <= TOLERANCE_M,
    )


def _one_by_one(figures: PredictorFigures) -> Target:
    got = np.array([figures.of(name).means for name in DEMONSTRATIONS])
    off = float(np.abs(got - np.array(TRIVIAL[figures.name])).max())
    return Target(
        f"{figures.name}, each of the seven: off the reference values by",
        f"<= {TOLERANCE_M:.2f}",
        f"{off:.3f}",
        "",
        off <= TOLERANCE_M,
    )


def _row(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


def _ascending(values: Sequence[float]) -> str:
    return " < ".join(f"{value:.2f}" for value in values) if list(values) == sorted(values) else _row(values)


def _changes(before: Sequence[float], after: Sequence[float]) -> str:
    return ", ".join(f"{a:.2f} → {b:.2f}" for a, b in zip(before, after, strict=True))
