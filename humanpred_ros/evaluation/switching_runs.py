"""The arm chooses between goals while a person moves: one run for every kind of occupancy that it may go by."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros.evaluation.simulation import RunSettings, World, drive, nobody
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.scene import Scene

#: What choices are made by: predictor, and what that is.
VARIANTS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "ours": ("forecast", "the default predictor, forecast, with the classifier forest"),
        "ours_p1": ("swept_volume", "P1's predictor, swept_volume, with the classifier gmm"),
        "current": ("current", "current occupancy only: the body where it is now"),
    }
)
CURRENT = "current"
#: Probability of what is going to be swept, told as a prediction: almost certain.
_EXPECTED = 0.99


@dataclass(frozen=True)
class SwitchTask:
    """One person, and the seeds of the runs of every variant."""

    scene: str
    motion: str
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class StepCosts:
    """One replanning step.

    Attributes:
        step: from 1.
        t_s: data time of the posture it follows from.
        costs: what the goals were compared by, by name; NaN where no plan was needed (the arm is at another goal)
            or none is possible.
        barred: why a goal could not be chosen whatever it costs, by name; without those that could.
        chosen: the goal worked on after it, None if that is none of the scene's.
        action: of the decision.
    """

    step: int
    t_s: float
    costs: dict[str, float]
    barred: dict[str, str]
    chosen: str | None
    action: str


@dataclass(frozen=True)
class ChoiceFigures:
    """One run's choices, one for each step from 1; a step that chooses no goal is skipped.

    Attributes:
        first, last: goals chosen first and last; None if none ever was.
        switches: changes from one goal to another.
        first_switch: step of the first of them, None if there is none.
        settled: step in which the final choice was made: from it on nothing changes; 1 if nothing ever did.
        returns: changes to a goal that had been chosen and left before. A - B - A is one: back and forth.
        right: whether the last choice is the right one.
        decided: step since when the right goal is chosen up to the end, None if the last choice is wrong.
        wrong_first: whether the first choice is wrong.
    """

    first: str | None
    last: str | None
    switches: int
    first_switch: int | None
    settled: int
    returns: int
    right: bool
    decided: int | None
    wrong_first: bool

    @classmethod
    def of(cls, choices: Sequence[str | None], right: str) -> ChoiceFigures:
        """Return the figures of a run's choices, step by step; `right` is the right goal."""
        chosen = [(step, goal) for step, goal in enumerate(choices, start=1) if goal is not None]
        left: set[str] = set()
        changes, returns = [], 0
        for (_, before), (step, goal) in itertools.pairwise(chosen):
            if goal != before:
                changes.append(step)
                left.add(before)
                returns += goal in left
        first, last = (chosen[0][1], chosen[-1][1]) if chosen else (None, None)
        settled = changes[-1] if changes else (chosen[0][0] if chosen else 1)
        return cls(
            first=first,
            last=last,
            switches=len(changes),
            first_switch=changes[0] if changes else None,
            settled=settled,
            returns=returns,
            right=last == right,
            decided=settled if last == right else None,
            wrong_first=first != right,
        )


@dataclass(frozen=True)
class VariantRun:
    """The choices of one run."""

    variant: str
    seed: int
    steps: tuple[StepCosts, ...]
    figures: ChoiceFigures


@dataclass(frozen=True)
class Person:
    """What the arm chose beside one person.

    Attributes:
        scene, motion: which.
        right: the goal that the same planner chooses at once if it is told what the body is going to sweep.
        default: the goal it chooses if nobody is there.
        runs: by variant and seed.
    """

    scene: str
    motion: str
    right: str
    default: str
    runs: tuple[VariantRun, ...]

    @property
    def conflict(self) -> bool:
        """Whether the person takes the goal the arm would choose: only then is there anything to be decided."""
        return self.right != self.default

    def run(self, variant: str, seed: int = 0) -> VariantRun:
        """Return one run (KeyError if there is none such)."""
        for run in self.runs:
            if (run.variant, run.seed) == (variant, seed):
                return run
        raise KeyError(variant, seed)


class Choosing:
    """Carries a library to where runs are made; called with a task it returns what the arm chose.

    Same library, settings and task give the same choices.
    """

    def __init__(self, library: MotionLibrary, settings: RunSettings) -> None:
        self.world, self.settings = World(library, settings), settings

    def __call__(self, task: SwitchTask) -> Person:
        """Make the runs of one task. Raises what training, prediction and planning raise."""
        scene, motion = self.world.scene(task.scene), self.world.library.find(task.motion)
        # P1's last step comes after the last posture; by the stamps it is due a moment later.
        n_held = math.ceil(motion.duration_s / self.settings.steps / motion.period_s) + 1
        told = {variant: self.world.told(name, scene, motion, n_held) for variant, (name, _) in VARIANTS.items()}
        empty = next(nobody(scene.grid, motion, 0))
        swept = self.world.swept(scene, motion)
        runs: list[VariantRun] = []
        right = default = ""
        for seed in task.seeds:
            replanner = Replanner.for_scene(scene, self.settings.replanner_config(motion, seed))
            try:
                if not runs:
                    right, default = (_at_once(replanner, scene, known) for known in (swept, empty))
                for variant, occupancies in told.items():
                    decisions = drive(replanner, scene.start, occupancies, len(motion) + n_held)
                    steps = step_costs(scene, decisions, replanner.config.period_s, self.settings.steps)
                    figures = ChoiceFigures.of([step.chosen for step in steps], right)
                    runs.append(VariantRun(variant, seed, steps, figures))
            finally:
                replanner.close()
        return Person(task.scene, task.motion, right, default, tuple(runs))


def step_costs(scene: Scene, decisions: list[Decision], period_s: float, n_steps: int) -> tuple[StepCosts, ...]:
    """Return what was compared and chosen in each replanning step of a motion.

    Step k is the first decision from k periods on, up to the next step, for which something was planned; if there is
    none (an arm at its goal may rest), the first of them.
    """
    names = [goal.name for goal in scene.goals]
    steps = []
    for step in range(1, n_steps + 1):
        begin_s, end_s = step * period_s - 1e-6, (step + 1) * period_s - 1e-6
        within = [decision for decision in decisions if begin_s <= decision.stamp_s < end_s]
        if not within:
            continue
        decision = next((decision for decision in within if decision.goals), within[0])
        valid = {report.name: report.selection_cost for report in decision.goals if report.valid}
        costs = {name: valid.get(name, math.nan) for name in names}
        chosen = decision.chosen if decision.chosen in names else None
        barred = {report.name: report.obstacle_to_choice for report in decision.goals if not report.eligible}
        steps.append(StepCosts(step, decision.stamp_s, costs, barred, chosen, decision.action))
    return tuple(steps)


def _at_once(replanner: Replanner, scene: Scene, occupancy: Occupancy) -> str:
    """Return the goal chosen in the first step by an occupancy; the cheapest if none can be chosen."""
    replanner.start(scene.start, 0.0)
    # Told as what is going to be: what is certain the planner takes for where the body is now.
    expected = np.minimum(occupancy.probability, np.float32(_EXPECTED))
    known = Occupancy(occupancy.grid, expected, replanner.config.period_s)
    decision = replanner.plan(known)
    names = [goal.name for goal in scene.goals]
    if decision.chosen in names:
        return str(decision.chosen)
    costs = {report.name: report.selection_cost for report in decision.goals}
    return min(names, key=lambda name: costs.get(name, math.inf))


def steps_earlier(ours: ChoiceFigures, other: ChoiceFigures, n_steps: int) -> int:
    """Return by how many steps `ours` decided rightly before `other`; never counts as one after the last."""
    never = n_steps + 1
    return (never if other.decided is None else other.decided) - (never if ours.decided is None else ours.decided)


def variant_figures(variant: str, persons: Sequence[Person], n_steps: int) -> dict[str, Any]:
    """Return the choices of one variant, seed 0, beside persons; quartiles are (25, 50, 75 %) over them."""
    mine = [person.run(variant).figures for person in persons]
    current = [person.run(CURRENT).figures for person in persons]
    pairs = list(zip(mine, current, strict=True))
    return {
        "variant": variant,
        "persons": len(mine),
        "right": sum(f.right for f in mine),
        "wrong_first": sum(f.wrong_first for f in mine),
        "recovered": sum(f.wrong_first and f.right for f in mine),
        "switched": sum(f.switches > 0 for f in mine),
        "returned": sum(f.returns > 0 for f in mine),
        "returned_often": sum(f.returns > 1 for f in mine),
        "settled": _quartiles([f.settled for f in mine]),
        "decided": _quartiles([n_steps + 1 if f.decided is None else f.decided for f in mine]),
        "settled_earlier": _quartiles([theirs.settled - f.settled for f, theirs in pairs]),
        "decided_earlier": _quartiles([steps_earlier(f, theirs, n_steps) for f, theirs in pairs]),
    }


def _quartiles(values: Sequence[int]) -> tuple[float, float, float]:
    low, middle, high = np.percentile(np.array(values, dtype=np.float64), [25.0, 50.0, 75.0])
    return float(low), float(middle), float(high)
