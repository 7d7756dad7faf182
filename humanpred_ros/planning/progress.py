"""How far the work has come: what the replanner carries from one step to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.decision import HOLD, REPLAN, Decision
from humanpred_ros.planning.schedule import Schedule
from humanpred_ros.planning.situation import Situation

#: Stamps count as due this much early, s: they are whole nanoseconds, periods are not.
_DUE_TOLERANCE_S = 1e-6


@dataclass
class Progress:
    """The state of `MultiGoalReplanner` since its start.

    Attributes:
        period_s: of replanning steps.
        schedule: what the robot executes when.
        goals: configurations (K, D) of each goal, unwrapped from where the robot started.
        last_stamp_s: of the newest step.
        last_due_s: of the newest step that was due.
        step: number of the next step.
        paths, set_aside, left, chosen, leads_to: as in `Situation`.
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

    def situation(
        self, stamp_s: float, t_switch_s: float, task_costs: Mapping[str, float], noise_std: FloatArray | None
    ) -> Situation:
        """Return where a step begins whose plan takes over at `t_switch_s`."""
        return Situation(
            step=self.step,
            stamp_s=stamp_s,
            t_switch_s=t_switch_s,
            goals=self.goals,
            task_costs=task_costs,
            paths=self.paths,
            set_aside=self.set_aside,
            left=self.left,
            chosen=self.chosen,
            leads_to=self.leads_to,
            arrived=self.at_goal(t_switch_s),
            executing=self.schedule.at(t_switch_s),
            held=bool(self.held),
            noise_std=noise_std,
        )

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
