"""One workplace: robot, table, objects, goals and where the human stands, read from YAML and checked once.

A scene that loads can be planned in: every configuration lies within the joint limits and touches nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np

from humanpred_ros.errors import ArrayError, GoalUnreachableError, SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.distance_field import DEFAULT_RESOLUTION_M, SignedDistanceField, build_distance_field
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.geometry.shapes import Box, Cylinder, Obstacle, planar_pose
from humanpred_ros.resources import share_file
from humanpred_ros.robot.contact import nearest_contacts, shoulder_approach
from humanpred_ros.robot.goal import Goal as Goal  # part of a scene, so importable from here
from humanpred_ros.robot.goal_file import GOAL_KEYS, parse_goals
from humanpred_ros.robot.pr2 import LEFT_ARM_JOINTS, RIGHT_ARM_JOINTS, Pr2Arm
from humanpred_ros.robot.reach_goal import REACH_GOAL_KEYS, ReachGoal, parse_reach_goals
from humanpred_ros.robot.scene_file import Section, read_yaml

#: Distances beyond this need not be told apart: links are skipped, and movements proven free, well below it, m.
_FIELD_CAP_M = 0.5


@dataclass(frozen=True, eq=False)
class Scene:
    """What is fixed while robot and human work; frames are world unless the name says otherwise.

    Attributes:
        name: how reports call it.
        T_world_base: (4, 4) pose of the robot's base_footprint.
        torso_lift_m: height of the torso.
        left_arm_rad: (7,) configuration of the resting left arm.
        start: (7,) configuration of the right arm at the beginning.
        goals: at least one, with different names; continuous joints are unwrapped so that
            `goal.configurations - start` is the shorter way.
        table: the table's top.
        objects: what stands on it.
        T_world_human: (4, 4) pose of the tracker's frame, in which postures are given.
        grid: the voxels in which human occupancy is predicted.
        reach_goals: places the person may reach for, with different labels; none: the predictor asks its library.

    Raises:
        SceneError: for no goals, or names or labels used twice.
        GoalUnreachableError: for a configuration outside the joint limits.
    """

    name: str
    T_world_base: FloatArray
    torso_lift_m: float
    left_arm_rad: FloatArray
    start: FloatArray
    goals: tuple[Goal, ...]
    table: Obstacle
    objects: tuple[Obstacle, ...]
    T_world_human: FloatArray
    grid: VoxelGrid
    reach_goals: tuple[ReachGoal, ...] = ()

    def __post_init__(self) -> None:
        for name, shape in (("T_world_base", (4, 4)), ("T_world_human", (4, 4)), ("left_arm_rad", (7,))):
            array = checked(f"scene {self.name}: {name}", getattr(self, name), shape, error=SceneError)
            object.__setattr__(self, name, frozen(array))
        if not self.goals:
            raise SceneError(f"scene {self.name}: wanted at least one goal, got none; add one under goals")
        for what, names in (
            ("goal names", [goal.name for goal in self.goals]),
            ("object names", [obstacle.name for obstacle in self.obstacles]),
            ("reach goal labels", [str(goal.label) for goal in self.reach_goals]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise SceneError(f"scene {self.name}: wanted different {what}, got {', '.join(twice)} twice")
        start = self.arm.check_configuration(self.start, f"start of scene {self.name}")
        object.__setattr__(self, "start", frozen(start))
        unwrapped = []
        for goal in self.goals:
            within = [self.arm.check_configuration(q, what) for what, q in self._called(goal)]
            unwrapped.append(replace(goal, configurations=start + self.arm.difference(start, np.array(within))))
        object.__setattr__(self, "goals", tuple(unwrapped))

    @cached_property
    def arm(self) -> Pr2Arm:
        """The robot's right arm, placed."""
        return Pr2Arm(self.T_world_base, self.torso_lift_m, self.left_arm_rad)

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Table and objects."""
        return (self.table, *self.objects)

    def goal(self, name: str) -> Goal:
        """Return the goal of that name.

        Raises:
            SceneError: if there is none; the message lists the names.
        """
        for goal in self.goals:
            if goal.name == name:
                return goal
        known = ", ".join(goal.name for goal in self.goals)
        raise SceneError(f"scene {self.name}: wanted one of the goals {known}, got {name!r}")

    def distance_field(self, resolution_m: float = DEFAULT_RESOLUTION_M) -> SignedDistanceField:
        """Return the distance to table, objects and the robot's own fixed bodies wherever the arm can reach.

        Distances are capped at 0.5 m. The human is not in it, as in the paper: human occupancy is a cost of its own.
        """
        centre, radius = self.arm.reach
        obstacles = (*self.obstacles, *self.arm.fixed_obstacles)
        return build_distance_field(obstacles, centre - radius, centre + radius, resolution_m, _FIELD_CAP_M)

    def check_free(self) -> None:
        """Check that the arm touches nothing, itself included, at the start and at every goal.

        Raises:
            GoalUnreachableError: naming configuration, link, obstacle (or other link) and depth.
            SceneError: if table or an object stands where the robot's shoulder can get to.
        """
        named = [(f"start of scene {self.name}", self.start), *chain(*map(self._called, self.goals))]
        contacts = nearest_contacts(self.arm, self.obstacles, np.array([q for _, q in named]))
        for (what, _), nearest in zip(named, contacts, strict=True):
            if nearest.clearance_m < 0.0:
                raise GoalUnreachableError(
                    f"{what}: wanted the arm free of obstacles and of itself, got {nearest.link} "
                    f"{-nearest.clearance_m:.3f} m deep in {nearest.obstacle}; move the obstacle or the configuration"
                )
        shoulder = shoulder_approach(self.arm, self.obstacles)
        if shoulder.clearance_m < 0.0:
            raise SceneError(
                f"scene {self.name}: wanted nothing where the robot's shoulder can get to, which planners do not "
                f"look at, got {shoulder.obstacle} within reach of {shoulder.link}; move it or the robot"
            )

    def _called(self, goal: Goal) -> list[tuple[str, FloatArray]]:
        """Return each configuration of a goal with what messages call it."""
        what, n = f"goal {goal.name!r} of scene {self.name}", len(goal.configurations)
        return [
            (what if n == 1 else f"{what}, configuration {i} of {n}", q) for i, q in enumerate(goal.configurations, 1)
        ]


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the package."""
    return tuple(sorted(path.stem for path in share_file("config", "scenes").glob("*.yaml")))


def load_scene(name_or_path: str | Path) -> Scene:
    """Read and check a scene.

    Args:
        name_or_path: the name of a scene of the package (`face_to_face`), or the path of a YAML file.

    Raises:
        SceneError: for a file that cannot be read, unknown or missing keys, impossible values.
        GoalUnreachableError: for a start or goal outside the joint limits or in collision, and for a tool pose
            that no configuration reaches without collision.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        known = scene_names()
        if str(name_or_path) not in known:
            raise SceneError(
                f"scene: wanted one of {', '.join(known)} or the path of a .yaml file, got {str(name_or_path)!r}"
            )
        path = share_file("config", "scenes", f"{name_or_path}.yaml")
    try:
        scene = _parse(
            Section(
                read_yaml(path),
                f"scene {path.stem}",
                ("name", "robot", "start_angle", "goals", "table", "objects", "human", "grid", "reach_goals"),
            )
        )
    except ArrayError as trouble:
        raise SceneError(f"scene {path.stem}: {trouble}") from trouble
    scene.check_free()
    return scene


def _parse(top: Section) -> Scene:
    robot = top.section("robot", ("base_xy_m", "yaw_angle", "torso_lift_m", "left_arm_angle"))
    human = top.section("human", ("offset_m", "yaw_angle"))
    grid = top.section("grid", ("origin_m", "resolution_m", "shape"))
    base, offset = robot.numbers("base_xy_m", 2), human.numbers("offset_m", 3)
    arm = Pr2Arm(
        planar_pose(base[0], base[1], 0.0, robot.angle("yaw")),
        robot.number("torso_lift_m"),
        robot.angles("left_arm", len(LEFT_ARM_JOINTS)),
    )
    name = top.text("name")
    start = arm.check_configuration(top.angles("start", len(RIGHT_ARM_JOINTS)), f"start of scene {name}")
    table = Obstacle("table", _table(top.section("table", ("top_centre_m", "size_m", "yaw_angle"))))
    objects = tuple(_object(entry) for entry in top.sections("objects", ("name", "base_m", "radius_m", "height_m")))
    return Scene(
        name=name,
        T_world_base=arm.T_world_base,
        torso_lift_m=arm.torso_lift_m,
        left_arm_rad=arm.left_arm_rad,
        start=start,
        goals=parse_goals(top.sections("goals", GOAL_KEYS), arm, start, (table, *objects)),
        table=table,
        objects=objects,
        T_world_human=planar_pose(offset[0], offset[1], offset[2], human.angle("yaw")),
        grid=VoxelGrid(
            tuple(grid.numbers("origin_m", 3)),
            grid.number("resolution_m"),
            _counts(grid.numbers("shape", 3)),
        ),
        reach_goals=parse_reach_goals(top.sections("reach_goals", REACH_GOAL_KEYS) if "reach_goals" in top else ()),
    )


def _table(section: Section) -> Box:
    top, size = section.numbers("top_centre_m", 3), section.numbers("size_m", 3)
    yaw = section.angle("yaw") if "yaw_angle" in section else 0.0
    return Box(planar_pose(top[0], top[1], top[2] - size[2] / 2.0, yaw), size)


def _object(section: Section) -> Obstacle:
    base, height = section.numbers("base_m", 3), section.number("height_m")
    pose = planar_pose(base[0], base[1], base[2] + height / 2.0)
    return Obstacle(section.text("name"), Cylinder(pose, section.number("radius_m"), height))


def _counts(numbers: FloatArray) -> tuple[int, int, int]:
    if (numbers != np.round(numbers)).any():
        raise SceneError(f"grid shape: wanted whole numbers of voxels, got {numbers}")
    x, y, z = (int(number) for number in numbers)
    return x, y, z
