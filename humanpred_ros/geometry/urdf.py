"""The one reader of URDFs, for robots and people: yourdfpy reads the file, pinocchio joins fixed links into a tree.

What was read is plain arrays and solids. It is kept in the user's cache folder, because the two libraries together
take 150 MB and about two seconds in every process; a file that was read before costs a few milliseconds.

URDF knows boxes, cylinders, spheres and meshes. Two marks in a link's <collision_checking> say what a <cylinder>
stands for; tools that do not know them ignore them:

    <capsule name="B"/>                  collision B has half spheres at both ends (pinocchio's own convention)
    <elliptic_cylinder name="B" x="S"/>  collision B is an ellipse across: semi-axis S (m) along its x, the cylinder's
                                         radius along its y
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.files import read_text
from humanpred_ros.geometry import description, solids
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.description import Body, Description, MeshBody, Mimic
from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Shape, Sphere
from humanpred_ros.resources import cache_root


def read_description(urdf: Path) -> Description:
    """Return what a URDF file says; file names of meshes are looked up beside it and in the folders above it.

    Raises:
        UsageError: if the file or one of its meshes cannot be read, or says what no description can hold.
    """
    if not urdf.is_file():
        raise UsageError(f"robot: wanted a URDF file, got {urdf}, which does not exist")
    try:
        return parse_description(urdf_text(urdf), urdf.resolve().parent)
    except UsageError as trouble:
        raise UsageError(f"robot: wanted a readable URDF, got {urdf}: {trouble}") from trouble


@lru_cache(maxsize=8)
def _expanded(urdf: Path, _state: tuple[str, int, int]) -> str:
    try:
        import xacro
    except ImportError as missing:
        raise UsageError(
            "its macros need xacro, which is not installed: pip install xacro, or name what `xacro FILE` writes"
        ) from missing
    try:
        return str(xacro.process_file(str(urdf)).toxml())
    except Exception as trouble:  # whatever the file's own expressions raise
        raise UsageError(f"xacro says: {trouble}") from trouble


def urdf_text(urdf: Path, meshes: Callable[[Path], str] | None = None, *, visual: bool = True) -> str:
    """Return the text of a URDF file, its macros (xacro) expanded.

    Args:
        urdf: the file.
        meshes: returns the name to write for each mesh's file that is found; names stay as they are by default.
        visual: keep what is only to be looked at; with `meshes` alone.

    Raises:
        UsageError: for a file that cannot be read, or whose macros cannot be expanded.
    """
    text = read_text(urdf, UsageError)
    if "xmlns:xacro" in text and "<xacro:" in text:
        text = _expanded(urdf, _state(str(urdf)))
    if meshes is None:
        return text
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as trouble:
        raise UsageError(f"{urdf}: wanted a URDF (XML), got text that does not parse: {trouble}") from trouble
    for link in robot.iterfind("link"):
        for seen in link.findall("visual") if not visual else ():
            link.remove(seen)
    for mesh in robot.iter("mesh"):
        if found := _mesh_file(mesh.get("filename", ""), urdf.resolve().parent):
            mesh.set("filename", meshes(found))
    return ElementTree.tostring(robot, encoding="unicode")


@lru_cache(maxsize=32)
def parse_description(text: str, folder: Path | None = None) -> Description:
    """Return what the text of a URDF says.

    Args:
        text: the URDF.
        folder: where file names of meshes start from; without it they must be absolute.

    Raises:
        UsageError: with the link or joint and what is wrong with it.
    """
    entry = _entry(hashlib.sha256(f"{folder}\n{text}".encode()).hexdigest())
    kept = _kept(entry)
    if kept is None:
        kept = _parse(text, folder)
        _keep(entry, kept)
    return kept


def standing_urdf(text: str, moving: Sequence[str], values: Mapping[str, float], T_world_root: FloatArray) -> str:
    """Return a URDF with the root `world`, in which all joints but some stand still.

    So that robot_state_publisher shows a whole robot from the joint states of an arm alone.

    Args:
        text: the URDF.
        moving: names of the joints that move.
        values: rad or m of those of the others that are not at zero.
        T_world_root: (4, 4) where the URDF's root stands.
    """
    from scipy.spatial.transform import Rotation

    robot = ElementTree.fromstring(text)
    joints = robot.findall("joint")
    children = {joint.find("child").get("link") for joint in joints}  # type: ignore[union-attr]
    root = next(link for link in robot.iterfind("link") if link.get("name") not in children)
    name = str(root.get("name"))
    if name == "world":
        root.set("name", "robot_root")
        for parent in robot.iterfind("joint/parent[@link='world']"):
            parent.set("link", "robot_root")

    def triple(element: ElementTree.Element | None, key: str, default: str) -> FloatArray:
        return np.array((default if element is None else element.get(key, default)).split(), dtype=np.float64)

    def place(joint: ElementTree.Element, turn: Rotation, xyz: FloatArray) -> None:
        origin = joint.find("origin")
        origin = ElementTree.SubElement(joint, "origin") if origin is None else origin
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # at a pitch of 90 degrees other angles say the same
            rpy = turn.as_euler("xyz")
        origin.set("xyz", " ".join(map(repr, xyz.tolist())))
        origin.set("rpy", " ".join(map(repr, rpy.tolist())))

    for joint in joints:
        if joint.get("type") == "fixed" or joint.get("name") in moving:
            continue
        value, origin = values.get(str(joint.get("name")), 0.0), joint.find("origin")
        turn, xyz = Rotation.from_euler("xyz", triple(origin, "rpy", "0 0 0")), triple(origin, "xyz", "0 0 0")
        axis = triple(joint.find("axis"), "xyz", "1 0 0")
        axis = value * axis / np.linalg.norm(axis)
        if joint.get("type") == "prismatic":
            place(joint, turn, xyz + turn.apply(axis))
        else:
            place(joint, turn * Rotation.from_rotvec(axis), xyz)
        joint.set("type", "fixed")
        for part in [part for part in joint if part.tag not in ("parent", "child", "origin")]:
            joint.remove(part)
    ElementTree.SubElement(robot, "link", name="world")
    stand = ElementTree.SubElement(robot, "joint", name="robot_stands", type="fixed")
    ElementTree.SubElement(stand, "parent", link="world")
    ElementTree.SubElement(stand, "child", link=str(root.get("name")))
    place(stand, Rotation.from_matrix(np.array(T_world_root[:3, :3])), T_world_root[:3, 3])
    return ElementTree.tostring(robot, encoding="unicode")


def _parse(text: str, folder: Path | None) -> Description:
    # Imported here: a process that finds its descriptions in the cache needs neither library.
    import pinocchio as pin

    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as trouble:
        raise UsageError(f"wanted a URDF (XML), got text that does not parse: {trouble}") from trouble
    if robot.tag != "robot":
        raise UsageError(f"wanted a URDF with the root element <robot>, got <{robot.tag}>")
    said = _read_elements(robot)
    _complete_limits(robot)
    try:
        tree = pin.buildModelFromXML(ElementTree.tostring(robot, encoding="unicode"))
    except (ValueError, RuntimeError) as trouble:
        raise UsageError(f"wanted one tree of links, pinocchio says: {trouble}") from trouble
    names = tuple(str(name) for name in tree.names)[1:]
    joints = [said.joint_map[name] for name in names]
    limits = np.array([_limits(joint) for joint in joints]).reshape(-1, 3)
    axes = np.array([joint.axis for joint in joints]).reshape(-1, 3)
    links = [frame for frame in tree.frames if frame.type == pin.FrameType.BODY]
    link_names = tuple(str(frame.name) for frame in links)
    files: list[tuple[str, int, int]] = []
    marks = {str(link.get("name")): _marks(link) for link in robot.iterfind("link")}
    bodies = [body for link in said.robot.links for body in _bodies(link, marks[link.name], folder, files)]
    return Description(
        name=said.robot.name or "robot",
        joint_names=names,
        kind=tuple(joint.type for joint in joints),
        parent=np.array(list(tree.parents)[1:], dtype=np.int64),
        T_parent_joint=np.array([T.homogeneous for T in list(tree.jointPlacements)[1:]]).reshape(-1, 4, 4),
        axis=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        lower=limits[:, 0].copy(),
        upper=limits[:, 1].copy(),
        velocity_limit=limits[:, 2].copy(),
        mimic={
            name: Mimic(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
            for name, joint in zip(names, joints, strict=True)
            if joint.mimic is not None
        },
        link_names=link_names,
        link_joint=np.array([_joint_of(frame) for frame in links], dtype=np.int64),
        T_joint_link=np.array([frame.placement.homogeneous for frame in links]),
        bodies=tuple(body for body in bodies if isinstance(body, Body)),
        meshes=tuple(body for body in bodies if isinstance(body, MeshBody)),
        files=tuple(files),
    )


def _joint_of(frame: Any) -> int:
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)  # pinocchio 3 renamed it


def _read_elements(robot: ElementTree.Element) -> Any:
    """Return yourdfpy's reading of a URDF; an element that it cannot read is found and named."""
    import yourdfpy

    def load(*elements: ElementTree.Element) -> Any:
        alone = ElementTree.Element("robot", robot.attrib)
        alone.extend(elements)
        text = ElementTree.tostring(alone)
        return yourdfpy.URDF.load(io.BytesIO(text), build_scene_graph=False, load_meshes=False)

    try:
        return load(*robot)
    except Exception as trouble:  # yourdfpy checks nothing: any error of Python may come
        wanted = (
            "wanted a <geometry> in each collision and numbers in all lengths, origins and limits, got something else"
        )
        for element in robot:
            try:
                load(element)
            except Exception as found:
                where = f"URDF {element.tag} {element.get('name')}"
                raise UsageError(f"{where}: {wanted} ({found}); correct it") from found
        raise UsageError(f"URDF: {wanted} ({trouble}); correct it") from trouble


def _limits(joint: Any) -> tuple[float, float, float]:
    """Return lower and upper limit and the largest speed of a joint; urdfdom has refused hinges without limits."""
    limit = joint.limit
    speed = np.inf if limit is None or limit.velocity is None else float(limit.velocity)
    if joint.type == "continuous" or limit is None:
        return -np.inf, np.inf, speed
    return float(limit.lower or 0.0), float(limit.upper or 0.0), speed


def _complete_limits(robot: ElementTree.Element) -> None:
    """Add what pinocchio wants of limits and nobody here reads; speeds that are unknown stay so."""
    for joint in robot.iterfind("joint"):
        limit = joint.find("limit")
        if limit is None and joint.get("type") in ("revolute", "prismatic"):
            raise UsageError(
                f"URDF joint {joint.get('name')}: wanted a <limit>, got none; add lower, upper and velocity"
            )
        for name in ("effort", "velocity"):
            if limit is not None and name not in limit.attrib:
                limit.set(name, "0")


def _marks(link: ElementTree.Element) -> dict[str, float | None]:
    """Return which cylinders of a link stand for something else: None for a capsule, a semi-axis for an ellipse."""
    marks: dict[str, float | None] = {}
    for mark in (*link.iterfind("collision_checking/capsule"), *link.iterfind("collision_checking/elliptic_cylinder")):
        where = f"URDF link {link.get('name')}: <{mark.tag} name={mark.get('name')!r}>"
        if mark.get("name") not in {collision.get("name") for collision in link.iterfind("collision")}:
            raise UsageError(f"{where} names no <collision> of this link; correct the name")
        semi_axis_m = None
        if mark.tag == "elliptic_cylinder":
            try:
                semi_axis_m = float(mark.get("x", ""))
            except ValueError as trouble:
                raise UsageError(f"{where}: wanted a number in 'x', got {mark.get('x')!r}; correct it") from trouble
        marks[str(mark.get("name"))] = semi_axis_m
    return marks


def _bodies(
    link: Any, marks: Mapping[str, float | None], folder: Path | None, files: list[tuple[str, int, int]]
) -> list[Body | MeshBody]:
    bodies: list[Body | MeshBody] = []
    for collision in link.collisions:
        name = str(collision.name or link.name)
        where = f"URDF link {link.name}, collision {name}"
        T = np.eye(4) if collision.origin is None else collision.origin
        if not np.isfinite(T).all():
            raise UsageError(f"{where}: wanted finite numbers in 'xyz' and 'rpy', got {T.tolist()}; correct them")
        if collision.geometry is not None and collision.geometry.mesh is not None:
            triangles = _mesh(where, collision.geometry.mesh, folder, files)
            bodies.append(MeshBody(name, link.name, triangles, T))
        else:
            try:
                shape = _shape(collision.geometry, name in marks, marks.get(name))
            except HumanPredError as trouble:
                raise UsageError(f"{where}: {trouble}") from trouble
            bodies.append(Body(name, link.name, shape, T))
    return bodies


def _shape(geometry: Any, marked: bool, semi_axis_m: float | None) -> Shape:
    if geometry is not None and geometry.sphere is not None:
        return Sphere(float(geometry.sphere.radius))
    if geometry is not None and geometry.box is not None:
        if np.shape(geometry.box.size) != (3,):
            raise UsageError(f"wanted 3 finite numbers in 'size', got {geometry.box.size}; correct it")
        return Box(*map(float, geometry.box.size))
    if geometry is not None and geometry.cylinder is not None:
        radius_m, length_m = float(geometry.cylinder.radius), float(geometry.cylinder.length)
        if marked and semi_axis_m is None:
            return Capsule(radius_m, length_m)
        return EllipticCylinder(radius_m if semi_axis_m is None else semi_axis_m, radius_m, length_m)
    raise UsageError("wanted a <geometry> with a box, cylinder, sphere or mesh, got none; add one")


def _mesh(where: str, mesh: Any, folder: Path | None, files: list[tuple[str, int, int]]) -> FloatArray:
    found = _mesh_file(str(mesh.filename), folder)
    if found is None:
        raise UsageError(
            f"{where}: wanted the mesh {mesh.filename}, which is not beside the URDF nor above it, and in no share "
            "folder of ROS; copy it there, or source its workspace"
        )
    triangles = read_mesh(found, where)
    files.append(_state(str(found)))
    scaled: FloatArray = triangles if mesh.scale is None else triangles * mesh.scale
    return scaled


def _mesh_file(filename: str, folder: Path | None) -> Path | None:
    # package:// names a folder above the URDF, whatever that package is called in this installation, or one of ROS.
    name = filename.removeprefix("package://").removeprefix("file://")
    folders = [Path("/")] if folder is None else [folder, *folder.parents]
    if filename.startswith("package://"):
        folders += [
            Path(entry) / "share" for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry
        ]
    return next((path for path in (base / name for base in folders) if path.is_file()), None)


def read_mesh(file: Path, where: str) -> FloatArray:
    """Return the triangles (F, 3, 3) of a mesh file, in its own unit; UsageError, after `where`, if it has none."""
    import trimesh

    try:
        loaded: Any = trimesh.load(file, force="mesh", process=False)
        triangles = np.array(loaded.triangles, dtype=np.float64).reshape(-1, 3, 3)
    except Exception as trouble:  # readers of many formats, each with errors of its own
        raise UsageError(f"{where}: wanted a readable mesh (STL, OBJ, DAE), got {file}: {trouble}") from trouble
    if not len(triangles) or not np.isfinite(triangles).all():
        raise UsageError(f"{where}: wanted a mesh of triangles, got {file}, which has none that are finite")
    return triangles


def _state(file: str) -> tuple[str, int, int]:
    """Return a file's name, size and time of change (ns), by which a change of it is noticed."""
    state = os.stat(file)
    return file, state.st_size, state.st_mtime_ns


def _entry(key: str) -> Path | None:
    """Return the cache's file of a description; another one after any change of what reads or holds it."""
    root = cache_root()
    if root is None:
        return None
    code = b"".join(Path(str(module)).read_bytes() for module in (__file__, description.__file__, solids.__file__))
    version = hashlib.sha256(code + np.__version__.encode()).hexdigest()[:16]
    return root / f"descriptions-{version}" / f"{key[:32]}.pickle"


def _kept(entry: Path | None) -> Description | None:
    """Return a description that was read before, unless one of its meshes has changed since."""
    if entry is None:
        return None
    try:
        kept: Description = pickle.loads(entry.read_bytes())
        os.utime(entry.parent)
        unchanged = all(_state(name) == (name, *state) for name, *state in kept.files)
    except (OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError, TypeError, ValueError):
        return None  # nothing there, or written by something else: read again
    return kept if unchanged else None


def _keep(entry: Path | None, said: Description) -> None:
    if entry is None:
        return
    with contextlib.suppress(OSError):  # where nothing can be written, every process reads again
        entry.parent.mkdir(parents=True, exist_ok=True)
        unfinished = entry.with_suffix(f".{os.getpid()}")
        unfinished.write_bytes(pickle.dumps(said))
        unfinished.replace(entry)
