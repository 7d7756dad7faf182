"""Tasks of the robot: sets of configurations, given directly or found by inverse kinematics for a tool pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import GoalUnreachableError, SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.robot.arm import Arm
from humanpred_ros.robot.clearance import nearest_contacts
from humanpred_ros.robot.inverse_kinematics import InverseKinematicsSettings, ToolPose, solve_tool_pose, spread
from humanpred_ros.settings import Settings, setting


@dataclass(frozen=True, eq=False)
class Goal:
    """A task of the robot: bring the arm to any one of `configurations`.

    Raises:
        SceneError: for no configurations, values that are not finite, or a cost that is negative.
    """

    name: str  #: how scenes, messages and reports call it
    configurations: FloatArray  #: (K, J) rad, K >= 1, the preferred one first; one configuration (J,) becomes (1, J)
    #: what choosing this task costs beside disturbing the human, at least 0, in the unit of a goal's selection cost
    #: (human cost integrated over configuration distance)
    task_cost: float = 0.0

    def __post_init__(self) -> None:
        what = f"goal {self.name!r}"
        given = np.asarray(self.configurations, dtype=object)  # lists of different lengths are for `checked` to refuse
        if given.ndim < 2:
            given = given[None]
        configurations = checked(f"{what}: configurations", given, ("K", "J"), error=SceneError)
        if configurations.size == 0:
            raise SceneError(f"{what}: wanted at least one configuration, got shape {configurations.shape}")
        object.__setattr__(self, "configurations", frozen(configurations))
        cost = float(checked(f"{what}: task_cost", self.task_cost, (), error=SceneError))
        if cost < 0.0:
            raise SceneError(f"{what}: wanted a task_cost of at least 0, got {cost}; raise the others' instead")
        object.__setattr__(self, "task_cost", cost)

    @property
    def configuration(self) -> FloatArray:
        """The preferred configuration (J,) rad."""
        first: FloatArray = self.configurations[0]
        return first


class ToolGoalSettings(Settings):
    """Which solutions for a tool pose become a goal's configurations.

    A planner looks distances up on a lattice of 0.025 m: it would take a goal for a collision that touches nothing by
    less than half a cell's diagonal. The paths from the start to the goals of P1 are 0.3 to 1.4 long.
    """

    most: int = setting(6, "Configurations kept at most; the planner plans to each of them", low=1)
    separation: float = setting(0.25, "Configuration distance between any two that are kept", low=0.0)
    clearance_m: float = setting(0.02, "Least distance to everything", unit="m", low=0.0)
    inverse_kinematics: InverseKinematicsSettings = setting(InverseKinematicsSettings(), "How solutions are found")


def tool_goal(
    arm: Arm,
    name: str,
    T_world_tool: ArrayLike,
    start: ArrayLike,
    *,
    position_tolerance_m: ArrayLike = 0.0,
    orientation_tolerance_rad: ArrayLike = 0.0,
    task_cost: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    settings: ToolGoalSettings | None = None,
) -> Goal:
    """Return the goal of bringing the tool to a pose, as configurations that reach it and touch nothing.

    Args:
        arm: the arm, placed; its `tool_frame` is the tool.
        name: the goal's name.
        T_world_tool: (4, 4) wanted pose of the tool.
        start: (J,) rad; the nearest configuration to it becomes the goal's first, and continuous joints
            take the shorter way from it.
        position_tolerance_m: one number, or one along each axis of the wanted pose.
        orientation_tolerance_rad: one number, or one about each axis; pi leaves the tool free to turn about it.
        task_cost: as in `Goal`.
        obstacles: what the arm must not touch beside itself and its robot.

    Raises:
        GoalUnreachableError: naming the goal: no configuration within the joint limits reaches the pose (with
            how close the tool came), or all that do are in collision (with link, obstacle and depth).
        SceneError: for a pose that is not rigid or tolerances that are negative.
    """
    settings = settings or ToolGoalSettings()
    what = f"goal {name!r}"
    try:
        target = ToolPose.within(T_world_tool, position_tolerance_m, orientation_tolerance_rad)
    except SceneError as trouble:
        raise SceneError(f"{what}: {trouble}") from trouble
    start = arm.check_configuration(start, f"start of {what}")
    found = solve_tool_pose(arm, target, start, settings.inverse_kinematics)
    if len(found.configurations) == 0:
        place = ", ".join(f"{coordinate:.3f}" for coordinate in target.T_world_tool[:3, 3])
        raise GoalUnreachableError(
            f"{what}: wanted the tool at ({place}), got no configuration within the joint limits; the closest stays "
            f"{found.missing_m:.3f} m and {np.rad2deg(found.missing_rad):.1f} deg beyond the tolerances; move the "
            "goal or the robot, or widen the tolerances"
        )
    free = _free(arm, what, found.configurations, obstacles, settings.clearance_m)
    return Goal(name, spread(arm, free, settings.separation, settings.most), task_cost)


def _free(
    arm: Arm, what: str, configurations: FloatArray, obstacles: Sequence[Obstacle], clearance_m: float
) -> FloatArray:
    """Return those of the configurations (N, J) that keep their distance to everything."""
    contacts = nearest_contacts(arm, obstacles, configurations)
    clearance = np.array([contact.clearance_m for contact in contacts])
    if (clearance < clearance_m).all():
        best = contacts[int(np.argmax(clearance))]
        got = f"{-best.clearance_m:.3f} m deep in" if best.clearance_m < 0.0 else f"{best.clearance_m:.3f} m from"
        raise GoalUnreachableError(
            f"{what}: wanted the arm at least {clearance_m:.3f} m away from everything, got none of "
            f"{len(configurations)} configurations that reach the pose; the best has {best.link} {got} "
            f"{best.obstacle}; move the goal or the obstacle, or widen the tolerances"
        )
    free: FloatArray = configurations[clearance >= clearance_m]
    return free
