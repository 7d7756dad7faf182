"""Reading the links, joints and solids of a URDF, because pinocchio keeps neither the exact shapes nor their sources.

URDF knows boxes, cylinders and spheres. What else a <cylinder> may stand for is stated in the link's element
<collision_checking>, which tools ignore that do not know it:

    <capsule name="B"/>                  collision B has half spheres at both ends (pinocchio's own convention)
    <elliptic_cylinder name="B" x="S"/>  collision B is an ellipse across: semi-axis S (m) along its x, the cylinder's
                                         radius along its y
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.capsules import Box, Capsule, EllipticCylinder, Shape, Sphere
from humanpred_ros.geometry.checks import FloatArray, frozen


@dataclass(frozen=True)
class Body:
    """One solid, fixed to a link.

    Attributes:
        name: the collision element's name, or the link's if it has none.
        link: name of the link it moves with.
        shape: the solid in its own frame.
        T_link_body: (4, 4) pose of that frame in the link.
    """

    name: str
    link: str
    shape: Shape
    T_link_body: FloatArray


def parse_urdf(text: str) -> ElementTree.Element:
    """Return the <robot> element of a URDF.

    Raises:
        HumanModelError: not XML, or XML that is no URDF.
    """
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as trouble:
        raise HumanModelError(f"wanted a URDF (XML), got text that does not parse: {trouble}") from trouble
    if robot.tag != "robot":
        raise HumanModelError(f"wanted a URDF with the root element <robot>, got <{robot.tag}>")
    return robot


def read_bodies(robot: ElementTree.Element) -> tuple[Body, ...]:
    """Return the collision solids of all links, in the order of the file.

    Raises:
        HumanModelError: a geometry that is missing, unknown (meshes), or has lengths that are not positive numbers.
    """
    bodies = []
    for link in robot.iter("link"):
        link_name = link.get("name", "")
        capsules = {mark.get("name") for mark in link.iterfind("collision_checking/capsule")}
        ellipses = {
            mark.get("name"): _numbers(mark, "x", 1)[0]
            for mark in link.iterfind("collision_checking/elliptic_cylinder")
        }
        names = {collision.get("name") for collision in link.iterfind("collision")}
        for mark in sorted(str(name) for name in (capsules | ellipses.keys()) - names):
            raise HumanModelError(
                f"URDF link {link_name}: <collision_checking> speaks of {mark}, which is no <collision> of this link"
            )
        for collision in link.iterfind("collision"):
            name = collision.get("name")
            shape = _shape(collision, link_name, name in capsules, ellipses.get(name))
            bodies.append(Body(name or link_name, link_name, shape, _pose(collision.find("origin"))))
    return tuple(bodies)


def signature_of(robot: ElementTree.Element, bodies: tuple[Body, ...]) -> str:
    """Return the sha256 (hex) of what defines kinematics and bodies.

    Comments, white space, the order of attributes, how numbers are written, names of the robot and materials, visual
    geometry and inertias do not enter; joints, their order, limits, and every solid do.
    """
    digest = hashlib.sha256()
    for joint in robot.iterfind("joint"):
        limit = joint.find("limit")
        numbers = [*_vector(joint.find("origin"), "xyz"), *_vector(joint.find("origin"), "rpy")]
        numbers += _vector(joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
        numbers += [] if limit is None else [_numbers(limit, key, 1, (0.0,))[0] for key in ("lower", "upper")]
        names = [joint.get("name"), joint.get("type"), _link_of(joint, "parent"), _link_of(joint, "child")]
        digest.update(repr((names, [float(x) + 0.0 for x in numbers])).encode())
    for body in bodies:
        pose = (np.round(body.T_link_body, 12) + 0.0).tolist()  # + 0.0: no difference between 0 and -0
        digest.update(repr((body.name, body.link, body.shape, pose)).encode())
    return digest.hexdigest()


def _link_of(joint: ElementTree.Element, role: str) -> str | None:
    element = joint.find(role)
    return None if element is None else element.get("link")


def _shape(collision: ElementTree.Element, link: str, is_capsule: bool, semi_axis_m: float | None) -> Shape:
    geometry = collision.find("geometry")
    solid = None if geometry is None else next(iter(geometry), None)
    kind = None if solid is None else solid.tag
    if solid is not None and kind == "sphere":
        return Sphere(*_numbers(solid, "radius", 1))
    if solid is not None and kind == "box":
        return Box(*_numbers(solid, "size", 3))
    if solid is not None and kind == "cylinder":
        (radius_m,), (length_m,) = _numbers(solid, "radius", 1), _numbers(solid, "length", 1)
        if is_capsule:
            return Capsule(radius_m, length_m)
        return EllipticCylinder(radius_m if semi_axis_m is None else semi_axis_m, radius_m, length_m)
    raise HumanModelError(
        f"URDF link {link}: wanted a collision geometry of kind box, cylinder or sphere, got {kind}; "
        "replace meshes by such solids"
    )


def _pose(origin: ElementTree.Element | None) -> FloatArray:
    """Return the 4x4 pose of an <origin>: fixed-axis roll, pitch, yaw as URDF defines them."""
    (cr, cp, cy), (sr, sp, sy) = (f(np.array(_vector(origin, "rpy"))) for f in (np.cos, np.sin))
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = _vector(origin, "xyz")
    return np.asarray(frozen(T), dtype=np.float64)


def _vector(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[float, ...]:
    return default if element is None else _numbers(element, key, 3, default)


def _numbers(
    element: ElementTree.Element, key: str, count: int, default: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    attributes: Mapping[str, str] = element.attrib
    if key not in attributes and default is not None:
        return default
    try:
        numbers = tuple(float(word) for word in attributes.get(key, "").split())
    except ValueError:
        numbers = ()
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise HumanModelError(
            f"URDF <{element.tag}>: wanted {count} finite number(s) in {key!r}, got {attributes.get(key)!r}; "
            "correct the file"
        )
    return numbers
