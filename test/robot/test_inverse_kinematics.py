"""Tool poses with tolerances, and the configurations that reach them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pr2 import pr2_arm
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import ArrayError, SceneError, SettingsError
from humanpred_ros.geometry.solids import planar_pose
from humanpred_ros.robot.inverse_kinematics import InverseKinematicsSettings, ToolPose, solve_tool_pose, spread

pytestmark = pytest.mark.core

SEED = st.integers(0, 100_000)


def pose(rotation: Rotation, position: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def random_poses(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack(
        [pose(Rotation.random(random_state=int(rng.integers(1 << 30))), rng.normal(size=3)) for _ in range(n)]
    )


WANTED = pose(Rotation.from_euler("xyz", [0.3, 1.2, -2.0]), [0.4, -0.2, 0.9])


@given(SEED, st.lists(st.sampled_from([0.0, 0.05, 0.4, np.pi]), min_size=3, max_size=3))
def test_the_nearest_pose_is_allowed_and_the_error_leads_to_it(seed: int, tolerance: list[float]) -> None:
    target = ToolPose.within(WANTED, [0.0, 0.1, 2.0], tolerance)
    poses = random_poses(seed, 8)
    nearest = target.nearest(poses)
    assert np.abs(target.error(nearest)).max() < 1e-6
    missing = target.error(poses)
    np.testing.assert_allclose(poses[:, :3, 3] + missing[:, :3], nearest[:, :3, 3], atol=1e-12)
    turned = Rotation.from_rotvec(missing[:, 3:]).as_matrix() @ poses[:, :3, :3]
    np.testing.assert_allclose(turned, nearest[:, :3, :3], atol=1e-7)
    shift = (nearest[:, :3, 3] - WANTED[:3, 3]) @ WANTED[:3, :3]
    assert (np.abs(shift) <= np.array([0.0, 0.1, 2.0]) + 1e-12).all()


@given(st.floats(-np.pi, np.pi), st.floats(-0.19, 0.19), st.floats(-0.19, 0.19), st.integers(0, 2))
def test_a_free_axis_may_turn_while_it_does_not_tilt(turn: float, tilt_a: float, tilt_b: float, axis: int) -> None:
    tolerance = np.full(3, 0.2)
    tolerance[axis] = np.pi
    target = ToolPose.within(WANTED, 0.0, tolerance)
    tilt = np.insert([tilt_a, tilt_b], axis, 0.0)
    about = np.eye(3)[axis] * turn
    inside = WANTED @ pose(Rotation.from_rotvec(tilt) * Rotation.from_rotvec(about))
    assert np.abs(target.error(inside)).max() < 1e-9
    # Tilting 0.5 rad instead of at most 0.2 leaves 0.3 rad, whatever the turn.
    outside = WANTED @ pose(Rotation.from_rotvec(0.5 * np.eye(3)[axis - 1]) * Rotation.from_rotvec(about))
    assert np.linalg.norm(target.error(outside)[3:]) == pytest.approx(0.3, abs=1e-9)
    assert np.abs(target.error(outside)[:3]).max() < 1e-12


def test_positions_are_measured_along_the_wanted_poses_axes() -> None:
    target = ToolPose.within(pose(Rotation.from_euler("z", np.pi / 2)), [0.1, 0.0, 0.0], np.pi)
    # The tool's x is the world's y.
    along, across = np.eye(4), np.eye(4)
    along[1, 3], across[0, 3] = 0.15, 0.15
    np.testing.assert_allclose(target.error(along)[:3], [0.0, -0.05, 0.0], atol=1e-12)
    np.testing.assert_allclose(target.error(across)[:3], [-0.15, 0.0, 0.0], atol=1e-12)


def test_tightening_never_goes_below_zero() -> None:
    target = ToolPose.within(WANTED, [0.0, 0.1, 0.2], 0.3).tightened(0.15)
    np.testing.assert_allclose(target.position_tolerance_m, [0.0, 0.0, 0.05])
    np.testing.assert_allclose(target.orientation_tolerance_rad, 0.15)


@pytest.mark.parametrize(
    ("T", "position", "orientation", "words"),
    [
        (np.eye(3), 0.0, 0.0, r"wanted shape \(4, 4\)"),
        (2.0 * np.eye(4), 0.0, 0.0, "rigid"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), 0.0, 0.0, "rigid"),
        (np.full((4, 4), np.nan), 0.0, 0.0, "finite"),
        (np.eye(4), -0.1, 0.0, "position_tolerance_m: wanted numbers of at least 0"),
        (np.eye(4), [0.1, 0.1], 0.0, "position tolerance: wanted shape"),
        (np.eye(4), 0.0, [0.1, -0.1, 0.0], "orientation_tolerance_rad: wanted numbers of at least 0"),
        (np.eye(4), 0.0, "free", "orientation tolerance: wanted numbers"),
        (np.eye(4), 0.0, np.inf, "orientation tolerance: wanted finite"),
    ],
)
def test_poses_that_make_no_sense_are_refused(T: Any, position: Any, orientation: Any, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        ToolPose.within(T, position, orientation)


ARM = pr2_arm(planar_pose(0.024, 0.018, 0.0, np.deg2rad(-90.54)))
START = np.deg2rad([-115.807877, 15.206147, -64.424, -104.86128, -24.20327, -66.399792, 159.720137])
MARGIN = InverseKinematicsSettings().limit_margin_rad
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
        assert ARM.configuration_distance(q[i], q[:i]).min() >= InverseKinematicsSettings().duplicate_distance


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
    other = solve_tool_pose(ARM, target, START, InverseKinematicsSettings(seed=1)).configurations
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
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        InverseKinematicsSettings(**wrong)


def test_a_start_that_is_no_configuration_is_refused() -> None:
    for start in (np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(ArrayError, match="start"):
            solve_tool_pose(ARM, ToolPose.within(np.eye(4), 0.0, 0.0), start)
