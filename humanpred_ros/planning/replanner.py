"""Keeps the robot working on the goal that disturbs the person least, replanning while it moves (P1 Alg. 1).

Each step takes the newest predicted occupancy, plans to every goal from where the robot will be one period
later, and lets the best plan take over then (the one-step lag of P1 Fig. 4). Planning changes nothing:
`plan` returns a decision, `commit` makes it so.

A goal that has been reached is kept until the person is likely to come to it. On the way, the path being executed
is kept unless a new one is better by a margin, so that the robot does not twitch at every step, and a goal is given
up only for one that is clearly better, so that it does not dither.

Between the steps every occupancy is held against what is being executed (`respond`): a motion that has become bad
is replanned at once, and one that would come too close to the person before a new plan can take over is stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import reach_m
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, MISSED, Decision
from humanpred_ros.planning.guard import has_become_bad, stop_reason
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.progress import Progress
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.schedule import Schedule
from humanpred_ros.planning.step import ReplanningStep
from humanpred_ros.planning.timing.stopping import brake_along
from humanpred_ros.planning.tools import Tools
from humanpred_ros.planning.validity.goal_check import outside_limits, usable_configurations
from humanpred_ros.planning.validity.motion_check import SelfClearance
from humanpred_ros.planning.warm_up import warm_up
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.contacts import SelfCollision
from humanpred_ros.robot.goals import Goal
from humanpred_ros.robot.scene import Scene
from humanpred_ros.stomp.costs import Float32Array

__all__ = ["MultiGoalReplanner", "ReplannerConfig"]


class MultiGoalReplanner:
    """P1's Algorithm 1 for one arm and a set of goals.

    Attributes:
        keep_rollouts: whether `rollouts` is wanted; it is for pictures only.
        rollouts: noisy trajectories (R, N, D) of the last step's last update, by goal.

    Not safe to call from several threads at once; it uses threads of its own.
    """

    def __init__(
        self,
        arm: Arm,
        goals: Sequence[Goal],
        field: SignedDistanceField,
        config: ReplannerConfig | None = None,
        *,
        self_clearance: SelfClearance | None = None,
        grid: VoxelGrid | None = None,
    ) -> None:
        """Take the arm, its goals and the distance to obstacles; call `start` before planning.

        Args:
            arm: what moves.
            goals: tasks to choose from.
            field: signed distance to obstacles.
            config: settings.
            self_clearance: clearance (T,) of the arm from itself at configurations (T, D); not looked at if absent.
            grid: the lattice every occupancy must have; any will do if absent.

        Raises:
            PlanningError: for no goals or two of one name.
            GoalUnreachableError: for a goal all of whose configurations are outside the joint limits or not free.
        """
        self.config = config or ReplannerConfig()
        self.arm = arm
        self.chain = arm.chain
        names = [goal.name for goal in goals]
        if not names or len(set(names)) != len(names):
            raise PlanningError(f"replanner: wanted one or more goals of different names, got {names}")
        self.goal_names = tuple(names)
        self._grid = grid
        self._tools = tools = Tools.of_arm(arm, field, self.config, self_clearance)
        self.weights = tools.weights
        self.velocity_limit, self.acceleration_limit = tools.velocity_limit, tools.acceleration_limit
        self._configurations = {goal.name: usable_configurations(goal, self._tools.checker) for goal in goals}
        self._task_costs = {goal.name: goal.task_cost for goal in goals}
        self._progress: Progress | None = None
        self._noise_std: FloatArray | None = None
        self.keep_rollouts = False
        self.rollouts: dict[str, Float32Array] = {}

    @classmethod
    def for_scene(cls, scene: Scene, config: ReplannerConfig | None = None) -> MultiGoalReplanner:
        """Return the replanner of a scene's arm, goals and obstacles."""
        arm = scene.arm
        itself = SelfCollision.for_arm(arm).clearance
        return cls(arm, scene.goals, scene.distance_field(), config, self_clearance=itself, grid=scene.grid)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the D joints, in the order of every configuration."""
        return self.chain.joint_names

    def start(self, q_start: ArrayLike, t_s: float) -> None:
        """Begin anew with the robot at rest at `q_start` (D,) from `t_s` on.

        Goals are unwrapped so that continuous joints go the shorter way from here.

        Raises:
            PlanningError: for a start that is not finite, or outside the joint limits.
        """
        q = checked("start configuration", q_start, (self.chain.n_joints,), error=PlanningError)
        outside = outside_limits(self.chain, q)
        if outside:
            raise PlanningError(f"start configuration: {outside}; is the robot reporting this arm's joints?")
        goals = {name: q + self.arm.difference(q, goal) for name, goal in self._configurations.items()}
        # P1 looks at the first 5 % of a motion before it plans: no step is due yet.
        self._progress = Progress(self.config.period_s, Schedule(q, t_s), goals, last_stamp_s=t_s, last_due_s=t_s)

    def set_noise(self, noise_std: ArrayLike) -> None:
        """Let the steps to come use this noise, as in `StompConfig`: one number, or one for each joint.

        Raises:
            PlanningError: for another number of them, or one that is not positive.
        """
        std = np.asarray(noise_std, dtype=np.float64)
        if std.shape not in ((), (self.chain.n_joints,)) or not (np.isfinite(std) & (std > 0.0)).all():
            raise PlanningError(f"noise_std: wanted one number > 0 or {self.chain.n_joints} of them, got {std}")
        self._noise_std = std

    def due(self, t_s: float) -> bool:
        """Return whether an occupancy stamped `t_s` calls for a replanning step; after an emergency stop, any does."""
        return self._started().due(t_s)

    def respond(
        self,
        occupancy: Occupancy,
        now: Callable[[], float] | None = None,
        deadline: Callable[[], bool] | None = None,
    ) -> Decision:
        """Answer one occupancy with one decision, and make it so: what a node calls for every message.

        A step is planned if one is due, or at once if what is being executed has become bad: it would come too
        close to where the person is, or end where the person is likely to come. If it would come too close before
        a new plan can take over, the robot stops.

        Args:
            occupancy: the newest one.
            now: the time, s, where it passes while this works; the occupancy's stamp if not given. A plan that is
                ready too late to take over is "missed".
            deadline: as in `plan`.

        Raises:
            PlanningError: as `plan`.
        """
        progress = self._check(occupancy)
        now_s = occupancy.t_s if now is None else now()
        person = self._tools.person(occupancy)
        schedule, t_switch_s = progress.schedule, occupancy.t_s + self.config.period_s
        # Without a goal ahead it stops already, or gets out of the way as well as it can.
        if progress.leads_to is not None:
            reason = stop_reason(person, schedule, now_s, t_switch_s, self.config.min_separation_m)
            if reason:
                return replace(self.hold(now_s, reason), stamp_s=occupancy.t_s)
        if not (progress.due(occupancy.t_s) or has_become_bad(person, schedule, occupancy.t_s, t_switch_s)):
            return self.keep(occupancy)
        decision = self._planned(progress, occupancy, person, deadline)
        if now is not None and decision.trajectory is not None and now() >= decision.t_switch_s:
            return self.missed(decision)
        self.commit(decision)
        return decision

    def plan(self, occupancy: Occupancy, deadline: Callable[[], bool] | None = None) -> Decision:
        """Plan to every goal and choose (P1 Alg. 1); nothing changes until the decision is committed.

        Args:
            occupancy: predicted human occupancy; the plan takes over `period_s` after its stamp.
            deadline: asked before every STOMP iteration; once it says True the best so far is used. Decisions
                made under a deadline depend on the machine.

        Raises:
            PlanningError: before `start`, for an occupancy older than the last one committed, or one of another
                lattice than the replanner was made for.
        """
        progress = self._check(occupancy)
        return self._planned(progress, occupancy, self._tools.person(occupancy), deadline)

    def commit(self, decision: Decision) -> None:
        """Make a decision of `plan` so: its trajectory is executed from its switch time on.

        Raises:
            PlanningError: if it does not follow from the present state (already committed, or a hold came
                in between).
        """
        progress = self._started()
        if decision.step != progress.step:
            raise PlanningError(
                f"replanner: wanted the decision of step {progress.step}, got that of step {decision.step}; plan again"
            )
        progress.take(decision)

    def keep(self, occupancy: Occupancy) -> Decision:
        """Return the answer to an occupancy for which no step is due: whatever goes on goes on."""
        progress = self._started()
        action, reason = KEEP, "no replanning step is due"
        if progress.held:
            action, reason = HOLD, progress.held
        elif progress.at_goal(occupancy.t_s):
            action, reason = ARRIVED, f"at {progress.chosen}"
        return Decision(occupancy.t_s, progress.step - 1, action, reason, progress.chosen, progress.chosen)

    def missed(self, decision: Decision) -> Decision:
        """Record that a decision of `plan` came too late to take over; what is being executed goes on."""
        progress = self._started()
        progress.count(decision.stamp_s)
        late = f"took {decision.compute_s:.3f} s, too long to take over at {decision.t_switch_s:.3f} s"
        return replace(
            decision, action=MISSED, reason=late, chosen=progress.chosen, previous=progress.chosen,
            t_switch_s=float("nan"), trajectory=None,
        )  # fmt: skip

    def hold(self, t_s: float, reason: str) -> Decision:
        """Stop at once, along what is being executed; in force without `commit`.

        Further holds return no new trajectory; the next plan that is committed ends the hold.
        """
        progress = self._started()
        schedule = progress.schedule
        # An arm at rest needs no stop, unless it is about to set out.
        resting = self.at_rest(t_s) and schedule.last_from_s <= t_s
        stop = None
        if not (progress.held or resting):
            stop = brake_along(schedule.at(t_s), t_s, self.acceleration_limit, self.config.sample_period_s)
        decision = Decision(
            t_s, progress.step, HOLD, reason, progress.chosen, progress.chosen,
            t_switch_s=float("nan") if stop is None else t_s, trajectory=stop,
        )  # fmt: skip
        progress.stop(decision)
        return decision

    def state_at(self, t_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (D,) commanded at `t_s`."""
        return self._started().schedule.state_at(t_s)

    def at_rest(self, t_s: float) -> bool:
        """Return whether the robot is commanded to rest at `t_s`."""
        return self._started().schedule.at(t_s).end_s <= t_s

    def tool_path(self, path: ArrayLike) -> FloatArray:
        """Return the (N, 3) world positions of the tool along a path (N, D)."""
        positions: FloatArray = self.chain.tool_pose(path)[..., :3, 3]
        return positions

    def warm_up(self) -> None:
        """Compile everything a step needs, so that the first one is no slower than the others."""
        centre_m, _ = reach_m(self.chain, self.arm.spheres())
        warm_up(self._tools, next(iter(self._configurations.values()))[0], centre_m)

    def close(self) -> None:
        """End the threads; the replanner cannot plan any more."""
        if self._tools.pool is not None:
            self._tools.pool.shutdown()

    def _planned(
        self, progress: Progress, occupancy: Occupancy, person: Person, deadline: Callable[[], bool] | None
    ) -> Decision:
        began = time.perf_counter()
        t_switch_s = occupancy.t_s + self.config.period_s
        situation = progress.situation(occupancy.t_s, t_switch_s, self._task_costs, self._noise_std)
        step = ReplanningStep(self._tools, situation, person, deadline)
        decision = step.decide()
        self.rollouts = step.rollouts() if self.keep_rollouts else {}
        return replace(decision, compute_s=time.perf_counter() - began)

    def _started(self) -> Progress:
        if self._progress is None:
            raise PlanningError("replanner: wanted start() first, which says where the robot is; call it")
        return self._progress

    def _check(self, occupancy: Occupancy) -> Progress:
        progress = self._started()
        if not occupancy.t_s >= progress.last_stamp_s:
            raise PlanningError(
                f"replanner: wanted an occupancy at {progress.last_stamp_s:.3f} s or later, got {occupancy.t_s:.3f} s; "
                "call start() when the clock jumps back"
            )
        if self._grid is not None and occupancy.grid != self._grid:
            raise PlanningError(
                f"replanner: wanted an occupancy on the scene's lattice {self._grid}, got {occupancy.grid}; "
                "use one scene for predictor and planner"
            )
        return progress
