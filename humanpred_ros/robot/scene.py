"""One workplace: robot, table, objects, goals and where the human stands, read from YAML and checked once.

A scene that loads can be planned in: every configuration lies within the joint limits and touches nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from humanpred_ros.errors import ArrayError, GoalUnreachableError, SceneError
from humanpred_ros.files import yaml_of
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.distance_field import DEFAULT_RESOLUTION_M, SignedDistanceField, build_distance_field
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.geometry.solids import Box, Obstacle, Sphere, cylinder, planar_pose
from humanpred_ros.geometry.urdf import read_mesh
from humanpred_ros.motion.labels import checked_label
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.clearance import nearest_contacts, shoulder_approach
from humanpred_ros.robot.goals import Goal, tool_goal
from humanpred_ros.robot.robot import load_robot
from humanpred_ros.robot.scene_file import (
    LARGEST_M,
    GoalSection,
    RobotSection,
    SceneFile,
    TaskList,
    read_scene_file,
    start_of,
)
from humanpred_ros.robot.sections import section_of
from humanpred_ros.robot.surface import covering_boxes

#: Distances beyond this need not be told apart: links are skipped, and movements proven free, well below it, m.
_FIELD_CAP_M = 0.5
#: A fitted lattice's voxels, and how far it goes beyond the arm's reach, m.
_VOXEL_M, _BEYOND_M = 0.05, 0.3
#: So many voxels must lie where the arm can be, along each axis.
_LEAST_VOXELS = 4
#: A mesh is filled with as many boxes as save this volume each, m^3; none is thinner, m.
_MESH_SAVING_M3, _THINNEST_M = 0.0001, 1e-4


@dataclass(frozen=True, eq=False)
class Place:
    """A place the person may reach for, whether or not anybody was ever seen to reach there.

    Raises:
        SceneError: for a label that is no text or whole number, or a place that is not three finite numbers.
    """

    label: str  #: by which messages call it; where a library has a class of reaches to it, that class's
    place_m: FloatArray  #: (3,) where the palm ends, world frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", checked_label(self.label, SceneError))
        place = checked(f"place {self.label}: place_m", self.place_m, (3,), error=SceneError)
        object.__setattr__(self, "place_m", frozen(place))


@dataclass(frozen=True, eq=False)
class Scene:
    """What is fixed while robot and human work; frames are world unless the name says otherwise.

    Raises:
        SceneError: for no goals, or names or labels used twice.
        GoalUnreachableError: for a configuration outside the joint limits.
    """

    name: str  #: how reports call it
    arm: Arm  #: the robot's arm, placed
    start: FloatArray  #: (J,) configuration of the arm at the beginning
    #: at least one, with different names; continuous joints are unwrapped so that `goal.configurations - start` is the
    #: shorter way
    goals: tuple[Goal, ...]
    obstacles: tuple[Obstacle, ...]  #: table and objects
    T_world_human: FloatArray  #: (4, 4) pose of the tracker's frame, in which postures are given
    grid: VoxelGrid  #: the voxels in which human occupancy is predicted
    #: where the person may reach, with different labels; without any the predictor asks its library
    places: tuple[Place, ...] = ()
    human_frame: str = ""  #: name of the tracker's frame; empty where the scene leaves it open

    def __post_init__(self) -> None:
        T = checked(f"scene {self.name}: T_world_human", self.T_world_human, (4, 4), error=SceneError)
        object.__setattr__(self, "T_world_human", frozen(T))
        if not self.goals:
            raise SceneError(f"scene {self.name}: wanted at least one goal, got none; add one under goals")
        for what, names in (
            ("goal names", [goal.name for goal in self.goals]),
            ("names of table, objects and obstacles", [obstacle.name for obstacle in self.obstacles]),
            ("labels of places", [str(place.label) for place in self.places]),
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

    @property
    def T_world_base(self) -> FloatArray:  # noqa: N802
        """(4, 4) pose of the robot's base."""
        return self.arm.T_world_base

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
        if shoulder is not None and shoulder.clearance_m < 0.0:
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


def load_scene(name_or_path: str | Path, *, check: bool = True) -> Scene:
    """Read and check a scene.

    Args:
        name_or_path: the name of a scene of the package (`face_to_face`), or the path of a YAML file.
        check: check that the arm touches nothing at the start and at the goals (about a second; reports of runs and
            nodes that do not plan need not).

    Raises:
        SceneError: for a file that cannot be read, unknown or missing keys, impossible values.
        GoalUnreachableError: for a start or goal outside the joint limits or in collision, and for a tool pose
            that no configuration reaches without collision.
    """
    try:
        scene = scene_of(read_scene_file(name_or_path))
    except ArrayError as trouble:
        raise SceneError(f"scene {Path(name_or_path).stem}: {trouble}") from trouble
    if check:
        scene.check_free()
    return scene


def scene_of(file: SceneFile) -> Scene:
    """Return the scene that a file describes; raises as `load_scene`, and nothing for what touches."""
    arm = _arm(file.robot)
    start = arm.check_configuration(start_of(file)[1], f"start of scene {file.name}")
    obstacles = _obstacles(file)
    grid = VoxelGrid(file.grid.origin_m, file.grid.resolution_m, file.grid.shape) if file.grid else fitted_grid(arm)
    centre, radius = arm.reach
    low, high = np.array(grid.origin_m), np.array(grid.origin_m) + grid.resolution_m * np.array(grid.shape)
    if (np.minimum(high, centre + radius) - np.maximum(low, centre - radius) < _LEAST_VOXELS * grid.resolution_m).any():
        raise SceneError(
            f"scene {file.name}: grid: wanted voxels around the arm, which reaches {radius:.2f} m around "
            f"{centre.round(2).tolist()}, got {low.tolist()} to {high.tolist()}; correct grid, or leave it out"
        )
    return Scene(
        name=file.name,
        arm=arm,
        start=start,
        goals=tuple(_goal(entry, arm, start, obstacles) for entry in file.goals),
        obstacles=obstacles,
        T_world_human=planar_pose(*file.human.offset_m, float(file.human.angle("yaw"))),
        grid=grid,
        places=tuple(Place(str(entry.label), np.array(entry.place_m)) for entry in file.places),
        human_frame=file.human.frame or "",
    )


def tasks_of(
    text: str, scene: Scene, obstacles: Sequence[Obstacle], known: Mapping[GoalSection, Goal]
) -> dict[GoalSection, Goal]:
    """Return the tasks of a YAML text, by what it says of each: a list as under `goals` in a scene file.

    Args:
        text: of all tasks there are to be.
        scene: whose tasks they take the place of.
        obstacles: what the arm must not touch beside the scene's own.
        known: tasks that are there; one that is the same stays what it is, even where an obstacle blocks it now.

    Raises:
        SceneError: for what no scene file may hold, or no task.
        GoalUnreachableError: for a task that the arm cannot reach; whoever plans checks configurations for collision.
    """
    try:
        file = section_of({"goals": yaml_of(text)}, TaskList, "tasks", SceneError)
    except ValueError as trouble:
        raise SceneError(f"tasks: wanted YAML, got something else: {trouble}") from trouble
    around = (*scene.obstacles, *obstacles)
    try:
        goals = [known.get(entry) or _goal(entry, scene.arm, scene.start, around) for entry in file.goals]
        return dict(zip(file.goals, replace(scene, goals=tuple(goals)).goals, strict=True))
    except ArrayError as trouble:
        raise SceneError(f"tasks: {trouble}") from trouble


def fitted_grid(arm: Arm) -> VoxelGrid:
    """Return a lattice around all that the arm can reach, and as far beyond as a person matters to it."""
    centre, radius = arm.reach
    lower = np.floor((centre - radius - _BEYOND_M) / _VOXEL_M)
    upper = np.ceil((centre + radius + _BEYOND_M) / _VOXEL_M)
    x, y, z = (float(value) for value in lower * _VOXEL_M)
    i, j, k = (int(value) for value in upper - lower)
    return VoxelGrid((x, y, z), _VOXEL_M, (i, j, k))


def _obstacles(file: SceneFile) -> tuple[Obstacle, ...]:
    found = []
    if file.table is not None:
        top, size = file.table.top_centre_m, file.table.size_m
        pose = planar_pose(top[0], top[1], top[2] - size[2] / 2.0, float(file.table.angle("yaw")))
        found.append(Obstacle("table", Box(*size), pose))
    for entry in file.objects:
        pose = planar_pose(entry.base_m[0], entry.base_m[1], entry.base_m[2] + entry.height_m / 2.0)
        found.append(Obstacle(entry.name, cylinder(entry.radius_m, entry.height_m), pose))
    for solid in file.obstacles:
        pose = _pose(solid.position_m, solid.angle("orientation"))
        if solid.mesh is not None:
            found += _mesh_obstacles(solid.name, Path(solid.mesh), pose)
        elif solid.box_m is not None:
            found.append(Obstacle(solid.name, Box(*solid.box_m), pose))
        elif solid.cylinder_m is not None:
            found.append(Obstacle(solid.name, cylinder(*solid.cylinder_m), pose))
        elif solid.sphere_m is not None:
            found.append(Obstacle(solid.name, Sphere(solid.sphere_m), pose))
    return tuple(found)


def _mesh_obstacles(name: str, file: Path, pose: FloatArray) -> list[Obstacle]:
    """Return boxes that fill a closed mesh."""
    triangles = read_mesh(file, f"obstacle {name}")
    if (size := float(np.ptp(triangles.reshape(-1, 3), axis=0).max())) > LARGEST_M:
        raise SceneError(f"obstacle {name}: wanted a mesh in metres, got {file}, which is {size:.0f} m long; scale it")
    parts = []
    for k, (lower, upper) in enumerate(covering_boxes(triangles, _MESH_SAVING_M3), 1):
        T = pose.copy()
        T[:3, 3] += pose[:3, :3] @ ((lower + upper) / 2.0)
        parts.append(Obstacle(f"{name} (part {k})", Box(*np.maximum(upper - lower, _THINNEST_M)), T))
    return parts


def _arm(section: RobotSection) -> Arm:
    """Return the scene's arm, where it stands."""
    robot, standing = load_robot(section.robot), {name: float(value) for name, value in section.standing.items()}
    for key, values in section.old_keys.items():
        joints = robot.file.scene_keys.get(key, ())
        if len(joints) != len(values):
            raise SceneError(
                f"robot {robot.name}: {key}: wanted {len(joints)} numbers, got {len(values)}; use standing, by joint"
            )
        standing |= dict(zip(joints, values, strict=True))
    if section.base_m is not None:
        return Arm(robot, _pose(section.base_m, section.angle("base_orientation")), standing)
    assert section.base_xy_m is not None
    return Arm(robot, planar_pose(*section.base_xy_m, 0.0, float(section.angle("yaw"))), standing)


def _pose(place_m: Sequence[float], rpy_rad: FloatArray) -> FloatArray:
    """Return a (4, 4) pose by place and roll, pitch, yaw about the world's x, y, z in turn, as in a URDF."""
    from scipy.spatial.transform import Rotation  # takes half a second to import; few scenes turn anything so

    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", np.broadcast_to(rpy_rad, 3)).as_matrix()
    T[:3, 3] = place_m
    return T


def _goal(section: GoalSection, arm: Arm, start: FloatArray, obstacles: Sequence[Obstacle]) -> Goal:
    tool = section.tool_pose
    if tool is None:
        return Goal(section.name, section.angle("configuration"), section.task_cost)
    return tool_goal(
        arm,
        section.name,
        _pose(tool.position_m, tool.angle("orientation")),
        start,
        position_tolerance_m=tool.position_tolerance_m,
        orientation_tolerance_rad=tool.angle("orientation_tolerance"),
        task_cost=section.task_cost,
        obstacles=obstacles,
    )
