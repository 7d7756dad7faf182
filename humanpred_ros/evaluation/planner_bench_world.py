"""The workload of `humanpred bench planner`: a place where the planner cannot save itself any work.

In an open scene most links are far from everything and the kernels skip them. A figure from there would say little
about the cost of a lookup, so the bench's arm reaches into a shelf whose boards are near every link, through a ball of
occupancy as in the C++ yardstick.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from humanpred_ros.errors import SettingsError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField, build_distance_field
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.geometry.solids import Box, Obstacle, Sphere, cylinder, planar_pose
from humanpred_ros.planning.live_obstacles import LiveObstacles
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.robot import BODY_POINT_SPACING_M
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.robot.scene_file import read_scene_file, scene_names
from humanpred_ros.settings import Settings, setting, setting_of
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import HumanOccupancyCost, ObstacleCost, SmoothnessCost
from humanpred_ros.stomp.planner import StompPlanner

#: Arm, start and goals are this scene's, unless another arm is compared.
SCENE = "four_places"
#: The boards of the shelf, m: heights of the faces, and where they lie. The arm's way runs from 0.85 to 1.20 m.
_LOWER_BOARD_M, _UPPER_BOARD_M, _THICKNESS_M = 0.85, 1.25, 0.02
_BOARD_CENTRE_M, _BOARD_SIZE_M = (-0.1, -0.6), (1.6, 1.2)
#: Grid and ball of the yardstick: a cube of 2 m, the ball 1.2, 1.2 and 1.1 m from its lower corner, twice as high as
#: it is wide.
_GRID_M, _RESOLUTION_M, _BALL_RADIUS_M = (80, 80, 80), 0.025, 0.35
_BALL_IN_GRID_M, _BALL_STRETCH = np.array([1.2, 1.2, 1.1]), np.array([1.0, 1.0, 0.5])


#: What is told of while the planner runs: so many solids, or a cloud of so many points.
LIVE_SOLIDS, LIVE_POINTS = 20, 100_000


class Workload(Settings):
    """How much there is to plan."""

    goals: int = setting(8, "goals planned to on two threads", low=1)
    waypoints: int = setting_of(StompConfig, "waypoints", default=60, description="waypoints of a trajectory")
    rollouts: int = setting_of(StompConfig, "rollouts", description="noisy rollouts per iteration")
    points: int = setting(150, "body points looked up in the occupancy", low=1)
    spheres: int = setting(50, "spheres looked up in the distance field", low=1)
    iterations: int = setting_of(StompConfig, "iterations", description="STOMP iterations", low=1)
    reused: int = setting(0, "rollouts kept from the iteration before; 0: fresh noise", low=0)

    def check(self) -> None:
        """Refuse more reused rollouts than rollouts."""
        if self.reused >= self.rollouts:
            raise SettingsError(
                f"{type(self).__name__} reused: wanted fewer than rollouts ({self.rollouts}), got {self.reused}"
            )

    @property
    def lookups(self) -> int:
        """Lookups per goal: each point in the occupancy and each sphere in the distance field, per configuration.

        Configurations are those of every new rollout and of the noiseless trajectory, in every iteration.
        """
        new = self.rollouts - self.reused
        configurations = (self.iterations * (new + 1) + self.reused) * self.waypoints
        return configurations * (self.points + self.spheres)


@dataclass(frozen=True, eq=False)
class BenchWorld:
    """Everything a workload is planned with."""

    workload: Workload  #: how much there is to plan
    planner: StompPlanner  #: ours, with obstacle, human occupancy and smoothness as its cost terms
    paths: tuple[FloatArray, ...]  #: (N, 7) straight line to each goal
    arm: Arm  #: the scene's
    human: HumanOccupancyCost  #: two of the cost terms
    obstacle: ObstacleCost


def bench_world(workload: Workload, of: str = SCENE) -> BenchWorld:
    """Return the world of a workload, with arm, start and goals of a scene that comes with the package."""
    scene, field = _surroundings(of)
    arm, chain = scene.arm, scene.arm.chain
    # All iterations are done, whether or not they still help.
    stomp = workload.part(StompConfig, patience=0)
    paths = tuple(straight(scene.start, goal, workload.waypoints) for goal in spread_goals(scene, workload.goals))
    middle = np.mean([chain.tool_pose(path[len(path) // 2])[:3, 3] for path in paths], axis=0)
    occupancy = ball(middle)
    human = HumanOccupancyCost(chain, body_points(arm, workload.points), occupancy, stomp.human_weight)
    spheres = body_spheres(arm, workload.spheres)
    obstacle = ObstacleCost(chain, spheres, field, stomp.obstacle_weight)
    terms = (obstacle, human, SmoothnessCost(stomp.smoothness_weight))
    return BenchWorld(workload, StompPlanner(terms, chain.lower, chain.upper, stomp), paths, arm, human, obstacle)


def scenes_of_arms() -> tuple[str, ...]:
    """Return a scene of every robot that there is a scene of in the package, `SCENE` first."""
    found = {read_scene_file(SCENE).robot.robot: SCENE}
    for name in scene_names():
        found.setdefault(read_scene_file(name).robot.robot, name)
    return tuple(found.values())


@dataclass(frozen=True, eq=False)
class LiveWorld:
    """A planner at a table on which things are told of while it runs: two of each of these in turn."""

    replanner: Replanner
    live: LiveObstacles
    solids: tuple[tuple[Obstacle, ...], ...]
    clouds: tuple[FloatArray, ...]  #: points (N, 3)

    @classmethod
    def of(cls, scene_name: str) -> LiveWorld:
        """Return it for a scene; solids and points lie around where its goals want the tool."""
        scene, rng = load_scene(scene_name), np.random.default_rng(0)
        tool = np.mean([scene.arm.chain.tool_pose(goal.configuration)[:3, 3] for goal in scene.goals], axis=0)
        shapes = (Box(0.1, 0.05, 0.2), cylinder(0.04, 0.1), Sphere(0.05))

        def solid(k: int) -> Obstacle:
            x, y, z = tool + rng.uniform((-0.7, -0.35, -0.2), (0.7, 0.35, 0.0))
            return Obstacle(f"thing {k}", shapes[k % len(shapes)], planar_pose(x, y, z, rng.uniform(0.0, np.pi)))

        solids = tuple(tuple(solid(k) for k in range(LIVE_SOLIDS)) for _ in range(2))
        clouds = tuple(
            tool + rng.uniform((-0.7, -0.35, -0.2), (0.7, 0.35, 0.0), (LIVE_POINTS, 3)) * (1, 1, rng.random())
            for _ in range(2)
        )
        return cls(Replanner.for_scene(scene), LiveObstacles(scene.distance_field()), solids, clouds)

    def update(self, k: int, what: str) -> None:
        """Take the solids or the cloud of turn `k`, and let the planner have the distances to everything."""
        if what == "cloud":
            self.live.set_points(self.clouds[k % 2])
        else:
            for key, solid in enumerate(self.solids[k % 2]):
                self.live.put(key, solid)
        self.replanner.change(field=self.live.field())


@cache
def _surroundings(of: str) -> tuple[Scene, SignedDistanceField]:
    """Return a scene, and the distances to the shelf."""
    scene = load_scene(of)
    faces_m = {"lower board": _LOWER_BOARD_M - _THICKNESS_M / 2.0, "upper board": _UPPER_BOARD_M + _THICKNESS_M / 2.0}
    size = np.array((*_BOARD_SIZE_M, _THICKNESS_M))
    boards = [Obstacle(name, Box(*size), planar_pose(*_BOARD_CENTRE_M, z)) for name, z in faces_m.items()]
    centre, radius = scene.arm.reach
    return scene, build_distance_field(boards, centre - radius, centre + radius)


def spread_goals(scene: Scene, count: int) -> tuple[FloatArray, ...]:
    """Return `count` configurations (7,) spread evenly along the closed line through the scene's goals."""
    corners = np.array([goal.configuration for goal in scene.goals])
    found = []
    for s in np.arange(count) * len(corners) / count:
        k, part = int(s), float(s - int(s))
        found.append((1.0 - part) * corners[k] + part * corners[(k + 1) % len(corners)])
    return tuple(found)


def body_points(arm: Arm, count: int) -> BodyPoints:
    """Return `count` points on the arm, spread over its links as `Arm.body_points` spreads them."""
    spacing = BODY_POINT_SPACING_M
    points = arm.body_points(spacing)
    while len(points) < count:
        spacing /= 1.3
        points = arm.body_points(spacing)
    kept = _thinned(len(points), count)
    return BodyPoints(points.link[kept], points.local_m[kept])


def body_spheres(arm: Arm, count: int) -> BodySpheres:
    """Return `count` spheres on the arm: those of `Arm.spheres` thinned, or the largest doubled along the link.

    The two halves of a sphere keep its radius and lie a quarter of it to either side, so the same links are covered
    to within that.
    """
    spheres = arm.spheres()
    kept = _thinned(len(spheres), min(count, len(spheres)))
    link, centre, radius = spheres.link[kept].tolist(), list(spheres.local_m[kept]), spheres.radius_m[kept].tolist()
    halved = [0] * len(link)
    while len(link) < count:
        # The largest first; once halved, a sphere counts as half as large.
        k = int(np.argmax([r / 2**times for r, times in zip(radius, halved, strict=True)]))
        aside = np.array([radius[k] / 2.0 ** (halved[k] + 2), 0.0, 0.0])  # the PR2's links lie along x
        centre[k : k + 1] = [centre[k] - aside, centre[k] + aside]
        for values in (link, radius):
            values.insert(k, values[k])
        halved[k : k + 1] = [halved[k] + 1] * 2
    return BodySpheres(np.array(link), np.array(centre), np.array(radius))


def ball(centre_m: FloatArray) -> Occupancy:
    """Return the yardstick's ball of occupancy around `centre_m` (3,), world frame, in its cube of 2 m at 2.5 cm."""
    origin = centre_m - _BALL_IN_GRID_M
    grid = VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), _RESOLUTION_M, _GRID_M)
    offset = (grid.centres_m(np.arange(grid.size)) - centre_m) * _BALL_STRETCH
    p = np.maximum(1.0 - np.linalg.norm(offset, axis=1) / _BALL_RADIUS_M, 0.0)
    return Occupancy(grid, p.astype(np.float32).reshape(grid.shape))


def _thinned(available: int, count: int) -> list[int]:
    return [int((k + 0.5) * available / count) for k in range(count)]
