"""Goals: sets of configurations, and tool poses that become such sets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from humanpred_ros.errors import GoalUnreachableError, SceneError, SettingsError
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.robot.clearance import nearest_contacts
from humanpred_ros.robot.goals import Goal, ToolGoalSettings, tool_goal
from humanpred_ros.robot.inverse_kinematics import ToolPose
from humanpred_ros.robot.scene import load_scene


def test_one_configuration_is_a_set_of_one() -> None:
    goal = Goal("here", np.arange(7.0))
    assert goal.configurations.shape == (1, 7)
    np.testing.assert_array_equal(goal.configuration, np.arange(7.0))
    assert goal.task_cost == 0.0


def test_the_first_configuration_is_the_preferred_one() -> None:
    q = np.arange(6.0).reshape(2, 3)
    goal = Goal("either", q, task_cost=2)
    np.testing.assert_array_equal(goal.configuration, q[0])
    assert goal.task_cost == 2.0


def test_a_goal_cannot_be_changed_by_accident() -> None:
    q = np.zeros((2, 3))
    goal = Goal("fixed", q)
    q[0] = 1.0
    assert (goal.configurations == 0.0).all()
    with pytest.raises(ValueError, match="read-only"):
        goal.configurations[0, 0] = 1.0


@pytest.mark.parametrize(
    ("configurations", "cost", "words"),
    [
        ([], 0.0, "at least one configuration"),
        (np.empty((0, 7)), 0.0, "at least one configuration"),
        ([[1.0, 2.0], [3.0]], 0.0, "wanted numbers"),
        ([0.0, np.nan], 0.0, "finite"),
        ("home", 0.0, "wanted numbers"),
        (np.zeros((1, 2, 3)), 0.0, "wanted shape"),
        ([0.0], -0.1, "task_cost of at least 0, got -0.1"),
        ([0.0], np.inf, "task_cost: wanted finite"),
        ([0.0], [1.0, 2.0], "task_cost: wanted shape"),
    ],
)
def test_goals_that_make_no_sense_are_refused_by_name(configurations: Any, cost: Any, words: str) -> None:
    with pytest.raises(SceneError, match=f"goal 'odd'.*{words}"):
        Goal("odd", configurations, cost)


SCENE = load_scene("face_to_face")
ARM, START = SCENE.arm, SCENE.start
# Above the middle of the table, pointing down.
ABOVE = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, -0.7], [-1.0, 0.0, 0.0, 0.95], [0.0, 0.0, 0.0, 1.0]])
LOOSE: dict[str, Any] = {"position_tolerance_m": 0.02, "orientation_tolerance_rad": [np.pi, 0.3, 0.3]}


def lowered(by_m: float) -> np.ndarray:
    T = ABOVE.copy()
    T[2, 3] -= by_m
    return T


def test_every_configuration_finishes_the_task_and_touches_nothing() -> None:
    goal = tool_goal(ARM, "look down", ABOVE, START, task_cost=0.5, obstacles=SCENE.obstacles, **LOOSE)
    assert goal.name == "look down"
    assert goal.task_cost == 0.5
    q = goal.configurations
    assert 2 <= len(q) <= ToolGoalSettings().most
    target = ToolPose.within(ABOVE, LOOSE["position_tolerance_m"], LOOSE["orientation_tolerance_rad"])
    assert np.abs(target.error(ARM.chain.tool_pose(q))).max() < 1e-6
    for i, one in enumerate(q):
        ARM.check_configuration(one, f"configuration {i}")
    clearance = [contact.clearance_m for contact in nearest_contacts(ARM, SCENE.obstacles, q)]
    assert min(clearance) >= ToolGoalSettings().clearance_m


def test_configurations_are_spread_the_nearest_first() -> None:
    settings = ToolGoalSettings(separation=0.3)
    q = tool_goal(ARM, "g", ABOVE, START, obstacles=SCENE.obstacles, settings=settings, **LOOSE).configurations
    distance = ARM.configuration_distance(START, q)
    assert (np.diff(distance) >= 0.0).all()
    for i in range(1, len(q)):
        assert ARM.configuration_distance(q[i], q[:i]).min() >= 0.3
    one = tool_goal(ARM, "g", ABOVE, START, obstacles=SCENE.obstacles, settings=ToolGoalSettings(most=1), **LOOSE)
    np.testing.assert_array_equal(one.configurations, q[:1])


def test_the_same_task_gives_the_same_goal() -> None:
    first, again = (tool_goal(ARM, "g", ABOVE, START, obstacles=SCENE.obstacles, **LOOSE) for _ in range(2))
    np.testing.assert_array_equal(first.configurations, again.configurations)


def test_a_goal_configurations_tool_pose_gives_that_task_back() -> None:
    for goal in SCENE.goals:
        settings = ToolGoalSettings(clearance_m=0.0)
        T = ARM.chain.tool_pose(goal.configuration)
        found = tool_goal(ARM, goal.name, T, START, obstacles=SCENE.obstacles, settings=settings)
        np.testing.assert_allclose(
            ARM.chain.tool_pose(found.configurations), np.broadcast_to(T, (len(found.configurations), 4, 4)), atol=2e-6
        )
        known = float(ARM.configuration_distance(START, goal.configuration))
        assert float(ARM.configuration_distance(START, found.configuration)) <= known + 0.05


def test_out_of_reach_is_refused_with_how_close_it_came() -> None:
    far = ABOVE.copy()
    far[1, 3] = -3.0
    with pytest.raises(
        GoalUnreachableError,
        match=r"goal 'far': wanted the tool at \(0\.000, -3\.000, 0\.950\), got no configuration within the joint "
        r"limits; the closest stays [12]\.\d\d\d m and \d+\.\d deg beyond the tolerances; move",
    ):
        tool_goal(ARM, "far", far, START, **LOOSE)


def test_a_pose_in_the_table_is_refused_with_link_obstacle_and_depth() -> None:
    with pytest.raises(
        GoalUnreachableError,
        match=r"goal 'deep': wanted the arm at least 0\.020 m away from everything, got none of \d+ configurations "
        r"that reach the pose; the best has r_wrist_roll_link 0\.\d\d\d m deep in table; move",
    ):
        tool_goal(ARM, "deep", lowered(0.25), START, obstacles=SCENE.obstacles, **LOOSE)


def test_too_near_is_refused_too() -> None:
    post = Obstacle("post", Box(0.05, 0.05, 0.05), planar_pose(0.0, -0.7, 0.86))
    exact = {"position_tolerance_m": 0.0, "orientation_tolerance_rad": [np.pi, 0.0, 0.0]}
    with pytest.raises(GoalUnreachableError, match=r"best has r_wrist_roll_link 0\.\d\d\d m from post"):
        tool_goal(ARM, "near", ABOVE, START, obstacles=[post], settings=ToolGoalSettings(clearance_m=0.2), **exact)
    tool_goal(ARM, "near", ABOVE, START, obstacles=[post], settings=ToolGoalSettings(clearance_m=0.0), **exact)


def test_a_pose_inside_the_robot_is_refused_naming_its_own_link() -> None:
    names = {obstacle.name for obstacle in ARM.fixed_obstacles} | set(ARM.link_names)
    inside = ABOVE.copy()
    shoulder = ARM.chain.joint_origin_m[0] @ ARM.chain.T_world_root[:3, :3].T + ARM.chain.T_world_root[:3, 3]
    inside[:3, 3] = shoulder + np.array([0.0, -0.05, -0.3])
    with pytest.raises(GoalUnreachableError, match=r"goal 'self': .* m deep in (\w+);") as refusal:
        tool_goal(ARM, "self", inside, START, position_tolerance_m=0.01, orientation_tolerance_rad=np.pi)
    assert any(f"deep in {name};" in str(refusal.value) for name in names)


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ({"T_world_tool": np.zeros((4, 4))}, SceneError, "goal 'odd': tool pose: wanted a rigid"),
        ({"position_tolerance_m": -1.0}, SceneError, "goal 'odd': tool pose position"),
        ({"task_cost": -1.0}, SceneError, "goal 'odd': wanted a task_cost"),
        ({"start": np.full(7, 3.0)}, GoalUnreachableError, "start of goal 'odd': wanted r_shoulder_pan_joint"),
        ({"start": np.zeros(6)}, GoalUnreachableError, "start of goal 'odd': wanted shape"),
    ],
)
def test_nonsense_is_refused_by_name(wrong: dict[str, Any], error: type[Exception], words: str) -> None:
    arguments = {"T_world_tool": ABOVE, "start": START, **LOOSE, **wrong}
    with pytest.raises(error, match=words):
        tool_goal(ARM, "odd", **arguments)


@pytest.mark.parametrize("wrong", [{"most": 0}, {"separation": -1.0}, {"clearance_m": np.nan}])
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        ToolGoalSettings(**wrong)
