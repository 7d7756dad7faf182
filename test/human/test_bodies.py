"""The bodies in the URDF: what standard tools see agrees with what the package computes with."""

from __future__ import annotations

from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from human_distance import distances_m

from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Sphere
from humanpred_ros.human.model import HumanModel


@pytest.fixture(scope="module")
def human() -> HumanModel:
    return HumanModel.kinect12()


def test_pinocchio_places_the_same_bodies(human: HumanModel) -> None:
    tree = pin.buildModelFromXML(human.urdf)
    solids = pin.buildGeomFromUrdfString(tree, human.urdf, pin.GeometryType.COLLISION)
    q = np.random.default_rng(0).uniform(-0.5, 0.5, 12)
    placed = pin.GeometryData(solids)
    pin.updateGeometryPlacements(tree, tree.createData(), solids, placed, q)
    assert solids.ngeoms == len(human.bodies)
    ours = {
        tuple(T.round(9).ravel() + 0.0): body.shape for body, T in zip(human.bodies, human.body_poses(q), strict=True)
    }
    for solid, T in zip(solids.geometryObjects, placed.oMg, strict=True):
        shape = ours[tuple(T.homogeneous.round(9).ravel() + 0.0)]
        assert (type(solid.geometry).__name__ == "Capsule") == isinstance(shape, Capsule)


def test_what_plain_tools_see_encloses_the_elliptic_bodies(human: HumanModel) -> None:
    elliptic = [body.shape for body in human.bodies if isinstance(body.shape, EllipticCylinder)]
    assert any(shape.x_m < shape.y_m for shape in elliptic)
    assert all(shape.x_m <= shape.y_m for shape in elliptic)


def test_visual_and_collision_geometry_are_the_same(human: HumanModel) -> None:
    for element in ElementTree.fromstring(human.urdf).iter("link"):
        shown, used = (
            sorted((part.get("name"), [(e.tag, e.attrib) for e in part.iter()][1:]) for part in element.iterfind(kind))
            for kind in ("visual", "collision")
        )
        assert shown == used, element.get("name")


def test_published_body_sizes(human: HumanModel) -> None:
    shapes = {body.name: body.shape for body in human.bodies}
    assert shapes["pelvis"] == EllipticCylinder(0.1595, 0.1819, 0.20)
    assert shapes["torso"] == EllipticCylinder(0.1415, 0.203, 0.2574)
    assert shapes["shoulders"] == Box(0.2035, 0.4031, 0.1515)
    assert shapes["head"] == Sphere(0.13)
    centre = dict(zip([b.name for b in human.bodies], human.body_poses(np.zeros(12))[:, :3, 3], strict=True))
    np.testing.assert_allclose(centre["pelvis"], (0.0276, -0.003, -0.0373), atol=1e-6)
    np.testing.assert_allclose(centre["torso"], (0.0265, -0.003, 0.2428), atol=1e-6)
    np.testing.assert_allclose(centre["shoulders"], (0.0106, -0.0044, 0.4474), atol=1e-6)
    np.testing.assert_allclose(centre["neck"], (0.0138, -0.0044, 0.5402), atol=1e-6)


@pytest.mark.parametrize("trans", [-0.06, 0.06, 0.2, 0.22, 0.32])
def test_the_right_arm_is_covered_from_shoulder_to_fingertips_however_long(human: HumanModel, trans: float) -> None:
    q = np.zeros(12)
    q[[7, 8, 9, 10, 11]] = (0.9, 0.4, 0.2, trans, 0.8)
    p = human.forward(q)
    tip = p["right_wrist"] + (p["right_palm"] - p["right_wrist"]) / 0.15 * 0.2159  # fingertips 0.216 m on
    bones = [p["right_shoulder"], p["right_elbow"], p["right_wrist"], tip]
    along = np.linspace(0, 1, 200)[:, None]
    for a, b in pairwise(bones):
        assert distances_m(human, q, a + along * (b - a)).max() < 0.0


def test_legs_and_left_arm_are_covered(human: HumanModel) -> None:
    p = human.forward(np.zeros(12))
    along = np.linspace(0, 1, 200)[:, None]
    legs = [(f"{side}_hip", f"{side}_knee", f"{side}_foot") for side in ("left", "right")]
    for chain in (("left_shoulder", "left_elbow", "left_wrist", "left_palm"), *legs):
        for a, b in pairwise(chain):
            assert distances_m(human, np.zeros(12), p[a] + along * (p[b] - p[a])).max() < 0.0
