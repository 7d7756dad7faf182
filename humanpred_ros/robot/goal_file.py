"""The goals of a scene file: a task stands there as a configuration or as a tool pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.chain import axis_rotation
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.shapes import Obstacle
from humanpred_ros.robot.goal import Goal
from humanpred_ros.robot.pr2 import Pr2Arm
from humanpred_ros.robot.scene_file import Section
from humanpred_ros.robot.tool_goal import tool_goal

GOAL_KEYS = ("name", "configuration_angle", "tool_pose", "task_cost")
_TOOL_KEYS = ("position_m", "orientation_angle", "position_tolerance_m", "orientation_tolerance_angle")


def parse_goals(
    entries: Sequence[Section], arm: Pr2Arm, start: FloatArray, obstacles: Sequence[Obstacle]
) -> tuple[Goal, ...]:
    """Return the goals of a scene.

    Args:
        entries: the goals' sections, with `GOAL_KEYS`.
        start: (7,) rad, from which tool poses are solved.
        obstacles: what solutions for tool poses must not touch beside the robot.

    Raises:
        SceneError: for missing or unknown keys and impossible values.
        GoalUnreachableError: for a tool pose that no configuration reaches without collision.
    """
    return tuple(_goal(entry, arm, start, obstacles) for entry in entries)


def _goal(entry: Section, arm: Pr2Arm, start: FloatArray, obstacles: Sequence[Obstacle]) -> Goal:
    name = entry.text("name")
    task_cost = entry.number("task_cost") if "task_cost" in entry else 0.0
    if ("configuration_angle" in entry) == ("tool_pose" in entry):
        got = "both" if "tool_pose" in entry else "neither"
        raise SceneError(
            f"{entry.where}: wanted either configuration_rad or configuration_deg or tool_pose, got {got}; "
            "state the task in one way"
        )
    if "tool_pose" not in entry:
        return Goal(name, entry.angles("configuration", arm.chain.n_joints), task_cost)
    tool = entry.section("tool_pose", _TOOL_KEYS)
    T_world_tool = np.eye(4)
    # Roll, pitch and yaw about the world's x, y and z, one after the other, as in a URDF.
    for axis, angle in zip(np.eye(3), tool.angles("orientation", 3), strict=True):
        T_world_tool[:3, :3] = axis_rotation(axis, angle) @ T_world_tool[:3, :3]
    T_world_tool[:3, 3] = tool.numbers("position_m", 3)
    return tool_goal(
        arm,
        name,
        T_world_tool,
        start,
        position_tolerance_m=tool.each("position_tolerance_m", 3),
        orientation_tolerance_rad=tool.each_angle("orientation_tolerance", 3),
        task_cost=task_cost,
        obstacles=obstacles,
    )
