"""What a replanning step starts from: the state that is carried from step to step, and the moment of the step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import HOLD, REPLAN, Decision, GoalReport
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.problem import Problem
from humanpred_ros.planning.trajectory import Schedule, TimedTrajectory

if TYPE_CHECKING:
    from humanpred_ros.planning.candidates import Candidate

#: Stamps count as due this much early, s: they are whole nanoseconds, periods are not.
_DUE_TOLERANCE_S = 1e-6


@dataclass
class State:
    """All that changes while the robot works.

    Attributes:
        period_s: of replanning steps.
        schedule: what the robot executes when.
        goals: configurations (K, D) of each goal, continuous joints unwrapped from where the robot started.
        last_stamp_s: of the newest step.
        last_due_s: of the newest step that was due.
        step: number of the next step.
        paths: path (N, D) to each goal found by the last step; empty before the first.
        set_aside: goals that the last step did not consider, with the reason.
        left: how often each goal has been given up for another.
        chosen: goal being worked on; None before the first choice.
        leads_to: goal that the trajectory being executed ends at; None while stopping or moving aside.
        held: why the robot has been stopped; empty while it has not.
        urgent: whether any occupancy calls for a step, after an emergency stop.
    """

    period_s: float
    schedule: Schedule
    goals: Mapping[str, FloatArray]
    last_stamp_s: float
    last_due_s: float
    step: int = 1
    paths: dict[str, FloatArray] = field(default_factory=dict)
    set_aside: dict[str, str] = field(default_factory=dict)
    left: dict[str, int] = field(default_factory=dict)
    chosen: str | None = None
    leads_to: str | None = None
    held: str = ""
    urgent: bool = False

    def due(self, t_s: float) -> bool:
        """Return whether an occupancy stamped `t_s` calls for a step."""
        return self.urgent or self._on_time(t_s)

    def at_goal(self, t_s: float) -> bool:
        """Return whether the robot will rest at the chosen goal at `t_s`."""
        if self.chosen is None or self.held:
            return False
        executing = self.schedule.at(t_s)
        return executing.end_s <= t_s and bool((executing.q[-1] == self.goals[self.chosen]).all(axis=1).any())

    def take(self, decision: Decision) -> None:
        """Go on as a step has decided."""
        if decision.trajectory is not None:
            self.schedule.add(decision.t_switch_s, decision.trajectory)
        if decision.trajectory is not None or decision.action == HOLD:
            self.leads_to = decision.chosen if decision.action == REPLAN else None
        self.held = decision.reason if decision.action == HOLD else ""
        self.paths.update({report.name: report.path for report in decision.goals})
        self.set_aside = {report.name: report.set_aside for report in decision.goals if report.set_aside}
        if decision.switched and decision.previous is not None:
            self.left[decision.previous] = self.left.get(decision.previous, 0) + 1
        self.chosen = decision.chosen
        self.count(decision.stamp_s)

    def count(self, stamp_s: float) -> None:
        """Note a step; those between two due ones, for a motion that has become bad, do not put the next one off."""
        self.step += 1
        self.last_stamp_s = stamp_s
        self.urgent = False
        if self._on_time(stamp_s):
            self.last_due_s = stamp_s

    def stop(self, decision: Decision) -> None:
        """Note a hold, which needs no commitment."""
        if decision.trajectory is not None:
            self.schedule.add(decision.t_switch_s, decision.trajectory)
            self.step += 1
        self.held, self.leads_to = decision.reason, None
        self.urgent = True

    def _on_time(self, t_s: float) -> bool:
        return t_s >= self.last_due_s + self.period_s - _DUE_TOLERANCE_S


class Step:
    """One step being made; it changes nothing of the state.

    Attributes:
        problem, state, person: the arm and its goals, what the step starts from, and the person now.
        stamp_s, t_switch_s: stamp of the occupancy; when the step's trajectory takes over, one period later.
        executing: the trajectory being executed at the switch if nothing changes.
        q, v, a: (D,) position, velocity and acceleration at the switch.
        planner, human: STOMP for this occupancy, and the cost of the person.
        noise_std: noise of the rollouts, as in `StompConfig`; None for the configured one.
        deadline: says True when the time is over; None for no deadline.
        candidates: a path to each goal, in the scene's order, once planned.
    """

    def __init__(
        self,
        problem: Problem,
        state: State,
        person: Person,
        noise_std: ArrayLike | None = None,
        deadline: Callable[[], bool] | None = None,
    ) -> None:
        self.problem, self.state, self.person = problem, state, person
        self.noise_std, self.deadline = noise_std, deadline
        self.stamp_s = person.occupancy.t_s
        self.t_switch_s = self.stamp_s + problem.config.period_s
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
