"""The figures of one run that decide whether it went well, as plain data that tables, files and reports share."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from humanpred_ros.viewing.figures import goal_colours
from humanpred_ros.viewing.recorded import JointTrack, LatencyFigures, RecordedDecision
from humanpred_ros.viewing.reliability import OccupancyCalibration, measure_calibration
from humanpred_ros.viewing.run import WHOLE_REACH_PERCENT, Run
from humanpred_ros.viewing.workcell import Clearance, Closest, Workcell, load_workcell, measure_clearance

#: Largest joint error at which a goal counts as reached.
GOAL_TOLERANCE_RAD = 0.02
#: Actions that change what the arm does; they end a hold or an evasion, as far as they are not the same again.
_SENT_ON = ("replan", "arrived", "hold", "evade")
#: Stamps of the last posture of the reach may round up.
_STAMP_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class StepRow:
    """One replanning step, 1-based as in P1."""

    step: int  #: its number, the planner's
    #: replan, keep (no better path was found), hold (no way was found), evade (out of the person's way) or missed
    action: str
    t_s: float  #: data time of the occupancy it was computed on
    percent: float | None  #: share of the human's motion over by then
    best_class: str | None  #: most probable class then, None without a posterior
    best_probability: float | None
    costs: Mapping[str, float | None]  #: selection cost per goal, None where it has none
    chosen: str  #: goal, empty if none
    switched: bool  #: the chosen goal differs from the previous step's
    compute_ms: float | None  #: wall time the step took, None if not told
    #: by how much the chosen goal was cheaper than the next one, negative where habit decided; None without a choice
    margin: float | None = None
    reason: str = ""  #: the planner's explanation
    out: Mapping[str, str] = field(default_factory=dict)  #: why goals could not be chosen, by name
    #: "hold" or "evade" where the arm did that rather than work on the chosen goal, by this step's decision or before
    instead: str = ""

    @property
    def missed(self) -> bool:
        """Whether it came too late to be carried out."""
        return self.action == "missed"

    @property
    def lost_to(self) -> str:
        """Why the arm did not work on the chosen goal because of it: missed, hold or evade; empty if it did."""
        return "missed" if self.missed else self.instead


@dataclass(frozen=True)
class Switch:
    """A change of the chosen goal."""

    step: int  #: 1-based number of the step that decided it
    step_in_effect: int  #: the step during which the robot acts on it, one later (P1 Fig. 4)
    t_s: float  #: data time of the decision
    percent: float | None  #: share of the human's motion over by then
    t_effect_s: float | None  #: when the new trajectory takes over, None if not told
    goal_before: str
    goal_after: str
    reason: str = ""  #: the planner's explanation


@dataclass(frozen=True)
class Interruption:
    """A time in which the arm works on no goal, for one reason: it stops, or moves out of the person's way.

    It lasts until the arm is sent on or another way, or the run ends; `decisions` says how often it was decided.
    """

    t_s: float
    until_s: float
    decisions: int
    reason: str


@dataclass(frozen=True)
class Recognised:
    """Since when the true class was the most probable one up to the end of a movement; None if it never was so.

    Of several movements the first such one counts: a recorded reach may come with its return.
    """

    true_class: str
    t_s: float | None
    percent: float | None


@dataclass(frozen=True)
class Belief:
    """What a movement of the human was believed to be in the end: a classifier may find several, with rest between."""

    from_s: float  #: first and last posterior that tell classes apart
    until_s: float
    best_class: str  #: the most probable class at the end, and its probability
    probability: float
    since_s: float  #: since when it was the most probable one up to then
    since_percent: float | None  #: share of the recorded motion over by then
    unknown: float  #: probability at the end that it is of no class, 0 from classifiers that do not consider it
    unknown_max: float  #: its maximum over the movement, and when that was
    unknown_max_s: float

    @property
    def rather_unknown(self) -> bool:
        """Whether no class at all is more probable than the most probable class."""
        return self.unknown > self.probability


@dataclass(frozen=True)
class Reached:
    """The goal the arm ended at: since when it has stayed there, and the final largest joint error."""

    goal: str
    t_s: float
    error_rad: float


@dataclass(frozen=True)
class RunSummary:
    """What is said of a run, in tables, files and reports; what cannot be evaluated is None, with a note."""

    outcome: str  #: one sentence
    facts: Mapping[str, str]  #: what the recorder was told about the run
    duration_s: float  #: data time
    wall_s: float
    motion_duration_s: float  #: of the human's motion
    goals: tuple[str, ...]  #: names, in the planner's order
    steps: tuple[StepRow, ...]
    switches: tuple[Switch, ...]
    holds: tuple[Interruption, ...]  #: when the arm stopped
    missed: int  #: number of replanning steps that came too late
    closest: Closest | None  #: over the whole run
    recognised: Recognised | None  #: how early the human's motion was, None if its true class is not known
    beliefs: tuple[Belief, ...]  #: what each movement was taken for, in time order; none without a posterior
    calibration: Mapping[str, OccupancyCalibration]  #: whether the occupancy came true, by part of the run
    latency: Mapping[str, LatencyFigures]  #: by name
    planning: LatencyFigures  #: wall time of one replanning step
    reached: Reached | None  #: None if the arm did not end at a goal
    peak_velocity: float | None  #: largest joint speed as a share of the joint's limit
    counts: Mapping[str, int]  #: postures, occupancies, decisions, trajectories and robot states recorded
    evasions: tuple[Interruption, ...] = ()  #: when the arm moved out of the person's way
    actions: Mapping[str, int] = field(default_factory=dict)  #: how many decisions were to do what
    notes: tuple[str, ...] = ()  #: what could not be read or evaluated, and why

    def to_json(self) -> str:
        """Return the summary as strict JSON: numbers that are not finite become null."""
        return json.dumps(_plain(dataclasses.asdict(self)), indent=2, allow_nan=False, ensure_ascii=False) + "\n"

    @property
    def interruptions(self) -> list[tuple[str, Interruption]]:
        """When the arm worked on no goal, with what it did instead, in time order."""
        both = [("stops", hold) for hold in self.holds] + [("moves aside", evasion) for evasion in self.evasions]
        return sorted(both, key=lambda entry: entry[1].t_s)


@dataclass(frozen=True)
class Analysis:
    """A run with all that tables, plots and the report tell of it."""

    run: Run
    workcell: Workcell
    clearance: Clearance
    summary: RunSummary

    @cached_property
    def colours(self) -> dict[str, str]:
        """The colour of each goal."""
        return goal_colours(dict.fromkeys([*self.workcell.goals, *self.summary.goals]))


def analyse(run: Run, workcell: Workcell | None = None) -> Analysis:
    """Measure a run in its workcell; found by the run's facts if None."""
    workcell = workcell or load_workcell(run)
    clearance = measure_clearance(run, workcell)
    calibration, troubles = measure_calibration(run, workcell)
    steps = _steps(run)
    movements = _movements(run)
    reached = _reached(run.robot, workcell)
    summary = RunSummary(
        outcome=_outcome(run, reached),
        facts=dict(run.facts),
        duration_s=run.duration_s,
        wall_s=run.wall_s,
        motion_duration_s=run.motion_duration_s,
        goals=run.goal_names,
        steps=steps,
        switches=tuple(
            Switch(
                step=row.step,
                step_in_effect=row.step + 1,
                t_s=row.t_s,
                percent=row.percent,
                t_effect_s=_finite(decision.t_switch_s),
                goal_before=decision.previous,
                goal_after=decision.chosen,
                reason=decision.reason,
            )
            # A missed step is not carried out: the robot stays with the goal it had.
            for row, decision in zip(steps, run.steps, strict=True)
            if row.switched and not row.missed and decision.previous
        ),
        holds=_interruptions(run, "hold"),
        evasions=_interruptions(run, "evade"),
        actions=dict(Counter(decision.action for decision in run.decisions)),
        missed=sum(step.missed for step in steps),
        closest=clearance.closest,
        recognised=_recognised(run, movements),
        beliefs=tuple(_belief(run, movement) for movement in movements),
        calibration=calibration,
        latency={latency.name: latency.figures for latency in run.latencies},
        planning=run.planning.figures,
        reached=reached,
        peak_velocity=_peak_velocity(run.robot, workcell),
        counts={
            "postures": len(run.postures),
            "occupancies": len(run.occupancy),
            "decisions": len(run.decisions),
            "trajectories": len(run.trajectories),
            "robot states": len(run.robot),
        },
        notes=(*run.notes, *workcell.notes, *troubles),
    )
    return Analysis(run, workcell, clearance, summary)


def _steps(run: Run) -> tuple[StepRow, ...]:
    rows, instead = [], ""
    for decision in run.decisions:
        if decision.action in _SENT_ON:  # others keep to what the arm does
            instead = decision.action if decision.action in ("hold", "evade") else ""
        if decision.is_step:
            rows.append(_step(run, decision, instead))
    return tuple(rows)


def _step(run: Run, decision: RecordedDecision, instead: str) -> StepRow:
    best_class, best_probability = run.posterior.at(decision.t_s)
    return StepRow(
        step=decision.step,
        action=decision.action,
        t_s=decision.t_s,
        percent=run.percent(decision.t_s),
        best_class=best_class,
        best_probability=best_probability,
        costs={goal.name: _finite(goal.selection_cost) for goal in decision.goals},
        chosen=decision.chosen,
        switched=decision.switched,
        compute_ms=_finite(1e3 * decision.compute_s),
        margin=_finite(decision.margin),
        reason=decision.reason,
        out={goal.name: goal.set_aside or goal.message for goal in decision.goals if not goal.eligible},
        instead=instead,
    )


def _interruptions(run: Run, action: str) -> tuple[Interruption, ...]:
    """Return when the arm held or evaded: until it was sent on or sent another way, or for another trouble."""
    found: list[Interruption] = []
    open_kind: str | None = None

    def close(t_s: float) -> None:
        if open_kind is not None:
            found[-1] = dataclasses.replace(found[-1], until_s=max(found[-1].t_s, t_s))

    for decision in run.decisions:
        if decision.action == action:
            # Ages, distances and goals inside a reason differ from one to the next; its first words name the trouble.
            kind = re.split(r"[:;(]", decision.reason, maxsplit=1)[0].strip()
            if kind == open_kind:
                found[-1] = dataclasses.replace(found[-1], decisions=found[-1].decisions + 1)
            else:
                close(decision.begins_s)
                found.append(Interruption(decision.begins_s, decision.begins_s, 1, decision.reason))
                open_kind = kind
        elif decision.action in _SENT_ON:
            close(decision.begins_s)
            open_kind = None
    close(run.duration_s)
    return tuple(found)


def _movements(run: Run) -> tuple[slice, ...]:
    """Return the movements to be recognised: of a person at rest after the recorded one nothing is."""
    moving_s = run.motion_duration_s + _STAMP_TOLERANCE_S if run.motion_duration_s > 0.0 else np.inf
    return run.posterior.movements(moving_s)


def _recognised(run: Run, movements: tuple[slice, ...]) -> Recognised | None:
    """Return when the class the replayed motion is labelled with (`class/index`) became the most probable for good."""
    label = run.facts.get("trajectory", "").rpartition("/")[0]
    if not len(run.posterior) or label not in run.posterior.labels:
        return None
    column = run.posterior.labels.index(label)
    for movement in movements:
        since = run.posterior.most_probable_since(movement, column)
        if since < movement.stop:
            t_s = float(run.posterior.t_s[since])
            return Recognised(label, t_s, run.percent(t_s))
    return Recognised(label, None, None)


def _belief(run: Run, movement: slice) -> Belief:
    track, last = run.posterior, movement.stop - 1
    best, unknown = int(track.probability[last].argmax()), track.unknown[movement]
    since_s = float(track.t_s[track.most_probable_since(movement, best)])
    return Belief(
        from_s=float(track.t_s[movement.start]),
        until_s=float(track.t_s[last]),
        best_class=track.labels[best],
        probability=float(track.probability[last, best]),
        since_s=since_s,
        since_percent=run.percent(since_s),
        unknown=float(unknown[-1]),
        unknown_max=float(unknown.max()),
        unknown_max_s=float(track.t_s[movement][unknown.argmax()]),
    )


def _reached(robot: JointTrack, workcell: Workcell) -> Reached | None:
    """Return the goal the arm has stayed at until the end; full turns of endless joints do not count."""
    if workcell.arm is None or not len(robot):
        return None
    for name, configurations in workcell.goals.items():
        error = np.min([np.abs(workcell.arm.difference(robot.q, q)).max(axis=1) for q in configurations], axis=0)
        if error[-1] <= GOAL_TOLERANCE_RAD:
            away = np.flatnonzero(error > GOAL_TOLERANCE_RAD)
            since = int(away[-1]) + 1 if len(away) else 0
            return Reached(name, float(robot.t_s[since]), float(error[-1]))
    return None


def _peak_velocity(robot: JointTrack, workcell: Workcell) -> float | None:
    if not len(robot) or workcell.arm is None:
        return None
    return float((np.abs(robot.v) / workcell.arm.chain.velocity_limit).max())


def _outcome(run: Run, reached: Reached | None) -> str:
    if not len(run.postures) and not run.decisions:
        return "Nothing was recorded of the human or the planner: the run ended before it began."
    if reached is not None:
        return f"The arm reached the goal {reached.goal} after {reached.t_s:.2f} s."
    if not run.decisions:
        return "The planner made no decision."
    last = run.decisions[-1]
    if last.action == "hold":
        return f"The run ended in a hold: {last.reason}."
    if last.action == "evade":
        return f"The run ended while the arm moved out of the person's way: {last.reason}."
    if any(decision.action == "arrived" for decision in run.decisions):
        return "The planner reports arrival; the recorded configurations do not confirm a goal."
    seen = run.seen_percent
    if seen is not None and seen < WHOLE_REACH_PERCENT:
        return f"The run was interrupted after {seen:.0f} % of the reach, before the arm reached a goal."
    return "The run ended before the arm reached a goal."


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
