"""The arm chooses between goals while a person moves: one run for every kind of occupancy that it may go by."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.evaluation.simulation import METHODS, RunSettings, World, drive, nobody
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.scene import Scene

#: What choices are made by, of `METHODS`.
VARIANTS = ("ours", "ours_p1", "current")
CURRENT = "current"
#: What choices are made by in P1's Fig. 9, by our names and those of its file.
FIG9_VARIANTS = {"prediction": "prediction", "current": "current_occupancy"}
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
    """One replanning step."""

    step: int  #: from 1
    t_s: float  #: data time of the posture it follows from
    #: what the goals were compared by, by name; NaN where no plan was needed (the arm is at another goal) or none is
    #: possible
    costs: dict[str, float]
    barred: dict[str, str]  #: why a goal could not be chosen whatever it costs, by name; without those that could
    chosen: str | None  #: the goal worked on after it, None if that is none of the scene's
    action: str  #: of the decision


@dataclass(frozen=True)
class ChoiceFigures:
    """One run's choices, one for each step from 1; a step that chooses no goal is skipped."""

    first: str | None  #: goals chosen first and last; None if none ever was
    last: str | None
    switches: int  #: changes from one goal to another
    first_switch: int | None  #: step of the first of them, None if there is none
    settled: int  #: step in which the final choice was made: from it on nothing changes; 1 if nothing ever did
    returns: int  #: changes to a goal that had been chosen and left before. A - B - A is one: back and forth.
    right: bool  #: whether the last choice is the right one
    decided: int | None  #: step since when the right goal is chosen up to the end, None if the last choice is wrong
    wrong_first: bool  #: whether the first choice is wrong

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
    """What the arm chose beside one person."""

    scene: str  #: which
    motion: str
    right: str  #: the goal that the same planner chooses at once if it is told what the body is going to sweep
    default: str  #: the goal it chooses if nobody is there
    runs: tuple[VariantRun, ...]  #: by variant and seed

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
        told_by = {variant: str(METHODS[variant][0]) for variant in VARIANTS}
        seen = {variant: self.world.predictions(name, scene, motion, n_held) for variant, name in told_by.items()}
        empty = next(nobody(scene.grid, motion, 0))
        swept = self.world.swept(scene, motion)
        runs: list[VariantRun] = []
        right = default = ""
        for seed in task.seeds:
            with closing(Replanner.for_scene(scene, self.settings.replanner_config(motion, seed))) as replanner:
                if not runs:
                    right, default = (_at_once(replanner, scene, known) for known in (swept, empty))
                for variant, occupancies in seen.items():
                    decisions = drive(replanner, scene.start, occupancies.since(0), len(motion) + n_held)
                    steps = step_costs(scene, decisions, replanner.config.period_s, self.settings.steps)
                    figures = ChoiceFigures.of([step.chosen for step in steps], right)
                    runs.append(VariantRun(variant, seed, steps, figures))
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


def first_switch(costs: Sequence[Sequence[float]] | FloatArray) -> int | None:
    """Return the step, from 1, in which another goal than in the first is cheapest; None if none ever is."""
    cheapest = np.argmin(np.asarray(costs), axis=1)
    changed = np.flatnonzero(cheapest != cheapest[0])
    return int(changed[0]) + 1 if len(changed) else None


class Curve(NamedTuple):
    """The goals' costs in one run, as in P1's Fig. 9."""

    title: str  #: what the choices are made by
    goals: Sequence[str]  #: names
    costs: FloatArray  #: (N, goals) by step; NaN where there are none
    chosen: Sequence[int]  #: (N,) number of the goal worked on after each step, -1 for none
    switch: int | None  #: step of the first switch, None if there is none


def curves(person: Person, goals: Sequence[str], published: Mapping[str, Any] | None) -> list[Curve]:
    """Return the costs of seed 0 by variant, then the published ones, as `switching.read_fig9` gives them."""
    found = []
    for variant in VARIANTS:
        run = person.run(variant)
        costs = np.array([[step.costs[goal] for goal in goals] for step in run.steps])
        chosen = [goals.index(step.chosen) if step.chosen is not None else -1 for step in run.steps]
        found.append(Curve(variant, goals, costs, chosen, run.figures.first_switch))
    for name in FIG9_VARIANTS if published else ():
        costs = np.asarray((published or {})[name])
        chosen = np.argmin(costs, axis=1).tolist()
        found.append(Curve(f"published {name}", (published or {})["goals"], costs, chosen, first_switch(costs)))
    return found


#: Figures of a variant: key, title, and what is counted of (run, run by current occupancy, number of steps): yes or no
#: are counted over persons, numbers of steps get quartiles.
SUMMARY: tuple[tuple[str, str, Callable[[ChoiceFigures, ChoiceFigures, int], bool | int]], ...] = (
    ("right", "right in the end", lambda f, current, n: f.right),
    ("wrong_first", "wrong first", lambda f, current, n: f.wrong_first),
    ("recovered", "  of these right in the end", lambda f, current, n: f.wrong_first and f.right),
    ("switched", "changed the goal", lambda f, current, n: f.switches > 0),
    ("returned", "returned to a goal left before", lambda f, current, n: f.returns > 0),
    ("returned_often", "  more than once", lambda f, current, n: f.returns > 1),
    ("settled", "step of the final choice", lambda f, current, n: f.settled),
    ("decided", "right since step", lambda f, current, n: n + 1 if f.decided is None else f.decided),
    ("settled_earlier", "final choice: steps earlier than current", lambda f, current, n: current.settled - f.settled),
    ("decided_earlier", "right: steps earlier than current", steps_earlier),
)


def variant_figures(variant: str, persons: Sequence[Person], n_steps: int) -> dict[str, Any]:
    """Return `SUMMARY` of one variant, seed 0, beside persons; quartiles are (25, 50, 75 %) over them."""
    found: dict[str, Any] = {"variant": variant, "persons": len(persons)}
    for key, _, figure in SUMMARY:
        values = [figure(p.run(variant).figures, p.run(CURRENT).figures, n_steps) for p in persons]
        if isinstance(values[0], bool):
            found[key] = sum(values)
        else:
            found[key] = tuple(np.percentile(np.array(values, dtype=np.float64), [25.0, 50.0, 75.0]).tolist())
    return found
