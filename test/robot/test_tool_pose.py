"""A tool pose says for every pose how far it is from being good enough."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import SceneError
from humanpred_ros.robot.tool_pose import ToolPose

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
