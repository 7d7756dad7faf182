"""What the covers call free is free: compared with coal on the robot's meshes; the verdict is the smaller of both."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arm_clearance import nearest_approach
from collision_library import Transform, coal
from pr2 import LEFT_ARM_JOINTS, LEFT_ARM_RAD, RIGHT_ARM_JOINTS, TORSO_LIFT_M, URDF, pr2_arm

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.chain import BodyBoxes
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.robot.clearance import SelfCollision, nearest_approaches, nearest_contacts, shoulder_approach
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.robot.scene_file import scene_names

ARM = pr2_arm()
ITSELF = SelfCollision.for_arm(ARM)
PAN, LIFT, UPPER_ARM, ELBOW, FOREARM, WRIST, HAND = range(7)


def random_configurations(n: int, seed: int = 0) -> np.ndarray:
    chain = ARM.chain
    lower, upper = np.where(chain.continuous, -np.pi, chain.lower), np.where(chain.continuous, np.pi, chain.upper)
    return np.random.default_rng(seed).uniform(lower, upper, (n, 7))


@lru_cache(maxsize=1)
def reference() -> tuple[Any, Any, dict[int, int], list[int]]:
    """Pinocchio's model and meshes, the arm's joint (0..6) of each moving mesh, and the meshes that stand still."""
    model = pin.buildModelFromUrdf(str(URDF))
    folders = [str(parent) for parent in URDF.parents]
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION, package_dirs=folders)
    arm = [model.getJointId(name) for name in RIGHT_ARM_JOINTS]
    moving, fixed = {}, []
    for k, item in enumerate(geometry.geometryObjects):
        owners = [arm.index(joint) for joint in model.supports[item.parentJoint] if joint in arm]
        if owners:
            moving[k] = owners[-1]
        else:
            fixed.append(k)
    return model, geometry, moving, fixed


def placed_meshes(q: np.ndarray) -> Any:
    """Return pinocchio's geometry data with the right arm at `q`, the rest as in ARM."""
    model, geometry, _, _ = reference()
    full = pin.neutral(model)
    named = dict(zip((*RIGHT_ARM_JOINTS, *LEFT_ARM_JOINTS), (*q, *LEFT_ARM_RAD), strict=True))
    named["torso_lift_joint"] = TORSO_LIFT_M
    for name, value in named.items():
        joint = model.joints[model.getJointId(name)]
        full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    data, placed = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, placed, full)
    return placed


def touch(placed: Any, a: int, b: int) -> bool:
    _, geometry, _, _ = reference()
    poses = [Transform(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (a, b)]
    shapes = [geometry.geometryObjects[k].geometry for k in (a, b)]
    return coal.collide(shapes[0], poses[0], shapes[1], poses[1], coal.CollisionRequest(), coal.CollisionResult()) > 0


def distance_m(placed: Any, a: int, b: int) -> float:
    _, geometry, _, _ = reference()
    poses = [Transform(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (a, b)]
    shapes = [geometry.geometryObjects[k].geometry for k in (a, b)]
    return coal.distance(shapes[0], poses[0], shapes[1], poses[1], coal.DistanceRequest(), coal.DistanceResult())


def own_pairs(*, everything: bool) -> list[tuple[int, int]]:
    """Pairs of meshes two joints or more apart: all of them, or those that are compared."""
    _, _, moving, _ = reference()
    pairs = [(a, b) for a, i in moving.items() for b, j in moving.items() if j > i + 1]
    return pairs if everything else [(a, b) for a, b in pairs if (link_of(a), link_of(b)) in ITSELF.pairs]


def link_of(mesh: int) -> str:
    model, geometry, _, _ = reference()
    return str(model.frames[geometry.geometryObjects[mesh].parentFrame].name)


def test_no_collision_of_the_meshes_is_missed_and_few_free_ones_are_refused() -> None:
    configurations = random_configurations(600)
    clearance = ITSELF.clearance(configurations)
    pairs = own_pairs(everything=False)
    collides = np.zeros(len(configurations), dtype=bool)
    for i, q in enumerate(configurations):
        placed = placed_meshes(q)
        collides[i] = any(touch(placed, a, b) for a, b in pairs)
    # Measured over 1500 configurations: 5.7 % collide, 2.6 % of the free ones are refused.
    assert 0.03 < collides.mean() < 0.09
    assert clearance[collides].max() < 0.0, "not one collision is called free"
    assert (clearance[~collides] < 0.0).mean() < 0.06


def test_clearance_never_exceeds_the_meshes_distance() -> None:
    configurations = random_configurations(40, seed=1)
    for q, clearance in zip(configurations, ITSELF.clearance(configurations), strict=True):
        placed = placed_meshes(q)
        mesh = min(distance_m(placed, a, b) for a, b in own_pairs(everything=False))
        assert mesh - 0.15 < clearance <= mesh + 1e-9


def test_pairs_that_are_not_compared_cannot_tell_anything() -> None:
    """What is left out either is built to touch (shoulder inside the turret) or never does."""
    _, _, moving, _ = reference()
    compared = {(moving[a], moving[b]) for a, b in own_pairs(everything=False)}
    assert {(PAN, FOREARM), (PAN, WRIST), (PAN, HAND), (LIFT, HAND), (UPPER_ARM, HAND)} <= compared
    left_out = [(a, b) for a, b in own_pairs(everything=True) if (moving[a], moving[b]) not in compared]
    assert {(moving[a], moving[b]) for a, b in left_out} == {
        (PAN, UPPER_ARM),
        (UPPER_ARM, FOREARM),
        (ELBOW, WRIST),
        (ELBOW, HAND),
        (FOREARM, HAND),
    }
    for q in random_configurations(200, seed=2):
        placed = placed_meshes(q)
        for a, b in left_out:
            if (moving[a], moving[b]) != (PAN, UPPER_ARM):
                assert not touch(placed, a, b)


def test_the_robots_other_bodies_are_covered_too() -> None:
    """Collisions of upper arm to fingers with base, torso, head and left arm; the shoulder has none."""
    _, _, moving, fixed = reference()
    configurations = random_configurations(400, seed=3)
    nearest = nearest_approaches(ARM, ARM.spheres(), ARM.fixed_obstacles, configurations)
    clearance = np.array([approach.clearance_m for approach in nearest])
    collides = np.zeros(len(configurations), dtype=bool)
    for i, q in enumerate(configurations):
        placed = placed_meshes(q)
        collides[i] = any(touch(placed, a, b) for a, j in moving.items() if j >= UPPER_ARM for b in fixed)
        assert not any(touch(placed, a, b) for a, j in moving.items() if j < UPPER_ARM for b in fixed)
    # Measured over 1000 configurations: 10.8 % collide, 7.3 % of the free ones are refused.
    assert 0.06 < collides.mean() < 0.16
    assert clearance[collides].max() < 0.0
    assert (clearance[~collides] < 0.0).mean() < 0.12


@pytest.mark.parametrize("name", scene_names())
def test_starts_and_goals_are_far_from_self_collision(name: str) -> None:
    scene = load_scene(name)
    q = np.concatenate([scene.start[None], *(goal.configurations for goal in scene.goals)])
    assert SelfCollision.for_arm(scene.arm).clearance(q).min() > 0.02


def test_nearest_names_the_links_that_would_touch() -> None:
    # Upper arm back and down, elbow bent: the forearm lies against the turret.
    configurations = random_configurations(600)
    clearance = ITSELF.clearance(configurations)
    worst = ITSELF.nearest(configurations[np.argmin(clearance)])
    assert worst.clearance_m == pytest.approx(clearance.min())
    assert worst.obstacle == "r_shoulder_pan_link"
    assert worst.link.startswith(("r_forearm", "r_wrist", "r_gripper"))
    for q, expected in zip(configurations[:20], clearance[:20], strict=True):
        assert ITSELF.nearest(q).clearance_m == pytest.approx(expected)


def test_clearance_does_not_depend_on_where_the_robot_stands() -> None:
    elsewhere = pr2_arm(planar_pose(1.0, -2.0, 0.0, 0.7), torso_lift_joint=0.1)
    assert SelfCollision.for_arm(elsewhere) is SelfCollision.for_arm(ARM)
    q = random_configurations(1)[0]
    turned = ITSELF.clearance(q + 0.1 * np.eye(7)[PAN])
    np.testing.assert_allclose(turned, ITSELF.clearance(q), atol=1e-12)


def test_shapes() -> None:
    q = random_configurations(100)
    assert ITSELF.clearance(q.reshape(4, 25, 7)).shape == (4, 25)
    assert ITSELF.clearance(q[0]).shape == ()
    assert ITSELF.clearance(q[:0]).shape == (0,)
    np.testing.assert_array_equal(ITSELF.clearance(q.reshape(4, 25, 7)).ravel(), ITSELF.clearance(q))


def test_configurations_of_another_shape_are_refused() -> None:
    for q in (np.zeros(6), np.zeros((2, 8)), np.full(7, np.nan), 1.0):
        with pytest.raises(ArrayError, match="configurations"):
            ITSELF.clearance(q)
    with pytest.raises(ArrayError, match="configuration"):
        ITSELF.nearest(np.zeros((2, 7)))


def test_boxes_without_volume_are_refused() -> None:
    with pytest.raises(ArrayError, match="half_m: wanted positive"):
        BodyBoxes(np.array([0]), np.zeros((1, 3)), np.array([[1.0, 0.0, 1.0]]))
    with pytest.raises(ArrayError, match="joint index"):
        BodyBoxes(np.array([-1]), np.zeros((1, 3)), np.ones((1, 3)))
    with pytest.raises(ArrayError, match="shape"):
        BodyBoxes(np.array([0, 1]), np.zeros((1, 3)), np.ones((1, 3)))


def test_inner_boxes_fill_the_meshes_of_turret_shoulder_and_upper_arm() -> None:
    _, geometry, moving, _ = reference()
    model = reference()[0]
    q = random_configurations(1)[0]
    placed, boxes, poses = placed_meshes(q), ARM.robot.inner_boxes[0], ARM.chain.link_poses(q)
    checked = set()
    for k, joint in moving.items():
        if joint > UPPER_ARM:
            continue
        corners = np.array(geometry.geometryObjects[k].geometry.vertices())
        world = corners @ placed.oMg[k].rotation.T + placed.oMg[k].translation
        local = (world - poses[joint, :3, 3]) @ poses[joint, :3, :3]
        mine = boxes.link == joint
        beyond = (np.abs(local[:, None] - boxes.local_m[mine]) - boxes.half_m[mine]).max(axis=2)
        assert beyond.min(axis=1).max() <= 1e-9, model.frames[geometry.geometryObjects[k].parentFrame].name
        checked.add(joint)
    assert checked == {PAN, LIFT, UPPER_ARM}


SCENE = load_scene("face_to_face")
SCENE_ARM = SCENE.arm
LOWER = np.where(SCENE_ARM.chain.continuous, -np.pi, SCENE_ARM.chain.lower)
UPPER = np.where(SCENE_ARM.chain.continuous, np.pi, SCENE_ARM.chain.upper)
DRAWN = np.random.default_rng(4).uniform(LOWER, UPPER, (400, 7))


def test_the_verdict_is_the_smaller_of_both() -> None:
    contacts = nearest_contacts(SCENE_ARM, SCENE.obstacles, DRAWN)
    inside = SelfCollision.for_arm(SCENE_ARM).clearance(DRAWN)
    outside = nearest_approaches(SCENE_ARM, SCENE_ARM.spheres(), (*SCENE.obstacles, *SCENE_ARM.fixed_obstacles), DRAWN)
    for contact, own, other in zip(contacts, inside, outside, strict=True):
        assert contact.clearance_m == pytest.approx(min(float(own), other.clearance_m))
    inner = {link for link, _ in SelfCollision.for_arm(SCENE_ARM).pairs}
    against_itself = [contact for contact in contacts if contact.obstacle in inner]
    assert against_itself
    assert len(against_itself) < len(contacts)


def test_without_obstacles_the_robot_is_still_looked_at() -> None:
    contact = nearest_contacts(SCENE_ARM, (), SCENE.start[None])[0]
    assert contact.clearance_m > 0.0
    assert contact.obstacle in {obstacle.name for obstacle in SCENE_ARM.fixed_obstacles} | set(SCENE_ARM.link_names)


def test_many_at_once_are_what_each_is_alone() -> None:
    together = nearest_approaches(SCENE_ARM, SCENE_ARM.spheres(), SCENE.obstacles, DRAWN[:20])
    assert together == tuple(nearest_approach(SCENE_ARM, SCENE_ARM.spheres(), SCENE.obstacles, q) for q in DRAWN[:20])
    assert nearest_approaches(SCENE_ARM, SCENE_ARM.spheres(), SCENE.obstacles, DRAWN[:0]) == ()
    with pytest.raises(ArrayError, match="obstacle"):
        nearest_approaches(SCENE_ARM, SCENE_ARM.spheres(), (), DRAWN[:1])
    with pytest.raises(ArrayError, match="configurations"):
        nearest_contacts(SCENE_ARM, SCENE.obstacles, SCENE.start)


@pytest.mark.parametrize("gap_m", [0.0, 0.15, 0.4])
def test_the_shoulders_reach_is_never_overstated_nor_understated_by_much(gap_m: float) -> None:
    arm = pr2_arm()
    pan = arm.chain.joint_origin_m[0] + arm.chain.T_world_root[:3, 3]
    # The turret's mesh ends 0.229 m in front of the pan axis.
    post = Obstacle("post", Box(0.1, 0.1, 1.5), planar_pose(pan[0] + 0.229 + gap_m + 0.05, pan[1], pan[2]))
    nearest = shoulder_approach(arm, [post])
    assert nearest is not None
    assert nearest.obstacle == "post"
    assert nearest.link in arm.link_names[:2]
    assert gap_m - 0.15 < nearest.clearance_m <= gap_m


def test_the_arms_own_angles_do_not_matter_for_its_shoulder() -> None:
    nearest = shoulder_approach(SCENE_ARM, SCENE.obstacles)
    assert nearest is not None
    assert nearest.obstacle == "table"
    # Exact distance of the turret's mesh from the table, over all angles: 0.314 m.
    assert 0.2 < nearest.clearance_m < 0.314
