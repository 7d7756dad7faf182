"""What inverse kinematics returns reaches the pose within limits and tolerances, and what it cannot reach it says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.shapes import planar_pose
from humanpred_ros.robot.inverse_kinematics import InverseKinematicsConfig, solve_tool_pose, spread
from humanpred_ros.robot.pr2 import Pr2Arm
from humanpred_ros.robot.tool_pose import ToolPose

ARM = Pr2Arm(planar_pose(0.024, 0.018, 0.0, np.deg2rad(-90.54)))
START = np.deg2rad([-115.807877, 15.206147, -64.424, -104.86128, -24.20327, -66.399792, 159.720137])
MARGIN = InverseKinematicsConfig().limit_margin_rad
LOWER = np.where(ARM.chain.continuous, -np.pi, ARM.chain.lower + MARGIN)
UPPER = np.where(ARM.chain.continuous, np.pi, ARM.chain.upper - MARGIN)

CONFIGURATION = st.integers(0, 100_000).map(lambda seed: np.random.default_rng(seed).uniform(LOWER, UPPER))


def check(q: np.ndarray, target: ToolPose) -> None:
    """Fail unless the configurations (K, 7) are what is promised of solutions."""
    error = target.error(ARM.chain.tool_pose(q)).reshape(-1, 3)
    assert np.linalg.norm(error, axis=1).max() <= 1.01e-6, "m and rad"
    turns = ARM.chain.continuous
    assert (q[:, ~turns] >= LOWER[~turns] - 1e-12).all()
    assert (q[:, ~turns] <= UPPER[~turns] + 1e-12).all()
    assert np.abs(q - START)[:, turns].max() <= np.pi + 1e-12
    distance = ARM.configuration_distance(START, q)
    assert (np.diff(distance) >= -1e-12).all()
    for i in range(1, len(q)):
        assert ARM.configuration_distance(q[i], q[:i]).min() >= InverseKinematicsConfig().duplicate_distance


@settings(max_examples=25)
@given(CONFIGURATION)
def test_every_reachable_pose_is_reached_exactly(q: np.ndarray) -> None:
    target = ToolPose.within(ARM.chain.tool_pose(q), 0.0, 0.0)
    found = solve_tool_pose(ARM, target, START)
    assert len(found.configurations) >= 1
    assert (found.missing_m, found.missing_rad) == (0.0, 0.0)
    check(found.configurations, target)


@settings(max_examples=15)
@given(CONFIGURATION, st.integers(0, 2))
def test_tolerances_are_used_and_kept(q: np.ndarray, free: int) -> None:
    T = ARM.chain.tool_pose(q)
    tolerance = np.full(3, 0.1)
    tolerance[free] = np.pi
    target = ToolPose.within(T, [0.0, 0.01, 0.05], tolerance)
    found = solve_tool_pose(ARM, target, START).configurations
    check(found, target)
    assert len(found) > 5
    shift = (ARM.chain.tool_pose(found)[:, :3, 3] - T[:3, 3]) @ T[:3, :3]
    assert (np.abs(shift) <= [1.01e-6, 0.01, 0.05]).all(), "not a hair beyond where there is a tolerance"
    axis = ARM.chain.tool_pose(found)[:, :3, free] @ T[:3, free]
    assert axis.min() > np.cos(0.1 * np.sqrt(2.0)) - 1e-9, "the free axis does not tilt"


@pytest.mark.parametrize("seed", range(8))
def test_the_nearest_solution_is_no_farther_than_a_known_one(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(LOWER, UPPER)
    found = solve_tool_pose(ARM, ToolPose.within(ARM.chain.tool_pose(q), 0.0, 0.0), START)
    nearest = float(ARM.configuration_distance(START, found.configurations[0]))
    assert nearest <= float(ARM.configuration_distance(START, q)) + 0.05


def test_where_the_arm_already_is_the_start_comes_first() -> None:
    found = solve_tool_pose(ARM, ToolPose.within(ARM.chain.tool_pose(START), 0.0, 0.0), START)
    np.testing.assert_allclose(found.configurations[0], START, atol=1e-6)


def test_the_same_question_has_the_same_answer() -> None:
    target = ToolPose.within(ARM.chain.tool_pose(np.full(7, -0.5)), 0.01, 0.1)
    first, again = (solve_tool_pose(ARM, target, START).configurations for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = solve_tool_pose(ARM, target, START, InverseKinematicsConfig(seed=1)).configurations
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_out_of_reach_says_by_how_much() -> None:
    shoulder, radius = ARM.reach
    T = np.eye(4)
    T[:3, 3] = shoulder - 3.0 * np.eye(3)[1]
    found = solve_tool_pose(ARM, ToolPose.within(T, 0.0, np.pi), START)
    assert found.configurations.shape == (0, 7)
    assert 3.0 - radius < found.missing_m < 3.0 - 0.8 * radius
    assert found.missing_rad == pytest.approx(0.0, abs=1e-3)
    # With a tolerance that large it is reached.
    assert len(solve_tool_pose(ARM, ToolPose.within(T, 3.0, np.pi), START).configurations) > 0


def test_an_orientation_that_no_joint_allows_is_told_as_an_angle() -> None:
    shoulder, radius = ARM.reach
    # Nearly at full stretch and pointing back.
    T = planar_pose(*(shoulder - 0.9 * radius * np.eye(3)[1]), np.pi / 2)
    found = solve_tool_pose(ARM, ToolPose.within(T, 0.02, 0.1), START)
    assert len(found.configurations) == 0
    assert found.missing_m > 0.05 or found.missing_rad > 0.5


def test_spread_keeps_the_first_ones_apart() -> None:
    q = START + np.linspace(0.0, 1.0, 101)[:, None] * np.eye(7)[0]
    kept = spread(ARM, q, 0.1)
    np.testing.assert_array_equal(kept[0], START)
    assert np.diff(kept[:, 0] * 0.54).min() >= 0.1
    assert np.diff(kept[:, 0] * 0.54).max() <= 0.1 + 0.54 * 0.01 + 1e-12
    assert len(spread(ARM, q, 0.1, most=2)) == 2
    assert spread(ARM, q[:0], 0.1).shape == (0, 7)


@pytest.mark.parametrize(
    "wrong", [{"n_seeds": 0}, {"n_iterations": 0}, {"limit_margin_rad": -0.1}, {"duplicate_distance": np.nan}]
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        InverseKinematicsConfig(**wrong)


def test_a_start_that_is_no_configuration_is_refused() -> None:
    for start in (np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(ArrayError, match="start"):
            solve_tool_pose(ARM, ToolPose.within(np.eye(4), 0.0, 0.0), start)
