"""Keeps the robot working on the goal that disturbs the person least, replanning while it moves (P1 Alg. 1).

Each step takes the newest predicted occupancy, plans to every goal from where the robot will be one period
later, and lets the best plan take over then (the one-step lag of P1 Fig. 4). Planning changes nothing:
`plan` returns a decision, `commit` makes it so.

A goal that has been reached is kept: the task there has begun, and whether to leave it is not for the planner
to say. On the way, the path being executed is kept too unless a new one is better by a margin, so that the
robot does not twitch at every step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.checks import FloatArray, checked
from humanpred_ros.errors import GoalUnreachableError, PlanningError
from humanpred_ros.occupancy.grid import Occupancy, VoxelGrid
from humanpred_ros.planning.costs import ObstacleCost, SmoothnessCost
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, MISSED, Decision
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.reconnection import reconnect
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.schedule import Schedule
from humanpred_ros.planning.step import ReplanningStep, Situation, Tools
from humanpred_ros.planning.stopping import brake_along
from humanpred_ros.planning.timing import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.robot.distance_field import SignedDistanceField
from humanpred_ros.robot.scene import Goal, Scene

__all__ = ["Arm", "MultiGoalReplanner", "ReplannerConfig"]

#: Stamps count as due this much early, s: they are whole nanoseconds, periods are not.
_DUE_TOLERANCE_S = 1e-6


class Arm(Protocol):
    """What the replanner needs of a robot arm; `robot.pr2.Pr2Arm` is one."""

    chain: KinematicChain

    def body_points(self) -> BodyPoints: ...

    def spheres(self) -> BodySpheres: ...

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> FloatArray: ...

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> FloatArray: ...


class MultiGoalReplanner:
    """P1's Algorithm 1 for one arm and a set of goals.

    Not safe to call from several threads at once; it uses threads of its own.
    """

    def __init__(
        self, arm: Arm, goals: Sequence[Goal], field: SignedDistanceField, config: ReplannerConfig | None = None
    ) -> None:
        """Take the arm, its goals and the distance to obstacles; call `start` before planning.

        Raises:
            PlanningError: for no goals or two of one name.
            GoalUnreachableError: for a goal outside the joint limits.
        """
        self.config = config or ReplannerConfig()
        self.arm = arm
        self.chain = arm.chain
        names = [goal.name for goal in goals]
        if not names or len(set(names)) != len(names):
            raise PlanningError(f"replanner: wanted one or more goals of different names, got {names}")
        self.goal_names = tuple(names)
        self._configurations = [self._checked_goal(goal) for goal in goals]
        n = self.chain.n_joints
        # The weight of a joint is the distance of a one-radian change of it alone.
        self.weights = np.array([float(arm.configuration_distance(np.zeros(n), unit)) for unit in np.eye(n)])
        self.velocity_limit = self.config.velocity_scale * self.chain.velocity_limit
        self.acceleration_limit = np.array(np.broadcast_to(self.config.acceleration_limit, (n,)), dtype=np.float64)
        stomp = self.config.stomp
        self._tools = Tools(
            config=self.config,
            chain=self.chain,
            points=arm.body_points(),
            obstacles=ObstacleCost(self.chain, arm.spheres(), field, stomp.obstacle_weight),
            smoothness=SmoothnessCost(stomp.smoothness_weight),
            weights=self.weights,
            velocity_limit=self.velocity_limit,
            acceleration_limit=self.acceleration_limit,
            pool=ThreadPoolExecutor(self.config.n_threads) if self.config.n_threads > 1 else None,
        )
        self._schedule: Schedule | None = None

    @classmethod
    def for_scene(cls, scene: Scene, config: ReplannerConfig | None = None) -> MultiGoalReplanner:
        """Return the replanner of a scene's arm, goals and obstacles."""
        return cls(scene.arm, scene.goals, scene.distance_field(), config)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the D joints, in the order of every configuration."""
        return self.chain.joint_names

    def start(self, q_start: ArrayLike, t_s: float) -> None:
        """Begin anew with the robot at rest at `q_start` (D,) from `t_s` on.

        Goals are unwrapped so that continuous joints go the shorter way from here.
        """
        q = checked("start configuration", q_start, (self.chain.n_joints,), error=PlanningError)
        self._schedule = Schedule(q, t_s)
        self._goals = [q + self.arm.difference(q, goal) for goal in self._configurations]
        self._paths: dict[str, FloatArray] = {}
        self._chosen: str | None = None
        self._step = 1
        self._last_stamp_s = t_s  # P1 looks at the first 5 % of a motion before it plans
        self._held = ""

    def due(self, t_s: float) -> bool:
        """Return whether an occupancy stamped `t_s` calls for a replanning step; after a hold, any does."""
        self._started()
        return bool(self._held) or t_s >= self._last_stamp_s + self.config.period_s - _DUE_TOLERANCE_S

    def plan(self, occupancy: Occupancy, deadline: Callable[[], bool] | None = None) -> Decision:
        """Plan to every goal and choose (P1 Alg. 1); nothing changes until the decision is committed.

        Args:
            occupancy: predicted human occupancy; the plan takes over `period_s` after its stamp.
            deadline: asked before every STOMP iteration; once it says True the best so far is used. Decisions
                made under a deadline depend on the machine.

        Raises:
            PlanningError: before `start`, or for an occupancy older than the last one committed.
        """
        began = time.perf_counter()
        schedule = self._started()
        if not occupancy.t_s >= self._last_stamp_s:
            raise PlanningError(
                f"replanner: wanted an occupancy at {self._last_stamp_s:.3f} s or later, got {occupancy.t_s:.3f} s; "
                "call start() when the clock jumps back"
            )
        t_switch = occupancy.t_s + self.config.period_s
        situation = Situation(
            step=self._step,
            stamp_s=occupancy.t_s,
            t_switch_s=t_switch,
            goals=dict(zip(self.goal_names, self._goals, strict=True)),
            paths=self._paths,
            chosen=self._chosen,
            arrived=self._at_goal(t_switch),
            executing=schedule.at(t_switch),
            held=bool(self._held),
        )
        decision = ReplanningStep(self._tools, situation, occupancy, deadline).decide()
        return replace(decision, compute_s=time.perf_counter() - began)

    def commit(self, decision: Decision) -> None:
        """Make a decision of `plan` so: its trajectory is executed from its switch time on.

        Raises:
            PlanningError: if it does not follow from the present state (already committed, or a hold came
                in between).
        """
        schedule = self._started()
        if decision.step != self._step:
            raise PlanningError(
                f"replanner: wanted the decision of step {self._step}, got that of step {decision.step}; plan again"
            )
        if decision.trajectory is not None:
            schedule.add(decision.t_switch_s, decision.trajectory)
        self._held = decision.reason if decision.action == HOLD else ""
        self._paths = {report.name: report.path for report in decision.goals} or self._paths
        self._chosen = decision.chosen
        self._last_stamp_s = decision.stamp_s
        self._step += 1

    def keep(self, occupancy: Occupancy) -> Decision:
        """Return the answer to an occupancy for which no step is due: whatever goes on goes on."""
        self._started()
        last = self._step - 1
        if self._held:
            return Decision(occupancy.t_s, last, HOLD, self._held, self._chosen, self._chosen)
        if self._at_goal(occupancy.t_s):
            return Decision(occupancy.t_s, last, ARRIVED, f"at {self._chosen}", self._chosen, self._chosen)
        return Decision(occupancy.t_s, last, KEEP, "no replanning step is due", self._chosen, self._chosen)

    def missed(self, decision: Decision) -> Decision:
        """Record that a decision of `plan` came too late to take over; what is being executed goes on."""
        self._started()
        self._step += 1
        late = f"took {decision.compute_s:.3f} s, too long to take over at {decision.t_switch_s:.3f} s"
        return replace(
            decision, action=MISSED, reason=late, chosen=self._chosen, previous=self._chosen,
            t_switch_s=float("nan"), trajectory=None,
        )  # fmt: skip

    def hold(self, t_s: float, reason: str) -> Decision:
        """Stop at once, along what is being executed; in force without `commit`.

        Further holds return no new trajectory; the next plan that is committed ends the hold.
        """
        schedule = self._started()
        stop = None if self._held else self._stop(schedule, t_s)
        decision = Decision(
            t_s, self._step, HOLD, reason, self._chosen, self._chosen,
            t_switch_s=float("nan") if stop is None else t_s, trajectory=stop,
        )  # fmt: skip
        if stop is not None:
            schedule.add(t_s, stop)
            self._step += 1
        self._held = reason
        return decision

    def state_at(self, t_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (D,) commanded at `t_s`."""
        return self._started().state_at(t_s)

    def at_rest(self, t_s: float) -> bool:
        """Return whether the robot is commanded to rest at `t_s`."""
        return self._started().at(t_s).end_s <= t_s

    def tool_path(self, path: ArrayLike) -> FloatArray:
        """Return the (N, 3) world positions of the tool along a path (N, D)."""
        positions: FloatArray = self.chain.tool_pose(path)[..., :3, 3]
        return positions

    def warm_up(self) -> None:
        """Compile everything a step needs, so that the first one is no slower than the others."""
        q = self._configurations[0]
        grid = VoxelGrid((0.0, 0.0, 0.0), 1.0, (1, 1, 1))
        empty = Occupancy(grid, np.zeros(grid.shape, dtype=np.float32))
        planner = self._tools.planner(empty)
        path = straight(q, q + 0.1, self.config.stomp.n_waypoints)
        planner.plan(path, np.random.default_rng(0))
        reconnect(q, path, planner.terms, self.weights, self.config.reconnect_step, len(path))
        trajectory = time_parameterise(path, self.velocity_limit, self.acceleration_limit)
        brake_along(trajectory, 0.5 * trajectory.duration_s, self.acceleration_limit)

    def close(self) -> None:
        """End the threads; the replanner cannot plan any more."""
        if self._tools.pool is not None:
            self._tools.pool.shutdown()

    def _started(self) -> Schedule:
        if self._schedule is None:
            raise PlanningError("replanner: wanted start() first, which says where the robot is; call it")
        return self._schedule

    def _at_goal(self, t_s: float) -> bool:
        if self._schedule is None or self._chosen is None or self._held:
            return False
        executing = self._schedule.at(t_s)
        goal = self._goals[self.goal_names.index(self._chosen)]
        return executing.end_s <= t_s and bool(np.array_equal(executing.q[-1], goal))

    def _stop(self, schedule: Schedule, t_s: float) -> TimedTrajectory:
        return brake_along(schedule.at(t_s), t_s, self.acceleration_limit, self.config.sample_period_s)

    def _checked_goal(self, goal: Goal) -> FloatArray:
        q = checked(f"goal {goal.name}", goal.configuration, (self.chain.n_joints,), error=PlanningError)
        for joint, value, low, high in zip(self.chain.joint_names, q, self.chain.lower, self.chain.upper, strict=True):
            if not low - 1e-6 <= value <= high + 1e-6:
                raise GoalUnreachableError(
                    f"goal {goal.name}: wanted {joint} within {low:.4f} to {high:.4f} rad, got {value:.4f} rad; "
                    "choose a configuration within the limits"
                )
        return q
