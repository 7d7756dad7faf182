"""The arm beside one person, by every method and seed: the runs that Table I and its extension are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from humanpred_ros.evaluation.direct_run import drive
from humanpred_ros.evaluation.interference.avoidance import Avoidance, find_avoidance
from humanpred_ros.evaluation.interference.measures import RunFigures, Witness
from humanpred_ros.evaluation.interference.motion import ExecutedMotion
from humanpred_ros.evaluation.interference.occupancies import PredictedOccupancies, nobody
from humanpred_ros.evaluation.interference.world import RunSettings, World
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import MultiGoalReplanner
from humanpred_ros.robot.scene import Scene

#: What the arm goes by: the predictor that tells it (None: nobody), and what to call that.
METHODS: Mapping[str, tuple[str | None, str]] = MappingProxyType(
    {
        "ours": ("forecast", "the default predictor, forecast, with the classifier forest"),
        "ours_p1": ("swept_volume", "P1's predictor, swept_volume, with the classifier gmm"),
        "current": ("current", "current occupancy only: the body where it is now"),
        "wait": ("current", "rests until the human's motion is over, then goes by the last posture"),
        "basic": (None, "smoothness and obstacles only: knows of no human"),
    }
)
#: Methods that predict: of their runs every contact is looked into.
PREDICTING = ("ours", "ours_p1")
#: Judges every run by its prediction after the last posture, as in P1's Table I.
_JUDGE = "swept_volume"


@dataclass(frozen=True)
class RunTask:
    """What is to be run with one person in one scene.

    Attributes:
        scene: name.
        motion: name, `class/index`.
        runs: (method, seed) of each run.
    """

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
        methods = {method for method, _ in task.runs}
        predictors = {METHODS[method][0] for method in methods} | {_JUDGE}
        told = {name: self.world.told(name, scene, motion, n_held) for name in sorted(filter(None, predictors))}
        final = told[_JUDGE].after(len(motion) - 1)
        witness = Witness(scene, self.world.human, motion, final, self.world.swept(scene, motion), n_held)
        figures: dict[tuple[str, int], RunFigures] = {}
        for seed in dict.fromkeys(seed for _, seed in task.runs):
            replanner = MultiGoalReplanner.for_scene(scene, self.settings.replanner_config(motion, seed))
            try:
                for method in (method for method, its_seed in task.runs if its_seed == seed):
                    executed, decisions = self._run(replanner, scene, motion, method, told, n_held)
                    figures[method, seed] = witness.judge(method, seed, executed, decisions)
            finally:
                replanner.close()
        touched = any(run.contact is not None and run.method in PREDICTING for run in figures.values())
        config = self.settings.replanner_config(motion, 0)
        goal_m = max(_distance_m(witness, q, -1) for goal in scene.goals for q in goal.configurations)
        return PersonOutcome(
            tuple(figures[run] for run in task.runs),
            goal_m,
            min(_distance_m(witness, scene.start, 0), goal_m),
            find_avoidance(witness, config) if touched else None,
        )

    def _run(
        self,
        replanner: MultiGoalReplanner,
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


def _distance_m(witness: Witness, q: FloatArray, posture: int) -> float:
    q_arm = np.repeat(q[None], len(witness.t_s), axis=0)
    return float(witness.meter.measure(q_arm).distance_m[posture])
