"""A path to every goal, as good as the time allows: warm starts, fair turns, and no time for hopeless goals.

A goal may be set aside for a step, always with a reason: because the person is likely to come to where the arm
would rest, or because after a few updates another goal is cheaper by far. Every step looks at all of them anew, so
a goal comes back as soon as the reason has gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import GoalReport
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.reconnection import reconnect
from humanpred_ros.planning.situation import Situation
from humanpred_ros.planning.timing.path import path_integral, path_parameter, resampled, straight
from humanpred_ros.planning.tools import Tools
from humanpred_ros.stomp.costs import BoolArray, Float32Array, HumanOccupancyCost, as_batch
from humanpred_ros.stomp.planner import Plan, StompPlanner, StompRun, advance_all

#: Configurations the rest of a trajectory is first read at, before it is spaced evenly.
_REREAD = 300


@dataclass(frozen=True)
class Candidate:
    """A goal's report, and whether its path is the very one being executed."""

    report: GoalReport
    executing: bool = False


@dataclass
class _Task:
    """One goal in this step: where its path begins to be improved, and why it may be left alone."""

    name: str
    alternative: int
    initial: FloatArray
    warm_start: str
    set_aside: str
    run: StompRun | None = None


class Candidates:
    """Plans to every goal of one situation from the configuration `q` (D,) at the switch."""

    def __init__(
        self,
        tools: Tools,
        situation: Situation,
        q: FloatArray,
        person: Person,
        planner: StompPlanner,
        human: HumanOccupancyCost,
    ) -> None:
        self._runs: dict[str, StompRun] = {}
        self._tools, self._now, self._q = tools, situation, q
        self._person, self._planner, self._human = person, planner, human

    def plan(self, deadline: Callable[[], bool] | None = None) -> tuple[Candidate, ...]:
        """Return one candidate per goal, in the scene's order.

        Every goal draws from a generator of its own, so that neither threads nor other goals change a path.
        """
        cfg, now = self._tools.config, self._now
        seeds = np.random.SeedSequence((cfg.seed, now.step)).spawn(len(now.goals))
        tasks = [self._task(name) for name in now.goals]
        for task, seed in zip(tasks, seeds, strict=True):
            if not task.set_aside:
                task.run = self._planner.begin(task.initial, np.random.default_rng(seed), now.noise_std)
        n = cfg.stomp.iterations
        first = cfg.prune_after if 0 < cfg.prune_after < n and len(tasks) > 1 else n
        self._advance(tasks, first, deadline)
        if first < n:
            self._prune(tasks)
            self._advance(tasks, n - first, deadline)
        self._runs = {task.name: task.run for task in tasks if task.run is not None}
        return tuple(self._candidate(task) for task in tasks)

    def rollouts(self) -> dict[str, Float32Array]:
        """Return the noisy trajectories (R, N, D) of each goal's last update, where there was one."""
        return {name: run.rollouts for name, run in self._runs.items() if run.iterations}

    def arrived(self, name: str) -> GoalReport:
        """Return the report of a goal the robot rests at."""
        now = self._now
        path = np.repeat(self._q[None], self._tools.config.stomp.waypoints, axis=0)
        at = int(np.argmin(np.abs(now.goals[name] - self._q).max(axis=1)))
        return self._report(_Task(name, at, path, "arrived", ""), self._planner.assess(path))

    def _advance(self, tasks: list[_Task], iterations: int, deadline: Callable[[], bool] | None) -> None:
        runs = [task.run for task in tasks if task.run is not None and not task.set_aside]
        advance_all(runs, iterations, self._tools.pool, self._tools.config.threads, deadline)

    def _prune(self, tasks: list[_Task]) -> None:
        """Set aside the goals that are dearer by far than the cheapest allowed one."""
        cfg = self._tools.config
        reports = {task.name: self._report(task, task.run.result()) for task in tasks if task.run is not None}
        allowed = [report for report in reports.values() if report.valid]
        if not allowed:
            return
        best = min(allowed, key=lambda report: report.selection_cost)
        for task in tasks:
            report = reports.get(task.name)
            if report is None or not report.selection_cost > cfg.prune_factor * best.selection_cost + cfg.prune_cost:
                continue
            task.set_aside = (
                f"hopeless: costs {report.selection_cost:.3g} after {report.iterations} updates, "
                f"{best.name} {best.selection_cost:.3g}"
            )

    def _task(self, name: str) -> _Task:
        now = self._now
        configurations = now.goals[name]
        reasons = [self._person.comes_to(q) for q in configurations]
        if name == now.leads_to:
            at = int(np.argmin(np.abs(configurations - now.executing.q[-1]).max(axis=1)))
            if not reasons[at]:
                n, weights = self._tools.config.stomp.waypoints, self._tools.weights
                rest = resampled(now.executing.rest_of(now.t_switch_s, _REREAD), n, weights)
                return _Task(name, at, rest, "executing", "")
        at = self._alternative(name, reasons)
        initial, warm_start = self._warm_start(name, configurations[at])
        return _Task(name, at, initial, warm_start, reasons[at])

    def _alternative(self, name: str, reasons: list[str]) -> int:
        """Return which configuration of a goal to plan to: the one that straight lines say is the cheapest.

        One the person comes to ranks behind all others; the one planned to before goes first among equals.
        """
        configurations = self._now.goals[name]
        if len(configurations) == 1:
            return 0
        cfg, weights = self._tools.config, self._tools.weights
        lines = np.stack([straight(self._q, goal, cfg.stomp.waypoints) for goal in configurations])
        human = self._human.evaluate(as_batch(lines))[0].astype(np.float64)
        free: BoolArray = np.all(self._tools.obstacles.valid(lines), axis=1)
        before = self._now.paths.get(name)
        ranks = []
        for k, line in enumerate(lines):
            cost = float(path_integral(human[k], line, weights)) + cfg.rest_weight * float(human[k, -1])
            cost += cfg.length_weight * float(path_parameter(line, weights)[-1])
            kept = before is not None and bool(np.array_equal(before[-1], configurations[k]))
            ranks.append(
                (bool(reasons[k]), not bool(free[k]), cost * (1.0 - cfg.switch_improvement if kept else 1.0), k)
            )
        return min(ranks)[-1]

    def _warm_start(self, name: str, goal: FloatArray) -> tuple[FloatArray, str]:
        """Return the path to begin with and where it comes from."""
        cfg, weights = self._tools.config, self._tools.weights
        n = cfg.stomp.waypoints
        before = self._now.paths.get(name)
        if before is None or not np.array_equal(before[-1], goal):
            return straight(self._q, goal, n), "straight"
        old = reconnect(self._q, before, self._planner.terms, weights, cfg.reconnect_step, n, cfg.length_weight)
        return old.path, old.kind

    def _candidate(self, task: _Task) -> Candidate:
        if task.run is None:
            return Candidate(self._report(task, self._planner.assess(task.initial)))
        report = self._report(task, task.run.result())
        if task.warm_start != "executing":
            return Candidate(report)
        # The robot is on its way: a path that is hardly better is not worth a change of its movement.
        rest = self._report(task, self._planner.assess(task.initial, report.iterations))
        better = report.selection_cost < (1.0 - self._tools.config.min_improvement) * rest.selection_cost
        if report.valid and (better or not rest.valid):
            return Candidate(report)
        return Candidate(rest, executing=True)

    def _report(self, task: _Task, plan: Plan) -> GoalReport:
        cfg, weights = self._tools.config, self._tools.weights
        values = self._human.evaluate(as_batch(plan.waypoints[None]))[0][0].astype(np.float64)
        human = float(path_integral(values, plan.waypoints, weights))
        length = float(path_parameter(plan.waypoints, weights)[-1])
        rest, task_cost = float(values[-1]), self._now.task_costs[task.name]
        selection = plan.total if cfg.selection == "total" else self._selection(human, length, rest)
        return GoalReport(
            name=task.name,
            cost=plan.cost,
            total=plan.total,
            human=human,
            length=length,
            selection_cost=selection + task_cost,
            path=plan.waypoints,
            valid=plan.valid,
            reason=plan.reason,
            iterations=plan.iterations,
            warm_start=task.warm_start,
            rest=rest,
            task_cost=task_cost,
            alternative=task.alternative,
            set_aside=task.set_aside,
            revived=not task.set_aside and task.name in self._now.set_aside,
        )

    def _selection(self, human: float, length: float, rest: float) -> float:
        cfg = self._tools.config
        return human + cfg.length_weight * length + cfg.rest_weight * rest


def with_reason(candidate: Candidate, reason: str) -> Candidate:
    """Return a candidate that is not executed, because of something its trajectory would do."""
    return replace(candidate, report=replace(candidate.report, set_aside=reason))
