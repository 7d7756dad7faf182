"""What a scene file may hold: the types that read it, and from which its JSON schema is generated.

An angle is given in radians under `<name>_rad` or in degrees under `<name>_deg`, never both.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PositiveFloat,
    StrictInt,
    ValidationError,
    model_validator,
)

from humanpred_ros.errors import SceneError
from humanpred_ros.files import file_inside, read_yaml
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.resources import share_file
from humanpred_ros.robot.pr2 import RIGHT_ARM_JOINTS

#: The file in which a run keeps the scene that it was made with.
RECORDED_SCENE = "scene.yaml"

Triple = tuple[float, float, float]
ArmAngles = Annotated[
    tuple[float, ...], Field(min_length=len(RIGHT_ARM_JOINTS), max_length=len(RIGHT_ARM_JOINTS))
]  # in joint order
EachAxis = Annotated[
    Triple, BeforeValidator(lambda value: (value,) * 3 if isinstance(value, int | float) else value, Triple | float)
]


def _name(text: str) -> str:
    if not text.strip():
        raise ValueError("wanted a name")
    return text


Name = Annotated[str, AfterValidator(_name)]


class Section(BaseModel):
    """One mapping of a scene file; keys that it does not know are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    optional_angles: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        valid = ", ".join(cls.model_fields)
        if not isinstance(content, dict):
            raise ValueError(f"wanted a mapping with the keys {valid}")
        unknown = [str(key) for key in content if key not in cls.model_fields]
        if unknown:
            raise ValueError(f"unknown key {', '.join(unknown)}; valid keys are {valid}")
        return content

    @model_validator(mode="after")
    def _one_spelling(self) -> Section:
        for key in type(self).model_fields:
            name = key.removesuffix("_rad")
            if name == key:
                continue
            given = [spelling for spelling in (key, f"{name}_deg") if getattr(self, spelling) is not None]
            if len(given) > 1 or not (given or name in self.optional_angles):
                raise ValueError(f"wanted either {name}_rad or {name}_deg, got {' and '.join(given) or 'neither'}")
        return self

    def has_angle(self, name: str) -> bool:
        """Return whether the file states an angle, in either unit."""
        return getattr(self, f"{name}_rad") is not None or getattr(self, f"{name}_deg") is not None

    def angle(self, name: str) -> FloatArray:
        """Return an angle or several in rad, an array () or (N,), whatever the file's unit; 0 if it states none."""
        degrees, radians = getattr(self, f"{name}_deg"), getattr(self, f"{name}_rad")
        return np.asarray((radians or 0.0) if degrees is None else np.deg2rad(degrees), dtype=np.float64)


class RobotSection(Section):
    """Where the robot stands, and its joints that do not move."""

    base_xy_m: tuple[float, float] = Field(description="Place of the robot's base on the floor, world frame (m)")
    yaw_rad: float | None = Field(None, description="Turn of the base about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")
    torso_lift_m: float = Field(description="Height of the torso, 0 to 0.31 (m)")
    left_arm_rad: ArmAngles | None = Field(None, description="Configuration of the resting left arm (rad)")
    left_arm_deg: ArmAngles | None = Field(None, description="The same in degrees")


class ToolPoseSection(Section):
    """Where a task wants the tool, and how exactly."""

    position_m: Triple = Field(description="Wanted place of the tool, world frame (m)")
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
    """The table's top: a box."""

    optional_angles = ("yaw",)
    top_centre_m: Triple = Field(description="Middle of its upper face, world frame (m)")
    size_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = Field(description="Lengths along its own axes (m)")
    yaw_rad: float | None = Field(None, description="Turn about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")


class ObjectSection(Section):
    """An upright cylinder."""

    name: Name = Field(description="What messages call it")
    base_m: Triple = Field(description="Middle of its lower face, world frame (m)")
    radius_m: float = Field(gt=0.0)
    height_m: float = Field(gt=0.0)


class HumanSection(Section):
    """Where the tracker's frame is, in which postures are given."""

    offset_m: Triple = Field(description="Its origin, world frame (m)")
    yaw_rad: float | None = Field(None, description="Its turn about the vertical (rad)")
    yaw_deg: float | None = Field(None, description="The same in degrees")
    frame: Name | None = Field(None, description="Its name in headers and TF; none: that of the library learned from")


class GridSection(Section):
    """The voxels of predicted occupancy."""

    origin_m: Triple = Field(description="Lowest corner, world frame (m)")
    resolution_m: float = Field(description="Edge of a voxel (m)")
    shape: tuple[int, int, int] = Field(description="Numbers of voxels along x, y, z")


class PlaceSection(Section):
    """A place the person may reach for."""

    label: StrictInt = Field(description="Whole number; where a library has a class of reaches to it, that class's")
    place_m: Triple = Field(description="Where the palm ends, world frame (m)")


class SceneFile(Section):
    """A workplace: robot, tasks, table, objects, where the person is tracked; metres, world frame, z up."""

    name: Name = Field(description="What reports call it")
    robot: RobotSection
    start_rad: ArmAngles | None = Field(None, description="Configuration of the arm at the beginning (rad)")
    start_deg: ArmAngles | None = Field(None, description="The same in degrees")
    goals: tuple[GoalSection, ...] = Field(max_length=100)
    table: TableSection
    objects: tuple[ObjectSection, ...] = Field(max_length=1000)
    human: HumanSection
    grid: GridSection
    places: tuple[PlaceSection, ...] = Field(
        (), max_length=1000, description="Places the person may reach for; none: the library's"
    )


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


def read_scene_file(name_or_path: str | Path) -> SceneFile:
    """Return the content of a scene's YAML file.

    Args:
        name_or_path: the name of a scene of the package (`face_to_face`), or the path of a YAML file.

    Raises:
        SceneError: if it cannot be read, or for unknown, missing or impossible values, with their place in the file.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) not in scene_names():
            raise SceneError(
                f"scene: wanted one of {', '.join(scene_names())} or the path of a .yaml file, got {str(path)!r}"
            )
        path = share_file("config", "scenes", f"{name_or_path}.yaml")
    try:
        return SceneFile.model_validate(read_yaml(path, SceneError))
    except ValidationError as trouble:
        raise SceneError(f"scene {path.stem}{_reason(trouble)}") from None


def _reason(trouble: ValidationError) -> str:
    """Return the place and kind of the first thing that is wrong with a file."""
    first = trouble.errors()[0]
    place, missing = list(first["loc"]), first["type"] == "missing"
    last = place.pop() if missing else ""
    where = "".join(f"[{part}]" if isinstance(part, int) else f": {part}" for part in place)
    if isinstance(last, int):
        return f"{where}: wanted at least {last + 1} numbers, got {first['input']!r:.80}; correct it"
    if missing:
        return f"{where}: the key {last} is missing; add it"
    said = str(first.get("ctx", {}).get("error", "")) or first["msg"][:1].lower() + first["msg"][1:]
    return f"{where}: {said}, got {first['input']!r:.80}; correct it"
