"""The arm beside one person, by every method and seed: the runs that P1's Table I and its extension are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros.evaluation.avoidance import Avoidance, find_avoidance
from humanpred_ros.evaluation.run_figures import ExecutedMotion, RunEvaluator, RunFigures
from humanpred_ros.evaluation.simulation import PredictedOccupancies, RunSettings, World, drive, nobody
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.scene import Scene

#: What the arm goes by: the predictor that it is told by (None: nobody), and what that is.
METHODS: Mapping[str, tuple[str | None, str]] = MappingProxyType(
    {
        "ours": ("forecast", "the default predictor, forecast, with the classifier forest"),
        "ours_p1": ("swept_volume", "P1's predictor, swept_volume, with the classifier gmm"),
        "current": ("current", "current occupancy only: the body where it is now"),
        "wait": ("current", "rests until the human's motion is over, then goes by the last posture"),
        "basic": (None, "smoothness and obstacles only: knows of no human"),
    }
)
BASIC = "basic"
#: Methods that predict: every contact of their runs is looked into.
PREDICTING = ("ours", "ours_p1")
#: Whose prediction after the last posture every run is measured with, as in P1's Table I.
_MEASURE = "swept_volume"


@dataclass(frozen=True)
class RunTask:
    """What is to be run with one person in one scene: (method, seed) of each run."""

    scene: str
    motion: str
    runs: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class PersonOutcome:
    """What came of a task.

    Attributes:
        runs: one for each of the task's.
        goal_m: distance that the person, in the last posture, leaves an arm at a goal; at the goal where it is largest.
        bound_m: no run that ends at a goal can keep a larger least distance: the arm is at its start when the person
            is in the first posture, and at a goal when the person is in the last.
        avoidance: whether a contact could have been avoided; None if no predicting method had one.
    """

    runs: tuple[RunFigures, ...]
    goal_m: float
    bound_m: float
    avoidance: Avoidance | None


class Runs:
    """Carries a library to where runs are made.

    Called with a task it returns the outcome. Same library, settings and task give the same figures, times apart.
    """

    def __init__(self, library: MotionLibrary, settings: RunSettings) -> None:
        self.world, self.settings = World(library, settings), settings

    def __call__(self, task: RunTask) -> PersonOutcome:
        """Make the runs of one task. Raises what training, prediction and planning raise."""
        scene, motion = self.world.scene(task.scene), self.world.library.find(task.motion)
        n_held = self.settings.held_postures(motion)
        predictors = {METHODS[method][0] for method, _ in task.runs} | {_MEASURE}
        told = {name: self.world.told(name, scene, motion, n_held) for name in sorted(filter(None, predictors))}
        final, swept = told[_MEASURE].after(len(motion) - 1), self.world.swept(scene, motion)
        evaluator = RunEvaluator(scene, self.world.human, motion, final, swept, n_held)
        figures: dict[tuple[str, int], RunFigures] = {}
        for seed in dict.fromkeys(seed for _, seed in task.runs):
            replanner = Replanner.for_scene(scene, self.settings.replanner_config(motion, seed))
            try:
                for method in (method for method, its_seed in task.runs if its_seed == seed):
                    executed, decisions = _run(replanner, scene, motion, method, told, n_held)
                    figures[method, seed] = evaluator.figures(method, seed, executed, decisions)
            finally:
                replanner.close()
        touched = any(run.contact is not None and run.method in PREDICTING for run in figures.values())
        goal_m = max(evaluator.distance_m(q, -1) for goal in scene.goals for q in goal.configurations)
        return PersonOutcome(
            tuple(figures[run] for run in task.runs),
            goal_m,
            min(evaluator.distance_m(scene.start, 0), goal_m),
            find_avoidance(evaluator, self.settings.replanner_config(motion, 0)) if touched else None,
        )


def _run(
    replanner: Replanner,
    scene: Scene,
    motion: Motion,
    method: str,
    told: Mapping[str, PredictedOccupancies],
    n_held: int,
) -> tuple[ExecutedMotion, list[Decision]]:
    predictor, _ = METHODS[method]
    begin_s, n_least = 0.0, len(motion)
    occupancies: Iterable[Occupancy]
    if predictor is None:
        occupancies = nobody(scene.grid, motion, n_held)
    elif method == "wait":
        # It plans at the very moment the motion is over.
        begin_s, n_least = motion.duration_s - replanner.config.period_s, 1
        occupancies = told[predictor].since(len(motion) - 1)
    else:
        occupancies = told[predictor]
    decisions = drive(replanner, scene.start, occupancies, n_least, begin_s)
    return ExecutedMotion.of(scene.start, decisions, begin_s), decisions


def method_figures(method: str, runs: Sequence[RunFigures]) -> dict[str, Any]:
    """Return what came of a method's runs among `runs`, which hold those of basic, too.

    Least, mean and median values are over the runs. `ratio` is the mean cost of basic through this method's, on the
    same persons and seeds, `ratio_swept` the same under the voxels really swept, and `ratio_reached` the same over the
    runs that reached a goal and whose counterpart of basic did: who stops on the way costs little. A run that reaches
    no goal counts as infinitely late.
    """
    mine, basic = ([run for run in runs if run.method == name] for name in (method, BASIC))
    cost, swept = np.array([run.cost for run in mine]), np.array([run.cost_swept for run in mine])
    distance, step_ms = (np.array([getattr(run, of) for run in mine]) for of in ("least_distance_m", "step_ms"))
    timed = step_ms[np.isfinite(step_ms)]
    theirs = {(run.scene, run.motion, run.seed): run.cost for run in basic if run.goal is not None}
    pairs = [
        (theirs[run.scene, run.motion, run.seed], run.cost)
        for run in mine
        if run.goal is not None and (run.scene, run.motion, run.seed) in theirs
    ]
    return {
        "method": method,
        "runs": len(mine),
        "reached": sum(run.goal is not None for run in mine),
        "contacts": sum(run.contact is not None for run in mine),
        "cost_mean": float(cost.mean()),
        "cost_sd": float(cost.std(ddof=1)) if len(cost) > 1 else 0.0,
        "cost_median": float(np.median(cost)),
        "cost_swept_mean": float(swept.mean()),
        "ratio": _ratio(np.mean([run.cost for run in basic]) if basic else np.nan, cost.mean()),
        "ratio_swept": _ratio(np.mean([run.cost_swept for run in basic]) if basic else np.nan, swept.mean()),
        "ratio_reached": _ratio(sum(b for b, _ in pairs), sum(m for _, m in pairs)),
        "least_distance_m": float(distance.min()),
        "median_distance_m": float(np.median(distance)),
        "clearance_m": min(run.clearance_m for run in mine),
        "time_to_goal_s": float(np.median([run.time_to_goal_s for run in mine])),
        "execution_s": float(np.median([run.execution_s for run in mine])),
        "step_ms": float(np.median(timed)) if len(timed) else np.nan,
    }


def _ratio(basic: float | np.floating[Any], mine: float | np.floating[Any]) -> float:
    return float(basic / mine) if mine > 0.0 else np.nan
