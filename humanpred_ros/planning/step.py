"""One replanning step: plan to every goal, compare, and turn the best path into a trajectory (P1 Alg. 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from humanpred_ros.checks import FloatArray
from humanpred_ros.occupancy.grid import Occupancy
from humanpred_ros.planning.costs import HumanOccupancyCost, ObstacleCost, SmoothnessCost, as_batch
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, REPLAN, Decision, GoalReport
from humanpred_ros.planning.margin import widened
from humanpred_ros.planning.path import path_integral, path_parameter, resampled, straight
from humanpred_ros.planning.reconnection import reconnect
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.stomp import Plan, StompPlanner
from humanpred_ros.planning.stopping import brake_along
from humanpred_ros.planning.timing import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.chain import BodyPoints, KinematicChain

#: What a timed trajectory may lose of clearance against its path, m, and exceed the joint limits by, rad:
#: corners are rounded off, and what is left of the old velocity leads off the path for a moment.
_EXECUTION_SLACK_M = 0.005
_EXECUTION_SLACK_RAD = 0.005
#: Times between the configurations of a trajectory that are checked, s.
_CHECK_PERIOD_S = 0.02
#: Configurations the rest of a trajectory is first read at, before it is spaced evenly.
_REREAD = 300


@dataclass(frozen=True)
class Tools:
    """What stays the same from step to step."""

    config: ReplannerConfig
    chain: KinematicChain
    points: BodyPoints
    obstacles: ObstacleCost
    smoothness: SmoothnessCost
    weights: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    pool: ThreadPoolExecutor | None

    def planner(self, occupancy: Occupancy) -> StompPlanner:
        """Return the planner for one predicted occupancy; its second term is the human's."""
        stomp = self.config.stomp
        near = widened(occupancy, self.config.human_margin_m)
        human = HumanOccupancyCost(self.chain, self.points, near, stomp.human_weight)
        terms = (self.obstacles, human, self.smoothness)
        return StompPlanner(terms, self.chain.lower, self.chain.upper, stomp)


@dataclass(frozen=True)
class Situation:
    """Where a step begins.

    Attributes:
        step, stamp_s, t_switch_s: as in `Decision`.
        goals: configuration (D,) of each goal, unwrapped.
        paths: path (N, D) to each goal found by the step before; empty in the first.
        chosen: goal being worked on.
        arrived: whether the robot will rest at it by the switch.
        executing: the trajectory being executed at the switch if nothing changes.
        held: whether that is a stop.
    """

    step: int
    stamp_s: float
    t_switch_s: float
    goals: Mapping[str, FloatArray]
    paths: Mapping[str, FloatArray]
    chosen: str | None
    arrived: bool
    executing: TimedTrajectory
    held: bool


class ReplanningStep:
    """Plans for one situation; makes a decision and changes nothing."""

    def __init__(
        self, tools: Tools, situation: Situation, occupancy: Occupancy, deadline: Callable[[], bool] | None = None
    ) -> None:
        self._tools, self._now, self._deadline = tools, situation, deadline
        self._planner = tools.planner(occupancy)
        self._human = next(term for term in self._planner.terms if isinstance(term, HumanOccupancyCost))
        self._q, self._v, self._a = situation.executing.sample(situation.t_switch_s)

    def decide(self) -> Decision:
        """Return the decision of this step."""
        now = self._now
        if now.arrived and now.chosen is not None:
            path = np.repeat(self._q[None], self._tools.config.stomp.n_waypoints, axis=0)
            report = self._report(now.chosen, self._planner.assess(path), "arrived")
            if now.executing.end_s > now.stamp_s:
                return self._decision(KEEP, f"about to arrive at {now.chosen}", now.chosen, (report,))
            return self._decision(ARRIVED, f"at {now.chosen}", now.chosen, (report,))
        planned = self._plan_all()
        reports = tuple(report for report, _ in planned)
        refused = []
        for report, executing in sorted(planned, key=lambda entry: entry[0].selection_cost):
            if not report.valid:
                continue
            if executing:
                return self._decision(KEEP, "no better path than the one being executed", report.name, reports)
            trajectory = self._timed(report)
            trouble = self._trouble(trajectory)
            if not trouble:
                return self._decision(REPLAN, self._why(report), report.name, reports, trajectory)
            refused.append(f"{report.name}: {trouble}")
        refused += [f"{report.name}: {report.reason}" for report in reports if not report.valid]
        reason = "no path can be executed (" + "; ".join(refused) + ")"
        if now.chosen is not None and not now.held and not self._trouble(now.executing):
            return self._decision(KEEP, reason + "; the one being executed still can", now.chosen, reports)
        return self._decision(HOLD, reason, now.chosen, reports, self._stop())

    def _plan_all(self) -> tuple[tuple[GoalReport, bool], ...]:
        """Plan to every goal, each with a generator of its own, so that threads cannot change a result."""
        seeds = np.random.SeedSequence((self._tools.config.seed, self._now.step)).spawn(len(self._now.goals))
        jobs = list(zip(self._now.goals, seeds, strict=True))
        if self._tools.pool is None or len(jobs) == 1:
            return tuple(self._plan_one(*job) for job in jobs)
        return tuple(self._tools.pool.map(lambda job: self._plan_one(*job), jobs))

    def _plan_one(self, name: str, seed: np.random.SeedSequence) -> tuple[GoalReport, bool]:
        """Return the best path to a goal and whether it is the very one being executed."""
        cfg = self._tools.config
        initial, warm_start = self._warm_start(name)
        plan = self._planner.plan(initial, np.random.default_rng(seed), self._deadline)
        report = self._report(name, plan, warm_start)
        if warm_start != "executing":
            return report, False
        # The robot is on its way: a path that is hardly better is not worth a change of its movement.
        rest = self._report(name, self._planner.assess(initial, plan.iterations), warm_start)
        better = report.selection_cost < (1.0 - cfg.min_improvement) * rest.selection_cost
        return (report, False) if report.valid and (better or not rest.valid) else (rest, True)

    def _warm_start(self, name: str) -> tuple[FloatArray, str]:
        """Return the path to begin with and where it comes from."""
        now, cfg, weights = self._now, self._tools.config, self._tools.weights
        n = cfg.stomp.n_waypoints
        if name not in now.paths:
            return straight(self._q, now.goals[name], n), "straight"
        if name == now.chosen and not now.held:
            return resampled(now.executing.rest_of(now.t_switch_s, _REREAD), n, weights), "executing"
        old = reconnect(
            self._q, now.paths[name], self._planner.terms, weights, cfg.reconnect_step, n, cfg.length_weight
        )
        return old.path, old.kind

    def _report(self, name: str, plan: Plan, warm_start: str) -> GoalReport:
        cfg, weights = self._tools.config, self._tools.weights
        values = self._human.evaluate(as_batch(plan.waypoints[None]))[0][0]
        human = float(path_integral(values.astype(np.float64), plan.waypoints, weights))
        length = float(path_parameter(plan.waypoints, weights)[-1])
        selection = plan.total if cfg.selection == "total" else human + cfg.length_weight * length
        return GoalReport(
            name=name,
            cost=plan.cost,
            total=plan.total,
            human=human,
            length=length,
            selection_cost=selection,
            path=plan.waypoints,
            valid=plan.valid,
            reason=plan.reason,
            iterations=plan.iterations,
            warm_start=warm_start,
        )

    def _why(self, report: GoalReport) -> str:
        if self._now.chosen is None:
            return f"{report.name} is the cheapest goal"
        if report.name != self._now.chosen:
            return f"{report.name} has become cheaper than {self._now.chosen}"
        return f"a better path to {report.name}"

    def _timed(self, report: GoalReport) -> TimedTrajectory:
        tools = self._tools
        return time_parameterise(
            report.path,
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
        tools = self._tools
        begin = min(self._now.t_switch_s, trajectory.end_s)
        n = max(5, int(np.ceil((trajectory.end_s - begin) / _CHECK_PERIOD_S)) + 1)
        q = trajectory.sample(np.linspace(begin, trajectory.end_s, n))[0]
        slack = _EXECUTION_SLACK_RAD
        if ((q < tools.chain.lower - slack) | (q > tools.chain.upper + slack)).any():
            return "its trajectory leaves the joint limits"
        nearest = tools.obstacles.costs_and_distances(q[None])[1]
        if nearest.min() < tools.obstacles.margin_m - _EXECUTION_SLACK_M:
            return "its trajectory comes too close to an obstacle"
        return ""

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
