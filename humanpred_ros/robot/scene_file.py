"""What a scene file may hold: the types that read it, and from which its JSON schema is generated.

An angle is given in radians under `<name>_rad` or in degrees under `<name>_deg`, never both.
"""

from __future__ import annotations

import os
import shutil
from itertools import count
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import AfterValidator, BeforeValidator, Field, StrictInt, StrictStr, model_validator

from humanpred_ros.errors import RobotError, SceneError
from humanpred_ros.files import file_inside, read_yaml
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.urdf import urdf_text
from humanpred_ros.resources import share_file
from humanpred_ros.robot.robot_file import (
    Number,
    find_source,
    is_local,
    read_robot_file,
    robot_names,
    robot_path,
    robot_with_keys,
)
from humanpred_ros.robot.sections import Name, Section, read_section

#: The files in which a run keeps the scene that it was made with, and that scene's robot.
RECORDED_SCENE, _RECORDED_ROBOT = "scene.yaml", "robot.yaml"

#: No workplace is larger, m.
LARGEST_M = 100.0


def _metres(value: float) -> float:
    if abs(value) > LARGEST_M:
        raise ValueError(f"wanted metres, at most {LARGEST_M:.0f}; divide by 1000 what is in millimetres")
    return value


Metres = Annotated[float, AfterValidator(_metres)]
Length = Annotated[float, Field(gt=0.0), AfterValidator(_metres)]
Triple = tuple[float, float, float]
Place = tuple[Metres, Metres, Metres]
Lengths = tuple[Length, Length, Length]
ArmAngles = Annotated[tuple[float, ...], Field(min_length=1, max_length=100)]  # in joint order
EachAxis = Annotated[
    Triple, BeforeValidator(lambda value: (value,) * 3 if isinstance(value, int | float) else value, Triple | float)
]


class RobotSection(Section):
    """Which robot there is, where it stands, and its joints that do not move."""

    optional_angles = ("base_orientation", "yaw", "left_arm")
    name: Name | None = Field(None, description="A robot of the package, or the file of one, relative to this file")
    base_m: Place | None = Field(None, description="Place of the robot's base, world frame (m)")
    base_orientation_rad: Triple | None = Field(
        None, description="Its roll, pitch, yaw about the world's x, y, z axes (rad); none: upright"
    )
    base_orientation_deg: Triple | None = Field(None, description="The same in degrees")
    standing: dict[Name, Number] = Field(
        {}, max_length=1000, description="Joints that stand elsewhere than the robot's file says (rad or m)"
    )
    base_xy_m: tuple[Metres, Metres] | None = Field(
        None, description="Place of a base on the floor, world frame (m), instead of base_m"
    )
    yaw_rad: float | None = Field(None, description="Turn of such a base about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")
    torso_lift_m: float | None = Field(
        None, description="Joint of robots whose file knows this key of scene files of before (m); use standing"
    )
    left_arm_rad: ArmAngles | None = Field(None, description="Joints, as torso_lift_m (rad)")
    left_arm_deg: ArmAngles | None = Field(None, description="The same in degrees")

    @model_validator(mode="after")
    def _one_base(self) -> RobotSection:
        if (self.base_m is None) == (self.base_xy_m is None):
            raise ValueError("wanted base_m, or base_xy_m for a base on the floor; state the place in one way")
        if self.has_angle("yaw") != (self.base_xy_m is not None):
            raise ValueError("wanted yaw_rad or yaw_deg with base_xy_m alone; with base_m use base_orientation_deg")
        if self.base_m is None and self.has_angle("base_orientation"):
            raise ValueError("wanted base_orientation with base_m alone; with base_xy_m use yaw_deg")
        return self

    @property
    def old_keys(self) -> dict[str, tuple[float, ...]]:
        """Values (rad or m) of keys that only robots with such `scene_keys` have."""
        found: dict[str, tuple[float, ...]] = {}
        if self.torso_lift_m is not None:
            found["torso_lift_m"] = (self.torso_lift_m,)
        if self.has_angle("left_arm"):
            found["left_arm"] = tuple(self.angle("left_arm").tolist())
        return found

    @property
    def robot(self) -> str:
        """Name of the robot, or path of its file."""
        return self.name or robot_with_keys(set(self.old_keys))


class ToolPoseSection(Section):
    """Where a task wants the tool, and how exactly."""

    position_m: Place = Field(description="Wanted place of the tool, world frame (m)")
    orientation_rad: Triple | None = Field(None, description="Roll, pitch, yaw about the world's x, y, z axes (rad)")
    orientation_deg: Triple | None = Field(None, description="The same in degrees")
    position_tolerance_m: EachAxis = Field(description="Largest displacement along each axis of the wanted pose (m)")
    orientation_tolerance_rad: EachAxis | None = Field(None, description="Largest turn about each axis (rad)")
    orientation_tolerance_deg: EachAxis | None = Field(None, description="The same in degrees; 180: free")


class GoalSection(Section):
    """A task of the robot: a configuration of the arm or a pose of the tool."""

    optional_angles = ("configuration",)
    name: Name = Field(description="What messages and reports call it")
    configuration_rad: ArmAngles | None = Field(None, description="Configuration of the arm (rad)")
    configuration_deg: ArmAngles | None = Field(None, description="The same in degrees")
    tool_pose: ToolPoseSection | None = Field(None, description="Pose of the tool, instead of a configuration")
    task_cost: float = Field(0.0, description="Cost of choosing this task beside disturbing the person")

    @model_validator(mode="after")
    def _one_way(self) -> GoalSection:
        if self.has_angle("configuration") == (self.tool_pose is not None):
            got = "both" if self.tool_pose else "neither"
            raise ValueError(
                f"wanted either configuration_rad or configuration_deg or tool_pose, got {got}; state the task in one "
                "way"
            )
        return self


class TableSection(Section):
    """The table's top: a box that turns about the vertical only."""

    optional_angles = ("yaw",)
    top_centre_m: Place = Field(description="Middle of its upper face, world frame (m)")
    size_m: Lengths = Field(description="Lengths along its own axes (m)")
    yaw_rad: float | None = Field(None, description="Turn about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")


class ObjectSection(Section):
    """An upright cylinder."""

    name: Name = Field(description="What messages call it")
    base_m: Place = Field(description="Middle of its lower face, world frame (m)")
    radius_m: Length
    height_m: Length


class ObstacleSection(Section):
    """A solid that stands anywhere: exactly one of a box, a cylinder, a sphere and a mesh."""

    optional_angles = ("orientation",)
    name: Name = Field(description="What messages call it")
    position_m: Place = Field(description="Its middle, or a mesh's own origin, world frame (m)")
    orientation_rad: Triple | None = Field(
        None, description="Its roll, pitch, yaw about the world's x, y, z axes (rad); none: upright"
    )
    orientation_deg: Triple | None = Field(None, description="The same in degrees")
    box_m: Lengths | None = Field(None, description="Lengths of a box along its own axes (m)")
    cylinder_m: tuple[Length, Length] | None = Field(
        None, description="Radius of a cylinder, and length along its z axis (m)"
    )
    sphere_m: Length | None = Field(None, description="Radius of a sphere (m)")
    mesh: Name | None = Field(
        None, description="File of a closed mesh in metres (STL, OBJ, DAE), relative to this file"
    )

    @model_validator(mode="after")
    def _one_solid(self) -> ObstacleSection:
        given = [name for name in ("box_m", "cylinder_m", "sphere_m", "mesh") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"wanted one of box_m, cylinder_m, sphere_m and mesh, got {' and '.join(given) or 'none'}")
        return self


class HumanSection(Section):
    """Where the tracker's frame is, in which postures are given."""

    offset_m: Place = Field(description="Its origin, world frame (m)")
    yaw_rad: float | None = Field(None, description="Its turn about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")
    frame: Name | None = Field(None, description="Its name in headers and TF; none: that of the library learned from")


class GridSection(Section):
    """The voxels of predicted occupancy."""

    origin_m: Triple = Field(description="Lowest corner, world frame (m)")
    resolution_m: float = Field(gt=0.0, le=1.0, description="Edge of a voxel (m)")
    shape: tuple[int, int, int] = Field(description="Numbers of voxels along x, y, z")


class PlaceSection(Section):
    """A place the person may reach for."""

    label: StrictStr | StrictInt = Field(description="Its name, or that of the class of reaches to it")
    place_m: Place = Field(description="Where the palm ends, world frame (m)")


class TaskList(Section):
    """The tasks of a scene, told while the arm works."""

    goals: tuple[GoalSection, ...] = Field(max_length=100)


class SceneFile(Section):
    """A workplace: robot, tasks, obstacles, where the person is tracked; metres, world frame, z up."""

    optional_angles = ("start",)
    name: Name = Field(description="What reports call it")
    robot: RobotSection
    start_rad: ArmAngles | None = Field(None, description="Configuration of the arm at the beginning (rad)")
    start_deg: ArmAngles | None = Field(None, description="The same in degrees")
    start_state: Name | None = Field(None, description="The same by its name in the robot's file or SRDF")
    goals: tuple[GoalSection, ...] = Field(max_length=100)
    table: TableSection | None = Field(None, description="A table; further ones are obstacles")
    objects: tuple[ObjectSection, ...] = Field((), max_length=1000, description="Upright cylinders, such as cups")
    obstacles: tuple[ObstacleSection, ...] = Field((), max_length=1000, description="Anything else that stands there")
    human: HumanSection
    grid: GridSection | None = Field(
        None, description="The lattice; none: all that the arm can reach, in voxels of 0.05 m"
    )
    places: tuple[PlaceSection, ...] = Field(
        (), max_length=1000, description="Places the person may reach for; none: the library's"
    )

    @model_validator(mode="after")
    def _one_start(self) -> SceneFile:
        if self.has_angle("start") == (self.start_state is not None):
            got = "both" if self.start_state else "neither"
            raise ValueError(
                f"wanted either start_rad or start_deg or start_state, got {got}; state the start in one way"
            )
        return self


def start_of(file: SceneFile) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the robot's J joints, and the configuration (J,) rad at the beginning.

    Raises:
        RobotError: for an unknown robot.
        SceneError: for a configuration of another length.
    """
    joints = read_robot_file(file.robot.robot).joints
    if file.start_state is not None:
        from humanpred_ros.robot.robot import load_robot  # reads the whole description

        return joints, load_robot(file.robot.robot).state(file.start_state)
    start = file.angle("start")
    if len(start) != len(joints):
        raise SceneError(
            f"scene {file.name}: start: wanted {len(joints)} angles ({', '.join(joints)}), got {len(start)}; correct it"
        )
    return joints, start


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the package."""
    return tuple(sorted(path.stem for path in share_file("config", "scenes").glob("*.yaml")))


def recorded_scene(folder: Path, name: str) -> str:
    """Return the name or path by which the scene of a recorded run is loaded: one of the package, or the run's own.

    Args:
        folder: of the run; `scene.yaml` in it is its scene, where that is none of the package's.
        name: that the run tells; it may be a path on somebody's machine, which is not followed.

    Raises:
        SceneError: neither.
    """
    if name in scene_names():
        return name
    kept = folder / RECORDED_SCENE
    if not os.path.lexists(kept):
        raise SceneError(
            f"scene {name}: wanted one of {', '.join(scene_names())}, or {RECORDED_SCENE} in the run's folder; if you "
            f"trust the scene, copy it to {kept}"
        )
    return str(file_inside(folder, RECORDED_SCENE, SceneError, "scene"))


def keep_scene(name_or_path: str | Path, folder: Path) -> None:
    """Write a scene into a run's folder with all of the user's own files that it needs, so that the run may travel.

    Those are the robot's file, its URDF (macros expanded), SRDF, spheres and meshes for collision, and meshes of the
    scene. What comes with the package, or is part of something installed, stays there and is named as before.

    Raises:
        SceneError, RobotError, UsageError: for files that cannot be read.
    """
    path = Path(name_or_path).absolute()
    if str(name_or_path) in scene_names():
        return
    scene = read_yaml(path, SceneError)
    robot_file = path.parent / (read_scene_file(path).robot.name or "")
    numbers = count(1)

    def kept(file: Path) -> str:
        copied: str = copies.setdefault(file, f"robot_files/{next(numbers)}_{file.name}")
        if not (folder / copied).exists():
            shutil.copyfile(file, folder / copied)
        return copied

    copies: dict[Path, str] = {}
    (folder / "robot_files").mkdir(exist_ok=True)
    if robot_file.suffix in (".yaml", ".yml"):
        robot = read_yaml(robot_file, RobotError)
        if is_local(robot["description"]):
            urdf = find_source(robot["description"], robot_file.parent, ".urdf")
            (folder / "robot.urdf").write_text(urdf_text(urdf, kept, visual=False), encoding="utf-8")
            robot["description"] = "robot.urdf"
        for section, key, suffix in ((robot, "semantic", ".srdf"), (robot.get("collision") or {}, "spheres", ".xrdf")):
            if key in section and is_local(section[key]):
                section[key] = kept(find_source(section[key], robot_file.parent, suffix))
        (folder / _RECORDED_ROBOT).write_text(yaml.safe_dump(robot, sort_keys=False), encoding="utf-8")
        scene["robot"]["name"] = _RECORDED_ROBOT
    for obstacle in scene.get("obstacles") or ():
        if "mesh" in obstacle:
            obstacle["mesh"] = kept(path.parent / obstacle["mesh"])
    if not copies:
        (folder / "robot_files").rmdir()
    (folder / RECORDED_SCENE).write_text(yaml.safe_dump(scene, sort_keys=False), encoding="utf-8")


def scene_with_robot(name_or_path: str | Path, robot: str, folder: Path) -> Path:
    """Write a scene with another robot, which stands where the scene's does, and return the file.

    Raises:
        SceneError, RobotError: for a scene that cannot be read or has no such start, or an unknown robot.
    """
    path = _scene_path(name_or_path).absolute()
    scene, own = read_yaml(path, SceneError), robot_path(robot)
    base = [key for key in scene["robot"] if key.startswith(("base", "yaw"))]
    scene["robot"] = {
        "name": robot if robot in robot_names() else str(own.absolute()),
        **{key: scene["robot"][key] for key in base},
    }
    for obstacle in scene.get("obstacles") or ():
        if "mesh" in obstacle:
            obstacle["mesh"] = str(path.parent / obstacle["mesh"])
    written = folder / RECORDED_SCENE
    written.write_text(yaml.safe_dump(scene, sort_keys=False), encoding="utf-8")
    start_of(read_scene_file(written))
    return written


def read_scene_file(name_or_path: str | Path) -> SceneFile:
    """Return the content of a scene's YAML file.

    Args:
        name_or_path: the name of a scene of the package (`face_to_face`), or the path of a YAML file.

    Raises:
        SceneError: if it cannot be read, or for unknown, missing or impossible values, with their place in the file.
    """
    path = _scene_path(name_or_path)
    file = read_section(path, SceneFile, f"scene {path.stem}", SceneError)
    # Files that it names lie where it lies.
    name = file.robot.name
    robot, obstacles = (
        file.robot,
        tuple(
            one if one.mesh is None else one.model_copy(update={"mesh": str(path.parent / one.mesh)})
            for one in file.obstacles
        ),
    )
    if name and Path(name).suffix in (".yaml", ".yml"):
        robot = robot.model_copy(update={"name": str(path.parent / name)})
    return file.model_copy(update={"robot": robot, "obstacles": obstacles})


def _scene_path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if str(name_or_path) not in scene_names():
        raise SceneError(
            f"scene: wanted one of {', '.join(scene_names())} or the path of a .yaml file, got {str(path)!r}"
        )
    return share_file("config", "scenes", f"{name_or_path}.yaml")
