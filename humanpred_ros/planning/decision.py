"""What one replanning step decided and why, and the state that follows from it and is carried to the next step.

Decisions are what reports, bags and tests compare. Two are equal if every number in them is, bit for bit. The computing
time is kept apart from that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np

from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.planning.pace import Pace
from humanpred_ros.planning.trajectory import Schedule, TimedTrajectory

REPLAN = "replan"
KEEP = "keep"
HOLD = "hold"
EVADE = "evade"
ARRIVED = "arrived"
MISSED = "missed"
#: What the arm does to the goal, by action; a hold, and moving aside, are to no goal.
_IN_WORDS = {REPLAN: "to", KEEP: "goes on to", ARRIVED: "arrived at", MISSED: "too late for"}


@dataclass(frozen=True, eq=False)
class GoalReport:
    """The best path found to one goal in one replanning step."""

    name: str  #: the goal's
    cost: Mapping[str, float]  #: weighted share of each cost term, summed over waypoints
    total: float  #: sum of the shares
    human: float  #: human occupancy cost (unweighted) integrated over the path, in configuration distance
    length: float  #: of the path, in configuration distance
    selection_cost: float  #: what goals are compared by
    path: FloatArray  #: (N, D) waypoints, from where the robot will be to the goal, rad
    valid: bool  #: whether every waypoint is allowed
    reason: str  #: why it is not; empty if it is
    iterations: int  #: STOMP updates done; 0 where no plan was needed
    #: where the first path came from: "straight", "executing", a `Reconnection.kind`, or "arrived" where the robot is
    #: at the goal
    warm_start: str
    rest: float = 0.0  #: human occupancy cost (unweighted) of the last waypoint, where the arm would stay
    task_cost: float = 0.0  #: of the goal itself
    alternative: int = 0  #: which of the goal's configurations the path leads to
    set_aside: str = ""  #: why the goal is not considered in this step whatever its path costs; empty if it is
    revived: bool = False  #: whether it was set aside in the step before and is no more

    @property
    def eligible(self) -> bool:
        """Whether the arm may set out on this path, as far as the path itself tells."""
        return self.valid and not self.set_aside

    @property
    def obstacle_to_choice(self) -> str:
        """Why it may not; empty if it may."""
        return self.set_aside or self.reason

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", MappingProxyType(dict(self.cost)))
        object.__setattr__(self, "path", frozen(self.path))

    def __eq__(self, other: object) -> bool:
        return _same(self, other)

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class Decision:
    """What the replanner says to one occupancy (P1 Alg. 1), or on its own when it must stop."""

    stamp_s: float  #: stamp of the occupancy it follows from; of the hold, if it is one
    step: int  #: number of the replanning step, from 1 as in P1; of the last one (0 before any) if none was due
    #: "replan" (`trajectory` takes over at `t_switch_s`), "keep" (the trajectory being executed goes on), "hold" (stop,
    #: or stay stopped), "evade" (`trajectory` takes the arm out of the person's way), "arrived" (at rest at the chosen
    #: goal) or "missed" (a plan that came too late and is not executed)
    action: str
    reason: str  #: why, in words
    chosen: str | None  #: name of the goal being worked on; None before the first choice
    previous: str | None  #: the same before this step
    goals: tuple[GoalReport, ...] = ()  #: one report per goal, in the scene's order; empty where nothing was planned
    #: when `trajectory` takes over, NaN if there is none, and what is to be executed, None where nothing changes; both
    #: in the controller's time, which is the clock's until a guard slows the arm down (`pace.Pace`)
    t_switch_s: float = float("nan")
    trajectory: TimedTrajectory | None = None
    compute_s: float = field(default=0.0, compare=False)  #: seconds spent; not part of the comparison

    @property
    def switched(self) -> bool:
        """Whether another goal was chosen than before."""
        return self.previous is not None and self.chosen != self.previous

    @property
    def margin(self) -> float:
        """By how much the chosen goal is cheaper than the next one that may be chosen; negative where habit decided.

        NaN where there was no choice.
        """
        costs = {goal.name: goal.selection_cost for goal in self.goals if goal.eligible}
        if self.chosen not in costs or len(costs) < 2:
            return float("nan")
        return min(cost for name, cost in costs.items() if name != self.chosen) - costs[self.chosen]

    def report(self, name: str) -> GoalReport:
        """Return the report of one goal.

        Raises:
            KeyError: if this decision has none of that name.
        """
        for report in self.goals:
            if report.name == name:
                return report
        raise KeyError(name)

    def summary(self) -> str:
        """Return one line for people: what the arm does, for which goal, and why."""
        goal = f" {self.chosen}" if self.chosen and self.action in _IN_WORDS else ""
        instead = f", not {self.previous}" if goal and self.switched else ""
        reason = self.reason.removeprefix(f"{self.previous} cannot be worked on: " if instead else "")
        why = "" if self.action == ARRIVED else f": {reason}"
        return f"{_IN_WORDS.get(self.action, self.action)}{goal}{instead}{why}"

    def __eq__(self, other: object) -> bool:
        return _same(self, other)

    __hash__ = None  # type: ignore[assignment]


def _same(one: GoalReport | Decision, other: object) -> bool:
    if type(other) is not type(one):
        return False
    for part in fields(one):
        if not part.compare:
            continue
        a, b = getattr(one, part.name), getattr(other, part.name)
        same = np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray | float) else a == b
        if not same:
            return False
    return True


#: Stamps count as due this much early, s: they are whole nanoseconds, periods are not.
_DUE_TOLERANCE_S = 1e-6


@dataclass
class State:
    """All that changes while the robot works."""

    period_s: float  #: of replanning steps
    schedule: Schedule  #: what the robot executes when, in the controller's time
    #: configurations (K, D) of each goal, continuous joints unwrapped from where the robot started
    goals: Mapping[str, FloatArray]
    last_stamp_s: float  #: of the newest step
    last_due_s: float  #: of the newest step that was due
    step: int = 1  #: number of the next step
    #: path (N, D) to each goal found by the last step; empty before the first
    paths: dict[str, FloatArray] = field(default_factory=dict)
    #: goals that the last step did not consider, with the reason
    set_aside: dict[str, str] = field(default_factory=dict)
    left: dict[str, int] = field(default_factory=dict)  #: how often each goal has been given up for another
    chosen: str | None = None  #: goal being worked on; None before the first choice
    leads_to: str | None = None  #: goal that the trajectory being executed ends at; None while stopping or moving aside
    held: str = ""  #: why the robot has been stopped; empty while it has not
    urgent: bool = False  #: whether any occupancy calls for a step, after an emergency stop
    stops: int = 0  #: how often the robot has been stopped: a plan from before a stop is not executed
    #: why the robot is not where the schedule says, so that it may not be commanded; empty while it is there
    lost: str = ""
    retime: bool = False  #: whether what is being executed has another speed than plans are to have
    pace: Pace = field(default_factory=Pace)  #: of the controller's time

    def due(self, t_s: float) -> bool:
        """Return whether an occupancy stamped `t_s` calls for a step."""
        return self.urgent or self._on_time(t_s)

    def at_goal(self, t_s: float) -> bool:
        """Return whether the robot will rest at the chosen goal at `t_s`, the controller's time."""
        if self.chosen is None or self.held:
            return False
        executing = self.schedule.at(t_s)
        return executing.end_s <= t_s and bool((executing.q[-1] == self.goals[self.chosen]).all(axis=1).any())

    def take(self, decision: Decision) -> None:
        """Go on as a step has decided."""
        if decision.trajectory is not None:
            self.schedule.add(decision.t_switch_s, decision.trajectory)
            self.retime = False
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

    def change_goals(self, goals: Mapping[str, FloatArray]) -> None:
        """Take other goals; a goal that is gone is not worked on any more."""
        self.goals = goals
        self.paths = {name: path for name, path in self.paths.items() if name in goals}
        if self.chosen not in goals:
            self.chosen, self.leads_to, self.urgent = None, None, True

    def stop(self, decision: Decision) -> None:
        """Note a hold, which needs no commitment."""
        if decision.trajectory is not None:
            self.schedule.add(decision.t_switch_s, decision.trajectory)
            self.step += 1
        self.held, self.leads_to = decision.reason, None
        self.urgent = True
        self.stops += 1

    def _on_time(self, t_s: float) -> bool:
        return t_s >= self.last_due_s + self.period_s - _DUE_TOLERANCE_S
