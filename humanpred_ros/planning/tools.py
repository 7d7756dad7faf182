"""What a replanning step works with that stays the same from step to step: the arm, its costs, limits and threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from humanpred_ros.geometry.chain import BodyPoints, KinematicChain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.planning.margin import widened
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.validity.motion_check import MotionChecker, SelfClearance
from humanpred_ros.robot.arm import Arm
from humanpred_ros.stomp.costs import HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.stomp.planner import StompPlanner

#: What a timed trajectory may lose of clearance against its path, m: corners are rounded off, and what is left of
#: the old velocity leads off the path for a moment.
_EXECUTION_SLACK_M = 0.005


@dataclass(frozen=True, eq=False)
class Tools:
    """What stays the same from step to step, for an arm of D joints.

    Attributes:
        config: settings.
        chain, points: the arm, and what the human occupancy is summed over.
        obstacles, smoothness: cost terms that know nothing of the person.
        checker: says what may be executed.
        weights: (D,) P1's configuration distance of a one-radian change of each joint alone.
        velocity_limit, acceleration_limit: (D,) rad/s, rad/s2.
        pool: threads for several goals; None to plan in the caller's.
    """

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

    @classmethod
    def of_arm(
        cls, arm: Arm, field: SignedDistanceField, config: ReplannerConfig, self_clearance: SelfClearance | None
    ) -> Tools:
        """Return the tools for an arm among obstacles; `self_clearance` as in `MotionChecker`."""
        chain, spheres, stomp = arm.chain, arm.spheres(), config.stomp
        n = chain.n_joints
        return cls(
            config=config,
            chain=chain,
            points=arm.body_points(),
            obstacles=ObstacleCost(chain, spheres, field, stomp.obstacle_weight, margin_m=config.padding_m),
            smoothness=SmoothnessCost(stomp.smoothness_weight),
            checker=MotionChecker(chain, spheres, field, config.padding_m - _EXECUTION_SLACK_M, self_clearance),
            weights=np.array([float(arm.configuration_distance(np.zeros(n), unit)) for unit in np.eye(n)]),
            velocity_limit=config.velocity_scale * chain.velocity_limit,
            acceleration_limit=np.array(np.broadcast_to(config.acceleration_limit, (n,)), dtype=np.float64),
            pool=ThreadPoolExecutor(config.threads) if config.threads > 1 else None,
        )

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
