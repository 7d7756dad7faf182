"""The figures of one run that decide whether it went well: goals chosen, distances kept, time taken."""

from __future__ import annotations

import dataclasses
import math
import re
from collections import Counter

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.reliability import measure_calibration
from humanpred_ros.viewing.run import WHOLE_REACH_PERCENT, Run
from humanpred_ros.viewing.run_summary import (
    Belief,
    Closest,
    Interruption,
    LatencyFigures,
    Reached,
    Recognised,
    RunSummary,
    StepRow,
    Switch,
)
from humanpred_ros.viewing.tracks import RobotTrack
from humanpred_ros.viewing.workcell import Clearance, Workcell, load_workcell, measure_clearance

#: Largest joint error at which a goal counts as reached.
GOAL_TOLERANCE_RAD = 0.02
#: Actions that change what the arm does; they end a hold or an evasion, as far as they are not the same again.
_SENT_ON = ("replan", "arrived", "hold", "evade")
#: Stamps of the last posture of the reach may round up.
_STAMP_TOLERANCE_S = 1e-6


def summarise(run: Run, workcell: Workcell | None = None, clearance: Clearance | None = None) -> RunSummary:
    """Return the figures of a run; what cannot be evaluated is None, with the reason among the notes.

    Args:
        run: as read by `read_run`.
        workcell: scene, arm and human; found by the run's facts if None.
        clearance: distances already measured with this workcell; measured if None.
    """
    workcell = workcell or load_workcell(run)
    clearance = clearance or measure_clearance(run, workcell)
    calibration = measure_calibration(run, workcell)
    reached = _reached(run.robot, workcell)
    steps = _steps(run)
    return RunSummary(
        outcome=_outcome(run, reached),
        facts=dict(run.facts),
        duration_s=run.duration_s,
        wall_s=run.wall_s,
        motion_duration_s=run.motion_duration_s,
        goals=run.goal_names,
        steps=steps,
        switches=_switches(run, steps),
        holds=_interruptions(run, "hold"),
        evasions=_interruptions(run, "evade"),
        actions=dict(Counter(decision.action for decision in run.decisions)),
        missed=sum(step.missed for step in steps),
        closest=_closest(run, clearance),
        recognised=_recognised(run),
        beliefs=tuple(_belief(run, movement) for movement in _movements(run)),
        calibration=calibration.parts,
        latency={latency.name: _figures(latency.delay_s) for latency in run.latencies},
        planning=_figures(np.array([step.compute_s for step in run.steps])),
        reached=reached,
        peak_velocity=_peak_velocity(run.robot, workcell),
        counts={
            "postures": len(run.postures),
            "occupancies": len(run.occupancy),
            "decisions": len(run.decisions),
            "trajectories": len(run.trajectories),
            "robot states": len(run.robot),
        },
        notes=(*run.notes, *workcell.notes, *calibration.notes),
    )


def _steps(run: Run) -> tuple[StepRow, ...]:
    rows, instead = [], ""
    for decision in run.decisions:
        if decision.action in _SENT_ON:  # others keep to what the arm does
            instead = decision.action if decision.action in ("hold", "evade") else ""
        if not decision.is_step:
            continue
        best = run.posterior.at(decision.t_s)
        rows.append(
            StepRow(
                step=decision.step,
                action=decision.action,
                t_s=decision.t_s,
                percent=run.percent(decision.t_s),
                best_class=best[0] if best else None,
                best_probability=best[1] if best else None,
                costs={goal.name: _finite(goal.selection_cost) for goal in decision.goals},
                chosen=decision.chosen,
                switched=decision.switched,
                compute_ms=_finite(1e3 * decision.compute_s),
                margin=_finite(decision.margin),
                reason=decision.reason,
                out={goal.name: goal.set_aside or goal.message for goal in decision.goals if not goal.eligible},
                instead=instead,
            )
        )
    return tuple(rows)


def _switches(run: Run, steps: tuple[StepRow, ...]) -> tuple[Switch, ...]:
    return tuple(
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


def _closest(run: Run, clearance: Clearance) -> Closest | None:
    if not len(clearance):
        return None
    k = int(np.argmin(clearance.distance_m))
    t_s = float(clearance.t_s[k])
    return Closest(
        float(clearance.distance_m[k]), t_s, run.percent(t_s), clearance.robot_link[k], clearance.human_body[k]
    )


def _recognised(run: Run) -> Recognised | None:
    """Return when the class the replayed motion is labelled with (`class/index`) became the most probable for good."""
    found = re.fullmatch(r"(\d+)/\d+", run.facts.get("trajectory", ""))
    if found is None or not len(run.posterior) or int(found[1]) not in run.posterior.labels:
        return None
    column = run.posterior.labels.index(int(found[1]))
    for movement in _movements(run):
        since = _most_probable_since(run, movement, column)
        if since < movement.stop:
            t_s = float(run.posterior.t_s[since])
            return Recognised(int(found[1]), t_s, run.percent(t_s))
    return Recognised(int(found[1]), None, None)


def _belief(run: Run, movement: slice) -> Belief:
    """Return what the human was believed to do at the end of a movement."""
    track, last = run.posterior, movement.stop - 1
    best, unknown = int(track.probability[last].argmax()), track.unknown[movement]
    since_s = float(track.t_s[_most_probable_since(run, movement, best)])
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


def _movements(run: Run) -> tuple[slice, ...]:
    """Return the movements to be recognised: of a person at rest after the recorded one nothing is."""
    moving_s = run.motion_duration_s + _STAMP_TOLERANCE_S if run.motion_duration_s > 0.0 else np.inf
    return run.posterior.movements(moving_s)


def _most_probable_since(run: Run, movement: slice, column: int) -> int:
    """Return from which posterior of a movement on a class was the most probable one; its `stop` if not in the end."""
    other = np.flatnonzero(run.posterior.probability[movement].argmax(axis=1) != column)
    return int(movement.start) + (int(other[-1]) + 1 if len(other) else 0)


def _figures(delay_s: FloatArray) -> LatencyFigures:
    delay_ms = 1e3 * delay_s[np.isfinite(delay_s)]
    if not len(delay_ms):
        return LatencyFigures(0, None, None, None)
    median, p99 = np.percentile(delay_ms, [50.0, 99.0])
    return LatencyFigures(len(delay_ms), float(median), float(p99), float(delay_ms.max()))


def _reached(robot: RobotTrack, workcell: Workcell) -> Reached | None:
    """Return the goal the arm has stayed at until the end; full turns of endless joints do not count."""
    if workcell.arm is None or not len(robot):
        return None
    for name, configurations in workcell.goal_sets.items():
        error = np.min([np.abs(workcell.arm.difference(robot.q, q)).max(axis=1) for q in configurations], axis=0)
        if error[-1] <= GOAL_TOLERANCE_RAD:
            away = np.flatnonzero(error > GOAL_TOLERANCE_RAD)
            since = int(away[-1]) + 1 if len(away) else 0
            return Reached(name, float(robot.t_s[since]), float(error[-1]))
    return None


def _peak_velocity(robot: RobotTrack, workcell: Workcell) -> float | None:
    if not len(robot) or workcell.arm is None:
        return None
    return float((np.abs(robot.v) / workcell.arm.chain.velocity_limit).max())


def _outcome(run: Run, reached: Reached | None) -> str:
    if not len(run.postures) and not run.decisions:
        return "Nothing was recorded of the human or the planner: the run ended before it began."
    if reached is not None:
        return f"The arm reached the goal {reached.goal} after {reached.t_s:.2f} s."
    if run.decisions and run.decisions[-1].action == "hold":
        return f"The run ended in a hold: {run.decisions[-1].reason}."
    if run.decisions and run.decisions[-1].action == "evade":
        return f"The run ended while the arm moved out of the person's way: {run.decisions[-1].reason}."
    if not run.decisions:
        return "The planner made no decision."
    if any(decision.action == "arrived" for decision in run.decisions):
        return "The planner reports arrival; the recorded configurations do not confirm a goal."
    seen = run.seen_percent
    if seen is not None and seen < WHOLE_REACH_PERCENT:
        return f"The run was interrupted after {seen:.0f} % of the reach, before the arm reached a goal."
    return "The run ended before the arm reached a goal."


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
