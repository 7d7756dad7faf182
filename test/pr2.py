"""The PR2 that most tests plan for, and its joints by name."""

from __future__ import annotations

from typing import Any

import numpy as np

from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.robot import load_robot

PR2 = load_robot("pr2")
URDF = PR2.urdf
RIGHT_ARM_JOINTS = PR2.joint_names
LEFT_ARM_JOINTS = PR2.file.scene_keys["left_arm"]
LEFT_ARM_RAD = tuple(PR2.standing[name] for name in LEFT_ARM_JOINTS)
TORSO_LIFT_M = PR2.standing["torso_lift_joint"]


def pr2_arm(T_world_base: Any = None, **standing: float) -> Arm:
    """Return the right arm of a PR2 that stands somewhere, with joints that stand elsewhere than in P1's scenes."""
    return Arm(PR2, np.eye(4) if T_world_base is None else T_world_base, standing)
