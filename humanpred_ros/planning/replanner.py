"""P1's Algorithm 1: keeps the robot working on the goal that disturbs the person least, replanning while it moves.

`Replanner.respond` is one turn of the loop (docs/papers.md, P1 replanning, lines 1 to 7). Each step takes the
newest predicted occupancy, plans to every goal from where the robot will be one period later, and lets the best plan
take over then (the one-step lag of P1 Fig. 4). Planning changes nothing: `plan` returns a decision, `commit` makes it
so.

What is added to the paper: A goal that has been reached is kept until the person is likely to come to it. On the way,
the path being executed is kept unless a new one is better by a margin, so that the robot does not twitch at every
step, and a goal is given up only for one that is clearly better, so that it does not go back and forth. What is
executed has been checked between its waypoints too: against obstacles and the arm itself, and for the hard separation
from the person. Between the steps every occupancy is compared with what is being executed: a motion that has become
bad is replanned at once, and one that would come too close to the person before a new plan can take over is stopped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.choice import NO_TIME, decide
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, MISSED, Decision, State
from humanpred_ros.planning.following import ArmFollowing
from humanpred_ros.planning.motion_check import SelfClearance
from humanpred_ros.planning.pace import Pace
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.problem import Arm, Problem
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.step import Step
from humanpred_ros.planning.trajectory import Schedule, TimedTrajectory, at_rest
from humanpred_ros.robot.clearance import SelfCollision
from humanpred_ros.robot.goals import Goal
from humanpred_ros.robot.scene import Scene
from humanpred_ros.stomp.costs import Float32Array

__all__ = ["NO_TIME", "Replanner", "ReplannerConfig"]


class Replanner:
    """P1's Algorithm 1 for one arm and a set of goals.

    One thread plans. Another may call `hold`, `correct` and `regain`, also while a step is planned: under `lock`.

    Attributes:
        problem: what stays the same from step to step: arm, goals, limits, settings.
        config, arm, chain: of the problem.
        keep_rollouts: whether `rollouts` is wanted; it is for pictures only.
        rollouts: noisy trajectories (R, N, D) of the last step's last update, by goal.
        lock: held while the state changes, not while a step is planned.
        factor: speed at which the controller runs through what it is sent (`set_factor`).
        stopped: why that is 0; empty while it is not.
        doubt: why not all obstacles are known, so that no occupancy is planned with; empty while they are.
        paused: why no occupancy is planned with, by somebody's wish; empty while they are.
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
        self.problem = Problem(arm, goals, field, self.config, self_clearance)
        self.arm, self.chain = arm, arm.chain
        self._grid = grid
        self._state: State | None = None
        self._next: Problem | None = None
        self.keep_rollouts = False
        self.lock = threading.RLock()
        self.factor, self.stopped, self.paused, self.doubt = 1.0, "", "", ""
        self.rollouts: dict[str, Float32Array] = {}

    @classmethod
    def for_scene(cls, scene: Scene, config: ReplannerConfig | None = None) -> Replanner:
        """Return the replanner of a scene's arm, goals and obstacles."""
        itself = SelfCollision.for_arm(scene.arm).clearance
        return cls(scene.arm, scene.goals, scene.distance_field(), config, self_clearance=itself, grid=scene.grid)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the D joints, in the order of every configuration."""
        return self.chain.joint_names

    @property
    def goals(self) -> tuple[Goal, ...]:
        """The goals from the next occupancy on, in the scene's order, later ones behind."""
        return (self._next or self.problem).given

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Names of the goals."""
        return tuple(goal.name for goal in self.goals)

    def start(self, q_start: ArrayLike, t_s: float) -> None:
        """Begin anew with the robot at rest at `q_start` (D,) from `t_s` on.

        Goals are unwrapped so that continuous joints go the shorter way from here.

        Raises:
            PlanningError: for a start that is not finite, or outside the joint limits.
        """
        self._take_changes()
        q = checked("start configuration", q_start, (self.chain.n_joints,), error=PlanningError)
        outside = self.problem.outside_limits(q)
        if outside:
            raise PlanningError(f"start configuration: {outside}; is the robot reporting this arm's joints?")
        goals = self._unwrapped(q)
        # P1 looks at the first 5 % of a motion before it plans: no step is due yet.
        state = State(self.config.period_s, Schedule(q, t_s), goals, last_stamp_s=t_s, last_due_s=t_s)
        state.pace = state.pace.changed(t_s, self.factor)
        self._state = state

    def forget(self) -> None:
        """Be as before `start`; what was set meanwhile is kept."""
        self._state = None

    def change(
        self,
        config: ReplannerConfig | None = None,
        task_costs: Mapping[str, float] | None = None,
        disabled: Iterable[str] | None = None,
        goals: Sequence[Goal] | None = None,
        field: SignedDistanceField | None = None,
    ) -> None:
        """Let other settings, costs of goals, disabled goals, goals or obstacles count from the next occupancy on.

        All or none. A disabled goal is not planned for, and left with the next step; so is one that is gone, and one
        that other obstacles block. A step that is being planned, and what is being executed, keep what they were made
        with until then: what is not free of other obstacles is stopped or replaced by the next answer. Period and
        threads stay as they are.

        Raises:
            HumanPredError: as `Problem.changed`.
        """
        with self.lock:
            base = self._next or self.problem
            if disabled is None:
                disabled = base.disabled if goals is None else base.disabled & {goal.name for goal in goals}
            other = base.changed(config or base.config, task_costs or {}, disabled, goals, field)
            self._next = other
            if self._state is None:
                self._take_changes()

    def plan_now(self) -> None:
        """Let the next occupancy be answered with a replanning step, due or not."""
        self._started().urgent = True

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
            occupancy: the newest one: lines 2 and 3 of Algorithm 1, done by whoever predicts.
            now: the time, s, where it passes while this works; the occupancy's stamp if not given. A plan that is
                ready too late to take over is "missed".
            deadline: as in `plan`.

        Raises:
            PlanningError: as `plan`.
        """
        state, stamp_s = self._check(occupancy), occupancy.t_s
        now_s = stamp_s if now is None else now()
        with self.lock:
            worked_on, moved = state.chosen, self._take_changes()
            if self.blocked:
                return replace(self.hold(now_s, self.blocked), stamp_s=stamp_s)
            stops, pace = state.stops, state.pace
            seen_s, from_s, t_switch_s = pace.progress([stamp_s, now_s, stamp_s + self.config.period_s])
            checker, ahead = self.problem.checker, state.schedule.motion_from
            trouble = checker.first_trouble(ahead(from_s), from_s) if moved else None
            if state.chosen != worked_on and not self.at_rest(now_s):
                return replace(self.hold(now_s, f"task {worked_on} was removed"), stamp_s=stamp_s)
            if trouble is not None and trouble.at < t_switch_s and not self.at_rest(now_s):
                return replace(self.hold(now_s, f"an obstacle has come into its way: {trouble}"), stamp_s=stamp_s)
            state.urgent = state.urgent or trouble is not None
        person = self.problem.person(occupancy)
        reason = self._too_close(state, person, now_s)
        if reason:
            return replace(self.hold(now_s, reason), stamp_s=stamp_s)
        if not (state.due(stamp_s) or person.calls_for_replanning(state.schedule, seen_s, t_switch_s)):
            return self.keep(occupancy)
        decision = self._planned(state, person, deadline)  # lines 4 to 6
        with self.lock:
            if state.stops != stops or self._state is not state:  # somebody has stopped the robot meanwhile
                held = self._started()
                return Decision(stamp_s, held.step - 1, HOLD, held.held, held.chosen, held.chosen)
            if now is not None and decision.trajectory is not None and self._progress(now()) >= decision.t_switch_s:
                return self.missed(decision)
            self.commit(decision)  # line 7
            return decision

    def too_close(self, occupancy: Occupancy, now_s: float) -> str:
        """Return why the robot must stop at once, before `respond` can answer an occupancy; empty if it need not.

        For those who do not want to wait for a step that is being planned with an older one.
        """
        return self._too_close(self._check(occupancy), self.problem.person(occupancy), now_s)

    def plan(self, occupancy: Occupancy, deadline: Callable[[], bool] | None = None) -> Decision:
        """Plan to every goal and choose (lines 4 to 6 of Algorithm 1); nothing changes until `commit`.

        Args:
            occupancy: predicted human occupancy; the plan takes over `period_s` after its stamp.
            deadline: asked before every STOMP iteration; once it says True the best so far is used. Decisions
                made under a deadline depend on the machine.

        Raises:
            PlanningError: before `start`, for an occupancy older than the last one committed, or one of another
                lattice than the replanner was made for.
        """
        with self.lock:
            self._take_changes()
        return self._planned(self._check(occupancy), self.problem.person(occupancy), deadline)

    def commit(self, decision: Decision) -> None:
        """Make a decision of `plan` so: its trajectory is executed from its switch time on.

        Raises:
            PlanningError: if it does not follow from the present state (already committed, or a hold came
                in between).
        """
        state = self._started()
        if decision.step != state.step:
            raise PlanningError(
                f"replanner: wanted the decision of step {state.step}, got that of step {decision.step}; plan again"
            )
        state.take(decision)

    def keep(self, occupancy: Occupancy) -> Decision:
        """Return the answer to an occupancy for which no step is due: whatever goes on goes on."""
        state = self._started()
        action, reason = KEEP, "no replanning step is due"
        if state.held:
            action, reason = HOLD, state.held
        elif state.at_goal(self._progress(occupancy.t_s)):
            action, reason = ARRIVED, f"at {state.chosen}"
        return Decision(occupancy.t_s, state.step - 1, action, reason, state.chosen, state.chosen)

    def missed(self, decision: Decision) -> Decision:
        """Record that a decision of `plan` came too late to take over; what is being executed goes on."""
        state = self._started()
        state.count(decision.stamp_s)
        late = f"took {decision.compute_s:.3f} s, too long to take over at {self.reached_s(decision):.3f} s"
        return replace(
            decision, action=MISSED, reason=late, chosen=state.chosen, previous=state.chosen,
            t_switch_s=float("nan"), trajectory=None,
        )  # fmt: skip

    def hold(self, t_s: float, reason: str) -> Decision:
        """Stop at once, along what is being executed; in force without `commit`.

        Further holds return no new trajectory; the next plan that is committed ends the hold.
        """
        state, at_s = self._started(), self._progress(t_s)
        # An arm at rest needs no stop, unless it is about to set out.
        resting = self.at_rest(t_s) and state.schedule.last_from_s <= at_s
        stop = None if state.held or resting else self.problem.stopped(state.schedule.at(at_s), at_s, self.factor)
        return self._stop(t_s, reason, stop)

    def set_factor(self, factor: float, t_s: float, reason: str = "") -> Decision | None:
        """Let the arm's controller run through what it is sent at a factor of 0 to 1 from `t_s` on.

        At 0 the arm stands: hold for that reason until the factor has been raised and, where the robot had been
        started, `regain` was called.

        Returns:
            The hold that a factor of 0 is, if the arm did not stand by it already; None otherwise.

        Raises:
            PlanningError: for another factor, or a time that is not finite.
        """
        pace = Pace().changed(t_s, factor) if self._state is None else self._state.pace.changed(t_s, factor)
        stopped, self.stopped, self.factor = self.stopped, "" if factor else reason, factor
        if self._state is None:
            return None
        state, state.pace = self._state, pace
        if factor:
            return None
        if stopped:
            state.lost = state.held = reason
            return None
        at_s = self._progress(t_s)
        state.lost = reason
        return self._stop(t_s, reason, at_rest(state.schedule.state_at(at_s)[0], at_s))

    def correct(self, q: ArrayLike, v: ArrayLike, t_s: float, reason: str) -> Decision:
        """Take the arm for where it was measured instead of where it was commanded to be, and hold until `regain`.

        From there it stops, every joint for itself.

        Args:
            q, v: (D,) measured position and velocity.
            t_s: when.
            reason: of the hold.

        Raises:
            PlanningError: before `start`, or for a state of another shape.
        """
        state, at_s = self._started(), self._progress(t_s)
        stop = self.problem.stopped_from(q, v, at_s, self.factor)
        state.schedule, state.lost = Schedule(stop.q[0], at_s), reason
        return self._stop(t_s, reason, stop)

    def regain(self, q: ArrayLike, t_s: float) -> None:
        """Go on with an arm that was `lost`: measured at rest at `q` (D,) at `t_s`; raises as `correct`."""
        state = self._started()
        state.schedule, state.lost = Schedule(q, self._progress(t_s)), ""

    @property
    def pace(self) -> Pace:
        """How the controller's time runs."""
        return self._started().pace

    @property
    def disabled(self) -> frozenset[str]:
        """Names of the goals that are not planned for, from the next occupancy on."""
        return (self._next or self.problem).disabled

    @property
    def blocked(self) -> str:
        """Why no occupancy is planned with, whatever is in it; empty while they are."""
        none = f"no task is enabled: {', '.join(self.goal_names)} could be"
        why = self.stopped or self.lost or self.paused or self.doubt
        return why or (none if self.disabled.issuperset(self.goal_names) else "")

    @property
    def held(self) -> str:
        """Why the robot has been stopped; empty while it has not."""
        return "" if self._state is None else self._state.held

    @property
    def lost(self) -> str:
        """Why the arm is not where it was commanded to be, so that it is not commanded; empty while it is."""
        return "" if self._state is None else self._state.lost

    @lost.setter
    def lost(self, reason: str) -> None:
        self._started().lost = reason

    def motion_from(self, t_s: float) -> TimedTrajectory:
        """Return all that is commanded from `t_s` on, as one trajectory that begins with the state then.

        From its beginning at `t_s` on, its times are the controller's own.
        """
        at_s = self._progress(t_s)
        return self._started().schedule.motion_from(at_s).later(t_s - at_s)

    def reached_s(self, decision: Decision) -> float:
        """Return when a decision's trajectory takes over at the present speed factor, NaN if it has none."""
        return self._started().pace.reached_s(decision.t_switch_s)

    def arm_trouble(self, following: ArmFollowing, q: FloatArray, t_s: float, delay_s: float = 0.0) -> str:
        """Return why the arm does not follow what is commanded, as `ArmFollowing.trouble`; empty if it does."""
        state = self._started()
        return following.trouble(lambda t: state.schedule.positions(state.pace.progress(t)), q, t_s, delay_s)

    def nearest_start(self, q: ArrayLike, slack_rad: float) -> FloatArray:
        """Return where planning begins for an arm measured at `q` (D,): the nearest configuration within the limits.

        Raises:
            PlanningError: for a joint farther than `slack_rad` outside of its limits.
        """
        measured = checked("start configuration", q, (self.chain.n_joints,), error=PlanningError)
        within: FloatArray = np.clip(measured, self.chain.lower, self.chain.upper)
        if np.abs(within - measured).max() > slack_rad:
            raise PlanningError(
                f"start configuration: {self.problem.outside_limits(measured)}; move the arm to within its limits"
            )
        return within

    def state_at(self, t_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (D,) commanded at `t_s`."""
        q, v, a = self._started().schedule.state_at(self._progress(t_s))
        return q, v * self.factor, a * self.factor**2

    def at_rest(self, t_s: float) -> bool:
        """Return whether the robot is commanded to rest at `t_s`."""
        at_s = self._progress(t_s)
        return self._started().schedule.at(at_s).end_s <= at_s

    def tool_path(self, path: ArrayLike) -> FloatArray:
        """Return the (N, 3) world positions of the tool along a path (N, D)."""
        positions: FloatArray = self.chain.tool_pose(path)[..., :3, 3]
        return positions

    def tool_places(self) -> dict[str, FloatArray]:
        """Return where each goal wants the tool, (3,) world frame, by name."""
        return {goal.name: self.tool_path(goal.configuration[None])[0] for goal in self.goals}

    def warm_up(self) -> None:
        """Compile everything a step needs, so that the first one is no slower than the others."""
        self.problem.warm_up()

    def close(self) -> None:
        """End the threads; the replanner cannot plan any more."""
        if self.problem.pool is not None:
            self.problem.pool.shutdown()

    def _too_close(self, state: State, person: Person, now_s: float) -> str:
        # Without a goal ahead the robot stops already, or gets out of the way as well as it can.
        if state.leads_to is None:
            return ""
        stamp_s = person.occupancy.t_s
        from_s, t_switch_s = state.pace.progress([now_s, stamp_s + self.config.period_s])
        return person.stop_reason(state.schedule, from_s, t_switch_s)

    def _planned(self, state: State, person: Person, deadline: Callable[[], bool] | None) -> Decision:
        began = time.perf_counter()
        step = Step(self.problem, state, person, deadline)  # line 4: where the arm will be
        decision = decide(step)
        runs = [(c.name, c.run) for c in step.candidates if c.run is not None and c.run.iterations]
        self.rollouts = {name: run.rollouts for name, run in runs} if self.keep_rollouts else {}
        return replace(decision, compute_s=time.perf_counter() - began)

    def _stop(self, t_s: float, reason: str, stop: TimedTrajectory | None) -> Decision:
        """Hold from `t_s` on; `stop` is how, None for a robot that rests or stops already."""
        state = self._started()
        t_switch_s = float("nan") if stop is None else stop.start_s
        decision = Decision(
            t_s, state.step, HOLD, reason, state.chosen, state.chosen, t_switch_s=t_switch_s, trajectory=stop
        )
        state.stop(decision)
        return decision

    def _unwrapped(self, q: FloatArray) -> dict[str, FloatArray]:
        return {name: q + self.arm.difference(q, goal) for name, goal in self.problem.goals.items()}

    def _take_changes(self) -> bool:
        """Let what was changed count from now on; return whether there are other obstacles than before."""
        if self._next is None:
            return False
        before, now, state = self.problem, self._next, self._state
        self.problem, self.config, self._next = now, now.config, None
        if state is None:
            return False
        # What is being executed has another speed than is wanted now.
        state.retime = state.retime or not np.array_equal(before.velocity_limit, now.velocity_limit)
        same = before.goals.keys() == now.goals.keys()
        if not (same and all(np.array_equal(q, now.goals[name]) for name, q in before.goals.items())):
            state.change_goals(self._unwrapped(state.schedule.motion_from(state.schedule.last_from_s).q[-1]))
        return before.checker.field is not now.checker.field

    def _progress(self, t_s: float) -> float:
        """Return the controller's time at `t_s`."""
        return float(self._started().pace.progress(t_s))

    def _started(self) -> State:
        if self._state is None:
            raise PlanningError("replanner: wanted start() first, which says where the robot is; call it")
        return self._state

    def _check(self, occupancy: Occupancy) -> State:
        state = self._started()
        if not occupancy.t_s >= state.last_stamp_s:
            raise PlanningError(
                f"replanner: wanted an occupancy at {state.last_stamp_s:.3f} s or later, got {occupancy.t_s:.3f} s; "
                "call start() when the clock jumps back"
            )
        if self._grid is not None and occupancy.grid != self._grid:
            raise PlanningError(
                f"replanner: wanted an occupancy on the scene's lattice {self._grid}, got {occupancy.grid}; "
                "use one scene for predictor and planner"
            )
        return state
