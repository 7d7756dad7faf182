"""The PR2's arm agrees with pinocchio and with its own meshes, which are read here a second time."""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pr2 import LEFT_ARM_JOINTS, LEFT_ARM_RAD, RIGHT_ARM_JOINTS, TORSO_LIFT_M, URDF, pr2_arm
from scipy.spatial import ConvexHull, cKDTree

from humanpred_ros.errors import GoalUnreachableError, RobotError, SceneError
from humanpred_ros.geometry.solids import planar_pose
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.robot_file import find_source

pytestmark = pytest.mark.core

T_WORLD_BASE = planar_pose(0.828, -1.336, 0.0, np.deg2rad(151.812))
ARM = pr2_arm(T_WORLD_BASE)
POINTS = ARM.body_points(0.04)
UPPER_ARM = RIGHT_ARM_JOINTS.index("r_upper_arm_roll_joint")

CONFIGURATION = st.builds(
    lambda seed: np.random.default_rng(seed).uniform(
        np.where(ARM.chain.continuous, -7.0, ARM.chain.lower), np.where(ARM.chain.continuous, 7.0, ARM.chain.upper)
    ),
    st.integers(0, 100_000),
)


@lru_cache(maxsize=1)
def reference() -> tuple[Any, Any, Any]:
    """Pinocchio's own model, collision geometry and working memory."""
    model = pin.buildModelFromUrdf(str(URDF))
    folders = [str(parent) for parent in URDF.parents]
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION, package_dirs=folders)
    return model, geometry, model.createData()


def placed(q: np.ndarray) -> Any:
    """Return pinocchio's data with the right arm at `q` and the rest as in ARM, base at the origin."""
    model, _, data = reference()
    full = pin.neutral(model)
    named = dict(zip((*RIGHT_ARM_JOINTS, *LEFT_ARM_JOINTS), (*q, *LEFT_ARM_RAD), strict=True))
    named["torso_lift_joint"] = TORSO_LIFT_M
    for name, value in named.items():
        joint = model.joints[model.getJointId(name)]
        full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    pin.framesForwardKinematics(model, data, full)
    return data


def mesh_corners_m(q: np.ndarray, *, moving: bool) -> np.ndarray:
    """World positions of the collision meshes' corners: of upper arm to fingers, or of what stands still."""
    model, geometry, _ = reference()
    data = placed(q)
    arm = {model.getJointId(name) for name in RIGHT_ARM_JOINTS}
    body = {model.getJointId(name) for name in RIGHT_ARM_JOINTS[UPPER_ARM:]}
    corners = []
    for item in geometry.geometryObjects:
        supports = set(model.supports[item.parentJoint])
        if (supports & body if moving else not supports & arm) and hasattr(item.geometry, "vertices"):
            T = T_WORLD_BASE @ (data.oMi[item.parentJoint] * item.placement).homogeneous
            corners.append(np.array(item.geometry.vertices()) @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(corners)


@given(CONFIGURATION)
def test_chain_agrees_with_pinocchio(q: np.ndarray) -> None:
    model, _, _ = reference()
    data = placed(q)
    for joint, pose in zip(RIGHT_ARM_JOINTS, ARM.chain.link_poses(q), strict=True):
        expected = T_WORLD_BASE @ data.oMi[model.getJointId(joint)].homogeneous
        np.testing.assert_allclose(pose, expected, atol=1e-9)
    expected = T_WORLD_BASE @ data.oMf[model.getFrameId(ARM.tool_frame)].homogeneous
    np.testing.assert_allclose(ARM.chain.tool_pose(q), expected, atol=1e-9)


def test_chain_carries_the_limits_of_the_urdf() -> None:
    chain = ARM.chain
    assert chain.joint_names == RIGHT_ARM_JOINTS
    np.testing.assert_array_equal(chain.joint_axis, np.eye(3)[[2, 1, 0, 1, 0, 1, 0]])
    assert chain.continuous.tolist() == [False, False, False, False, True, False, True]
    np.testing.assert_allclose(chain.lower[:4], [-2.2853981634, -0.5236, -3.9, -2.3213])
    np.testing.assert_allclose(chain.upper[:4], [0.714601836603, 1.3963, 0.8, 0.0])
    np.testing.assert_allclose(chain.velocity_limit, [2.088, 2.082, 3.27, 3.3, 3.6, 3.078, 3.6])
    assert ARM.link_names[0] == "r_shoulder_pan_link"
    assert ARM.link_names[-1] == "r_wrist_roll_link"


@settings(max_examples=20)
@given(CONFIGURATION)
def test_spheres_cover_the_meshes_wherever_the_arm_is(q: np.ndarray) -> None:
    spheres = ARM.spheres()
    corners = mesh_corners_m(q, moving=True)
    apart = np.linalg.norm(corners[:, None] - spheres.world_m(ARM.chain, q), axis=2)
    assert (apart - spheres.radius_m).min(axis=1).max() <= 1e-9


def test_spheres_do_not_stick_out_far_and_are_few() -> None:
    q = np.zeros(7)
    model, geometry, _ = reference()
    data, spheres = placed(q), ARM.spheres()
    body = {model.getJointId(name) for name in RIGHT_ARM_JOINTS[UPPER_ARM:]}
    directions = np.random.default_rng(0).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    rim = spheres.world_m(ARM.chain, q)[:, None] + spheres.radius_m[:, None, None] * directions
    rim = rim.reshape(-1, 3)
    outside = np.ones(len(rim), dtype=bool)
    clouds, weights = [], np.random.default_rng(1).dirichlet([1, 1, 1], 30)
    for item in geometry.geometryObjects:
        if set(model.supports[item.parentJoint]) & body:
            triangles = triangles_m(item, T_WORLD_BASE @ (data.oMi[item.parentJoint] * item.placement).homogeneous)
            faces = ConvexHull(triangles.reshape(-1, 3)).equations
            outside &= (rim @ faces[:, :3].T + faces[:, 3] > 0.0).any(axis=1)
            clouds.append(np.einsum("pc,fcx->fpx", weights, triangles).reshape(-1, 3))
    # Distance to a dense cloud on the triangles: more than that to the triangles by a few millimetres.
    overshoot = np.where(outside, cKDTree(np.concatenate(clouds)).query(rim)[0], 0.0)
    assert overshoot.max() < 0.06
    assert overshoot.mean() < 0.01
    assert len(spheres) < 40
    assert spheres.link.min() == UPPER_ARM


def triangles_m(item: Any, T: np.ndarray) -> np.ndarray:
    shape = item.geometry
    corners = np.array(shape.vertices()) @ T[:3, :3].T + T[:3, 3]
    return corners[[[shape.tri_indices(f)[k] for k in range(3)] for f in range(shape.num_tris)]]


@settings(max_examples=20)
@given(CONFIGURATION)
def test_body_points_leave_no_gap_on_the_meshes(q: np.ndarray) -> None:
    points = POINTS
    corners = mesh_corners_m(q, moving=True)
    gap = np.linalg.norm(corners[:, None] - points.world_m(ARM.chain, q), axis=2).min(axis=1)
    assert gap.max() < 0.04 + 1e-6


def test_body_points_lie_on_the_surface_and_come_in_joint_order() -> None:
    points = ARM.body_points()
    assert 100 < len(points) < 300
    assert (np.diff(points.link) >= 0).all()
    assert set(points.link) == set(range(UPPER_ARM, 7))
    for link in set(points.link):
        own = points.local_m[points.link == link]
        apart = np.linalg.norm(own[:, None] - own, axis=2)[~np.eye(len(own), dtype=bool)]
        assert apart.min() >= 0.04 - 1e-6
    spheres = ARM.spheres()
    depth = spheres.radius_m - np.linalg.norm(points.local_m[:, None] - spheres.local_m, axis=2)
    assert np.where(points.link[:, None] == spheres.link, depth, -np.inf).max(axis=1).min() >= -1e-9
    # The fingertips are 0.199 m from the wrist, ahead of the tool frame.
    assert points.local_m[:, 0][points.link == 6].max() == pytest.approx(0.199, abs=0.005)
    assert len(ARM.body_points(0.03)) > len(points) > len(ARM.body_points(0.05))


def test_points_and_spheres_are_the_same_for_every_placement() -> None:
    other = pr2_arm(planar_pose(-3.0, 2.0, 0.0, 1.0), torso_lift_joint=0.1)
    np.testing.assert_array_equal(other.body_points().local_m, ARM.body_points().local_m)
    np.testing.assert_array_equal(other.spheres().local_m, ARM.spheres().local_m)


def test_fixed_obstacles_cover_the_bodies_that_stand_still() -> None:
    corners = mesh_corners_m(np.zeros(7), moving=False)
    distance = np.min([obstacle.distance_m(corners) for obstacle in ARM.fixed_obstacles], axis=0)
    assert distance.max() <= 1e-9
    names = {obstacle.name for obstacle in ARM.fixed_obstacles}
    assert {"base_link", "torso_lift_link", "head_tilt_link", "l_forearm_link", "laser_tilt_mount_link"} <= names
    assert not any(name.startswith("r_") for name in names)


def test_fixed_obstacles_follow_base_torso_and_left_arm() -> None:
    def centre(arm: Arm, name: str) -> np.ndarray:
        boxes = [obstacle for obstacle in arm.fixed_obstacles if obstacle.name == name]
        return np.mean([box.T_world_shape[:3, 3] for box in boxes], axis=0)

    here = pr2_arm()
    lower = pr2_arm(torso_lift_joint=0.02)
    moved = pr2_arm(planar_pose(1.0, 2.0))
    waving = pr2_arm(**dict.fromkeys(LEFT_ARM_JOINTS, 0.0))
    np.testing.assert_allclose(centre(here, "head_pan_link") - centre(lower, "head_pan_link"), [0, 0, 0.29], atol=1e-9)
    np.testing.assert_allclose(centre(here, "base_link"), centre(lower, "base_link"))
    np.testing.assert_allclose(centre(moved, "base_link") - centre(here, "base_link"), [1, 2, 0], atol=1e-9)
    assert np.linalg.norm(centre(waving, "l_forearm_link") - centre(here, "l_forearm_link")) > 0.1


@given(CONFIGURATION)
def test_arm_never_leaves_its_reach(q: np.ndarray) -> None:
    centre, radius = ARM.reach
    spheres = ARM.spheres()
    out = np.linalg.norm(spheres.world_m(ARM.chain, q) - centre, axis=1) + spheres.radius_m
    assert out.max() <= radius + 1e-9


@given(CONFIGURATION, CONFIGURATION)
def test_difference_leads_to_the_same_place_the_shorter_way(a: np.ndarray, b: np.ndarray) -> None:
    change = ARM.difference(a, b)
    np.testing.assert_allclose(ARM.chain.tool_pose(a + change), ARM.chain.tool_pose(b), atol=1e-9)
    assert (np.abs(change[ARM.chain.continuous]) <= np.pi + 1e-12).all()
    np.testing.assert_allclose(change[~ARM.chain.continuous], (b - a)[~ARM.chain.continuous])


@given(CONFIGURATION, CONFIGURATION)
def test_configuration_distance_is_symmetric_and_blind_to_full_turns(a: np.ndarray, b: np.ndarray) -> None:
    there = float(ARM.configuration_distance(a, b))
    turned = b + 2.0 * np.pi * ARM.chain.continuous
    assert there == pytest.approx(float(ARM.configuration_distance(b, a)), abs=1e-9)
    assert there == pytest.approx(float(ARM.configuration_distance(a, turned)), abs=1e-9)
    assert ARM.configuration_distance(a, a) == 0.0


def test_configuration_distance_weighs_each_joint() -> None:
    steps = 0.1 * np.eye(7)
    np.testing.assert_allclose(
        ARM.configuration_distance(np.zeros((7, 7)), steps), 0.1 * np.array([0.54, 0.19, 0.49, 0.14, 0.37, 0.06, 0.14])
    )


def test_configuration_outside_the_limits_names_joint_value_and_limits() -> None:
    q = np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    with pytest.raises(GoalUnreachableError, match=r"goal 'x'.*r_elbow_flex_joint.*-2\.3213 to 0\.0000.*0\.2000"):
        ARM.check_configuration(q, "goal 'x'")
    with pytest.raises(GoalUnreachableError, match="finite"):
        ARM.check_configuration([np.nan] * 7, "goal 'x'")
    with pytest.raises(GoalUnreachableError, match="shape"):
        ARM.check_configuration(np.zeros(6), "goal 'x'")
    far_turn = np.array([0.0, 0.0, 0.0, 0.0, 50.0, 0.0, -50.0])
    np.testing.assert_array_equal(ARM.check_configuration(far_turn, "turned"), far_turn)


def test_impossible_robots_are_refused() -> None:
    with pytest.raises(SceneError, match="torso_lift_joint"):
        pr2_arm(torso_lift_joint=0.5)
    with pytest.raises(SceneError, match="l_elbow_flex_joint"):
        pr2_arm(**dict.fromkeys(LEFT_ARM_JOINTS, 0.5))
    with pytest.raises(SceneError, match="robot base"):
        pr2_arm(np.zeros(3))
    with pytest.raises(SceneError, match="r_elbow_flex_joint, which is planned for"):
        pr2_arm(r_elbow_flex_joint=0.0)


def test_urdf_is_found_below_a_ros_prefix_or_its_absence_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "share" / "example-robot-data" / "robots" / "pr2_description" / "urdf" / "pr2.urdf"
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "empty"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    with pytest.raises(RobotError, match="pip install example-robot-data"):
        find_source("example-robot-data:pr2", tmp_path, ".urdf")
    elsewhere.parent.mkdir(parents=True)
    elsewhere.write_text("<robot/>")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert find_source("example-robot-data:pr2", tmp_path, ".urdf") == elsewhere
