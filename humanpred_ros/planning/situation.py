"""Where a replanning step begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.timing.trajectory import TimedTrajectory


@dataclass(frozen=True)
class Situation:
    """Where a step begins.

    Attributes:
        step, stamp_s, t_switch_s: as in `Decision`.
        goals: configurations (K, D) of each goal, unwrapped.
        task_costs: of each goal.
        paths: path (N, D) to each goal found by the step before; empty in the first.
        set_aside: goals the step before did not consider, with the reason.
        left: how often each goal has been given up for another.
        chosen: goal being worked on.
        leads_to: goal that the trajectory being executed ends at; None while stopping or moving aside.
        arrived: whether the robot will rest at the chosen goal by the switch.
        executing: the trajectory being executed at the switch if nothing changes.
        held: whether that is a stop.
        noise_std: noise of this step's rollouts, as in `StompConfig`; None for the configured one.
    """

    step: int
    stamp_s: float
    t_switch_s: float
    goals: Mapping[str, FloatArray]
    task_costs: Mapping[str, float]
    paths: Mapping[str, FloatArray]
    set_aside: Mapping[str, str]
    left: Mapping[str, int]
    chosen: str | None
    leads_to: str | None
    arrived: bool
    executing: TimedTrajectory
    held: bool
    noise_std: FloatArray | None = None
