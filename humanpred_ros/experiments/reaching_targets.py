"""The evaluation of reaches judged: reference values that must come out, and what the project wants of itself."""

from __future__ import annotations

import numpy as np

from humanpred_ros.experiments.reaching_reference import (
    DEMONSTRATIONS,
    INTERFERENCE_CASE,
    TOLERANCE_M,
    TRIVIAL,
    TRIVIAL_INTERFERENCE,
    TRIVIAL_MEANS,
)
from humanpred_ros.experiments.reaching_result import PredictorFigures, ReachingSet
from humanpred_ros.experiments.target import Target

_LABEL = "joint / task as coded / task"


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


def _row(values: tuple[float, float, float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values)
