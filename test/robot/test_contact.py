"""One verdict over obstacles, the robot's other bodies and the arm itself."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.shapes import Box, Obstacle, planar_pose
from humanpred_ros.robot.clearance import nearest_approach, nearest_approaches
from humanpred_ros.robot.contact import nearest_contacts, shoulder_approach
from humanpred_ros.robot.pr2 import Pr2Arm
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.robot.self_collision import SelfCollision

SCENE = load_scene("face_to_face")
ARM = SCENE.arm
LOWER = np.where(ARM.chain.continuous, -np.pi, ARM.chain.lower)
UPPER = np.where(ARM.chain.continuous, np.pi, ARM.chain.upper)
DRAWN = np.random.default_rng(4).uniform(LOWER, UPPER, (400, 7))


def test_the_verdict_is_the_smaller_of_both() -> None:
    contacts = nearest_contacts(ARM, SCENE.obstacles, DRAWN)
    inside = SelfCollision.for_arm(ARM).clearance(DRAWN)
    outside = nearest_approaches(ARM, ARM.spheres(), (*SCENE.obstacles, *ARM.fixed_obstacles), DRAWN)
    for contact, own, other in zip(contacts, inside, outside, strict=True):
        assert contact.clearance_m == pytest.approx(min(float(own), other.clearance_m))
    against_itself = [contact for contact in contacts if contact.obstacle in ARM.link_names]
    assert against_itself
    assert len(against_itself) < len(contacts)


def test_without_obstacles_the_robot_is_still_looked_at() -> None:
    contact = nearest_contacts(ARM, (), SCENE.start[None])[0]
    assert contact.clearance_m > 0.0
    assert contact.obstacle in {obstacle.name for obstacle in ARM.fixed_obstacles} | set(ARM.link_names)


def test_many_at_once_are_what_each_is_alone() -> None:
    together = nearest_approaches(ARM, ARM.spheres(), SCENE.obstacles, DRAWN[:20])
    assert together == tuple(nearest_approach(ARM, ARM.spheres(), SCENE.obstacles, q) for q in DRAWN[:20])
    assert nearest_approaches(ARM, ARM.spheres(), SCENE.obstacles, DRAWN[:0]) == ()
    with pytest.raises(ArrayError, match="obstacle"):
        nearest_approaches(ARM, ARM.spheres(), (), DRAWN[:1])
    with pytest.raises(ArrayError, match="configurations"):
        nearest_contacts(ARM, SCENE.obstacles, SCENE.start)


@pytest.mark.parametrize("gap_m", [0.0, 0.15, 0.4])
def test_the_shoulders_reach_is_never_overstated_nor_understated_by_much(gap_m: float) -> None:
    arm = Pr2Arm(np.eye(4))
    pan = arm.chain.joint_origin_m[0] + arm.chain.T_world_root[:3, 3]
    # The turret's mesh ends 0.229 m in front of the pan axis.
    post = Obstacle("post", Box(planar_pose(pan[0] + 0.229 + gap_m + 0.05, pan[1], pan[2]), [0.1, 0.1, 1.5]))
    nearest = shoulder_approach(arm, [post])
    assert nearest.obstacle == "post"
    assert nearest.link in arm.link_names[:2]
    assert gap_m - 0.15 < nearest.clearance_m <= gap_m


def test_the_arms_own_angles_do_not_matter_for_its_shoulder() -> None:
    assert shoulder_approach(ARM, SCENE.obstacles).obstacle == "table"
    # Exact distance of the turret's mesh from the table, over all angles: 0.314 m.
    assert 0.2 < shoulder_approach(ARM, SCENE.obstacles).clearance_m < 0.314
