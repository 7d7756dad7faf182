"""From the figures of an evaluation of reaches to its plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from humanpred_ros.evaluation.reaching.entry import GROUPS
from humanpred_ros.evaluation.reaching.evaluation_result import ReachingEvaluation
from humanpred_ros.evaluation.reaching.learned import PUBLISHED
from humanpred_ros.evaluation.reaching.recovery import RecoveryFigures
from humanpred_ros.evaluation.reaching.result import DISTANCES, PredictorFigures, ReachingSet, Statistic
from humanpred_ros.evaluation.reaching.sets import ITSELF
from humanpred_ros.evaluation.reaching.weights import WeightFigures
from humanpred_ros.viewing.plots_reach_figures import CostBySamples, DistanceBar, DistanceBars, WeightDots
from humanpred_ros.viewing.plots_reaching import ReachingPlot, WristPaths, save_reaching_plot

#: Whose paths are drawn; more would hide each other.
_DRAWN = ("minimum_jerk", "learned", "improved")
_MOST_DRAWN = 4


def draw_reaching(evaluation: ReachingEvaluation, path: Path) -> None:
    """Write the plot of an evaluation as PNG."""
    plot = ReachingPlot(
        paths=[paths for entry in evaluation.sets for paths in _paths(entry)],
        bars=[_bars(entry) for entry in evaluation.sets],
        samples=None if evaluation.recovery is None else _samples(evaluation.recovery),
        weights=None if evaluation.weights is None else _dots(evaluation.weights),
    )
    save_reaching_plot(path, plot)


def _paths(entry: ReachingSet) -> list[WristPaths]:
    names = [figures.name for figures in entry.predictors if figures.name != ITSELF]
    drawn = [name for name in _DRAWN if name in names] or names[:_MOST_DRAWN]
    return [
        WristPaths(
            name,
            entry.wrist_m[k],
            {f.name: f.recordings[k].wrist_m for wanted in drawn for f in entry.predictors if f.name == wanted},
        )
        for k, name in enumerate(entry.names)
    ]


def _bars(entry: ReachingSet) -> DistanceBars:
    tables = [row.table for row in entry.published]
    many = f"{len(entry.names)} reaches" if len(entry.names) > 1 else "1 reach"
    return DistanceBars(
        f"{many} ({tables[-1]})" if tables else many,
        [_bar(entry, figures) for figures in sorted(entry.predictors, key=lambda f: GROUPS.index(f.group))],
        "minimum_jerk",
    )


def _bar(entry: ReachingSet, figures: PredictorFigures) -> DistanceBar:
    joint, coded, task = (_three(getattr(figures.average, name)) for name in DISTANCES)
    row = entry.published_of(figures.name)
    nothing = float("nan")
    return DistanceBar(
        figures.name,
        GROUPS.index(figures.group),
        (joint[0], coded[0], task[0]),
        (joint[1], coded[1], task[1]),
        (joint[2], coded[2], task[2]),
        (nothing, nothing, nothing) if row is None else (row.joint_m, row.task_as_coded_m, nothing),
    )


def _samples(found: RecoveryFigures) -> CostBySamples:
    curves = {f"learned as {how}": found.learned[how] for how in found.learned}
    curves["best of the samples"] = found.best_sample
    return CostBySamples(
        found.samples,
        {name: np.array([_three(statistic) for statistic in values]) for name, values in curves.items()},
        found.line.mean,
        "straight line",
    )


def _dots(figures: WeightFigures) -> WeightDots | None:
    left_out = next((found for found in figures.left_out if found.how == PUBLISHED), None)
    authors = next((column for column in figures.columns if column.name == "authors_static"), None)
    if left_out is None or authors is None:
        return None
    return WeightDots(figures.features, left_out.weights, authors.weights, "authors, mean of single ones")


def _three(statistic: Statistic) -> tuple[float, float, float]:
    return statistic.mean, statistic.low, statistic.high
