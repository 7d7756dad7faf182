"""Clearances by spheres, against the meshes' own distances and the published ones."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.shapes import Box, Obstacle, planar_pose
from humanpred_ros.geometry.urdf import find_pr2_urdf
from humanpred_ros.robot.clearance import arm_clearance, nearest_approach
from humanpred_ros.robot.pr2 import RIGHT_ARM_JOINTS
from humanpred_ros.robot.scene import Scene, load_scene

SCENES = {name: load_scene(name) for name in ("face_to_face", "side_by_side")}
FACE, SIDE = SCENES["face_to_face"], SCENES["side_by_side"]


def mesh_clearance_m(scene: Scene, shape: Any, q: np.ndarray, first_joint: int) -> float:
    """Exact distance from the arm's collision meshes, from one joint outwards, to the table or an object."""
    model = pin.buildModelFromUrdf(str(find_pr2_urdf()))
    folders = [str(parent) for parent in find_pr2_urdf().parents]
    geometry = pin.buildGeomFromUrdf(model, str(find_pr2_urdf()), pin.GeometryType.COLLISION, package_dirs=folders)
    data, full = model.createData(), pin.neutral(model)
    for name, value in zip(("torso_lift_joint", *RIGHT_ARM_JOINTS), (scene.torso_lift_m, *q), strict=True):
        joint = model.joints[model.getJointId(name)]
        full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    pin.forwardKinematics(model, data, full)
    if isinstance(shape, Box):
        other = coal.Box(*shape.size_m)
    else:
        other = coal.Cylinder(shape.radius_m, shape.height_m)
    T_other = coal.Transform3s(shape.T_world_shape[:3, :3].copy(), shape.T_world_shape[:3, 3].copy())
    outer = {model.getJointId(name) for name in RIGHT_ARM_JOINTS[first_joint:]}
    least = np.inf
    for item in geometry.geometryObjects:
        if outer & set(model.supports[item.parentJoint]):
            T = scene.T_world_base @ (data.oMi[item.parentJoint] * item.placement).homogeneous
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            pose = coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())
            least = min(least, coal.distance(item.geometry, pose, other, T_other, request, result))
    return least


@pytest.mark.parametrize(
    ("scene", "which", "table_m"),
    [(FACE, "red", 0.071), (FACE, "blue", 0.131), (SIDE, "start", 0.163), (SIDE, "red", 0.129)],
)
def test_meshes_clear_the_table_by_the_published_distance(scene: Scene, which: str, table_m: float) -> None:
    q = scene.start if which == "start" else scene.goal(which).configuration
    # 0.0005 m is the rounding of the published figures (facts section 5).
    assert mesh_clearance_m(scene, scene.table.shape, q, first_joint=0) == pytest.approx(table_m, abs=5.5e-4)


@pytest.mark.parametrize("scene", [FACE, SIDE])
def test_spheres_never_promise_more_room_than_the_meshes_have(scene: Scene) -> None:
    spheres = scene.arm.spheres()
    for q in (scene.start, *(goal.configuration for goal in scene.goals)):
        for obstacle in scene.obstacles:
            mesh = mesh_clearance_m(scene, obstacle.shape, q, first_joint=2)
            sphere = nearest_approach(scene.arm, spheres, [obstacle], q).clearance_m
            assert mesh - 0.045 <= sphere <= mesh + 1e-9, obstacle.name


@pytest.mark.parametrize("scene", [FACE, SIDE])
def test_field_and_exact_shapes_agree_along_a_trajectory(scene: Scene) -> None:
    q = np.linspace(scene.start, scene.goals[0].configuration, 12)
    field, spheres = scene.distance_field(), scene.arm.spheres()
    clearance = arm_clearance(scene.arm, spheres, field, q)
    assert clearance.shape == (12,)
    everything = (*scene.obstacles, *scene.arm.fixed_obstacles)
    exact = [nearest_approach(scene.arm, spheres, everything, one).clearance_m for one in q]
    np.testing.assert_allclose(clearance, exact, atol=field.resolution_m / 2)


def test_nearest_approach_names_link_and_obstacle() -> None:
    arm, spheres = FACE.arm, FACE.arm.spheres()
    tool = arm.chain.tool_pose(FACE.start)[:3, 3]
    post = Obstacle("post", Box(planar_pose(*tool), [0.02, 0.02, 0.02]))
    nearest = nearest_approach(arm, spheres, [FACE.table, post], FACE.start)
    assert (nearest.link, nearest.obstacle) == ("r_wrist_roll_link", "post")
    assert nearest.clearance_m < 0.0


def test_side_by_side_straight_line_hits_the_red_cup() -> None:
    """The scene needs a planner: going straight, the gripper sweeps through the cup beside the goal."""
    line = np.linspace(SIDE.start, SIDE.goal("red").configuration, 60)
    clearance = arm_clearance(SIDE.arm, SIDE.arm.spheres(), SIDE.distance_field(), line)
    assert clearance[[0, -1]].min() > 0.0
    assert clearance.min() < -0.02


def test_trajectories_of_another_shape_are_refused() -> None:
    field = SIDE.distance_field(0.1)
    for q in (np.zeros(7), np.zeros((3, 6)), np.full((3, 7), np.nan)):
        with pytest.raises(ArrayError, match="trajectory"):
            arm_clearance(SIDE.arm, SIDE.arm.spheres(), field, q)
