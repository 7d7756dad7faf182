"""One replanning step: compare a path to every goal, and turn the best into a trajectory (P1 Alg. 1).

What is executed has been checked between its waypoints too: against obstacles and the arm itself, and for the hard
separation from the person. When no goal can be worked on, the arm waits where it is, or moves aside if the person
is likely to come there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.candidates import Candidate, Candidates, with_reason
from humanpred_ros.planning.decision import ARRIVED, EVADE, HOLD, KEEP, REPLAN, Decision, GoalReport
from humanpred_ros.planning.evasion import ways_aside
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.situation import Situation
from humanpred_ros.planning.timing.parameterisation import time_parameterise
from humanpred_ros.planning.timing.stopping import brake_along
from humanpred_ros.planning.timing.trajectory import TimedTrajectory
from humanpred_ros.planning.tools import Tools
from humanpred_ros.stomp.costs import Float32Array

#: What a timed trajectory may exceed the joint limits by, rad: corners are rounded off, and what is left of the old
#: velocity leads off the path for a moment.
_EXECUTION_SLACK_RAD = 0.005
#: A new way aside must keep this much more distance than the one the robot is on, m.
_BETTER_GAP_M = 0.02


class ReplanningStep:
    """Plans for one situation; makes a decision and changes nothing."""

    def __init__(
        self, tools: Tools, situation: Situation, person: Person, deadline: Callable[[], bool] | None = None
    ) -> None:
        self._tools, self._now, self._deadline = tools, situation, deadline
        self._planner, self._human = tools.planner(person.occupancy)
        self._person = person
        self._q, self._v, self._a = situation.executing.sample(situation.t_switch_s)
        self._candidates = Candidates(tools, situation, self._q, self._person, self._planner, self._human)

    def decide(self) -> Decision:
        """Return the decision of this step."""
        now = self._now
        leave = ""
        if now.arrived and now.chosen is not None:
            leave = self._person.comes_to(self._q)
            if not leave:
                report = self._candidates.arrived(now.chosen)
                if now.executing.end_s > now.stamp_s:
                    return self._decision(KEEP, f"about to arrive at {now.chosen}", now.chosen, (report,))
                return self._decision(ARRIVED, f"at {now.chosen}", now.chosen, (report,))
        candidates = list(self._candidates.plan(self._deadline))
        considered = [c.report for c in candidates if not c.report.set_aside]
        if considered and all(report.iterations == 0 for report in considered) and self._late():
            return self._wait("the deadline left no time for a single update", candidates)
        for k in self._ranking(candidates):
            candidate = candidates[k]
            if candidate.executing:
                trouble = self._trouble(now.executing)
                if not trouble:
                    reports = _reports(candidates)
                    return self._decision(
                        KEEP, "no better path than the one being executed", candidate.report.name, reports
                    )
            else:
                trajectory = self._timed(candidate.report.path)
                trouble = self._trouble(trajectory)
                if not trouble:
                    reports = _reports(candidates)
                    reason = self._why(candidate.report, candidates, leave)
                    return self._decision(REPLAN, reason, candidate.report.name, reports, trajectory)
            candidates[k] = with_reason(candidate, trouble)
        refused = "; ".join(f"{c.report.name}: {c.report.obstacle_to_choice}" for c in candidates)
        return self._wait(f"no path can be executed ({refused})", candidates)

    def rollouts(self) -> dict[str, Float32Array]:
        """Return the noisy trajectories (R, N, D) of each goal's last update, for pictures."""
        return self._candidates.rollouts()

    def _late(self) -> bool:
        return self._deadline is not None and self._deadline()

    def _ranking(self, candidates: Sequence[Candidate]) -> list[int]:
        """Return the eligible candidates, best first; the goal being worked on goes first unless clearly beaten."""
        cfg, now = self._tools.config, self._now
        order = [k for k, candidate in enumerate(candidates) if candidate.report.eligible]
        order.sort(key=lambda k: candidates[k].report.selection_cost)
        present = next((k for k in order if candidates[k].report.name == now.chosen), None)
        if present is None or order[0] == present:
            return order
        cost = candidates[present].report.selection_cost
        beaten = []
        for k in order[: order.index(present)]:
            other = candidates[k].report
            margin = cfg.switch_cost * (1 + now.left.get(other.name, 0))
            if other.selection_cost < (1.0 - cfg.switch_improvement) * cost - margin:
                beaten.append(k)
        return beaten + [present] + [k for k in order if k != present and k not in beaten]

    def _wait(self, reason: str, candidates: Sequence[Candidate]) -> Decision:
        """Go on with what is being executed if it still can be; else wait, aside if the person comes here."""
        now, reports = self._now, _reports(candidates)
        if now.leads_to is not None and now.executing.end_s > now.t_switch_s and not self._gone_bad():
            return self._decision(KEEP, reason + "; what is being executed still can", now.chosen, reports)
        stop = self._stop()
        end = self._q if stop is None else stop.q[-1]
        comes = self._person.comes_to(end)
        aside = now.leads_to is None and not now.held and now.executing.end_s > now.t_switch_s
        runs_into = (
            "" if stop is None or self._far_enough(stop) else "stopping alone would come too close to the person"
        )
        if not (comes or runs_into or aside):
            return self._decision(HOLD, reason, now.chosen, reports, stop)
        why = comes or runs_into
        trajectory = self._way_aside(None if comes else stop)
        if trajectory is None or trajectory is stop:
            return self._decision(HOLD, f"{why or 'nowhere to go'}; {reason}", now.chosen, reports, stop)
        if trajectory is now.executing:
            return self._decision(KEEP, f"on its way aside; {reason}", now.chosen, reports)
        return self._decision(EVADE, f"{why or 'a better way aside'}; {reason}", now.chosen, reports, trajectory)

    def _far_enough(self, trajectory: TimedTrajectory) -> bool:
        gap = self._person.least_gap_m(trajectory, self._now.t_switch_s)
        return gap >= self._tools.config.min_separation_m

    def _gone_bad(self) -> bool:
        """Return whether what is being executed should not go on: it is not free, or the person comes to its end."""
        executing = self._now.executing
        return bool(self._trouble(executing) or self._person.comes_to(executing.q[-1]))

    def _way_aside(self, stop: TimedTrajectory | None) -> TimedTrajectory | None:
        """Return the way out of the person's way that keeps the largest distance from them, up to the separation.

        If the robot is on such a way already, or could simply `stop`, that is what it does unless another keeps a
        clearly larger one.
        """
        now, tools = self._now, self._tools
        known = np.concatenate(list(now.goals.values()))
        rng = np.random.default_rng(np.random.SeedSequence((tools.config.seed, now.step, len(now.goals))))
        best: TimedTrajectory | None = None
        best_gap = -np.inf
        wanted = tools.config.min_separation_m
        aside = now.leads_to is None and not now.held and now.executing.end_s > now.t_switch_s
        if aside and not (self._person.comes_to(now.executing.q[-1]) or self._static_trouble(now.executing)):
            best = now.executing
        elif stop is not None:
            best = stop
        if best is not None:
            best_gap = self._person.least_gap_m(best, now.t_switch_s) + _BETTER_GAP_M
        for path in ways_aside(tools, self._person, self._human, self._q, known, rng):
            if best_gap >= wanted:
                break
            trajectory = self._timed(path)
            gap = self._person.least_gap_m(trajectory, now.t_switch_s)
            if gap > best_gap and not self._static_trouble(trajectory):
                best, best_gap = trajectory, gap
        return best

    def _why(self, report: GoalReport, candidates: Sequence[Candidate], leave: str) -> str:
        chosen = self._now.chosen
        if chosen is None:
            return f"{report.name} is the cheapest goal"
        if report.name == chosen:
            return (
                f"a better path to {report.name}" if self._now.leads_to == chosen else f"a way to {report.name} again"
            )
        old = next(c.report for c in candidates if c.report.name == chosen)
        if leave:
            return f"leaves {chosen}: {leave}"
        if not old.eligible:
            return f"{chosen} is out of the question: {old.obstacle_to_choice}"
        return f"{report.name} costs {report.selection_cost:.4f}, {chosen} {old.selection_cost:.4f}"

    def _timed(self, path: FloatArray) -> TimedTrajectory:
        tools = self._tools
        return time_parameterise(
            path,
            tools.velocity_limit,
            tools.acceleration_limit,
            self._v,
            self._a,
            tools.config.sample_period_s,
            self._now.t_switch_s,
        )

    def _stop(self) -> TimedTrajectory | None:
        """Return a stop from the switch on; None if the robot is stopping or rests anyway."""
        now, tools = self._now, self._tools
        if now.held or not (self._v.any() or self._a.any()):
            return None
        return brake_along(now.executing, now.t_switch_s, tools.acceleration_limit, tools.config.sample_period_s)

    def _trouble(self, trajectory: TimedTrajectory) -> str:
        """Return why a trajectory cannot be executed from the switch on; empty if it can."""
        trouble = self._static_trouble(trajectory)
        if trouble:
            return trouble
        person = self._person.in_the_way(trajectory, self._now.t_switch_s)
        if person is not None:
            return f"its trajectory comes too close to the person: {person}"
        return self._person.on_the_way(trajectory, self._now.t_switch_s)

    def _static_trouble(self, trajectory: TimedTrajectory) -> str:
        chain, begin_s = self._tools.chain, self._now.t_switch_s
        q = trajectory.q[trajectory.t_s >= begin_s]
        if ((q < chain.lower - _EXECUTION_SLACK_RAD) | (q > chain.upper + _EXECUTION_SLACK_RAD)).any():
            return "its trajectory leaves the joint limits"
        trouble = self._tools.checker.first_trouble(trajectory, begin_s)
        return "" if trouble is None else f"its trajectory is not free: {trouble}"

    def _decision(
        self,
        action: str,
        reason: str,
        chosen: str | None,
        reports: tuple[GoalReport, ...],
        trajectory: TimedTrajectory | None = None,
    ) -> Decision:
        now = self._now
        return Decision(
            stamp_s=now.stamp_s,
            step=now.step,
            action=action,
            reason=reason,
            chosen=chosen,
            previous=now.chosen,
            goals=reports,
            t_switch_s=float("nan") if trajectory is None else now.t_switch_s,
            trajectory=trajectory,
        )


def _reports(candidates: Sequence[Candidate]) -> tuple[GoalReport, ...]:
    return tuple(candidate.report for candidate in candidates)
