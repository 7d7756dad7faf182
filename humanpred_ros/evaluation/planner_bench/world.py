"""The workload of `humanpred bench planner`: a place where the planner cannot save itself any work.

In an open scene most links are far from everything and the kernels skip them. A figure from there would say little
about the cost of a lookup, so the bench's arm reaches into a shelf whose boards are near every link, through a ball of
occupancy as in the C++ yardstick. A second world leaves nothing at all to skip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField, build_distance_field
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.geometry.shapes import Box, Obstacle, planar_pose
from humanpred_ros.planning.path import straight
from humanpred_ros.robot.pr2 import BODY_POINT_SPACING_M, Pr2Arm
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.stomp.planner import StompPlanner

#: Arm, start and goals are this scene's.
_SCENE = "four_places"
#: The boards of the shelf, m: heights of the faces, and where they lie. The arm's way runs from 0.85 to 1.20 m.
_LOWER_BOARD_M, _UPPER_BOARD_M, _THICKNESS_M = 0.85, 1.25, 0.02
_BOARD_CENTRE_M, _BOARD_SIZE_M = (-0.1, -0.6), (1.6, 1.2)
#: Grid and ball of the yardstick: a cube of 2 m, the ball 1.2, 1.2 and 1.1 m from its lower corner, twice as high as
#: it is wide.
_GRID_M, _RESOLUTION_M, _BALL_RADIUS_M = (80, 80, 80), 0.025, 0.35
_BALL_IN_GRID_M, _BALL_STRETCH = np.array([1.2, 1.2, 1.1]), np.array([1.0, 1.0, 0.5])
#: Where nothing is to be skipped, every voxel is a little occupied and no distance exceeds this, m.
_HAZE, _NEAR_M = 1e-3, 0.05


@dataclass(frozen=True)
class Case:
    """How much there is to plan.

    Attributes:
        goals: number of goals planned to.
        waypoints, rollouts, iterations, reused: of STOMP; fresh noise means none reused.
        points: body points looked up in the occupancy.
        spheres: spheres looked up in the distance field.
    """

    goals: int = 8
    waypoints: int = 60
    rollouts: int = 10
    points: int = 150
    spheres: int = 50
    iterations: int = 50
    reused: int = 0

    def __post_init__(self) -> None:
        for name in ("goals", "rollouts", "points", "spheres", "iterations"):
            if getattr(self, name) < 1:
                raise UsageError(f"--{name}: wanted at least 1, got {getattr(self, name)}")
        if self.waypoints < 5:
            raise UsageError(f"--waypoints: wanted at least 5, got {self.waypoints}")
        if not 0 <= self.reused < self.rollouts:
            raise UsageError(f"--reused: wanted 0 to {self.rollouts - 1}, fewer than rollouts, got {self.reused}")

    @property
    def configurations(self) -> int:
        """Configurations costed per goal: every new rollout and the noiseless trajectory, in every iteration."""
        new = self.rollouts - self.reused
        return (self.iterations * (new + 1) + self.reused) * self.waypoints

    @property
    def lookups(self) -> int:
        """Lookups per goal: each point in the occupancy and each sphere in the distance field, per configuration."""
        return self.configurations * (self.points + self.spheres)

    @property
    def stomp(self) -> StompConfig:
        return StompConfig(
            waypoints=self.waypoints,
            iterations=self.iterations,
            rollouts=self.rollouts,
            reused=self.reused,
            patience=0,  # all iterations are done, whether or not they still help
        )


@dataclass(frozen=True, eq=False)
class BenchWorld:
    """Everything a case is planned with.

    Attributes:
        case: how much there is to plan.
        human, obstacle, smoothness: the cost terms.
        planner: ours, with these terms.
        paths: (N, 7) straight line to each goal.
        arm: the PR2's.
    """

    case: Case
    human: HumanOccupancyCost
    obstacle: ObstacleCost
    smoothness: SmoothnessCost
    planner: StompPlanner
    paths: tuple[FloatArray, ...]
    arm: Pr2Arm


class BenchWorlds:
    """Makes worlds; the scene and the distance fields are made once."""

    def __init__(self) -> None:
        self._scene = load_scene(_SCENE)
        self._shelf = _shelf(self._scene.arm)
        near = np.minimum(self._shelf.values, np.float32(_NEAR_M))
        self._near = SignedDistanceField(self._shelf.origin_m, self._shelf.resolution_m, near)

    def world(self, case: Case, *, skippable: bool = True) -> BenchWorld:
        """Return the world of one case.

        Args:
            case: how much there is to plan.
            skippable: False leaves nothing to skip: some occupancy in every voxel, something near everywhere.
        """
        arm, chain, stomp = self._scene.arm, self._scene.arm.chain, case.stomp
        paths = tuple(
            straight(self._scene.start, goal, case.waypoints) for goal in spread_goals(self._scene, case.goals)
        )
        middle = np.mean([chain.tool_pose(path[len(path) // 2])[:3, 3] for path in paths], axis=0)
        occupancy = ball(middle, 0.0 if skippable else _HAZE)
        field = self._shelf if skippable else self._near
        human = HumanOccupancyCost(chain, body_points(arm, case.points), occupancy, stomp.human_weight)
        obstacle = ObstacleCost(chain, body_spheres(arm, case.spheres), field, stomp.obstacle_weight)
        smoothness = SmoothnessCost(stomp.smoothness_weight)
        planner = StompPlanner((obstacle, human, smoothness), chain.lower, chain.upper, stomp)
        return BenchWorld(case, human, obstacle, smoothness, planner, paths, arm)


def spread_goals(scene: Scene, count: int) -> tuple[FloatArray, ...]:
    """Return `count` configurations (7,) spread evenly along the closed line through the scene's goals."""
    corners = np.array([goal.configuration for goal in scene.goals])
    found = []
    for s in np.arange(count) * len(corners) / count:
        k, part = int(s), float(s - int(s))
        found.append((1.0 - part) * corners[k] + part * corners[(k + 1) % len(corners)])
    return tuple(found)


def body_points(arm: Pr2Arm, count: int) -> BodyPoints:
    """Return `count` points on the arm, spread over its links as `Pr2Arm.body_points` spreads them."""
    spacing = BODY_POINT_SPACING_M
    points = arm.body_points(spacing)
    while len(points) < count:
        spacing /= 1.3
        points = arm.body_points(spacing)
    kept = _thinned(len(points), count)
    return BodyPoints(points.link[kept], points.local_m[kept])


def body_spheres(arm: Pr2Arm, count: int) -> BodySpheres:
    """Return `count` spheres on the arm: those of `Pr2Arm.spheres` thinned, or the largest doubled along the link.

    The two halves of a sphere keep its radius and lie a quarter of it to either side, so the same links are covered
    to within that.
    """
    spheres = arm.spheres()
    entries = list(zip(spheres.link.tolist(), spheres.centre_m, spheres.radius_m.tolist(), strict=True))
    entries = [entries[k] for k in _thinned(len(entries), min(count, len(entries)))]
    halved = [0] * len(entries)
    while len(entries) < count:
        # The largest first; once halved, a sphere counts as half as large.
        k = int(np.argmax([radius / 2**times for (_, _, radius), times in zip(entries, halved, strict=True)]))
        link, centre, radius = entries[k]
        aside = np.array([radius / 2.0 ** (halved[k] + 2), 0.0, 0.0])  # PR2 links lie along x
        entries[k : k + 1] = [(link, centre - aside, radius), (link, centre + aside, radius)]
        halved[k : k + 1] = [halved[k] + 1] * 2
    return BodySpheres(
        np.array([link for link, _, _ in entries]),
        np.array([centre for _, centre, _ in entries]),
        np.array([radius for _, _, radius in entries]),
    )


def ball(centre_m: FloatArray, least: float = 0.0) -> Occupancy:
    """Return the yardstick's ball of occupancy around `centre_m` (3,) in its cube of 2 m at 2.5 cm.

    Args:
        centre_m: world frame.
        least: probability of every other voxel.
    """
    origin = centre_m - _BALL_IN_GRID_M
    grid = VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), _RESOLUTION_M, _GRID_M)
    offset = (grid.centres_m(np.arange(grid.size)) - centre_m) * _BALL_STRETCH
    p = np.maximum(1.0 - np.linalg.norm(offset, axis=1) / _BALL_RADIUS_M, least)
    return Occupancy(grid, p.astype(np.float32).reshape(grid.shape))


def _shelf(arm: Pr2Arm) -> SignedDistanceField:
    size = (*_BOARD_SIZE_M, _THICKNESS_M)
    heights = {
        "lower board": _LOWER_BOARD_M - _THICKNESS_M / 2.0,
        "upper board": _UPPER_BOARD_M + _THICKNESS_M / 2.0,
    }
    boards = [
        Obstacle(name, Box(planar_pose(*_BOARD_CENTRE_M, height, 0.0), np.array(size)))
        for name, height in heights.items()
    ]
    centre, radius = arm.reach
    return build_distance_field(boards, centre - radius, centre + radius)


def _thinned(available: int, count: int) -> list[int]:
    return [int((k + 0.5) * available / count) for k in range(count)]
