"""Which of a step's paths is executed, and why: line 6 of P1's Algorithm 1, and what is done where none can be."""

from __future__ import annotations

from dataclasses import replace

from humanpred_ros.planning.decision import ARRIVED, KEEP, REPLAN, Decision
from humanpred_ros.planning.step import Candidate, Step
from humanpred_ros.planning.waiting import wait

#: Begins the reason of a step that could not be planned.
NO_TIME = "the deadline left no time for a single update"


def decide(step: Step) -> Decision:
    """Return the decision of a step: the best path that can be executed, or what to do without one."""
    chosen, leave = step.state.chosen, ""
    if chosen is not None and step.state.at_goal(step.t_switch_s):
        leave = step.disabled(chosen) or step.person.rest_conflict(step.q)
        if not leave:
            arriving = step.executing.end_s > step.seen_s
            action, reason = (KEEP, f"about to arrive at {chosen}") if arriving else (ARRIVED, f"at {chosen}")
            return step.decision(action, reason, chosen, reports=(step.report_at_goal(chosen),))
    step.plan_to_goals()  # line 5
    considered = [candidate.report for candidate in step.candidates if not candidate.report.set_aside]
    if considered and all(report.iterations == 0 for report in considered) and step.late:
        return wait(step, NO_TIME)
    for candidate in step.ranked():  # line 6
        goes_on = candidate.executing and not step.state.retime
        trajectory = step.executing if goes_on else step.timed(candidate.report.path)
        trouble = step.trouble(trajectory)
        if trouble:
            candidate.report = replace(candidate.report, set_aside=trouble)
        elif goes_on:
            return step.decision(KEEP, "no better path than the one being executed", candidate.name)
        else:
            return step.decision(REPLAN, _why(step, candidate, leave), candidate.name, trajectory)
    refused = "; ".join(f"{candidate.name}: {candidate.report.obstacle_to_choice}" for candidate in step.candidates)
    return wait(step, f"no path can be executed ({refused})")


def _why(step: Step, candidate: Candidate, leave: str) -> str:
    """Return why a goal's path is to be executed; `leave` is why the robot must leave the goal it is at."""
    chosen, report = step.state.chosen, candidate.report
    if chosen is None:
        return f"{report.name} is the cheapest goal"
    if report.name == chosen:
        if candidate.executing:
            return f"the same path to {report.name} at another speed"
        return f"a better path to {report.name}" if step.state.leads_to == chosen else f"a way to {report.name} again"
    if leave:
        return f"leaves {chosen}: {leave}"
    old = next(other.report for other in step.candidates if other.name == chosen)
    if not old.eligible:
        return f"{chosen} cannot be worked on: {old.obstacle_to_choice}"
    return f"{report.name} costs {report.selection_cost:.4f}, {chosen} {old.selection_cost:.4f}"
