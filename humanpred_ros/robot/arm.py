"""A robot's arm that stands somewhere: what planning, inverse kinematics and measuring need of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import GoalUnreachableError, HumanPredError, SceneError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain, inverse_pose, reach_m
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.description import LinkSurface, PlacedDescription
from humanpred_ros.geometry.solids import Box, Obstacle
from humanpred_ros.geometry.urdf import standing_urdf, urdf_text
from humanpred_ros.robot.robot import BODY_POINT_SPACING_M, Robot, load_robot

_LIMIT_TOLERANCE_RAD = 1e-6  # limits are written with about ten digits, scene angles with six


#: Random configurations that decide which bodies always touch.
_SAMPLES = 32


class Arm:
    """An arm of J joints on a robot that otherwise stands still, and what it must not hit of itself.

    Attributes:
        robot: whose arm it is; arms of one robot share it.
        chain: its kinematics.
        link_names: (J) the link each joint moves.
        tool_frame: name of the frame that `chain.tool_pose` gives.
        T_world_base: (4, 4) pose of the robot's base frame.
        standing: value (rad or m) of each joint that stands still and is not at zero.

    Args:
        robot: a robot, the name of one that comes with the package, or the path of a robot's file.
        T_world_base: (4, 4) pose of its base frame.
        standing: values (rad or m) of joints that stand elsewhere than the robot's file says.

    Raises:
        RobotError: for a robot that cannot be used.
        SceneError: for a base or a standing joint that is impossible.
    """

    def __init__(
        self, robot: Robot | str | Path, T_world_base: ArrayLike, standing: Mapping[str, float] | None = None
    ) -> None:
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.T_world_base = checked("robot base", T_world_base, (4, 4), error=SceneError).copy()
        self.T_world_base.setflags(write=False)
        said, file = self.robot.description, self.robot.file
        for joint in standing or {}:
            try:
                self.robot.check_standing(joint)
            except HumanPredError as trouble:
                raise SceneError(f"robot {self.robot.name}: {trouble}") from trouble
        self.standing = {**self.robot.standing, **{name: float(value) for name, value in (standing or {}).items()}}
        for joint, value in self.standing.items():
            self._check_standing(joint, value)
        T_world_root: FloatArray = self.T_world_base
        if file.base_frame is not None:
            T_root_base = said.link_poses(self.standing)[said.link_index(file.base_frame)]
            T_world_root = T_world_root @ inverse_pose(T_root_base)
        self._placed = PlacedDescription(self.robot.collision, T_world_root, self.standing)
        self.chain: KinematicChain = self.robot.chain(self._placed)
        self.link_names = tuple(said.link_of(joint) for joint in file.joints)
        self.tool_frame = file.tool_frame

    def body_points(self, spacing_m: float = BODY_POINT_SPACING_M) -> BodyPoints:
        """Return points on the surfaces of all moving links but the shoulder's, in joint order.

        These are what the human occupancy is summed over.

        Args:
            spacing_m: least distance between two points of a joint, and the largest gap between them.
        """
        return self.robot.body_points(spacing_m)

    def spheres(self) -> BodySpheres:
        """Return spheres that cover the surfaces of all moving links but the shoulder's, in joint order."""
        return self.robot.spheres

    def moving_surfaces(self) -> list[list[LinkSurface]]:
        """Return for each joint the surfaces that move with it, in the frame after it (`chain.link_poses`)."""
        return self._placed.moving_surfaces(self.chain.joint_names)

    def standing_surfaces(self) -> list[tuple[LinkSurface, FloatArray]]:
        """Return the surfaces of the robot that stand still, and the world pose (4, 4) of each one's frame."""
        return self._placed.fixed_surfaces(self.chain.joint_names)

    @cached_property
    def fixed_obstacles(self) -> tuple[Obstacle, ...]:
        """The robot's own bodies that stand still, as solids named after their links.

        Those that any of `spheres` may touch (a base next to the first moving link) are left out: what the arm does to
        them is `SelfCollision`'s, as what it does to itself.
        """
        return tuple(obstacle for near, _, obstacles in self.fixed_bodies if not near for obstacle in obstacles)

    @cached_property
    def fixed_bodies(self) -> list[tuple[bool, str, list[Obstacle]]]:
        """Each surface that stands still: whether any of `spheres` may touch it, its link, and solids that fill it."""
        links = set(self.robot.sphere_links)
        touchable = {link for pair in self.robot.left_out if links.intersection(pair) for link in pair} - links
        bodies = []
        surfaces = self.standing_surfaces()
        for (surface, T_world_frame), boxes in zip(surfaces, self.robot.fixed_boxes, strict=True):
            if surface.shape is not None and not isinstance(surface.shape, Box):
                obstacles = [Obstacle(surface.link, surface.shape, T_world_frame)]
            else:
                obstacles = []
                for lower, upper in boxes:
                    T_world_box = T_world_frame.copy()
                    T_world_box[:3, 3] += T_world_frame[:3, :3] @ ((lower + upper) / 2.0)
                    obstacles.append(Obstacle(surface.link, Box(*(upper - lower)), T_world_box))
            near = surface.link in touchable or self._always_touches(obstacles)
            bodies.append((near, surface.link, obstacles))
        return bodies

    def _always_touches(self, obstacles: list[Obstacle]) -> bool:
        """Return whether any link's spheres touch solids in all configurations that are drawn."""
        links, spheres = np.array(self.robot.sphere_links), self.spheres()
        centres = spheres.world_m(self.chain, drawn(self.chain, _SAMPLES))
        touch = np.min([obstacle.distance_m(centres) for obstacle in obstacles], axis=0) < spheres.radius_m
        return any(touch[:, links == link].any(axis=1).all() for link in dict.fromkeys(self.robot.sphere_links))

    def urdf(self) -> str:
        """Return the URDF of the whole robot as it stands here: its root is `world`, only the arm's joints move.

        Meshes are named by where they lie on this machine.
        """
        values = dict(self.standing)
        for name, mimic in self.robot.description.mimic.items():
            values.setdefault(name, mimic.multiplier * values.get(mimic.joint, 0.0) + mimic.offset)
        text = urdf_text(self.robot.urdf, lambda file: f"file://{file}")
        return standing_urdf(text, self.chain.joint_names, values, self._placed.T_world_base)

    @cached_property
    def reach(self) -> tuple[FloatArray, float]:
        """Centre (3,) and radius of a ball that the moving bodies never leave, world frame, metres."""
        return reach_m(self.chain, self.spheres())

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
        """Return the change (..., J) that leads from one configuration to another.

        Continuous joints go the shorter way round, so `q_from + difference` may name the same place as
        `q_to` by another angle.
        """
        change = np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64)
        shorter = (change + np.pi) % (2.0 * np.pi) - np.pi
        result: FloatArray = np.where(self.chain.continuous, shorter, change)
        return result

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> FloatArray:
        """Return Move3D's distance (...) between configurations (..., J), the unit of P1's path parameter.

        The root of the summed squares of each joint's change times its weight (docs/papers.md, P1 costs).
        """
        distance: FloatArray = np.linalg.norm(self.difference(a, b) * self.robot.distance_weights, axis=-1)
        return distance

    def check_configuration(self, q: ArrayLike, name: str) -> FloatArray:
        """Return `q` (J,) if it lies within the joint limits.

        Args:
            q: configuration in rad.
            name: what the configuration is, for the message.

        Raises:
            GoalUnreachableError: naming the joint, its value and its limits.
        """
        array = checked(name, q, (self.chain.n_joints,), error=GoalUnreachableError)
        for joint, value, lower, upper in zip(
            self.chain.joint_names, array, self.chain.lower, self.chain.upper, strict=True
        ):
            if not lower - _LIMIT_TOLERANCE_RAD <= value <= upper + _LIMIT_TOLERANCE_RAD:
                raise GoalUnreachableError(
                    f"{name}: wanted {joint} within {lower:.4f} to {upper:.4f} rad, got {value:.4f} rad "
                    f"({np.rad2deg(value):.2f} deg); choose a configuration within the limits"
                )
        return array

    def _check_standing(self, joint: str, value: float) -> None:
        lower, upper = self.robot.description.limits(joint)
        if not lower - _LIMIT_TOLERANCE_RAD <= value <= upper + _LIMIT_TOLERANCE_RAD:
            raise SceneError(
                f"robot {self.robot.name}: wanted {joint} within {lower:.4f} to {upper:.4f} (rad or m), got {value}; "
                "correct it in the scene, or under standing in the robot's file"
            )


def drawn(chain: KinematicChain, count: int) -> FloatArray:
    """Return configurations (N, J) drawn within the limits (a turn where there are none), always the same."""
    lower = np.where(chain.continuous, -np.pi, chain.lower)
    upper = np.where(chain.continuous, np.pi, chain.upper)
    return np.random.default_rng(0).uniform(lower, upper, (count, chain.n_joints))
