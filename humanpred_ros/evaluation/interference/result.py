"""The figures of an evaluation of interference: what is printed, drawn and written as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from humanpred_ros.evaluation.interference.avoidance import Avoidance
from humanpred_ros.evaluation.interference.measures import Contact, RunFigures
from humanpred_ros.evaluation.interference.reference import PublishedRow
from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.target import Target

BASIC = "basic"


@dataclass(frozen=True)
class MethodFigures:
    """What came of the runs of one method.

    Attributes:
        method: its name.
        runs: how many.
        reached: of these, how many ended at a goal.
        contacts: of these, in how many the arm's spheres touched the human.
        cost_mean, cost_sd: of the executed motion under P1's final prediction (sd with n - 1).
        cost_median: the same.
        cost_swept_mean: the mean under the voxels really swept.
        ratio, ratio_swept: mean cost of basic through this method's, on the same persons and seeds; NaN without
            basic.
        ratio_reached: the same over the runs that reached a goal and whose counterpart of basic did: who stops on the
            way costs little.
        least_distance_m, median_distance_m: to the human, least of all runs, and median of the runs' least.
        clearance_m: least to table and objects of all runs.
        time_to_goal_s: median; a run that reached none counts as infinitely late.
        execution_s: median.
        step_ms: median time of a replanning step, machine-dependent.
    """

    method: str
    runs: int
    reached: int
    contacts: int
    cost_mean: float
    cost_sd: float
    cost_median: float
    cost_swept_mean: float
    ratio: float
    ratio_swept: float
    ratio_reached: float
    least_distance_m: float
    median_distance_m: float
    clearance_m: float
    time_to_goal_s: float
    execution_s: float
    step_ms: float

    @classmethod
    def of(cls, method: str, runs: Sequence[RunFigures]) -> MethodFigures:
        """Return the figures of a method's runs among `runs`, which hold those of basic, too."""
        mine = [run for run in runs if run.method == method]
        basic = [run for run in runs if run.method == BASIC]

        def values(get: Callable[[RunFigures], float], of: Sequence[RunFigures] = mine) -> np.ndarray[Any, Any]:
            return np.array([get(run) for run in of], dtype=np.float64)

        cost, swept = values(lambda run: run.cost), values(lambda run: run.cost_swept)
        basic_cost = values(lambda run: run.cost, basic).mean() if basic else np.nan
        basic_swept = values(lambda run: run.cost_swept, basic).mean() if basic else np.nan
        distance = values(lambda run: run.least_distance_m)
        step_ms = values(lambda run: run.step_ms)
        timed = step_ms[np.isfinite(step_ms)]
        return cls(
            method=method,
            runs=len(mine),
            reached=sum(run.goal is not None for run in mine),
            contacts=sum(run.contact is not None for run in mine),
            cost_mean=float(cost.mean()),
            cost_sd=float(cost.std(ddof=1)) if len(cost) > 1 else 0.0,
            cost_median=float(np.median(cost)),
            cost_swept_mean=float(swept.mean()),
            ratio=_ratio(basic_cost, cost.mean()),
            ratio_swept=_ratio(basic_swept, swept.mean()),
            ratio_reached=_ratio_reached(basic, mine),
            least_distance_m=float(distance.min()),
            median_distance_m=float(np.median(distance)),
            clearance_m=float(values(lambda run: run.clearance_m).min()),
            time_to_goal_s=float(np.median(values(lambda run: run.time_to_goal_s))),
            execution_s=float(np.median(values(lambda run: run.execution_s))),
            step_ms=float(np.median(timed)) if len(timed) else np.nan,
        )


@dataclass(frozen=True)
class Comparison:
    """All methods beside the same persons.

    Attributes:
        title: which persons.
        persons: how many, one for each motion and scene.
        bound_m: median over persons of the largest least distance that a run can keep which ends at a goal.
        methods: side by side.
    """

    title: str
    persons: int
    bound_m: float
    methods: tuple[MethodFigures, ...]

    @classmethod
    def of(
        cls, title: str, methods: Sequence[str], persons: Sequence[tuple[Sequence[RunFigures], float]]
    ) -> Comparison:
        """Return the comparison; each person comes with the runs beside it and the bound."""
        runs = [run for some, _ in persons for run in some]
        bound_m = float(np.median([bound for _, bound in persons]))
        return cls(title, len(persons), bound_m, tuple(MethodFigures.of(method, runs) for method in methods))

    def figures(self, method: str) -> MethodFigures | None:
        """Return the figures of a method, None if it was not run."""
        return next((figures for figures in self.methods if figures.method == method), None)


@dataclass(frozen=True)
class TableRow:
    """One human trajectory of Table I.

    Attributes:
        number: its running number in the library, P1's global id.
        motion: its name.
        methods: figures by method.
        published: P1's, None if they do not lie beside the library.
    """

    number: int
    motion: str
    methods: Mapping[str, MethodFigures]
    published: PublishedRow | None


@dataclass(frozen=True)
class ContactReport:
    """One run in which the arm's spheres touched the human.

    Attributes:
        scene, motion, method, seed: which.
        contact: the first.
        avoidance: whether it could have been avoided; None where it was not looked into (methods that do not
            predict, beside persons that none that do touched).
    """

    scene: str
    motion: str
    method: str
    seed: int
    contact: Contact
    avoidance: Avoidance | None


@dataclass(frozen=True)
class UnreachedReport:
    """One run of a predicting method that did not end at a goal.

    Attributes:
        scene, motion, method, seed: which.
        goal_m: distance that the person in the last posture leaves an arm at a goal; at the goal where it is largest.
        ended: last decision, with its reason.
    """

    scene: str
    motion: str
    method: str
    seed: int
    goal_m: float
    ended: str


@dataclass(frozen=True)
class InterferenceEvaluation:
    """The whole evaluation.

    Attributes:
        library: facts about it.
        settings: everything the figures depend on.
        machine: what the times depend on.
        table1: P1's Table I; empty if it was left out.
        comparison: over many motions, first all of them, then parts; empty if it was left out.
        contacts: one by one.
        unreached: runs of predicting methods that did not end at a goal, one by one.
        targets: side by side.
        runs: all of them.
    """

    library: Mapping[str, Any]
    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    table1: tuple[TableRow, ...]
    comparison: tuple[Comparison, ...]
    contacts: tuple[ContactReport, ...]
    unreached: tuple[UnreachedReport, ...]
    targets: tuple[Target, ...]
    runs: tuple[RunFigures, ...]

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain values."""
        value: dict[str, Any] = plain(self)
        for report, made in zip(value["contacts"], self.contacts, strict=True):
            report["avoidable"] = None if made.avoidance is None else made.avoidance.avoidable
        return value


def _ratio_reached(basic: Sequence[RunFigures], mine: Sequence[RunFigures]) -> float:
    theirs = {(run.scene, run.motion, run.seed): run.cost for run in basic if run.goal is not None}
    pairs = [
        (theirs[run.scene, run.motion, run.seed], run.cost)
        for run in mine
        if run.goal is not None and (run.scene, run.motion, run.seed) in theirs
    ]
    return _ratio(sum(b for b, _ in pairs), sum(m for _, m in pairs))


def _ratio(basic: float, mine: float) -> float:
    return float(basic / mine) if mine > 0.0 else np.nan
