"""What a robot's file may hold: `config/robots/<name>.yaml`, or a user's own; and where what it names lies."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, PositiveFloat, StrictFloat, StrictInt

from humanpred_ros.errors import RobotError
from humanpred_ros.resources import share_file
from humanpred_ros.robot.sections import Name, Section, read_section

_EXAMPLES, _PACKAGE, _SHARE, _TOPIC = "example-robot-data:", "package:", "share:", "topic:"
_EXAMPLE_FOLDER = Path("share", "example-robot-data", "robots")

Number = StrictFloat | StrictInt
Links = Annotated[
    tuple[Name, ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value, tuple[str, ...] | str),
]
PerJoint = Annotated[
    tuple[PositiveFloat, ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, int | float) else value, tuple[float, ...] | float),
    Field(min_length=1, max_length=100),
]


class CollisionSection(Section):
    """What stands for the robot's links where they must not touch anything."""

    spheres: Name | None = Field(
        None, description="File with the links' spheres: XRDF, or a URDF whose collision geometry they are"
    )
    largest_sphere_m: PositiveFloat | None = Field(
        None, description="Largest radius of spheres that are made from collision geometry (m); found by link if absent"
    )
    largest_sphere_of_m: dict[Name, PositiveFloat] = Field(
        {}, max_length=1000, description="The same for single links (m)"
    )
    box_saving_m3: PositiveFloat = Field(
        0.0001, description="Links are filled with as many boxes as save this volume each (m^3)"
    )
    pairs_left_out: tuple[tuple[Links, Links], ...] = Field(
        (), max_length=10_000, description="Links, or lists of links, that are never checked against each other"
    )
    shoulder: tuple[Name, ...] = Field(
        (),
        max_length=100,
        description="Links moved by the first two joints that planners do not look at: a scene is refused if anything "
        "stands where they could get to",
    )


class RobotFile(Section):
    """An arm: where its description lies, which joints it has, and what no description says."""

    name: Name = Field(description="What messages and reports call it")
    description: Name = Field(
        description="Its URDF: a file (relative to this one), example-robot-data:NAME, package:PYTHON_PACKAGE/FILE, "
        "share:PACKAGE/FILE (in the share folder of an installation of ROS, conda or pip), or topic:/robot_description"
    )
    semantic: Name | None = Field(
        None, description="Its SRDF, given in the same ways: named states, and pairs of links that are not checked"
    )
    joints: tuple[Name, ...] = Field(
        min_length=1, max_length=100, description="Joints that are planned for, from the base outwards"
    )
    base_frame: Name | None = Field(None, description="Link whose pose scenes give; the root of the URDF if absent")
    tool_frame: Name = Field(description="Link whose pose tasks give")
    standing: dict[Name, Number] = Field(
        {},
        max_length=1000,
        description="Joints that stand still, and where (rad or m); others at zero, or at the limit next to it",
    )
    states: dict[Name, tuple[Number, ...]] = Field(
        {}, max_length=1000, description="Configurations by name (rad), in the order of joints"
    )
    velocity_limit: PerJoint | None = Field(
        None, description="Largest speed of every joint, or of each (rad/s); the URDF's if absent"
    )
    acceleration_limit: PerJoint | None = Field(
        None, description="The same for accelerations (rad/s^2); the planner's own limit if absent or lower"
    )
    distance_weights: PerJoint | None = Field(
        None, description="Configuration distance of one radian of each joint; found from the links' reach if absent"
    )
    collision: CollisionSection = Field(CollisionSection(), description="What stands for its links")
    scene_keys: dict[Name, tuple[Name, ...]] = Field(
        {}, max_length=10, description="Joints that stand still, by keys that scene files of before set them with"
    )


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots that come with the package."""
    return tuple(sorted(path.stem for path in share_file("config", "robots").glob("*.yaml")))


def robot_path(name_or_path: str | Path) -> Path:
    """Return the file of a robot: of the package by name (`panda`), or a YAML file by its path.

    Raises:
        RobotError: for another name.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if str(name_or_path) not in robot_names():
        raise RobotError(
            f"robot: wanted one of {', '.join(robot_names())} or the path of a .yaml file, got {str(name_or_path)!r}"
        )
    return share_file("config", "robots", f"{name_or_path}.yaml")


def read_robot_file(name_or_path: str | Path) -> RobotFile:
    """Return the content of a robot's YAML file; raises RobotError as `robot_path` and `read_section`."""
    path = robot_path(name_or_path)
    return read_section(path, RobotFile, f"robot {path}", RobotError)


def robot_with_keys(keys: set[str]) -> str:
    """Return the robot of the package whose file knows these keys of scene files (`scene_keys`).

    Raises:
        RobotError: if there is none.
    """
    for name in robot_names():
        if keys and keys <= read_robot_file(name).scene_keys.keys():
            return name
    raise RobotError(
        f"robot: wanted its name, got none; add one of {', '.join(robot_names())}, or a .yaml file, as name"
    )


def find_source(source: str, folder: Path, suffix: str) -> Path:
    """Return the file that a robot's file names.

    Args:
        source: as in `RobotFile.description`.
        folder: of the robot's file.
        suffix: of files that are looked for by name, such as ".urdf".

    Raises:
        RobotError: if there is none, with where it was looked for and what to install.
    """
    if source.startswith(_EXAMPLES):
        return _find_example(source.removeprefix(_EXAMPLES), suffix)
    if source.startswith(_TOPIC):
        return _received(source.removeprefix(_TOPIC), suffix)
    if source.startswith(_SHARE):
        found = [prefix / "share" / source.removeprefix(_SHARE) for prefix in dict.fromkeys(_prefixes())]
    elif source.startswith(_PACKAGE):
        package, _, file = source.removeprefix(_PACKAGE).partition("/")
        # Only a top-level name: looking for one below would run the package's own code.
        spec = find_spec(package) if package.isidentifier() else None
        if spec is None or not spec.submodule_search_locations:
            raise RobotError(f"wanted the Python package {package!r} of {source}, which is not installed; install it")
        found = [Path(place) / file for place in spec.submodule_search_locations]
    else:
        found = [folder / source]
    for path in found:
        if path.is_file():
            return path
    raise RobotError(
        f"wanted the file {source}, looked for as {found[0]}, which does not exist; correct the path"
        + (f", or install {source.removeprefix(_SHARE).partition('/')[0]}" if source.startswith(_SHARE) else "")
    )


def is_local(source: str) -> bool:
    """Return whether a source is a file of the user's own, or was received, instead of part of something installed."""
    return not source.startswith((_EXAMPLES, _PACKAGE, _SHARE))


@cache
def _received(topic: str, suffix: str) -> Path:
    """Return a file with what a running robot publishes on a latched topic, received once in every process."""
    # A process of its own: this package knows no ROS, and a node that reads this cannot wait for a message meanwhile.
    command = [sys.executable, "-m", "humanpred_ros.nodes.latched_text", topic]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        said = done.stdout.strip() or f"wanted ROS 2 to receive {topic}, got no connection; install the extra `ros`"
        raise RobotError(said)
    folder = Path(tempfile.mkdtemp(prefix="humanpred-robot-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / f"robot{suffix}"
    path.write_text(done.stdout, encoding="utf-8")
    return path


def _find_example(name: str, suffix: str) -> Path:
    """Return a file of example-robot-data from wherever that is installed (wheel, conda, apt)."""
    prefixes = list(dict.fromkeys(_prefixes()))
    for robots in (prefix / _EXAMPLE_FOLDER for prefix in prefixes):
        if (robots / name).is_file():
            return robots / name
        for pattern in (f"*/*/{name}{suffix}", f"*/*/{name}_robot{suffix}"):
            if "/" not in name and (found := sorted(robots.glob(pattern))):
                return found[0]
    raise RobotError(
        f"wanted {name}{suffix} of example-robot-data, looked for as {_EXAMPLE_FOLDER / name} below {len(prefixes)} "
        "prefixes and not found; install it (pip install example-robot-data), or give the path of a file"
    )


def _prefixes() -> Iterator[Path]:
    # pip puts the data into cmeel.prefix of some site-packages, others below a prefix that site-packages are also in.
    for entry in filter(None, sys.path):
        yield from (Path(entry) / "cmeel.prefix", *Path(entry).parents)
    yield from (Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry)
    yield Path(sys.prefix)
