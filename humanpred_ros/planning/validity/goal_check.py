"""What a goal must be before anybody plans to it: within the joint limits and free, or refused by name."""

from __future__ import annotations

import numpy as np

from humanpred_ros.errors import GoalUnreachableError, PlanningError
from humanpred_ros.geometry.chain import KinematicChain
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.validity.motion_check import MotionChecker
from humanpred_ros.robot.goals import Goal

#: Limits are written with about ten digits, configurations with six, rad.
_LIMIT_TOLERANCE_RAD = 1e-6


def usable_configurations(goal: Goal, checker: MotionChecker) -> FloatArray:
    """Return the configurations (K, D) of a goal that an arm can rest at.

    Raises:
        GoalUnreachableError: if there are none, with the reason for each.
        PlanningError: for configurations of another arm.
    """
    usable, reasons = [], []
    wanted = ("K", checker.chain.n_joints)
    for q in checked(f"goal {goal.name}", goal.configurations, wanted, error=PlanningError):
        trouble = outside_limits(checker.chain, q) or checker.first_trouble_on_path(q[None])
        if trouble:
            reasons.append(str(trouble))
        else:
            usable.append(q)
    if not usable:
        raise GoalUnreachableError(
            f"goal {goal.name}: {'; '.join(dict.fromkeys(reasons))}; choose a configuration within the limits "
            "and clear of obstacles"
        )
    return np.array(usable)


def outside_limits(chain: KinematicChain, q: FloatArray) -> str:
    """Return which joint of a configuration (D,) is outside its limits; empty if none is."""
    for joint, value, low, high in zip(chain.joint_names, q, chain.lower, chain.upper, strict=True):
        if not low - _LIMIT_TOLERANCE_RAD <= value <= high + _LIMIT_TOLERANCE_RAD:
            return f"wanted {joint} within {low:.4f} to {high:.4f} rad, got {value:.4f} rad"
    return ""
