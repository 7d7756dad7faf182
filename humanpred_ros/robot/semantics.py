"""What is said of a robot beside its URDF: SRDF (named states, pairs that need no check), and spheres of its links.

Spheres come as XRDF, as cuRobo's YAML, or as a URDF whose collision geometry they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from humanpred_ros.errors import RobotError
from humanpred_ros.files import read_text, read_yaml
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.description import Body, Description
from humanpred_ros.geometry.solids import Sphere
from humanpred_ros.geometry.urdf import read_description

#: Two links, in the order of their names.
Pair = tuple[str, str]


def pair_of(a: str, b: str) -> Pair:
    """Return two links in the order of their names."""
    return (a, b) if a <= b else (b, a)


@dataclass(frozen=True)
class Semantics:
    """What an SRDF says that matters here."""

    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  #: rad or m of joints, by name of state
    left_out: frozenset[Pair] = frozenset()  #: links that are never checked against each other


def read_srdf(path: Path, description: Description) -> Semantics:
    """Return what an SRDF says of a robot.

    Raises:
        RobotError: for a file that is none, or one of another robot.
    """
    try:
        root = ElementTree.fromstring(read_text(path, RobotError))
        states = {
            str(state.get("name")): {
                str(joint.get("name")): float(str(joint.get("value")).split()[0]) for joint in state.iterfind("joint")
            }
            for state in root.iterfind("group_state")
        }
    except (ElementTree.ParseError, ValueError, IndexError) as trouble:
        raise RobotError(f"{path}: wanted an SRDF (XML), got something else: {trouble}; correct it") from trouble
    pairs = [(str(pair.get("link1")), str(pair.get("link2"))) for pair in root.iterfind("disable_collisions")]
    known = set(description.link_names)
    if root.tag != "robot" or (pairs and not any(known.issuperset(pair) for pair in pairs)):
        got = f"links such as {pairs[0][0]}" if pairs else f"the root element <{root.tag}>"
        raise RobotError(
            f"{path}: wanted the SRDF of {description.name}, got one of {root.get('name')!r} with {got}; name the "
            "robot's own"
        )
    return Semantics(states, frozenset(pair_of(*pair) for pair in pairs if known.issuperset(pair)))


def with_spheres(description: Description, path: Path) -> tuple[Description, frozenset[Pair]]:
    """Return a description in which spheres of a file stand for the links that it names, and pairs it leaves out.

    Raises:
        RobotError: for a file without spheres, or with those of links that the robot does not have.
    """
    if path.suffix.lower() in (".urdf", ".xml"):
        found, ignored = _of_urdf(path), frozenset[Pair]()
    else:
        found, ignored = _of_yaml(path)
    unknown = sorted(found.keys() - set(description.link_names))
    if unknown or not found:
        got = f"those of {', '.join(unknown[:3])}, which it does not have" if unknown else "none"
        raise RobotError(f"{path}: wanted spheres of links of {description.name}, got {got}; correct the file")
    bodies = tuple(
        Body(link, link, Sphere(float(radius)), _at(centre))
        for link, spheres in found.items()
        for *centre, radius in spheres.tolist()
    )
    return replace(
        description,
        bodies=(*(body for body in description.bodies if body.link not in found), *bodies),
        meshes=tuple(mesh for mesh in description.meshes if mesh.link not in found),
    ), ignored


def _of_urdf(path: Path) -> dict[str, FloatArray]:
    found: dict[str, list[list[float]]] = {}
    for body in read_description(path).collisions:
        if isinstance(body, Body) and isinstance(body.shape, Sphere):
            found.setdefault(body.link, []).append([*body.T_link_body[:3, 3], body.shape.radius_m])
    return {link: np.array(spheres) for link, spheres in found.items()}


def _of_yaml(path: Path) -> tuple[dict[str, FloatArray], frozenset[Pair]]:
    content = read_yaml(path, RobotError)
    try:
        if "geometry" in content:  # XRDF
            used = content.get("collision") or {}
            name = used.get("geometry") or next(iter(content["geometry"]))
            spheres, buffer = content["geometry"][name]["spheres"], used.get("buffer_distance") or {}
            ignored = (content.get("self_collision") or {}).get("ignore") or {}
        else:
            said = content["robot_cfg"]["kinematics"] if "robot_cfg" in content else content.get("kinematics", content)
            spheres, buffer = said["collision_spheres"], said.get("collision_sphere_buffer") or 0.0
            ignored = said.get("self_collision_ignore") or {}
        grown = {link: _number(buffer.get(link, 0.0) if isinstance(buffer, dict) else buffer) for link in spheres}
        found = {
            str(link): np.array(
                [[*map(_number, one["center"]), _number(one["radius"]) + grown[link]] for one in listed]
            )
            for link, listed in spheres.items()
        }
        # cuRobo switches spheres off by a negative radius.
        found = {link: rows.reshape(-1, 4)[rows.reshape(-1, 4)[:, 3] > 0.0] for link, rows in found.items()}
        pairs = frozenset(pair_of(str(a), str(b)) for a, others in ignored.items() for b in others)
    except (KeyError, TypeError, ValueError, AttributeError, StopIteration) as trouble:
        raise RobotError(
            f"{path}: wanted XRDF, cuRobo's YAML or a URDF with spheres as {{center: [x, y, z], radius: r}} by link, "
            f"got something else ({type(trouble).__name__}: {trouble}); correct it"
        ) from trouble
    return {link: rows for link, rows in found.items() if len(rows)}, pairs


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"wanted a number, got {value!r:.40}")
    return float(value)


def _at(place: Iterable[float]) -> FloatArray:
    T = np.eye(4)
    T[:3, 3] = list(place)
    return T
