"""Clearances by spheres against the meshes' own distances and the published ones; distances between arm and person."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from arm_clearance import arm_clearance, nearest_approach
from collision_library import Transform, coal
from human_distance import least_distance_m
from pr2 import RIGHT_ARM_JOINTS, URDF
from small_library import REST

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.clearance import SeparationMeter
from humanpred_ros.robot.scene import Scene, load_scene

SCENES = {name: load_scene(name) for name in ("face_to_face", "side_by_side")}
FACE, SIDE = SCENES["face_to_face"], SCENES["side_by_side"]


def mesh_clearance_m(scene: Scene, obstacle: Obstacle, q: np.ndarray, first_joint: int) -> float:
    """Exact distance from the arm's collision meshes, from one joint outwards, to the table or an object."""
    model = pin.buildModelFromUrdf(str(URDF))
    folders = [str(parent) for parent in URDF.parents]
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION, package_dirs=folders)
    data, full = model.createData(), pin.neutral(model)
    for name, value in zip(
        ("torso_lift_joint", *RIGHT_ARM_JOINTS), (scene.arm.standing["torso_lift_joint"], *q), strict=True
    ):
        joint = model.joints[model.getJointId(name)]
        full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    pin.forwardKinematics(model, data, full)
    half = obstacle.shape.half_m
    other = (
        coal.Box(*np.multiply(2.0, half)) if isinstance(obstacle.shape, Box) else coal.Cylinder(half[0], 2.0 * half[2])
    )
    T_other = Transform(obstacle.T_world_shape[:3, :3].copy(), obstacle.T_world_shape[:3, 3].copy())
    outer = {model.getJointId(name) for name in RIGHT_ARM_JOINTS[first_joint:]}
    least = np.inf
    for item in geometry.geometryObjects:
        if outer & set(model.supports[item.parentJoint]):
            T = scene.T_world_base @ (data.oMi[item.parentJoint] * item.placement).homogeneous
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            pose = Transform(T[:3, :3].copy(), T[:3, 3].copy())
            least = min(least, coal.distance(item.geometry, pose, other, T_other, request, result))
    return least


@pytest.mark.parametrize(
    ("scene", "which", "table_m"),
    [(FACE, "red", 0.071), (FACE, "blue", 0.131), (SIDE, "start", 0.163), (SIDE, "red", 0.129)],
)
def test_meshes_clear_the_table_by_the_published_distance(scene: Scene, which: str, table_m: float) -> None:
    q = scene.start if which == "start" else scene.goal(which).configuration
    # 0.0005 m is the rounding of the published figures (docs/papers.md, P1 scenes).
    assert mesh_clearance_m(scene, scene.obstacles[0], q, first_joint=0) == pytest.approx(table_m, abs=5.5e-4)


@pytest.mark.parametrize("scene", [FACE, SIDE])
def test_spheres_never_promise_more_room_than_the_meshes_have(scene: Scene) -> None:
    spheres = scene.arm.spheres()
    for q in (scene.start, *(goal.configuration for goal in scene.goals)):
        for obstacle in scene.obstacles:
            mesh = mesh_clearance_m(scene, obstacle, q, first_joint=2)
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
    post = Obstacle("post", Box(0.02, 0.02, 0.02), planar_pose(*tool))
    nearest = nearest_approach(arm, spheres, [FACE.obstacles[0], post], FACE.start)
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


HUMAN = HumanModel.kinect12()


@cache
def scene() -> Scene:
    return load_scene("side_by_side")


def moments(count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Postures (T, 12) of people around the tool, and configurations (T, 7) around the start."""
    rng = np.random.default_rng(seed)
    postures = np.repeat(REST[None], count, axis=0)
    tool = scene().arm.chain.tool_pose(scene().start)[:2, 3]
    postures[:, :2] = tool - scene().T_world_human[:2, 3] + rng.uniform(-0.9, 0.9, (count, 2))
    postures[:, 3] = rng.uniform(-3.0, 3.0, count)
    return postures, scene().start + rng.uniform(-0.4, 0.4, (count, 7))


def meter(postures: FloatArray) -> SeparationMeter:
    return SeparationMeter(scene().arm, HUMAN, scene().T_world_human, postures)


def test_is_the_models_distance() -> None:
    postures, q = moments(12)
    found = meter(postures).measure(q)
    spheres, T = scene().arm.spheres(), scene().T_world_human
    for k in range(len(q)):
        local = (spheres.world_m(scene().arm.chain, q[k]) - T[:3, 3]) @ T[:3, :3]
        assert found.distance_m[k] == pytest.approx(least_distance_m(HUMAN, postures[k], local, spheres.radius_m))
    assert found.least_m == found.distance_m.min()
    assert found.distance_m.min() < 0.0 < found.distance_m.max()


def test_names_the_parts_that_are_closest() -> None:
    postures, q = moments(6, seed=1)
    found = meter(postures).measure(q)
    spheres, T = scene().arm.spheres(), scene().T_world_human
    poses = HUMAN.body_poses(postures)
    for k in range(len(q)):
        centre = spheres.world_m(scene().arm.chain, q[k])[found.part[k]]
        pose = T @ poses[k, found.body[k]]
        local = (centre - pose[:3, 3]) @ pose[:3, :3]
        alone = HUMAN.bodies[int(found.body[k])].shape.distance_m(local[None])[0] - spheres.radius_m[found.part[k]]
        assert alone == pytest.approx(found.distance_m[k])


def test_spheres_are_never_farther_than_the_surface() -> None:
    postures, q = moments(30, seed=2)
    spheres, surface = meter(postures).measure(q), meter(postures).measure_surface(q)
    assert (spheres.distance_m <= surface.distance_m + 1e-9).all()


def test_wrong_shapes_are_refused() -> None:
    postures, q = moments(4)
    with pytest.raises(ArrayError, match="arm configurations"):
        meter(postures).measure(q[:3])
    with pytest.raises(HumanModelError):
        meter(postures[:, :5])
