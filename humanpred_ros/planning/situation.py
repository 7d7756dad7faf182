"""What a replanning step works with: tools that stay the same from step to step, and where this one begins."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from humanpred_ros.checks import FloatArray
from humanpred_ros.occupancy.grid import Occupancy
from humanpred_ros.planning.margin import widened
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.stomp.costs import HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.planning.stomp.planner import StompPlanner
from humanpred_ros.planning.timing.trajectory import TimedTrajectory
from humanpred_ros.planning.validity.motion_check import MotionChecker
from humanpred_ros.robot.chain import BodyPoints, KinematicChain


@dataclass(frozen=True, eq=False)
class Tools:
    """What stays the same from step to step."""

    config: ReplannerConfig
    chain: KinematicChain
    points: BodyPoints
    obstacles: ObstacleCost
    smoothness: SmoothnessCost
    checker: MotionChecker
    weights: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    pool: ThreadPoolExecutor | None

    def planner(self, occupancy: Occupancy) -> tuple[StompPlanner, HumanOccupancyCost]:
        """Return the planner for one predicted occupancy, and the person's part of its terms."""
        stomp = self.config.stomp
        near = widened(occupancy, self.config.human_margin_m)
        human = HumanOccupancyCost(self.chain, self.points, near, stomp.human_weight)
        terms = (self.obstacles, human, self.smoothness)
        return StompPlanner(terms, self.chain.lower, self.chain.upper, stomp), human

    def person(self, occupancy: Occupancy) -> Person:
        """Return the person of one predicted occupancy."""
        return Person(occupancy, self.checker, self.config)


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
