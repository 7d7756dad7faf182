"""One replanning step: a path to every goal, as good as the time allows (P1 Alg. 1, line 5), and their order (line 6).

A goal may be set aside for a step, always with a reason: because the person is likely to come to where the arm
would rest, or because after a few updates another goal is far cheaper. Every step looks at all of them anew, so
a goal comes back as soon as the reason has gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import Decision, GoalReport, State
from humanpred_ros.planning.path import path_integral, path_parameter, reconnect, resampled, straight
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.problem import Problem
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.stomp.costs import BoolArray, as_batch
from humanpred_ros.stomp.planner import Plan, StompRun, advance_all

#: Configurations the rest of a trajectory is first read at, before it is spaced evenly.
_REREAD = 300


@dataclass
class Candidate:
    """The path to one goal in one step."""

    name: str  #: the goal's
    alternative: int  #: which of the goal's configurations the path leads to
    initial: FloatArray  #: (N, D) path that STOMP begins with
    warm_start: str  #: as in `GoalReport`
    set_aside: str = ""
    run: StompRun | None = None  #: the plan being made; None for a goal that is set aside from the beginning
    report: GoalReport = field(init=False)  #: on the best path found
    executing: bool = False  #: whether that path is the very one being executed


class Step:
    """One step being made; it changes nothing of the state.

    Attributes:
        problem, config, state, person: the arm and its goals, settings, what the step starts from, and the person now.
        stamp_s: stamp of the occupancy.
        seen_s, t_switch_s: the same in the controller's time; when the step's trajectory takes over, a period later.
        executing: the trajectory being executed at the switch if nothing changes.
        q, v, a: (D,) position, velocity and acceleration at the switch.
        planner, human: STOMP for this occupancy, and the cost of the person.
        deadline: says True when the time is over; None for no deadline.
        candidates: a path to each goal, in the scene's order, once planned.
    """

    def __init__(
        self,
        problem: Problem,
        state: State,
        person: Person,
        deadline: Callable[[], bool] | None = None,
    ) -> None:
        self.problem, self.config, self.state, self.person = problem, problem.config, state, person
        self.deadline = deadline
        self.stamp_s = person.occupancy.t_s
        self.seen_s = float(state.pace.progress(self.stamp_s))
        self.t_switch_s = float(state.pace.progress(self.stamp_s + problem.config.period_s))
        self.executing = state.schedule.at(self.t_switch_s)
        self.q, self.v, self.a = self.executing.sample(self.t_switch_s)
        self.planner, self.human = problem.planner(person.occupancy)
        self.candidates: list[Candidate] = []

    @property
    def late(self) -> bool:
        """Whether the deadline has passed."""
        return self.deadline is not None and self.deadline()

    @property
    def moving_aside(self) -> bool:
        """Whether the robot is on its way out of the person's way at the switch."""
        return self.state.leads_to is None and not self.state.held and self.executing.end_s > self.t_switch_s

    def disabled(self, name: str | None) -> str:
        """Return that a goal is disabled, or which obstacles block it; empty if it can be worked on."""
        return "disabled" if name in self.problem.disabled else self.problem.blocked.get(name or "", "")

    def timed(self, path: FloatArray) -> TimedTrajectory:
        """Return a trajectory along a path (N, D) that takes over at the switch."""
        return self.problem.timed(path, self.v, self.a, self.t_switch_s)

    def trouble(self, trajectory: TimedTrajectory) -> str:
        """Return why a trajectory cannot be executed from the switch on; empty if it can."""
        not_free = self.problem.not_free(trajectory, self.t_switch_s)
        if not_free:
            return not_free
        conflict = self.person.conflict(trajectory, self.t_switch_s)
        if conflict is not None:
            return f"its trajectory comes too close to the person: {conflict}"
        return self.person.crossing(trajectory, self.t_switch_s)

    def decision(
        self,
        action: str,
        reason: str,
        chosen: str | None,
        trajectory: TimedTrajectory | None = None,
        reports: tuple[GoalReport, ...] | None = None,
    ) -> Decision:
        """Return a decision of this step; with the candidates' reports if no others are given."""
        return Decision(
            stamp_s=self.stamp_s,
            step=self.state.step,
            action=action,
            reason=reason,
            chosen=chosen,
            previous=self.state.chosen,
            goals=tuple(candidate.report for candidate in self.candidates) if reports is None else reports,
            t_switch_s=float("nan") if trajectory is None else self.t_switch_s,
            trajectory=trajectory,
        )

    def plan_to_goals(self) -> None:
        """Plan to every goal from where the robot will be at the switch.

        Every goal draws from a generator of its own, so that neither threads nor other goals change a path.
        """
        cfg, goals = self.config, self.state.goals
        seeds = np.random.SeedSequence((cfg.seed, self.state.step)).spawn(len(goals))
        self.candidates = [self._first_path(name) for name in goals]
        for candidate in self.candidates:
            candidate.set_aside = self.disabled(candidate.name) or candidate.set_aside
        for candidate, seed in zip(self.candidates, seeds, strict=True):
            if not candidate.set_aside:
                candidate.run = self.planner.begin(candidate.initial, np.random.default_rng(seed))
        n = cfg.stomp.iterations
        first = cfg.prune_after if 0 < cfg.prune_after < n and len(goals) > 1 else n
        self._advance(first)
        if first < n:
            self._set_expensive_goals_aside()
            self._advance(n - first)
        for candidate in self.candidates:
            self._finish(candidate)

    def ranked(self) -> list[Candidate]:
        """Return the candidates that may be executed, best first.

        The goal being worked on goes before goals that are not clearly cheaper. A goal that has been left before must
        be cheaper by more and more.
        """
        cfg, state = self.config, self.state
        order = [candidate for candidate in self.candidates if candidate.report.eligible]
        order.sort(key=lambda candidate: candidate.report.selection_cost)
        present = next((candidate for candidate in order if candidate.name == state.chosen), None)
        if present is None:
            return order
        beaten = (1.0 - cfg.switch_improvement) * present.report.selection_cost

        def clearly_cheaper(other: Candidate) -> bool:
            margin = cfg.switch_cost * (1 + state.left.get(other.name, 0))
            return other.report.selection_cost < beaten - margin

        before = [candidate for candidate in order[: order.index(present)] if clearly_cheaper(candidate)]
        return before + [present] + [c for c in order if c is not present and c not in before]

    def report_at_goal(self, name: str) -> GoalReport:
        """Return the report of a goal that the robot rests at."""
        path = np.repeat(self.q[None], self.config.stomp.waypoints, axis=0)
        at = int(np.argmin(np.abs(self.state.goals[name] - self.q).max(axis=1)))
        return self._report(Candidate(name, at, path, "arrived"), self.planner.assess(path))

    def _advance(self, iterations: int) -> None:
        runs = [c.run for c in self.candidates if c.run is not None and not c.set_aside]
        advance_all(runs, iterations, self.problem.pool, self.config.threads, self.deadline)

    def _set_expensive_goals_aside(self) -> None:
        """Set aside the goals that cost far more than the cheapest allowed one, so that the others get their time."""
        running = [(c, self._report(c, c.run.result())) for c in self.candidates if c.run is not None]
        allowed = [report for _, report in running if report.valid]
        if not allowed:
            return
        best = min(allowed, key=lambda report: report.selection_cost)
        for candidate, report in running:
            if report.selection_cost > self.config.prune_factor * best.selection_cost + self.config.prune_cost:
                candidate.set_aside = (
                    f"far too expensive: costs {report.selection_cost:.3g} after {report.iterations} updates, "
                    f"{best.name} {best.selection_cost:.3g}"
                )

    def _first_path(self, name: str) -> Candidate:
        """Return a goal with the path that STOMP begins with: what is executed, the last step's path, or a line."""
        cfg, state, weights = self.config, self.state, self.problem.weights
        n, configurations = cfg.stomp.waypoints, state.goals[name]
        reasons = [self.person.rest_conflict(q) for q in configurations]
        if name == state.leads_to:
            at = int(np.argmin(np.abs(configurations - self.executing.q[-1]).max(axis=1)))
            if not reasons[at]:
                end_s = self.executing.end_s
                rest = self.executing.sample(np.linspace(min(self.t_switch_s, end_s), end_s, _REREAD))[0]
                return Candidate(name, at, resampled(rest, n, weights), "executing")
        at = self._alternative(name, reasons)
        goal, before = configurations[at], state.paths.get(name)
        if before is None or not np.array_equal(before[-1], goal):
            return Candidate(name, at, straight(self.q, goal, n), "straight", reasons[at])
        terms, human = self.planner.terms, self.human
        old = reconnect(self.q, before, terms, human, weights, cfg.reconnect_step, n, cfg.length_weight)
        return Candidate(name, at, old.path, old.kind, reasons[at])

    def _alternative(self, name: str, reasons: list[str]) -> int:
        """Return which configuration of a goal to plan to: the one that straight lines say is the cheapest.

        One that the person comes to ranks behind all others; the one planned to before goes first among equals.
        """
        configurations = self.state.goals[name]
        if len(configurations) == 1:
            return 0
        cfg, weights = self.config, self.problem.weights
        lines = np.stack([straight(self.q, goal, cfg.stomp.waypoints) for goal in configurations])
        human = self.human.evaluate(as_batch(lines))[0].astype(np.float64)
        free: BoolArray = np.all(self.problem.obstacles.valid(lines), axis=1)
        before = self.state.paths.get(name)
        ranks = []
        for k, line in enumerate(lines):
            cost = float(path_integral(human[k], line, weights)) + cfg.rest_weight * float(human[k, -1])
            cost += cfg.length_weight * float(path_parameter(line, weights)[-1])
            if before is not None and np.array_equal(before[-1], configurations[k]):
                cost *= 1.0 - cfg.switch_improvement
            ranks.append((bool(reasons[k]), not bool(free[k]), cost, k))
        return min(ranks)[-1]

    def _finish(self, candidate: Candidate) -> None:
        """Report on the best path; on the one being executed unless the best one is clearly better."""
        if candidate.run is None:
            candidate.report = self._report(candidate, self.planner.assess(candidate.initial))
            return
        candidate.report = report = self._report(candidate, candidate.run.result())
        if candidate.warm_start != "executing":
            return
        # The robot is on its way: a path that is hardly better is not worth a change of its movement.
        rest = self._report(candidate, self.planner.assess(candidate.initial, report.iterations))
        better = report.selection_cost < (1.0 - self.config.min_improvement) * rest.selection_cost
        if not (report.valid and (better or not rest.valid)):
            candidate.report, candidate.executing = rest, True

    def _report(self, candidate: Candidate, plan: Plan) -> GoalReport:
        cfg, weights, name = self.config, self.problem.weights, candidate.name
        values = self.human.evaluate(as_batch(plan.waypoints[None]))[0][0].astype(np.float64)
        human = float(path_integral(values, plan.waypoints, weights))
        length = float(path_parameter(plan.waypoints, weights)[-1])
        rest, task_cost = float(values[-1]), self.problem.task_costs[name]
        disturbance = human + cfg.length_weight * length + cfg.rest_weight * rest
        return GoalReport(
            name=name,
            cost=plan.cost,
            total=plan.total,
            human=human,
            length=length,
            selection_cost=(plan.total if cfg.selection == "total" else disturbance) + task_cost,
            path=plan.waypoints,
            valid=plan.valid,
            reason=plan.reason,
            iterations=plan.iterations,
            warm_start=candidate.warm_start,
            rest=rest,
            task_cost=task_cost,
            alternative=candidate.alternative,
            set_aside=candidate.set_aside,
            revived=not candidate.set_aside and name in self.state.set_aside,
        )
