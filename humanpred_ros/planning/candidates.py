"""A path to every goal, as good as the time allows (P1 Alg. 1, line 5), and their order (line 6).

A goal may be set aside for a step, always with a reason: because the person is likely to come to where the arm
would rest, or because after a few updates another goal is far cheaper. Every step looks at all of them anew, so
a goal comes back as soon as the reason has gone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import GoalReport
from humanpred_ros.planning.path import path_integral, path_parameter, reconnect, resampled, straight
from humanpred_ros.planning.step import Step
from humanpred_ros.stomp.costs import BoolArray, as_batch
from humanpred_ros.stomp.planner import Plan, StompRun, advance_all

#: Configurations the rest of a trajectory is first read at, before it is spaced evenly.
_REREAD = 300


@dataclass
class Candidate:
    """The path to one goal in one step.

    Attributes:
        name: the goal's.
        alternative: which of the goal's configurations the path leads to.
        initial: (N, D) path that STOMP begins with.
        warm_start, set_aside: as in `GoalReport`.
        run: the plan being made; None for a goal that is set aside from the beginning.
        report: on the best path found.
        executing: whether that path is the very one being executed.
    """

    name: str
    alternative: int
    initial: FloatArray
    warm_start: str
    set_aside: str = ""
    run: StompRun | None = None
    report: GoalReport = field(init=False)
    executing: bool = False

    def refuse(self, reason: str) -> None:
        """Set the goal aside because of something its trajectory would do."""
        self.report = replace(self.report, set_aside=reason)


def plan_to_goals(step: Step) -> list[Candidate]:
    """Plan to every goal from where the robot will be at the switch; the candidates become the step's.

    Every goal draws from a generator of its own, so that neither threads nor other goals change a path.
    """
    cfg, goals = step.problem.config, step.state.goals
    seeds = np.random.SeedSequence((cfg.seed, step.state.step)).spawn(len(goals))
    step.candidates = [_first_path(step, name) for name in goals]
    for candidate, seed in zip(step.candidates, seeds, strict=True):
        if not candidate.set_aside:
            rng = np.random.default_rng(seed)
            candidate.run = step.planner.begin(candidate.initial, rng, step.noise_std)
    n = cfg.stomp.iterations
    first = cfg.prune_after if 0 < cfg.prune_after < n and len(goals) > 1 else n
    _advance(step, first)
    if first < n:
        _set_expensive_goals_aside(step)
        _advance(step, n - first)
    for candidate in step.candidates:
        _finish(step, candidate)
    return step.candidates


def ranked(step: Step) -> list[Candidate]:
    """Return the candidates that may be executed, best first.

    The goal being worked on goes before goals that are not clearly cheaper. A goal that has been left before must be
    cheaper by more and more.
    """
    cfg, state = step.problem.config, step.state
    order = [candidate for candidate in step.candidates if candidate.report.eligible]
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


def report_at_goal(step: Step, name: str) -> GoalReport:
    """Return the report of a goal that the robot rests at."""
    path = np.repeat(step.q[None], step.problem.config.stomp.waypoints, axis=0)
    at = int(np.argmin(np.abs(step.state.goals[name] - step.q).max(axis=1)))
    return _report(step, Candidate(name, at, path, "arrived"), step.planner.assess(path))


def _advance(step: Step, iterations: int) -> None:
    runs = [c.run for c in step.candidates if c.run is not None and not c.set_aside]
    advance_all(runs, iterations, step.problem.pool, step.problem.config.threads, step.deadline)


def _set_expensive_goals_aside(step: Step) -> None:
    """Set aside the goals that cost far more than the cheapest allowed one, so that the others get their time."""
    cfg = step.problem.config
    running = [(c, _report(step, c, c.run.result())) for c in step.candidates if c.run is not None]
    allowed = [report for _, report in running if report.valid]
    if not allowed:
        return
    best = min(allowed, key=lambda report: report.selection_cost)
    for candidate, report in running:
        if report.selection_cost > cfg.prune_factor * best.selection_cost + cfg.prune_cost:
            candidate.set_aside = (
                f"far too expensive: costs {report.selection_cost:.3g} after {report.iterations} updates, "
                f"{best.name} {best.selection_cost:.3g}"
            )


def _first_path(step: Step, name: str) -> Candidate:
    """Return a goal with the path that STOMP begins with: what is executed, the last step's path, or a line."""
    cfg, state, weights = step.problem.config, step.state, step.problem.weights
    n, configurations = cfg.stomp.waypoints, state.goals[name]
    reasons = [step.person.rest_conflict(q) for q in configurations]
    if name == state.leads_to:
        at = int(np.argmin(np.abs(configurations - step.executing.q[-1]).max(axis=1)))
        if not reasons[at]:
            rest = resampled(step.executing.rest_of(step.t_switch_s, _REREAD), n, weights)
            return Candidate(name, at, rest, "executing")
    at = _alternative(step, name, reasons)
    goal, before = configurations[at], state.paths.get(name)
    if before is None or not np.array_equal(before[-1], goal):
        return Candidate(name, at, straight(step.q, goal, n), "straight", reasons[at])
    terms, human = step.planner.terms, step.human
    old = reconnect(step.q, before, terms, human, weights, cfg.reconnect_step, n, cfg.length_weight)
    return Candidate(name, at, old.path, old.kind, reasons[at])


def _alternative(step: Step, name: str, reasons: list[str]) -> int:
    """Return which configuration of a goal to plan to: the one that straight lines say is the cheapest.

    One that the person comes to ranks behind all others; the one planned to before goes first among equals.
    """
    configurations = step.state.goals[name]
    if len(configurations) == 1:
        return 0
    cfg, weights = step.problem.config, step.problem.weights
    lines = np.stack([straight(step.q, goal, cfg.stomp.waypoints) for goal in configurations])
    human = step.human.evaluate(as_batch(lines))[0].astype(np.float64)
    free: BoolArray = np.all(step.problem.obstacles.valid(lines), axis=1)
    before = step.state.paths.get(name)
    ranks = []
    for k, line in enumerate(lines):
        cost = float(path_integral(human[k], line, weights)) + cfg.rest_weight * float(human[k, -1])
        cost += cfg.length_weight * float(path_parameter(line, weights)[-1])
        kept = before is not None and bool(np.array_equal(before[-1], configurations[k]))
        ranks.append((bool(reasons[k]), not bool(free[k]), cost * (1.0 - cfg.switch_improvement if kept else 1.0), k))
    return min(ranks)[-1]


def _finish(step: Step, candidate: Candidate) -> None:
    """Report on the best path; on the one being executed unless the best one is clearly better."""
    if candidate.run is None:
        candidate.report = _report(step, candidate, step.planner.assess(candidate.initial))
        return
    candidate.report = report = _report(step, candidate, candidate.run.result())
    if candidate.warm_start != "executing":
        return
    # The robot is on its way: a path that is hardly better is not worth a change of its movement.
    rest = _report(step, candidate, step.planner.assess(candidate.initial, report.iterations))
    better = report.selection_cost < (1.0 - step.problem.config.min_improvement) * rest.selection_cost
    if not (report.valid and (better or not rest.valid)):
        candidate.report, candidate.executing = rest, True


def _report(step: Step, candidate: Candidate, plan: Plan) -> GoalReport:
    cfg, weights, name = step.problem.config, step.problem.weights, candidate.name
    values = step.human.evaluate(as_batch(plan.waypoints[None]))[0][0].astype(np.float64)
    human = float(path_integral(values, plan.waypoints, weights))
    length = float(path_parameter(plan.waypoints, weights)[-1])
    rest, task_cost = float(values[-1]), step.problem.task_costs[name]
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
        revived=not candidate.set_aside and name in step.state.set_aside,
    )
